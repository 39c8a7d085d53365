"""What is not known of gravity counts in the length of a pendulum, and what is given holds everywhere."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from armdyn.identify.compare import compare
from armdyn.identify.studies import make_study
from armdyn.model_file import ModelFile, base_pendulum, read_model, write_model_file
from armdyn.parameter import Prior
from armdyn.recording.units import KnownQuantity
from armdyn.run import Channel, Run

LENGTH, NOISE = 0.62, 1e-3


def swing(gravity, noise=NOISE):
    """The angle of a free swing by an equation of its own."""
    time = np.arange(0.0, 20.0, 0.01)
    found = solve_ivp(
        lambda _, s: [s[1], -gravity / LENGTH * np.sin(s[0])], (0.0, 20.0), [0.7, 0.0], "DOP853", time, rtol=1e-10
    )
    angle = found.y[0] + noise * np.random.default_rng(7).normal(size=len(time))
    return Run("a.csv", {"swing_angle": Channel(time, angle, "rad")}, {}, {"swing_angle": noise})


def length_of(model, run):
    return compare(make_study(model, [run], [], [])).parameters["length"]


@pytest.mark.parametrize("gravity", [9.78, 9.80665, 9.832])
@pytest.mark.parametrize("noise", [NOISE, 1e-6])
def test_a_length_from_a_period_is_as_uncertain_as_gravity(gravity, noise):
    found = length_of(base_pendulum(), swing(gravity, noise))
    assert found.std == pytest.approx(found.value * 0.02 / 9.81, rel=0.02)
    assert abs(found.value - LENGTH) < 2.0 * found.std


def test_a_length_is_known_better_where_gravity_is_given():
    found = length_of(base_pendulum({"gravity": "9.80665 m/s^2"}), swing(9.80665))
    assert found.std < 1e-5
    assert abs(found.value - LENGTH) < 4.0 * found.std


def test_gravity_may_be_stated_beside_a_recording():
    run = swing(9.79)
    stated = Run(run.name, run.channels, {"gravity": KnownQuantity(9.79, 1e-3, "m/s^2")}, run.noise)
    found = length_of(base_pendulum(), stated)
    assert found.std == pytest.approx(found.value * 1e-3 / 9.79, rel=0.02)
    assert abs(found.value - LENGTH) < 2.0 * found.std


@pytest.mark.parametrize(
    ("given", "value", "prior"),
    [
        (None, 9.81, Prior(9.81, 0.02)),
        ("9.7803 m/s^2 +/- 0.0002 m/s^2", 9.7803, Prior(9.7803, 2e-4)),
        ("1.62 m/s^2", 1.62, None),
    ],
)
def test_a_model_file_keeps_what_is_known_of_gravity(tmp_path, given, value, prior):
    path = tmp_path / "m.toml"
    write_model_file(path, ModelFile(base_pendulum({} if given is None else {"gravity": given}), {}))
    gravity = read_model(path).parameters["gravity"]
    assert (gravity.value, gravity.prior, gravity.fitted) == (value, prior, False)


def test_a_model_file_that_says_nothing_of_gravity_is_read(tmp_path):
    path = tmp_path / "m.toml"
    path.write_text('base = "pendulum"\neffects = []\n[parameters]\nlength = { value = 0.37, unit = "m" }\n')
    assert read_model(path).parameters["gravity"] == base_pendulum().parameters["gravity"]


def test_a_pendulum_on_the_moon_weighs_and_swings_as_there():
    model = base_pendulum({"gravity": "1.62 m/s^2", "mass": "0.1 kg", "length": "0.5 m"})
    time = np.arange(0.0, 1.0, 0.01)
    rest = Run("rest.csv", {"load_force": Channel(time, 0.0 * time, "N")})
    assert np.allclose(model.predict(rest, model.theta()).values, 0.162, atol=1e-12)
    assert model.start_state_window_seconds(model.theta()) == pytest.approx(2 * np.pi * np.sqrt(0.5 / 1.62))
    step = model.variational().step([0, 0, 0.1, 0], 0.0, 0.0, 0.01, model.physics_theta())
    assert float(step[3]) == pytest.approx(-0.01 * 1.62 / 0.5 * np.sin(0.1), rel=1e-3)
