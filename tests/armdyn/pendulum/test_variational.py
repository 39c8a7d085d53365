import numpy as np
import pytest
from derivatives import assert_jacobian

from armdyn.effects.catalogue import CATALOGUE
from armdyn.pendulum.composition import PendulumComposition
from armdyn.pendulum.variational import derive_variational

LENGTH, MASS, G, DT = 0.368, 0.1, 9.81, 0.01
THETA = np.array([LENGTH, MASS, G])
STATE, CONTROL = np.array([0.05, 0.2, 0.4, -0.9]), 0.7


@pytest.fixture(scope="module")
def bare():
    return derive_variational(PendulumComposition([]))


@pytest.fixture(scope="module")
def dragged():
    return derive_variational(PendulumComposition([CATALOGUE["linear_drag"]]))


def cartesian_step(state, control, dt):
    """The same scheme as a Cartesian load with a constraint and a multiplier, solved by Newton in (x, z, lambda)."""
    x, v, phi, rate = state

    def load(gripper, angle):
        return np.array([gripper - LENGTH * np.sin(angle), -LENGTH * np.cos(angle)])

    before, here = load(x - dt * v, phi - dt * rate), load(x, phi)
    x_next = x + dt * (v + dt * control)
    unknown = np.array([*(2 * here - before), MASS * G * dt / (2 * LENGTH)])

    def residual(y):
        q, multiplier = y[:2], y[2]
        balance = MASS * (q - 2 * here + before) / dt + dt * MASS * G * np.array([0, 1])
        balance += 2 * multiplier * (here - np.array([x, 0]))
        return np.array([*balance, (q[0] - x_next) ** 2 + q[1] ** 2 - LENGTH**2])

    for _ in range(30):
        J = np.array([(residual(unknown + 1e-7 * e) - residual(unknown - 1e-7 * e)) / 2e-7 for e in np.eye(3)]).T
        unknown = unknown - np.linalg.solve(J, residual(unknown))
    angle = np.arctan2(x_next - unknown[0], -unknown[1])
    return angle, 2 * LENGTH * unknown[2] / dt


def test_step_is_that_of_the_constrained_cartesian_load(bare):
    following = np.array(bare.step(STATE, CONTROL, 0.0, DT, THETA)).ravel()
    angle, tension = cartesian_step(STATE, CONTROL, DT)
    assert following[2] == pytest.approx(angle, abs=1e-9)
    assert float(bare.tension(STATE, CONTROL, 0.0, DT, THETA, following)) == pytest.approx(tension, rel=1e-6)


@pytest.mark.parametrize("name", ["bare", "dragged"])
def test_first_derivatives_are_exact(name, request):
    v = request.getfixturevalue(name)
    theta = THETA if name == "bare" else np.append(THETA, 0.05)
    z = np.append(STATE, CONTROL)
    following = v.step(STATE, CONTROL, 0.0, DT, theta)
    A, B = (np.array(m) for m in v.linearised(STATE, CONTROL, 0.0, DT, theta, following))
    assert_jacobian(lambda z: np.array(v.step(z[:4], z[4], 0.0, DT, theta)), z, np.hstack([A, B]), 1e-3, 1e-7)


@pytest.mark.parametrize("name", ["bare", "dragged"])
def test_second_derivatives_are_exact(name, request):
    v = request.getfixturevalue(name)
    theta = THETA if name == "bare" else np.append(THETA, 0.05)
    p, z = np.array([0.3, -1.2, 2.0, 0.7]), np.append(STATE, CONTROL)

    def gradient(z):
        A, B = v.linearised(z[:4], z[4], 0.0, DT, theta, v.step(z[:4], z[4], 0.0, DT, theta))
        return p @ np.hstack([np.array(A), np.array(B)])

    following = v.step(STATE, CONTROL, 0.0, DT, theta)
    assert_jacobian(gradient, z, np.array(v.curvature(STATE, CONTROL, 0.0, DT, theta, following, p)), 1e-3, 1e-6)


def rollout(v, dt, duration, phi0):
    state = np.array([0.0, 0.0, phi0, 0.0])
    # Second-order start from rest: the backward difference at t = 0 is that of the exact solution.
    state[3] = G * np.sin(phi0) / LENGTH * dt / 2
    angles = [phi0]
    for _ in range(round(duration / dt)):
        state = np.array(v.step(state, 0.0, 0.0, dt, THETA)).ravel()
        angles.append(state[2])
    return np.array(angles)


def test_it_converges_with_the_square_of_the_step(bare):
    fine = rollout(bare, 0.00125, 2.0, 0.8)
    errors = [np.abs(rollout(bare, dt, 2.0, 0.8) - fine[:: round(dt / 0.00125)]).max() for dt in (0.02, 0.01)]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


def test_energy_does_not_drift(bare):
    angles = rollout(bare, 0.01, 60.0, 1.0)
    rate = np.diff(angles) / 0.01
    middle = (angles[1:] + angles[:-1]) / 2
    energy = MASS * (LENGTH * rate) ** 2 / 2 - MASS * G * LENGTH * np.cos(middle)
    drift = np.polyfit(np.arange(len(energy)) * 0.01, energy, 1)[0]
    assert abs(drift) * 60 < 1e-4 * np.abs(energy).max()
