"""The predicted separation and probability against fits and outcomes that are really simulated."""

import numpy as np
import pytest
from scipy.stats import norm

from armdyn.effects.catalogue import CATALOGUE
from armdyn.errors import InputError
from armdyn.experiments.design import designed, within_swing
from armdyn.experiments.hypothesis import Experiment, Held, Hypothesis
from armdyn.experiments.motion import Harmonics, Limits, Motion
from armdyn.experiments.plan import inseparable
from armdyn.experiments.separation import MARGIN, Rival, beliefs, linear_separation, outlook, separation
from armdyn.pendulum.model import pendulum_model

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


def random_experiment(seed, limits=None):
    harmonics = Harmonics(4.0, limits or Limits(swing=0.5))
    first = Held(hypothesis("linear_drag"), Experiment("motion", "", harmonics.motion(np.zeros(harmonics.size))))
    c = within_swing([first], harmonics, harmonics.random(np.random.default_rng(seed)))
    return Experiment("motion", "", harmonics.motion(c), LOAD_CELL)


def test_a_motion_is_the_derivative_of_its_position_and_begins_and_ends_at_rest():
    harmonics = Harmonics(4.0, Limits(), step=1e-3)
    x, v, a = harmonics.motion(harmonics.random(np.random.default_rng(0))).along
    np.testing.assert_allclose(np.gradient(x, 1e-3)[2:-2], v[2:-2], atol=1e-4)
    np.testing.assert_allclose(np.gradient(v, 1e-3)[2:-2], a[2:-2], atol=5e-3)
    for end in (0, -1):
        np.testing.assert_allclose([x[end], v[end], a[end]], 0.0, atol=1e-12)


def test_a_random_motion_reaches_a_limit_and_passes_none():
    harmonics = Harmonics(8.0, Limits())
    for seed in range(5):
        used = harmonics.motion(harmonics.random(np.random.default_rng(seed))).peaks / Limits().vector()
        assert used.max() == pytest.approx(1.0)


def test_linear_and_refitted_separation_agree_where_the_rival_is_near():
    experiment = random_experiment(1)
    near = hypothesis("linear_drag", 0.0050), hypothesis("linear_drag", 0.0052)
    fixed = Hypothesis("held", near[1].model, ("length", "mass"), near[1].information[:2, :2])
    truth, rival = Held(near[0], experiment), Held(fixed, experiment)
    assert linear_separation(truth, rival) == pytest.approx(separation(truth, rival), rel=0.05)


def test_the_separation_of_a_value_is_its_information_with_the_others_as_nuisance():
    """Two values of one parameter as rivals: lambda = distance^2 / variance."""
    experiment = random_experiment(2)
    whole = hypothesis("linear_drag")
    held = Held(whole, experiment)
    J = held.predict(held.start)[1]
    covariance = np.linalg.inv(J.T @ J + held.prior + 1e-12 * np.eye(len(J.T)))
    place = whole.free.index("linear_drag.coefficient")
    distance = 1e-4
    rest = [i for i in range(len(whole.free)) if i != place]
    moved = whole.model.with_values({"linear_drag.coefficient": 0.005 + distance})
    rival = Hypothesis("moved", moved, tuple(whole.free[i] for i in rest), whole.information[np.ix_(rest, rest)])
    assert separation(held, Held(rival, experiment)) == pytest.approx(distance**2 / covariance[place, place], rel=0.02)


def test_what_earlier_runs_know_of_the_rival_counts_in_the_separation():
    experiment = random_experiment(3)
    truth = Held(hypothesis("pivot_viscous_friction"), experiment)
    free = hypothesis("linear_drag")
    information = free.information.copy()
    information[2, 2] = 1e-4**-2.0  # its coefficient is known
    knowing = Hypothesis("linear_drag", free.model, free.free, information)
    assert separation(truth, Held(knowing, experiment)) > 2.0 * separation(truth, Held(free, experiment))


def test_friction_does_not_become_negative_to_imitate():
    """A rival on its bound cannot take up what would need the other sign."""
    experiment = random_experiment(4)
    bare = hypothesis("linear_drag", 0.0)
    driven = Held(hypothesis("string_creep", 2e-4), experiment)
    rival = Rival(Held(bare, experiment), driven.predict(driven.start)[0])
    assert rival.refitted()[1][2] >= 0.0


