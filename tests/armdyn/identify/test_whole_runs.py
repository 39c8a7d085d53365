"""Sets of effects that are compared by what they leave of whole runs, with errors made by hand."""

from types import SimpleNamespace as Plain

import numpy as np
import pytest

from armdyn.identify import whole_runs
from armdyn.identify.selection.candidate import Candidate
from armdyn.identify.settings import DEFAULT_SETTINGS

LOAD, DRY, DRAG, BIAS = (Candidate.of(name, {"": (f"{name}.size",)}) for name in ("load", "dry", "drag", "bias"))
TRAINING, HELD_OUT = 0, 1


class Fitted(frozenset):
    """A fit of a set of effects, far above the noise."""

    at_bound = ()

    chi2_per_sample = 100.0


class Runs:
    """A study whose fits leave what a table says; an effect is worth as much evidence as another table says."""

    present: tuple[Candidate, ...] = ()
    model = Plain(guessed_parameters=())
    settings = DEFAULT_SETTINGS
    asked: frozenset[str] = frozenset()
    held_out = ("held out",)
    candidates = (LOAD, DRY, DRAG, BIAS)

    def __init__(self, left, evidence):
        self._left = {frozenset(key): np.array(value) for key, value in left.items()}
        self._evidence = evidence

    def quick_fit(self, effects):
        return Fitted(effects)

    def fit_base_with_effects(self, effects):
        return Fitted(effects)

    def excess(self, fit):
        return self._left.get(fit, np.array([100.0, 100.0]))

    def left(self, effects):
        return float(self.excess(frozenset(effects)).sum())

    def foretold_costs(self, effects, further):
        return {c: self.left((*effects, c)) for c in further}

    def residual_may_be_noise(self, fit):
        return bool(np.all(self.excess(fit) < 0.1))

    def evaluate(self, effects):
        effects = tuple(c for c in self.candidates if c in set(effects))
        return Plain(effects=effects, score=sum(self._evidence[c] for c in effects))

    optimise = evaluate


@pytest.fixture
def all_are_there(monkeypatch):
    """No effect ends at nothing."""
    monkeypatch.setattr(whole_runs, "_distance", lambda *_: np.ones(1))
    monkeypatch.setattr(whole_runs, "_is_nothing", lambda *_: False)


def chosen(left, evidence, *effects):
    runs = Runs(left, {LOAD: 0.0, DRY: 0.0, DRAG: 0.0, BIAS: 0.0, **evidence})
    return set(whole_runs.improve_effect_set_by_run_errors(runs, runs, runs.evaluate(effects), lambda _: None).effects)


EVIDENCE = {LOAD: 50.0, DRY: 40.0}


@pytest.mark.parametrize(
    ("rival", "kept"),
    [
        ((3.0, 4.0), DRY),
        ((7.0, 9.9), LOAD),  # better in training alone
        ((9.0, 9.0), LOAD),  # better by little
    ],
)
@pytest.mark.usefixtures("all_are_there")
def test_a_rival_that_leaves_clearly_less_of_every_kind_of_runs_takes_the_place_of_what_evidence_prefers(rival, kept):
    left = {(): (50.0, 50.0), (LOAD, DRAG): (10.0, 10.0), (DRY, DRAG): rival, (LOAD,): (12.0, 12.0), (DRAG,): (60, 60)}
    assert chosen(left, {**EVIDENCE, DRAG: 30.0}, LOAD, DRAG) == {kept, DRAG}


@pytest.mark.usefixtures("all_are_there")
def test_a_pair_that_leaves_much_less_than_one_effect_is_taken_also_where_training_runs_leave_little():
    left = {(): (5.0, 50.0), (LOAD,): (0.5, 9.0), (DRY, DRAG): (0.4, 1.0)}
    assert chosen(left, EVIDENCE, LOAD) == {DRY, DRAG}


@pytest.mark.parametrize(("pair", "kept"), [(11.0, {DRY, DRAG}), (13.0, {LOAD, BIAS, DRAG})])
@pytest.mark.usefixtures("all_are_there")
def test_a_set_gives_way_to_a_pair_beside_which_its_further_value_explains_little_of_gross_errors(pair, kept):
    left = {(LOAD, BIAS, DRAG): (10.0, 10.0), (DRY, DRAG): (pair, pair)}
    assert chosen(left, {**EVIDENCE, BIAS: 30.0, DRAG: 20.0}, LOAD, BIAS, DRAG) == kept


