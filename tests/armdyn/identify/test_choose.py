"""Where the way to a set ends, and what ties with its steps."""

from types import SimpleNamespace as Plain

import numpy as np
import pytest

from armdyn.experiments.rivals import undistinguished_effect_sets
from armdyn.identify.selection.candidate import Candidate, group_by_effect
from armdyn.identify.selection.path import SearchStep
from armdyn.identify.selection.search import Search, drop_small_steps
from armdyn.identify.settings import DEFAULT_SETTINGS


@pytest.mark.parametrize(
    ("left", "asked", "kept"),
    [
        ((9.0, 3.0, 2.9), (), 2),  # the last one lowers the error by a thirtieth
        ((9.0, 3.0, 2.5), (), 3),
        ((9.0, 3.0, 2.9), ("drift",), 3),  # an experiment was made to see it
        ((9.0, 0.1, 0.1), (), 3),  # at the noise no error shows what contradicts a weighed mass
    ],
)
def test_the_way_ends_where_each_further_value_lowers_the_error_by_little(left, asked, kept):
    added = ((), (Plain(effect="drag"),), (Plain(effect="drift"),))
    steps = [
        Plain(added=a, fit=Plain(left=x, free=np.ones(k))) for k, (a, x) in enumerate(zip(added, left, strict=True))
    ]
    study = Plain(
        asked=asked,
        settings=DEFAULT_SETTINGS,
        squared_error=lambda fit: fit.left,
        residual_may_be_noise=lambda fit: fit.left < 0.2,
    )
    assert drop_small_steps(study, steps) == steps[:kept]


def on(effect, *joints):
    return Candidate.of(effect, {joint: (f"{effect}.size[{joint}]",) for joint in joints})


@pytest.fixture
def found():
    """Dry friction on a shoulder and then on an elbow, each with a rival; what came between is gone at the end."""
    dry = on("dry", "shoulder"), on("dry", "elbow")
    ends = [(), (dry[0],), (dry[0], on("offset", "elbow")), group_by_effect(dry)]
    added = [(), (dry[0],), (on("offset", "elbow"),), (dry[1],)]
    ties = [(), (on("viscous", "shoulder"),), (on("drift", "elbow"),), (on("viscous", "elbow"), on("dry", "shoulder"))]
    return Search(tuple(SearchStep(a, t, e, None, None) for a, t, e in zip(added, ties, ends, strict=True)))


def test_ties_of_joints_that_came_one_after_the_other_are_kept(found):
    assert set(found.all_ties) == {on("viscous", "shoulder"), on("viscous", "elbow")}


def test_a_rival_takes_the_place_of_what_it_is_tied_with_on_its_joint_only(found):
    chosen, *rivals = undistinguished_effect_sets(Plain(search=found))
    assert chosen == (on("dry", "shoulder", "elbow"),)
    assert rivals == [(on("dry", "elbow"), on("viscous", "shoulder")), (on("dry", "shoulder"), on("viscous", "elbow"))]
