"""What a search puts first, where the model's own error is left."""

from types import SimpleNamespace as Plain

import numpy as np
import pytest

from armdyn.experiments.rivals import tied_sets
from armdyn.identify.candidate import Candidate, merged
from armdyn.identify.choose import best_set
from armdyn.identify.search import Search, without_little
from armdyn.identify.summed import Summed
from armdyn.identify.way import Step


class Set(Plain):
    """An appraisal, as far as it is looked at."""

    __hash__ = object.__hash__


LIMITED = Plain(complete=False)


NOTHING = Plain(overall=1.0)


def option(name, overall, values, *, effects=1, worth=0.0):
    return Set(name=name, overall=overall, free=np.ones(values), effects=(name,) * effects, worth=worth)


@pytest.mark.parametrize(
    ("simple", "first"),
    [
        (option("spring", 0.10, 2), "spring"),  # 0.77 of what the link explains, with 2 values in place of 10
        (option("spring", 0.20, 2), "link"),
        (option("gains of four joints", 0.10, 4, effects=4), "link"),
        (option("payload", 0.06, 10, worth=1.0), "link"),  # as many values: what explains more comes first
        (option("payload", 0.20, 4, worth=1.0), "payload"),  # half of it, but surer, as where wrists tell
        (option("payload", 0.30, 4, worth=1.0), "link"),
    ],
)
def test_few_values_that_explain_nearly_as_much_come_first_but_not_many_effects(simple, first):
    assert best_set(LIMITED, NOTHING, [option("link", 0.05, 10), simple]).name == first


def test_what_stands_in_is_compared_in_its_turn():
    links, link, payload = option("links", 0.018, 20, effects=2), option("link", 0.045, 10), option("payload", 0.064, 4)
    assert best_set(LIMITED, NOTHING, [links, link, payload]).name == "payload"


def test_where_nothing_explains_anything_what_does_most_harm_is_not_simpler():
    worse = [option("offset", 1.05, 1), option("link", 1.01, 10)]
    assert best_set(LIMITED, NOTHING, worse).name == "link"


def test_at_the_noise_the_worth_decides():
    noise = Plain(complete=True)
    options = [option("link", 0.05, 10, worth=3.0), option("spring", 0.5, 2, worth=4.0)]
    assert best_set(noise, NOTHING, options).name == "spring"


@pytest.mark.parametrize(
    ("left", "values", "wanted"), [(2.0, 2, True), (4.0, 2, False), (3.0, 1, True), (5.0, 1, False)]
)
def test_beside_one_strong_effect_a_second_is_wanted_that_explains_most_of_what_is_left(left, values, wanted):
    given, strong = Plain(overall=100.0), Plain(overall=10.0, free=np.ones(1))
    appraiser = Plain(complete=False, surely=lambda *_: False, _always=np.zeros(1), of={(): given}.get)
    assert Summed.useful(appraiser, Plain(overall=left, free=np.ones(1 + values)), strong) is wanted


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
    study = Plain(asked=asked, squared_error=lambda fit: fit.left, is_at_noise=lambda fit: fit.left < 0.2)
    assert without_little(study, steps) == steps[:kept]


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
    chosen, *rivals = tied_sets(Plain(search=found))
    assert chosen == (on("dry", "shoulder", "elbow"),)
    assert rivals == [(on("dry", "elbow"), on("viscous", "shoulder")), (on("dry", "shoulder"), on("viscous", "elbow"))]
