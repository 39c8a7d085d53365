"""A vibration that a signal passes, held against scipy's own simulation and finite differences."""

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lsim

from armdyn.effects.catalogue import CATALOGUE
from armdyn.effects.effect import effect
from armdyn.experiments.gripper import motion_series
from armdyn.experiments.hypothesis import Hypothesis, PlannedExperiment, PredictedExperiment
from armdyn.parameter import column, quantity
from armdyn.pendulum.model import pendulum_model
from armdyn.pendulum.path import GripperPath
from armdyn.physics.vibration import MIN_IGNORED_RADIANS_PER_SAMPLE, Vibration
from armdyn.smoothing.even import smoothed_motion

DT = 0.01
TIME = DT * np.arange(400)
SIGNAL = np.sin(7.0 * TIME) + np.where(TIME > 1.0, 0.5, 0.0) * np.sin(30.0 * (TIME - 1.0))


def vibration():
    """With 1/w^2 = theta0 theta1 and damping ratio theta2."""
    theta = ca.SX.sym("theta", 3)
    return Vibration(ca.Function("settings", [theta], [ca.vertcat(theta[0] * theta[1], theta[2])]))


def passed(theta, signal=SIGNAL):
    return vibration().response(signal, np.zeros((len(signal), 4)), np.array(theta), DT)


@pytest.mark.parametrize("damping", [0.0, 0.05, 0.3, 0.8])
@pytest.mark.parametrize("w", [12.0, 50.0, 140.0])
def test_it_is_what_scipy_simulates(w, damping):
    after, _ = passed([1.0, w**-2.0, damping])
    _, expected, _ = lsim(([w**2], [1.0, 2.0 * damping * w, w**2]), SIGNAL, TIME, interp=True)
    assert np.max(np.abs(after - expected)) < 2e-3 * np.max(np.abs(expected))


def test_what_is_too_fast_for_the_samples_is_left_out():
    after, by_theta = passed([1.0, (DT / (1.01 * MIN_IGNORED_RADIANS_PER_SAMPLE)) ** 2, 0.05])
    assert np.array_equal(after, SIGNAL)
    assert np.max(np.abs(by_theta)) < 1e-9


@pytest.mark.parametrize("w", [20.0, 120.0, 200.0, 250.0])
def test_derivatives_are_those_of_finite_differences(w):
    theta = np.array([2.0, 0.5 / w**2, 0.1])
    signal = SIGNAL + 0.3
    own = np.cos(3.0 * TIME)  # the signal's own derivative by the last parameter
    by_theta = np.zeros((len(signal), 4))
    by_theta[:, 3] = own
    _, found = vibration().response(signal, by_theta, theta, DT)
    for i in range(3):
        step = 1e-6 * theta[i]
        low, high = (passed(theta + sign * step * np.eye(3)[i], signal)[0] for sign in (-1.0, 1.0))
        expected = (high - low) / (2.0 * step)
        assert found[:, i] == pytest.approx(expected, rel=1e-5, abs=1e-6 * max(np.max(np.abs(expected)), 1.0))
    assert found[:, 3] == pytest.approx(passed(theta, own)[0])


def test_weights_taken_back_through_it_give_the_same_sum():
    rng = np.random.default_rng(0)
    signal, weights = rng.normal(size=(2, 300))
    theta = np.array([1.0, 1e-3, 0.1])
    earlier = vibration().adjoint(weights, theta, DT)
    assert earlier @ signal == pytest.approx(weights @ passed(theta, signal)[0], rel=1e-10)


