import numpy as np
import pytest
from derivatives import assert_jacobian
from scipy.integrate import solve_ivp

from armdyn.effects.catalogue import CATALOGUE
from armdyn.effects.effect import effect
from armdyn.errors import InputError
from armdyn.parameter import quantity
from armdyn.pendulum.composition import PendulumComposition
from armdyn.pendulum.dynamics import derive_dynamics
from armdyn.pendulum.model import pendulum_model
from armdyn.pendulum.path import GripperPath
from armdyn.physics.simulate import Simulator
from armdyn.run import Channel, Run

LENGTH, MASS, G = 0.368, 0.1, 9.81
THETA = np.array([LENGTH, MASS, G])
AMPLITUDE, OMEGA = 0.04, 2 * np.pi * 0.8
DRAG = [CATALOGUE[name] for name in ("linear_drag", "sensor_gain")]


def moving(t):
    """Gripper input at time t: 0.04 m at 0.8 Hz along a level line."""
    x = AMPLITUDE * np.sin(OMEGA * t)
    return np.array([t, x, AMPLITUDE * OMEGA * np.cos(OMEGA * t), -(OMEGA**2) * x, 0.0, 0.0, 0.0])


def path(duration):
    rows = np.array([moving(t) for t in np.arange(0.0, duration + 0.005, 0.01)]).T
    return GripperPath(0.0, 0.01, rows[1], rows[2], rows[3])


@pytest.fixture(scope="module")
def dynamics():
    return derive_dynamics(PendulumComposition([]))


def test_tension_is_the_textbook_formula(dynamics):
    phi, rate, u = 0.4, 1.7, 1.1
    state = dynamics.initial(phi, rate, np.zeros(7), THETA)
    at = np.array([0, 0, 0, u, 0, 0, 0])
    right = MASS * (G * np.cos(phi) + LENGTH * rate**2 + u * np.sin(phi))
    assert float(dynamics.tension(state, at, THETA)) == pytest.approx(right, rel=1e-13)


def test_the_state_needs_no_gripper_acceleration(dynamics):
    gliding = np.array([0.0, 0.1, 0.3, 0.0, 0.0, 0.0, 0.0])
    jolted = gliding.copy()
    jolted[3] = 50.0
    state = np.array([0.3, 0.004])
    moved, also = (np.array(dynamics.derivative(state, w, THETA)) for w in (gliding, jolted))
    assert np.array_equal(moved, also)
    assert float(dynamics.tension(state, gliding, THETA)) != float(dynamics.tension(state, jolted, THETA))


def test_rollout_agrees_with_an_eighth_order_integrator():
    def slow(t, s):
        u = moving(t)[3]
        return [s[1], (u * np.cos(s[0]) - G * np.sin(s[0])) / LENGTH]

    start = moving(0.0)
    times = np.arange(0.0, 5.005, 0.01)
    reference = solve_ivp(slow, (0, 5.0), [0.0, start[2] / LENGTH], "DOP853", times[:501], rtol=1e-12, atol=1e-12)
    run = Simulator(derive_dynamics(PendulumComposition([])), "test").rollout(path(5.0), THETA)
    assert np.abs(run.states[:, 0] - reference.y[0]).max() < 1e-6  # it swings up to 1.2 rad at resonance


@pytest.mark.parametrize("column", range(7))
def test_sensitivities_match_finite_differences(column):
    simulator = Simulator(derive_dynamics(PendulumComposition(DRAG)), "test_drag_gain")
    point = np.array([LENGTH, MASS, G, 0.02, 0.01, 0.2, 0.3])
    run = simulator.rollout(path(4.0), point[:5], point[5], point[6])

    def outputs(value):
        changed = point.copy()
        changed[column] = value[0]
        return simulator.rollout(path(4.0), changed[:5], changed[5], changed[6]).outputs[::40].ravel()

    exact = run.sensitivities[::40, :, column].ravel()
    assert_jacobian(outputs, point[[column]], exact[:, None], 1e-4, 1e-7)


def test_measured_height_of_the_gripper_enters_the_tension(dynamics):
    lifted = np.array([0, 0, 0, 0, 0, 0, 0.5])
    assert float(dynamics.tension([0, 0], lifted, THETA)) == pytest.approx(MASS * (G + 0.5), rel=1e-13)


STAMPS = np.arange(0.0, 3.0, 0.005)
STILL = Run(
    "a.csv", {"swing_angle": Channel(STAMPS, 0 * STAMPS, "rad"), "load_force": Channel(STAMPS, 0 * STAMPS, "N")}
)
SIZES = {"bristle_friction.torque": 4e-3, "bristle_friction.deflection": 0.02, "initial_angle": 0.5}


@effect("bristle_friction", acts_on="string", summary="dry friction of bristles that bend", source="Dahl 1968")
def bristle_friction(
    string,
    torque=quantity("N m", typical=1e-3, lower=0),
    deflection=quantity("rad", typical=0.02, null=0.02, lower=1e-3),
):
    speed = string.rate
    string, bent = string.with_state(lambda z: speed - (speed**2 + 1e-12) ** 0.5 * z / deflection)
    return string.with_torque(-torque * bent / deflection)


def test_an_effect_brings_a_state_of_its_own():
    model = pendulum_model(LENGTH, MASS, [bristle_friction]).with_values(SIZES)

    def slow(_, s):
        torque = 4e-3 * s[2] / 0.02
        return [s[1], -G / LENGTH * np.sin(s[0]) - torque / (MASS * LENGTH**2), s[1] - abs(s[1]) * s[2] / 0.02]

    reference = solve_ivp(slow, (0, 3), [0.5, 0.0, 0.0], "DOP853", STAMPS, rtol=1e-10, atol=1e-12, max_step=0.002)
    predicted = model.predict(STILL, model.theta())
    assert np.abs(predicted.values[predicted.slices["swing_angle"]] - reference.y[0]).max() < 1e-4


def test_its_derivatives_are_exact():
    model = pendulum_model(LENGTH, MASS, [bristle_friction]).with_values(SIZES)
    exact = model.predict(STILL, model.theta()).sensitivities
    steps = 1e-5 * np.array([p.typical for p in model.parameters.values()])
    assert_jacobian(lambda theta: model.predict(STILL, theta).values, model.theta(), exact, steps, 1e-4)


def test_control_leaves_the_state_as_it_is_at_the_start():
    model = pendulum_model(LENGTH, MASS, [bristle_friction]).with_values(SIZES)
    assert model.dynamics().state_count == 2
    assert model.rest_angle() == pytest.approx(0.0, abs=1e-9)


def test_a_state_that_changes_the_length_is_refused(complains):
    @effect("creeping", acts_on="string", summary="", source="")
    def creeping(string, rate=quantity("1/s", typical=1.0)):
        string, z = string.with_state(lambda z: rate - z)
        return string.with_length(string.length + z)

    with complains(InputError):
        pendulum_model(LENGTH, MASS, [creeping]).dynamics()
