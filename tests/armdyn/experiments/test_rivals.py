"""From a diagnosis to hypotheses; the recordings come from equations of their own."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from worlds.pendulum import Setup, record, weighed

from armdyn.effects.catalogue import CATALOGUE
from armdyn.errors import InputError, UnknownNameError
from armdyn.experiments.hypothesis import PlannedExperiment
from armdyn.experiments.limits import GripperLimits
from armdyn.experiments.plan import other_experiments, plan_experiment
from armdyn.experiments.rivals import (
    NO_EFFECT_NAME,
    require_plannable,
    rival_values_of_worst_parameter,
    rivals_by_name,
    rivals_of_diagnosis,
    rivals_refitted_to,
)
from armdyn.experiments.separation import expected_outcome
from armdyn.identify.compare import compare
from armdyn.identify.diagnose import diagnose
from armdyn.identify.studies import make_study
from armdyn.pendulum.model import pendulum_model
from armdyn.recording.channels import Channel
from armdyn.recording.units import KnownQuantity
from armdyn.run import Run

FRICTIONS = [CATALOGUE[n] for n in ("pivot_viscous_friction", "linear_drag", "wind", "path_tilt")]


def study_of(hidden, effects=FRICTIONS, seed=5, noise=5e-3):
    run = record("a.csv", Setup(hidden=hidden, duration=6.0, force_noise=noise), np.random.default_rng(seed))
    run = weighed(run, KnownQuantity(0.08, 8e-4, "kg"), KnownQuantity(0.368, 3e-3, "m"))
    return make_study(pendulum_model(0.36, 0.08), [run], [], effects)


@pytest.fixture(scope="module")
def windy():
    return study_of({"wind": 0.02})


def test_ties_become_hypotheses_with_what_the_runs_say_of_their_values(windy):
    found = rivals_of_diagnosis(windy, diagnose(windy))
    assert found is not None
    assert {h.name for h in found.hypotheses} == {"wind", "path_tilt"}
    assert found.hypotheses[0].misfit == 0.0
    assert 0.0 <= found.hypotheses[1].misfit < 6.0  # else it would be no tie
    assert found.noise["load_force"] == pytest.approx(5e-3, rel=0.15)
    for h in found.hypotheses:
        own = next(i for i, name in enumerate(h.free) if name.startswith(h.name))
        std = np.linalg.inv(h.information)[own, own] ** 0.5
        truth = {"wind": 0.02, "path_tilt": np.arctan(0.02 / (0.08 * 9.81))}[h.name]
        assert abs(h.model.value(h.free[own]) - truth) < 5.0 * std
    again = rivals_refitted_to(windy, [("path_tilt",), ("wind",)])
    assert {h.name: round(h.misfit, 6) for h in again.hypotheses} == {
        h.name: round(h.misfit, 6) for h in found.hypotheses
    }


def test_one_name_stands_against_no_effect(windy):
    found = rivals_by_name(windy, ["wind"])
    assert {h.name for h in found.hypotheses} == {"wind", NO_EFFECT_NAME}
    assert found.hypotheses[0].name == "wind"  # there is wind
    assert found.hypotheses[1].misfit > 20.0


def test_an_effect_that_the_runs_do_not_see_is_as_large_as_they_allow():
    found = rivals_by_name(study_of({}), ["pivot_viscous_friction", "linear_drag"])
    for h in found.hypotheses:
        name = next(n for n in h.free if "." in n)
        size, p = h.model.value(name), h.model.parameters[name]
        assert 0.0 < size <= p.typical  # at 0 both would be the same


def test_what_is_determined_worst_is_asked_for_where_nothing_ties():
    study = study_of({"linear_drag": 0.03}, [CATALOGUE["linear_drag"]], noise=0.02)
    found = rival_values_of_worst_parameter(study, diagnose(study))
    assert found is not None
    first, second = found.hypotheses
    assert "=" in first.name
    assert second.misfit == pytest.approx(4.0)  # two standard deviations away
    angle = PlannedExperiment(
        "angle_sensor", "", other_experiments(found, 5.0)[0].motion, {**found.noise, "swing_angle": 1e-3}
    )
    alone = PlannedExperiment("motion", "", angle.motion, found.noise)
    assert expected_outcome(found.hypotheses, angle).separation > expected_outcome(found.hypotheses, alone).separation


def test_only_what_was_not_done_is_proposed(windy):
    found = rivals_by_name(windy, ["wind", "path_tilt"])
    kinds = [e.kind for e in other_experiments(found, 5.0)]
    assert {"mass", "length", "angle_sensor", "measure", "turn", "rest"} <= set(kinds)
    assert "weigh" not in kinds  # it was, to 1 %
    seen = replace(found, noise={**found.noise, "swing_angle": 5e-3})
    assert "angle_sensor" not in [e.kind for e in other_experiments(seen, 5.0)]
    unweighed = replace(found, last=replace(found.last, known={}))
    assert "weigh" in [e.kind for e in other_experiments(unweighed, 5.0)]


def test_names_that_cannot_be_rivals_are_refused(windy, complains):
    with complains(UnknownNameError):
        rivals_by_name(windy, ["nonsense"])
    arm = SimpleNamespace(base="arm", hangs_from_gripper=False, open_questions=())
    with complains(InputError):
        require_plannable(SimpleNamespace(model=arm, runs=()))
    time = np.arange(20.0)
    free = Run("free.csv", {"swing_angle": Channel(time, np.sin(time), "rad")})
    require_plannable(SimpleNamespace(model=windy.model, runs=(free,)))
    with complains(InputError):
        require_plannable(SimpleNamespace(model=windy.model, runs=(*windy.runs, free)))
    blind = Run("blind.csv", {"swing_rate": Channel(time, np.sin(time), "rad/s")})
    with complains(InputError):
        require_plannable(SimpleNamespace(model=windy.model, runs=(blind,)))


def decaying(seconds=12.0, angle=0.25, length=0.5, seed=3):
    """A swing below a fixed pivot by scipy, with friction of the pivot in proportion to the speed."""
    time = np.arange(0.0, seconds, 0.03)

    def rates(_, y):
        return [y[1], -9.81 / length * np.sin(y[0]) - 0.002 / (0.1 * length**2) * y[1]]

    swing = solve_ivp(rates, (0.0, seconds), (angle, 0.0), t_eval=time, rtol=1e-9).y[0]
    noise = 4e-3 * np.random.default_rng(seed).standard_normal(len(time))
    return Run("free.csv", {"swing_angle": Channel(time, swing + noise, "rad")})


@pytest.mark.parametrize(
    ("names", "best", "useless"),
    [
        # A force at the load over m l^2 does not depend on the length, a torque of the pivot does.
        (("linear_drag", "pivot_viscous_friction"), {"length"}, {"larger", "smaller", "longer", "mass"}),
        # Dry friction ends a swing, and a drag that grows with the square of the speed hardly slows a small one.
        (("pivot_coulomb_friction", "quadratic_drag"), {"larger", "smaller", "longer", "length"}, {"weigh"}),
    ],
)
def test_below_a_fixed_pivot_other_swings_are_compared(names, best, useless):
    model = pendulum_model(0.5, 0.1).with_prior("length", 0.5, 0.002)
    effects = [CATALOGUE[name] for name in names]
    rivals = rivals_by_name(make_study(model, [decaying()], [], effects), list(names))
    plan = plan_experiment(rivals)
    assert plan.motion is None
    separation = {p.experiment.kind: p.expected.separation for p in plan.proposals}
    assert plan.proposals[0].experiment.kind in best
    assert all(separation[kind] < 1.0 for kind in useless)


def test_no_swing_beyond_the_limit_of_its_user_is_proposed():
    model, names = pendulum_model(0.5, 0.1), ["linear_drag", "quadratic_drag"]
    rivals = rivals_by_name(make_study(model, [decaying()], [], [CATALOGUE[name] for name in names]), names)
    limits = GripperLimits(swing=0.4)
    kinds = [{p.experiment.kind for p in plan_experiment(rivals, limits=given).proposals} for given in (None, limits)]
    assert kinds[0] - kinds[1] == {"larger"}  # from .5 rad, and the recorded swing began at .25


def test_the_swing_that_is_proposed_separates_as_much_as_was_promised():
    """The right one of two rivals fits a recording of the proposed experiment, made by scipy; the other does not."""
    model = pendulum_model(0.5, 0.1).with_prior("length", 0.5, 0.002)
    names = ["linear_drag", "pivot_viscous_friction"]
    effects = [CATALOGUE[name] for name in names]
    plan = plan_experiment(rivals_by_name(make_study(model, [decaying()], [], effects), names))
    shorter = plan.proposals[0].experiment.changed["length"][0]
    second = weighed(
        decaying(length=shorter, seed=4), KnownQuantity(0.1, 1e-4, "kg"), KnownQuantity(shorter, 1e-3, "m")
    )
    first = weighed(decaying(), KnownQuantity(0.1, 1e-4, "kg"), KnownQuantity(0.5, 1e-3, "m"))
    wrong, right = (
        compare(make_study(pendulum_model(0.5, 0.1, effects=[effect]), [first, second], [], [])).fit.cost
        for effect in effects
    )
    rise = wrong - right
    assert 0.5 < np.sqrt(rise) / plan.proposals[0].expected.separation < 2.0
