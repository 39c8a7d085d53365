import numpy as np
import pytest
from derivatives import assert_jacobian

from armdyn.control.sac import SacSettings, SacState, SequentialActionControl, needle
from armdyn.effects.catalogue import CATALOGUE
from armdyn.errors import InputError
from armdyn.pendulum.model import pendulum_model

MODEL = pendulum_model(0.368, 0.08, [CATALOGUE["linear_drag"]]).with_values({"linear_drag.coefficient": 0.005})
STATE = SacState(1.0, 0.02, 0.1, np.array([0.2, 0.004]), np.array([0.4, 0.01]))


@pytest.fixture(scope="module")
def control():
    return SequentialActionControl(MODEL)


def test_gradient_is_that_of_the_discretised_cost(control):
    schedule = np.random.default_rng(0).normal(size=control.settings.steps)
    _, gradient = control.gradient(schedule, STATE, MODEL)
    assert_jacobian(lambda u: np.array(control.gradient(u, STATE, MODEL)[0]), schedule, gradient, 1e-3, 1e-6)


def test_an_action_lowers_the_cost(control):
    action = control.act(STATE, MODEL)
    assert action.cost < action.free_cost
    assert action.cost == pytest.approx(control.gradient(action.schedule, STATE, MODEL)[0])


def test_from_exact_rest_nothing_moves(control):
    still = SacState(0.0, 0.0, 0.0, np.zeros(2), np.zeros(2))
    assert np.all(control.act(still, MODEL).schedule == 0.0)


def test_saturation_and_speed_guard_hold(control):
    fast = SacState(0.0, 0.0, 0.89, np.array([0.5, 0.01]), np.array([2.0, 0.05]))
    schedule = control.act(fast, MODEL).schedule
    assert np.abs(schedule).max() <= control.settings.largest_acceleration + 1e-12
    speed = 0.89 + np.cumsum(schedule) * control.settings.dt
    assert np.abs(speed).max() <= control.settings.largest_speed + 1e-12


def test_the_barrier_turns_the_gripper_round(control):
    outside = SacState(0.0, 0.25, 0.1, np.zeros(2), np.array([0.1, 0.0]))
    assert control.act(outside, MODEL).acceleration < 0.0


def test_a_needle_keeps_its_impulse_whatever_the_grid():
    schedule = needle(1.5, 0.0234, 0.1178, 80, 0.01)
    assert schedule.sum() * 0.01 == pytest.approx(1.5 * (0.1178 - 0.0234))
    assert np.all(schedule[12:] == 0.0)


def test_more_information_than_the_free_motion_after_six_seconds(control):
    """Closed loop on the model's own equations; the load is kicked and then either left alone or driven."""

    def information(driven):
        d, theta = MODEL.dynamics(), MODEL.physics_theta()
        x = v = 0.0
        s, psi, total = np.zeros(2), np.zeros(2), 0.0
        schedule = np.zeros(5)
        for k in range(600):
            if k < 40:
                u = 0.8 if k < 20 else -0.8
            else:
                if driven and k % 5 == 0:
                    schedule = control.act(SacState(0.01 * k, x, v, s, psi), MODEL).schedule
                u = schedule[k % 5] if driven else 0.0
            w = np.array([0.0, x, v, u, 0, 0, 0])
            total += _gamma(d, s, psi, w, theta) ** 2
            s, psi = _heun(d, s, psi, w, theta)
            x, v = x + 0.01 * v + 5e-5 * u, v + 0.01 * u
        return total

    assert information(True) > 100 * information(False)


def _gamma(d, s, psi, w, theta, h=1e-6):
    up, down = (theta + h * e for e in (np.eye(len(theta))[0], -np.eye(len(theta))[0]))
    return (float(d.tension(s + h * psi, w, up)) - float(d.tension(s - h * psi, w, down))) / (2 * h)


def _heun(d, s, psi, w, theta, dt=0.01, h=1e-6):
    """Midpoint step of the state, and of its derivative by differences along (state, length)."""
    e = np.eye(len(theta))[0]

    def step(s, theta):
        k1 = np.array(d.derivative(s, w, theta)).ravel()
        after = w + np.array([0, dt / 2 * w[2], dt / 2 * w[3], 0, 0, 0, 0])
        return s + dt * np.array(d.derivative(s + dt / 2 * k1, after, theta)).ravel()

    return step(s, theta), (step(s + h * psi, theta + h * e) - step(s - h * psi, theta - h * e)) / (2 * h)


def test_settings_that_cannot_work_are_refused():
    with pytest.raises(InputError, match="desired_change"):
        SacSettings(desired_change=1.0)
    with pytest.raises(InputError, match="horizon"):
        SacSettings(horizon=0.0)