def test_a_load_bounces_on_an_elastic_string_as_a_spring_pendulum_does():
    """The whole spring pendulum, integrated by scipy in Cartesian coordinates, against the model's load cell."""
    mass, length, compliance, damping, g = 0.08, 0.368, 5e-3, 0.05, 9.81
    time = 0.005 * np.arange(1200)

    def jerked(t):
        """Acceleration of the gripper, m/s^2: from rest, with a jerk every quarter of a second until 4 s."""
        return 1.5 * np.sin(4.0 * np.pi * t) ** 3 * (t < 4.0)

    def right(t, s):
        x, v, qx, qz, vx, vz = s
        d = np.array([qx - x, qz])
        r = np.hypot(*d)
        n = d / r
        pull = (r - length) / compliance + 2.0 * damping * np.sqrt(mass / compliance) * (np.array([vx - v, vz]) @ n)
        return [v, jerked(t), vx, vz, -pull * n[0] / mass, -pull * n[1] / mass - g]

    rest = [0.0, 0.0, 0.0, -length - compliance * mass * g, 0.0, 0.0]
    found = solve_ivp(right, (0.0, time[-1]), rest, "DOP853", t_eval=time, rtol=1e-10, atol=1e-12, max_step=0.005).y
    x, v, qx, qz, vx, vz = found
    r = np.hypot(qx - x, qz)
    speed = ((vx - v) * (qx - x) + vz * qz) / r
    truth = (r - length) / compliance + 2.0 * damping * np.sqrt(mass / compliance) * speed

    values = {"string_elasticity.compliance": compliance, "string_elasticity.damping": damping}
    model = pendulum_model(length, mass).with_effect(CATALOGUE["string_elasticity"]).with_values(values)
    path = GripperPath(0.0, 0.005, *smoothed_motion(time, x, 0.005, exact=True))
    predicted = model.rollout(path, model.theta(), ("load_force",)).outputs[:, 0]
    slow = model.with_values({"string_elasticity.damping": 0.9})
    without = slow.rollout(path, slow.theta(), ("load_force",)).outputs[:, 0]
    bounce, left = np.std(truth - without), np.std(truth - predicted)
    assert bounce > 2e-3  # what a load cell of 5 mN sees in a second
    assert left < 0.3 * bounce


@effect(summary="", source="")
def oil(string, k=quantity("N m s/(rad K)", typical=1e-5), warm=column("extra.temperature", "K", usual=290.0)):
    return string.with_torque(-k * string.rate * warm)


EFFECTS = {**CATALOGUE, "oil": oil}
SERIES = motion_series(3.0)
BASIS = SERIES.basis_at(np.linspace(0.0, 3.0, 151))
COEFFICIENTS = 0.02 * np.random.default_rng(0).standard_normal(SERIES.coefficient_count)


def motion(coefficients):
    moved = BASIS.motion(coefficients[None])
    return GripperPath(0.0, float(BASIS.time[1]), moved.q[:, 0], moved.v[:, 0], moved.a[:, 0])


def predicted(effects, coefficients, noise):
    """A hypothesis with effects at their typical sizes, in an experiment with one motion."""
    model = pendulum_model(0.368, 0.08, [EFFECTS[name] for name in effects])
    model = model.with_values({n: p.typical for n, p in model.parameters.items() if p.effect})
    free = ("length", "mass")
    experiment = PlannedExperiment("motion", "", motion(coefficients), noise)
    return PredictedExperiment(Hypothesis("", model, free, np.zeros((2, 2))), experiment)


# Plain equations; the sensor's lag and delay; a gripper that trails; what yields, with its jerk and impulse; further
# states; a column of recordings, alone and behind what yields and trails.
@pytest.mark.parametrize(
    "effects",
    [
        ("linear_drag",), ("sensor_lag", "sensor_delay"), ("gripper_lag", "pivot_coulomb_friction"),
        ("string_elasticity", "sensor_lag"), ("gripper_compliance", "gripper_lag"), ("out_of_plane_swing", "wind"),
        ("oil",), ("oil", "gripper_compliance", "gripper_lag"),
    ],
)  # fmt: skip
def test_the_reverse_pass_gives_the_gradient_of_any_sum_of_readings(effects):
    noise = {"load_force": 5e-3, "swing_angle": 5e-3}
    at = predicted(effects, COEFFICIENTS, noise)
    rng = np.random.default_rng(1)
    readings, swing = rng.normal(size=len(at.predict(at.start)[0])), rng.normal(size=len(BASIS.time))
    gradient = at.coefficient_gradient(at.start, BASIS, readings, swing)

    def total(coefficients):
        other = predicted(effects, coefficients, noise)
        return readings @ other.predict(other.start)[0] + swing @ other.swing(other.start)

    some = rng.choice(SERIES.coefficient_count, 4, replace=False)
    steps = 1e-4 * np.eye(SERIES.coefficient_count)[some]
    numeric = [(total(COEFFICIENTS + s) - total(COEFFICIENTS - s)) / 2e-4 for s in steps]
    np.testing.assert_allclose(numeric, gradient[some], rtol=0, atol=1e-6 * np.abs(gradient).max())