def test_the_probability_is_that_of_simulated_outcomes():
    """Noise is drawn, both hypotheses are really fitted, and the margin decides."""
    experiment = random_experiment(2)
    pair = hypothesis("linear_drag", 0.01), hypothesis("pivot_viscous_friction", 2e-3)
    foretold = outlook(pair, experiment)
    rng = np.random.default_rng(0)
    helds = [Held(h, experiment) for h in pair]
    truth = helds[0]
    wins, count = 0, 60
    for _ in range(count):
        at = truth.start + truth.spread @ rng.standard_normal(len(truth.start))
        at = np.clip(at, truth.lower, truth.upper)
        readings = truth.predict(at)[0] + rng.standard_normal(len(truth.predict(at)[0]))
        own, other = (Rival(held, readings).refitted(at if held is truth else None)[0] for held in helds)
        wins += other - own > MARGIN
    expected = foretold.right[0]
    assert 0.05 < expected < 0.95  # else it would be no test
    assert abs(wins / count - expected) < 3.0 * np.sqrt(expected * (1.0 - expected) / count) + 0.05
    # The usual approximation N(lambda, 4 lambda) is not far off either.
    rise = foretold.rises[0, 1]
    assert abs(norm.sf((MARGIN - rise) / (2.0 * np.sqrt(rise))) - expected) < 0.25


def test_a_designed_motion_separates_far_better_than_random_ones_within_the_limits():
    pair = hypothesis("pivot_viscous_friction"), hypothesis("linear_drag")
    limits = Limits()
    found = designed(pair, Experiment("motion", "", noise=LOAD_CELL), 5.0, limits)
    assert found.rise > 10.0 * found.start
    assert np.all(found.motion.peaks <= limits.vector() * (1.0 + 1e-9))
    for h in pair:
        held = Held(h, Experiment("motion", "", found.motion, LOAD_CELL))
        assert np.abs(held.swing(held.start)).max() <= limits.swing
        assert held.rollout(held.start).outputs[:, 0].min() > 0.0  # the string stays taut


def test_wind_and_tilt_are_inseparable_by_motion_and_the_reason_is_a_rotation():
    wind = hypothesis("wind", 0.02)
    tilt = hypothesis("path_tilt", -wind.rest_angle)
    experiment = random_experiment(6)
    pairs = inseparable((wind, tilt), outlook((wind, tilt), experiment), experiment)
    assert [p.effects for p in pairs] == [("wind", "path_tilt")]
    assert "rotation of the frame" in pairs[0].why
    # A run in which the wind blows from the other side, after one in which both were measured.
    turned = Experiment("turn", "", experiment.motion, LOAD_CELL, turned=("wind.force",))
    seen = [
        Hypothesis(h.name, h.model, h.free, h.information + np.diag([0.0, 0.0, size**-2.0, 0.0]))
        for h, size in ((wind, 1e-3), (tilt, 1e-3))
    ]
    assert outlook(seen, turned).rises[~np.eye(2, dtype=bool)].min() > 100.0


def test_a_load_that_is_weighed_tells_gain_from_a_wrong_mass():
    gain = hypothesis("sensor_gain", 0.03)
    heavy = Hypothesis(
        "heavy", gain.model.with_values({"mass": 0.08 * 1.03, "sensor_gain.error": 0.0}), ("length", "mass"),
        np.zeros((2, 2)),
    )  # fmt: skip
    weighed = Experiment("weigh", "", measured={"mass": 4e-4})
    assert outlook((gain, heavy), weighed).rises[1, 0] == pytest.approx(
        (0.0024 / 4e-4) ** 2 / (1 + 4.0**0 * (8e-4 / 4e-4) ** 2), rel=0.01
    )


def test_belief_follows_from_the_fit_of_earlier_runs():
    one, two = hypothesis("linear_drag"), hypothesis("pivot_viscous_friction", misfit=2.0 * np.log(4.0))
    np.testing.assert_allclose(beliefs((one, two)), [0.8, 0.2])


def test_a_motion_that_is_too_short_is_refused():
    with pytest.raises(InputError, match="1 s"):
        Harmonics(1.0, Limits())
    with pytest.raises(InputError, match="travel"):
        Limits(travel=0.0)


def test_effort_is_the_integral_of_the_squared_acceleration():
    time = np.arange(0.0, 2.0 + 1e-9, 0.01)
    motion = Motion(time, np.array([0 * time, 0 * time, np.full(len(time), 0.5)]))
    assert motion.effort == pytest.approx(0.5, rel=0.01)
