"""Every effect on the pendulum: absent at null, exact derivatives, and the physics of equations written apart."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from worlds import pendulum

from armdyn.effects.catalogue import CATALOGUE
from armdyn.pendulum.model import pendulum_model
from armdyn.run import Channel, Run

PENDULUM = [name for name, effect in CATALOGUE.items() if effect.acts_on not in ("joint", "drive", "wrench")]
AGREEMENT = dict.fromkeys(pendulum.REALISTIC, 2e-5) | {
    "gripper_lag": 1e-3,  # the lag starts from rest there, from a steady motion here
    "gripper_compliance": 1e-3,  # slow manifold against a light carriage that rings at first
    "string_elasticity": 4e-4,
    "out_of_plane_swing": 1e-3,
    "sensor_lag": 1e-3,
}
"""N; the noise of a good load cell is 3e-3."""


def short_run(duration=2.0):
    t = np.arange(0.0, duration, 0.01)
    x = 0.06 * (1 - np.cos(2 * np.pi * 0.6 * t)) + 0.02 * (1 - np.cos(2 * np.pi * 1.15 * t))
    channels = {"gripper_x": Channel(t, x, "m")}
    for name, unit in (("load_force", "N"), ("swing_angle", "rad"), ("swing_rate", "rad/s")):
        channels[name] = Channel(t, 0 * t, unit)
    return Run("a.csv", channels, {}, {"gripper_x": 0.0})


RUN = short_run()
BASE = pendulum_model(0.368, 0.08).with_values({"initial_angle": 0.2, "initial_rate": 0.1})


ROUNDING = 1e-14  # relative error of a prediction that some hundred steps leave


@pytest.mark.parametrize("name", PENDULUM)
def test_an_effect_changes_nothing_at_null_to_the_last_digit_and_has_exact_derivatives(name):
    effect = CATALOGUE[name]
    model = BASE.with_effect(effect)
    assert np.array_equal(model.predict(RUN, model.theta()).values, BASE.predict(RUN, BASE.theta()).values)
    model = model.with_values({p.name: 0.7 * p.typical for p in effect.parameters()})
    theta = model.theta()
    exact = model.predict(RUN, theta).sensitivities
    for i, parameter in enumerate(model.parameters.values()):
        step = np.zeros(len(theta))
        step[i] = 1e-5 * parameter.typical
        above, below = model.predict(RUN, theta + step).values, model.predict(RUN, theta - step).values
        finite, rounding = (above - below) / (2 * step[i]), ROUNDING * np.max(np.abs(above)) / step[i]
        assert np.max(np.abs(exact[:, i] - finite)) < 1e-6 * np.max(np.abs(finite)) + rounding, parameter.name


@pytest.mark.parametrize("name", pendulum.REALISTIC)
def test_an_effect_is_the_physics_of_equations_written_apart(name):
    size = pendulum.REALISTIC[name]
    setup = pendulum.Setup(hidden={name: size}, force_noise=0.0, start=(0.02, 0.03), duration=4.0)
    run = pendulum.record("a.csv", setup, np.random.default_rng(5))
    first = CATALOGUE[name].parameters()[0].name
    value = size**2 if name == "out_of_plane_swing" else size
    model = pendulum_model(0.368, 0.08, [CATALOGUE[name]])
    model = model.with_values({"initial_angle": 0.02, "initial_rate": 0.03, first: value})
    error = run.channels["load_force"].value - model.predict(run, model.theta()).values
    without = pendulum_model(0.368, 0.08).with_values({"initial_angle": 0.02, "initial_rate": 0.03})
    change = run.channels["load_force"].value - without.predict(run, without.theta()).values
    assert np.sqrt(np.mean(error**2)) < min(AGREEMENT[name], 0.2 * np.sqrt(np.mean(change**2)))


@settings(max_examples=8)
@given(order=st.permutations(["sensor_bias", "sensor_gain", "linear_drag"]))
def test_the_order_in_which_effects_are_added_does_not_matter(order):
    values = {"sensor_bias.force": 0.1, "sensor_gain.error": 0.05, "linear_drag.coefficient": 0.01}
    model = pendulum_model(0.368, 0.08, [CATALOGUE[name] for name in order]).with_values(values)
    sorted_model = pendulum_model(0.368, 0.08, [CATALOGUE[name] for name in sorted(order)]).with_values(values)
    assert np.array_equal(
        model.predict(RUN, model.theta()).values, sorted_model.predict(RUN, sorted_model.theta()).values
    )


def test_the_upper_end_of_a_heavy_string_carries_load_and_string():
    model = pendulum_model(0.4, 0.1, [CATALOGUE["string_mass"]]).with_values({"string_mass.mass": 0.02})
    t = np.arange(0.0, 1.0, 0.01)
    run = Run("rest.csv", {"load_force": Channel(t, 0 * t, "N")})
    assert np.allclose(model.predict(run, model.theta()).values, 0.12 * 9.81, atol=1e-12)


def test_a_stiff_pivot_is_a_spring_beside_the_weight():
    model = pendulum_model(0.4, 0.1, [CATALOGUE["pivot_stiffness"]])
    model = model.with_values({"pivot_stiffness.stiffness": 0.05, "initial_angle": 0.01})
    t = np.arange(0.0, 10.0, 0.01)
    run = Run("still.csv", {"swing_angle": Channel(t, 0 * t, "rad")})
    rate = np.sqrt(9.81 / 0.4 + 0.05 / (0.1 * 0.4**2))
    assert np.allclose(model.predict(run, model.theta()).values, 0.01 * np.cos(rate * t), atol=5e-6)


@pytest.mark.parametrize(
    ("name", "read"),
    [
        ("angle_gain", lambda phi: 1.1 * phi),
        ("angle_skew", lambda phi: phi + 0.1 * phi**2),
        ("angle_distortion", lambda phi: phi + 0.1 * phi**3),
    ],
)
def test_an_angle_sensor_reads_a_polynomial_of_the_true_angle_and_a_gyro_does_not(name, read):
    effect = CATALOGUE[name]
    model = BASE.with_effect(CATALOGUE["angle_offset"]).with_effect(effect)
    model = model.with_values({"angle_offset.angle": 0.3, effect.parameters()[0].name: 0.1})
    wrong, right = (m.predict(RUN, m.theta()) for m in (model, BASE))
    angle = right.values[right.slices["swing_angle"]]
    assert np.allclose(wrong.values[wrong.slices["swing_angle"]], read(angle) + 0.3, atol=1e-14)
    for other in ("load_force", "swing_rate"):
        assert np.array_equal(wrong.values[wrong.slices[other]], right.values[right.slices[other]])


def test_the_bias_of_a_gyro_is_not_that_of_a_load_cell():
    model = BASE.with_effect(CATALOGUE["sensor_bias"]).with_values({"sensor_bias.rate": 2.4})
    wrong, right = (m.predict(RUN, m.theta()) for m in (model, BASE))
    change = wrong.values - right.values
    assert np.allclose(change[wrong.slices["swing_rate"]], 2.4)
    assert not change[wrong.slices["load_force"]].any()
    assert not change[wrong.slices["swing_angle"]].any()
