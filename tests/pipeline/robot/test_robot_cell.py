import numpy as np
import pytest
from simulated_truth import load_truth

from pipeline.robot.devices import SimulatedCell
from pipeline.robot.hidden import resolve_hidden
from pipeline.robot.settings import CellSettings

QUIET = {"noise": 0.0, "resolution": 0.0}


def cell(hidden=None, latency=0.0, bias=0.0, seed=1, **settings):
    rng = np.random.default_rng(seed)
    return SimulatedCell(CellSettings(**{**QUIET, **settings}), resolve_hidden(hidden or {}), bias, latency, rng)


def samples(tension, seconds=2.0, angle=0.0, **given):
    """Time of reception and reading of every sample of a cell that feels tension(t) and angle."""
    made = cell(**given)
    for step in range(round(seconds * 1000)):
        made.feel(step, tension(step * 1e-3), angle)
    received = made.received(seconds)
    return np.array([s.time for s in received]), np.array([s.force for s in received])


def wave(time):
    return 0.8 + 0.1 * np.sin(6.0 * time)


def test_samples_come_every_ten_milliseconds():
    time, _ = samples(wave)
    np.testing.assert_allclose(np.diff(time), 0.01, atol=1e-12)


def test_samples_on_the_way_are_not_handed_out_and_none_is_handed_out_twice():
    made = cell(latency=0.025)
    for step in range(51):
        made.feel(step, 1.0, 0.0)
    assert [s.time for s in made.received(0.05)] == pytest.approx([0.025, 0.035, 0.045])
    assert made.received(0.05) == []
    assert [s.time for s in made.received(0.06)] == pytest.approx([0.055])


def test_noise_has_the_standard_deviation_of_the_settings():
    _, force = samples(lambda _: 0.8, 60.0, noise=5e-3)
    assert np.std(force) == pytest.approx(5e-3, rel=0.05)
    assert np.mean(force) == pytest.approx(0.8, abs=2e-4)


def test_readings_are_multiples_of_the_resolution():
    _, force = samples(wave, resolution=5e-4)
    np.testing.assert_allclose(force / 5e-4, np.round(force / 5e-4), atol=1e-9)


def test_reading_stays_within_full_scale():
    _, force = samples(lambda t: 20.0 * np.sin(6.0 * t), full_scale=9.8)
    assert (force.min(), force.max()) == (-9.8, 9.8)


LAG = 1.0 / (1.0 + 6.0j * 0.05)
"""Response of a first-order filter of 0.05 s at 6 rad/s."""


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({}, wave),
        ({"latency": 0.0137}, lambda t: wave(t - 0.0137)),
        ({"hidden": {"sensor_bias": 0.03}, "bias": 0.01}, lambda t: wave(t) + 0.04),
        ({"hidden": {"sensor_gain": -0.1}}, lambda t: 0.9 * wave(t)),
        ({"hidden": {"sensor_drift": 2e-3}}, lambda t: wave(t) + 2e-3 * t),
        ({"hidden": {"sensor_delay": 0.04}, "latency": 0.005}, lambda t: wave(t - 0.045)),
        ({"hidden": {"sensor_nonlinearity": 0.05}}, lambda t: wave(t) + 0.05 * wave(t) ** 2),
        ({"hidden": {"vertical_sensing_axis": None}, "angle": 0.4}, lambda t: wave(t) * np.cos(0.4)),
        ({"hidden": {"cross_axis_sensitivity": 0.05}, "angle": -0.4}, lambda t: wave(t) * (1.0 - 0.05 * np.sin(0.4))),
        ({"hidden": {"sensor_lag": 0.05}}, lambda t: 0.8 + 0.1 * np.abs(LAG) * np.sin(6.0 * t + np.angle(LAG))),
    ],
)
def test_reading_is_the_force_with_what_each_effect_makes_of_it(given, expected):
    time, force = samples(wave, 3.0, **given)
    late = time > 1.0
    tolerance = 4e-4 if "sensor_lag" in given.get("hidden", {}) else 1e-12  # the filter goes in steps of 1 ms
    np.testing.assert_allclose(force[late], expected(time[late]), atol=tolerance)


@pytest.mark.parametrize("name", ["vertical_sensing_axis", "cross_axis_sensitivity"])
def test_direction_of_the_swinging_string_reaches_the_cell(still_pendulum, name):
    robot = still_pendulum(0.4, {name: 0.5})
    robot.advance(0.5)
    load = load_truth(robot)
    robot.advance(0.001)
    share = np.cos(load.swing_angle) if name == "vertical_sensing_axis" else 1 + np.sin(load.swing_angle)
    assert robot.load_cell()[-1].force == pytest.approx(load.tension * (1 + share) / 2, abs=1e-6)
