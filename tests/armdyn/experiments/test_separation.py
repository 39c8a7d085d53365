"""The predicted separation and probability against fits and outcomes that are really simulated."""

import numpy as np
import pytest
from scipy.stats import norm

from armdyn.effects.catalogue import CATALOGUE
from armdyn.errors import InputError
from armdyn.experiments.gripper import GRIPPER_NODE_INTERVAL_SECONDS, GripperProblem, design_motion, motion_series
from armdyn.experiments.hypothesis import Hypothesis, PlannedExperiment, PredictedExperiment
from armdyn.experiments.limits import GripperLimits
from armdyn.experiments.plan import inseparable_pairs
from armdyn.experiments.search import AugmentedLagrangian, random_motion
from armdyn.experiments.separation import (
    TIE_CHI2,
    RivalRefitCost,
    expected_outcome,
    hypothesis_probabilities,
    linear_separation,
)
from armdyn.pendulum.model import pendulum_model
from armdyn.pendulum.path import GripperPath

KNOWN = {"mass": 8e-4, "sensor_bias.force": 0.02}
LOAD_CELL = {"load_force": 5e-3}


def hypothesis(effect, value=None, **changes):
    """An effect of typical size beside an uncertain bias; the load was weighed."""
    others = [name for name in ("sensor_bias",) if name != effect]
    model = pendulum_model(0.368, 0.08, [CATALOGUE[name] for name in (effect, *others)])
    name = next(n for n in model.names if n.startswith(f"{effect}."))
    model = model.with_values({name: model.parameters[name].typical if value is None else value})
    free = ("length", "mass", name, *(f"{other}.force" for other in others))
    information = np.diag([KNOWN.get(n, np.inf) ** -2.0 for n in free])
    return Hypothesis(effect, model, free, information, **changes)


def separation(truth, rival):
    """The rise of chi2 when the rival is refitted."""
    return RivalRefitCost(rival, truth.predict(truth.start)[0]).chi2_increase_and_refit()[0]


def gripper(effects, seconds=4.0, limits=None, step=GRIPPER_NODE_INTERVAL_SECONDS):
    hypotheses = [hypothesis(name) for name in effects]
    cell = PlannedExperiment("motion", "", noise=LOAD_CELL)
    return GripperProblem(hypotheses, cell, motion_series(seconds), limits or GripperLimits(), step)


def random_experiment(seed):
    problem = gripper(["linear_drag"], limits=GripperLimits(swing=0.5))
    x = random_motion(problem, np.random.default_rng(seed))
    return PlannedExperiment("motion", "", problem.motion(x), LOAD_CELL)


def test_a_random_motion_reaches_a_limit_and_passes_none():
    problem = gripper(["linear_drag", "wind"], 8.0)
    for seed in range(5):
        x = random_motion(problem, np.random.default_rng(seed))
        used = problem.motion(x).peaks / [0.15, 0.9, 2.0]
        swings = max(np.abs(p.swing(p.start)).max() for p in problem.predictions_along(x))
        assert max(used.max(), swings) == pytest.approx(1.0, abs=0.03)
        assert max(used.max(), swings) <= 1.0


def test_the_gradient_of_the_search_is_that_of_finite_differences():
    """Beyond the limits of gripper and swing, with the rivals refitted again at every motion."""
    problem = gripper(["linear_drag", "pivot_viscous_friction"], limits=GripperLimits(acceleration=1.0, swing=0.2))
    x = 1.5 * random_motion(problem, np.random.default_rng(1))
    point, rng, h = x / problem.coefficient_scale[:, None], np.random.default_rng(0), 1e-4

    def cost(at):
        lagrangian = AugmentedLagrangian(problem.linearised_around(at * problem.coefficient_scale[:, None]), 5.0)
        for _ in range(4):  # each goes on with the refit
            found = lagrangian(at)
        return found

    _, gradient = cost(point)
    for _ in range(3):
        direction = rng.standard_normal(point.shape)
        measured = (cost(point + h * direction)[0] - cost(point - h * direction)[0]) / (2 * h)
        assert measured == pytest.approx(float(gradient @ direction.ravel()), rel=2e-3, abs=1e-3)


def test_linear_and_refitted_separation_agree_where_the_rival_is_near():
    experiment = random_experiment(1)
    near = hypothesis("linear_drag", 0.0050), hypothesis("linear_drag", 0.0052)
    fixed = Hypothesis("held", near[1].model, ("length", "mass"), near[1].information[:2, :2])
    truth, rival = PredictedExperiment(near[0], experiment), PredictedExperiment(fixed, experiment)
    assert linear_separation(truth, rival) == pytest.approx(separation(truth, rival), rel=0.05)


def test_the_separation_of_a_value_is_its_information_with_the_others_as_nuisance():
    """Two values of one parameter as rivals: lambda = distance^2 / variance."""
    experiment = random_experiment(2)
    whole = hypothesis("linear_drag")
    held = PredictedExperiment(whole, experiment)
    J = held.predict(held.start)[1]
    covariance = np.linalg.inv(J.T @ J + held.prior + 1e-12 * np.eye(len(J.T)))
    place = whole.free.index("linear_drag.coefficient")
    distance = 1e-4
    rest = [i for i in range(len(whole.free)) if i != place]
    moved = whole.model.with_values({"linear_drag.coefficient": 0.005 + distance})
    rival = Hypothesis("moved", moved, tuple(whole.free[i] for i in rest), whole.information[np.ix_(rest, rest)])
    assert separation(held, PredictedExperiment(rival, experiment)) == pytest.approx(
        distance**2 / covariance[place, place], rel=0.02
    )