@pytest.mark.usefixtures("all_are_there")
def test_starts_are_searched_for_effects_whose_evidence_is_near_the_best(monkeypatch):
    searched = []

    def fitted(_runs, effects):
        searched.append(set(effects))
        return Fitted(effects)

    monkeypatch.setattr(Runs, "fit_base_with_effects", fitted)
    monkeypatch.setattr(Runs, "model", Plain(guessed_parameters=("mass",)))
    left = {
        (): (50.0, 50.0),
        (LOAD, BIAS): (10.0, 10.0),
        (LOAD,): (12.0, 12.0),
        (DRY,): (14.0, 14.0),
        (DRAG,): (13.0, 13.0),
    }
    runs = Runs(left, {**EVIDENCE, DRAG: 20.0, BIAS: 0.0})
    runs.squared_error = lambda fit: float(runs.excess(fit).sum())
    whole_runs.improve_effect_set_by_run_errors(runs, runs, runs.evaluate((LOAD, BIAS)), lambda _: None)
    assert {LOAD} in searched
    assert {DRY} in searched
    assert {DRAG} not in searched


@pytest.mark.usefixtures("all_are_there")
def test_what_makes_held_out_runs_worse_goes():
    left = {(): (50.0, 50.0), (LOAD, BIAS): (0.05, 0.09), (LOAD,): (0.06, 0.0), (BIAS,): (40.0, 40.0)}
    assert chosen(left, {**EVIDENCE, BIAS: 20.0}, LOAD, BIAS) == {LOAD}


def test_what_ends_at_nothing_goes_also_where_the_error_is_larger_without_it(monkeypatch):
    """A gripper's scale that an uncertain gravity explains as well."""
    monkeypatch.setattr(whole_runs, "_distance", lambda *_: np.ones(1))
    monkeypatch.setattr(whole_runs, "_is_nothing", lambda _study, _fit, _set, one: one is BIAS)
    left = {(LOAD, BIAS): (0.01, 0.01), (LOAD,): (0.2, 0.2)}
    assert chosen(left, {**EVIDENCE, BIAS: 20.0}, LOAD, BIAS) == {LOAD}


@pytest.mark.parametrize(("remains", "more"), [(0.8, {DRAG}), (0.9, set())])
@pytest.mark.usefixtures("all_are_there")
def test_what_explains_more_than_a_little_of_gross_errors_is_added(remains, more):
    """Evidence prefers the pair: process noise excuses what the third one explains."""
    left = {(): (60.0, 60.0), (LOAD, DRY): (10.0, 10.0), (LOAD, DRY, DRAG): (10.0 * remains, 10.0 * remains)}
    assert chosen(left, {**EVIDENCE, DRAG: -30.0}, LOAD, DRY) == {LOAD, DRY} | more


def nothing(monkeypatch, value, runs, rise=0.0):
    """Whether a bias is, which is `value` standard deviations large."""
    runs.motion = Plain(threshold_values={"dry.size": 3.0})
    problem = Plain(
        mask_of_unknowns=lambda names: np.array([name.startswith(("bias", "dry")) for name in ("load.size", *names)]),
        null=np.zeros(2),
    )
    found = Plain(problem=problem, free=np.ones(2, dtype=bool), values=np.array([5.0, 3.0 * value]))
    certain = Plain(covariance=np.diag([1.0, 9.0]), std_inflation=1.0)
    monkeypatch.setattr(whole_runs, "uncertainty", lambda *_: certain)
    monkeypatch.setattr(whole_runs, "_rise", lambda *_: rise)
    return lambda one: whole_runs._is_nothing(runs, found, (LOAD, one), one)


@pytest.mark.parametrize(("value", "stays"), [(1.9, False), (2.1, True)])
def test_a_value_within_two_standard_deviations_of_nothing_goes(monkeypatch, value, stays):
    assert nothing(monkeypatch, value, Runs({}, {}))(BIAS) is not stays


def test_a_value_that_is_uncertain_with_all_others_stays_where_they_do_not_allow_its_absence(monkeypatch):
    assert nothing(monkeypatch, 1.0, Runs({}, {}), rise=3.0)(BIAS)
    assert not nothing(monkeypatch, 1.0, Runs({}, {}), rise=5.0)(BIAS)


@pytest.mark.parametrize(("without", "stays"), [(11.0, False), (12.0, True)])
def test_an_effect_with_a_place_goes_where_whole_runs_are_predicted_as_well_without_it(monkeypatch, without, stays):
    runs = Runs({(LOAD, DRY): (10.0, 10.0), (LOAD,): (without, without), (LOAD, BIAS): (10.0, 10.0)}, {})
    is_nothing = nothing(monkeypatch, 1.0, runs)
    assert is_nothing(DRY) is not stays
    assert is_nothing(BIAS)
