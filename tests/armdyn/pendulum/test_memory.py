import numpy as np
import pytest
from derivatives import assert_jacobian
from scipy.integrate import solve_ivp

from armdyn.effects.effect import effect
from armdyn.errors import InputError
from armdyn.parameter import quantity
from armdyn.pendulum.model import pendulum_model
from armdyn.run import Channel, Run

LENGTH, MASS, G = 0.4, 0.1, 9.81
TIME = np.arange(0.0, 3.0, 0.005)
RUN = Run("a.csv", {"swing_angle": Channel(TIME, 0 * TIME, "rad"), "load_force": Channel(TIME, 0 * TIME, "N")})
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

    reference = solve_ivp(slow, (0, 3), [0.5, 0.0, 0.0], "DOP853", TIME, rtol=1e-10, atol=1e-12, max_step=0.002)
    predicted = model.predict(RUN, model.theta())
    assert np.abs(predicted.values[predicted.slices["swing_angle"]] - reference.y[0]).max() < 1e-4


def test_its_derivatives_are_exact():
    model = pendulum_model(LENGTH, MASS, [bristle_friction]).with_values(SIZES)
    exact = model.predict(RUN, model.theta()).sensitivities
    steps = 1e-5 * np.array([p.typical for p in model.parameters.values()])
    assert_jacobian(lambda theta: model.predict(RUN, theta).values, model.theta(), exact, steps, 1e-4)


def test_control_leaves_the_state_as_it_is_at_the_start():
    model = pendulum_model(LENGTH, MASS, [bristle_friction]).with_values(SIZES)
    assert model.dynamics().states == 2
    assert model.rest_angle() == pytest.approx(0.0, abs=1e-9)


def test_a_state_that_changes_the_length_is_refused():
    @effect("creeping", acts_on="string", summary="", source="")
    def creeping(string, rate=quantity("1/s", typical=1.0)):
        string, z = string.with_state(lambda z: rate - z)
        return string.with_length(string.length + z)

    with pytest.raises(InputError, match="a force, a torque or a reading"):
        pendulum_model(LENGTH, MASS, [creeping]).dynamics()