def test_what_earlier_runs_know_of_the_rival_counts_in_the_separation():
    experiment = random_experiment(9)
    truth = PredictedExperiment(hypothesis("pivot_viscous_friction"), experiment)
    free = hypothesis("linear_drag")
    information = free.information.copy()
    information[2, 2] = 1e-4**-2.0  # its coefficient is known
    knowing = Hypothesis("linear_drag", free.model, free.free, information)
    assert separation(truth, PredictedExperiment(knowing, experiment)) > 2.0 * separation(
        truth, PredictedExperiment(free, experiment)
    )


def test_friction_does_not_become_negative_to_imitate():
    """A rival on its bound cannot take up what would need the other sign."""
    experiment = random_experiment(4)
    bare = hypothesis("linear_drag", 0.0)
    driven = PredictedExperiment(hypothesis("string_creep", 2e-4), experiment)
    rival = RivalRefitCost(PredictedExperiment(bare, experiment), driven.predict(driven.start)[0])
    assert rival.chi2_increase_and_refit()[1][2] >= 0.0


def test_the_probability_is_that_of_simulated_outcomes():
    """Noise is drawn, both hypotheses are really fitted, and the margin decides."""
    experiment = random_experiment(2)
    pair = hypothesis("linear_drag", 0.01), hypothesis("pivot_viscous_friction", 2e-3)
    foretold = expected_outcome(pair, experiment)
    rng = np.random.default_rng(0)
    both = [PredictedExperiment(h, experiment) for h in pair]
    truth = both[0]
    wins, count = 0, 60
    for _ in range(count):
        at = truth.start + truth.covariance_root @ rng.standard_normal(len(truth.start))
        at = np.clip(at, truth.lower, truth.upper)
        readings = truth.predict(at)[0] + rng.standard_normal(len(truth.predict(at)[0]))
        own, other = (
            RivalRefitCost(held, readings).chi2_increase_and_refit(at if held is truth else None)[0] for held in both
        )
        wins += other - own > TIE_CHI2
    expected = foretold.correct_decision_probability[0]
    assert 0.05 < expected < 0.95  # else it would be no test
    assert abs(wins / count - expected) < 3.0 * np.sqrt(expected * (1.0 - expected) / count) + 0.05
    # The usual approximation N(lambda, 4 lambda) is not far off either.
    rise = foretold.chi2_increase[0, 1]
    assert abs(norm.sf((TIE_CHI2 - rise) / (2.0 * np.sqrt(rise))) - expected) < 0.25


def test_a_designed_motion_separates_far_better_than_random_ones_within_the_limits():
    pair = hypothesis("pivot_viscous_friction"), hypothesis("linear_drag")
    limits = GripperLimits()
    motion, random = design_motion(pair, PlannedExperiment("motion", "", noise=LOAD_CELL), 5.0, limits)
    apart = expected_outcome(pair, PlannedExperiment("motion", "", motion, LOAD_CELL)).separation ** 2
    assert apart > 10.0 * random
    assert np.all(motion.peaks <= [limits.travel, limits.speed, limits.acceleration])
    for h in pair:
        held = PredictedExperiment(h, PlannedExperiment("motion", "", motion, LOAD_CELL))
        assert np.abs(held.swing(held.start)).max() <= limits.swing
        assert held.rollout(held.start).outputs[:, 0].min() > 0.0  # the string stays taut


def test_wind_and_tilt_are_inseparable_by_motion_and_the_reason_is_a_rotation():
    wind = hypothesis("wind", 0.02)
    tilt = hypothesis("path_tilt", -wind.rest_angle)
    experiment = random_experiment(8)
    pairs = inseparable_pairs((wind, tilt), expected_outcome((wind, tilt), experiment), experiment)
    assert [p.effects for p in pairs] == [("wind", "path_tilt")]
    assert "rotation of the frame" in pairs[0].why
    # A run in which the wind blows from the other side, after one in which both were measured.
    turned = PlannedExperiment("turn", "", experiment.motion, LOAD_CELL, sign_reversed=("wind.force",))
    seen = [
        Hypothesis(h.name, h.model, h.free, h.information + np.diag([0.0, 0.0, size**-2.0, 0.0]))
        for h, size in ((wind, 1e-3), (tilt, 1e-3))
    ]
    assert expected_outcome(seen, turned).chi2_increase[~np.eye(2, dtype=bool)].min() > 100.0


def test_a_load_that_is_weighed_tells_gain_from_a_wrong_mass():
    gain = hypothesis("sensor_gain", 0.03)
    heavy = Hypothesis(
        "heavy", gain.model.with_values({"mass": 0.08 * 1.03, "sensor_gain.error": 0.0}), ("length", "mass"),
        np.zeros((2, 2)),
    )  # fmt: skip
    weighed = PlannedExperiment("weigh", "", measured={"mass": 4e-4})
    assert expected_outcome((gain, heavy), weighed).chi2_increase[1, 0] == pytest.approx(
        (0.0024 / 4e-4) ** 2 / (1 + 4.0**0 * (8e-4 / 4e-4) ** 2), rel=0.01
    )


def test_belief_follows_from_the_fit_of_earlier_runs():
    one, two = hypothesis("linear_drag"), hypothesis("pivot_viscous_friction", misfit=2.0 * np.log(4.0))
    np.testing.assert_allclose(hypothesis_probabilities((one, two)), [0.8, 0.2])


def test_a_motion_that_is_too_short_is_refused(complains):
    with complains(InputError):
        motion_series(1.0)
    with complains(InputError):
        GripperLimits(travel=0.0)


def test_effort_is_the_integral_of_the_squared_acceleration():
    still = np.zeros(201)
    motion = GripperPath(0.0, 0.01, still, still, still + 0.5)
    assert motion.effort == pytest.approx(0.5, rel=0.01)
