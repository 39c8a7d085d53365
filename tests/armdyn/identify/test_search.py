"""What a search says of its way: effects that the runs cannot tell apart, of effects that came one joint at a time."""

from types import SimpleNamespace

import pytest

from armdyn.experiments.rivals import tied_sets
from armdyn.identify.candidate import Candidate, merged
from armdyn.identify.search import Search
from armdyn.identify.way import Step


def on(effect, *joints):
    return Candidate.of(effect, {joint: (f"{effect}.size[{joint}]",) for joint in joints})


@pytest.fixture
def found():
    """Dry friction on a shoulder and then on an elbow, each with a rival; what came between is gone at the end."""
    dry = on("dry", "shoulder"), on("dry", "elbow")
    ends = [(), (dry[0],), (dry[0], on("offset", "elbow")), merged(dry)]
    added = [(), (dry[0],), (on("offset", "elbow"),), (dry[1],)]
    ties = [(), (on("viscous", "shoulder"),), (on("drift", "elbow"),), (on("viscous", "elbow"), on("dry", "shoulder"))]
    return Search(tuple(Step(a, t, e, None, None) for a, t, e in zip(added, ties, ends, strict=True)))


def test_ties_of_joints_that_came_one_after_the_other_are_kept(found):
    assert set(found.tied) == {on("viscous", "shoulder"), on("viscous", "elbow")}


def test_a_rival_takes_the_place_of_what_it_is_tied_with_on_its_joint_only(found):
    chosen, *rivals = tied_sets(SimpleNamespace(search=found))
    assert chosen == (on("dry", "shoulder", "elbow"),)
    assert rivals == [(on("dry", "elbow"), on("viscous", "shoulder")), (on("dry", "shoulder"), on("viscous", "elbow"))]
