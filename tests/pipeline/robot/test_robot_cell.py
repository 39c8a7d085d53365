import numpy as np
import pytest

from pipeline.robot.devices import SimulatedCell
from pipeline.robot.hidden import resolve_hidden
from pipeline.robot.settings import CellSettings

QUIET = {"noise": 0.0, "resolution": 0.0}


def _samples(tension, seconds=2.0, hidden=None, latency=0.0, bias=0.0, angle=0.0, **settings):
    """Time of reception and reading of every sample of a cell that feels tension(t) and angle."""
    rng = np.random.default_rng(1)
    cell = SimulatedCell(CellSettings(**{**QUIET, **settings}), resolve_hidden(hidden or {}), bias, latency, rng)
    for step in range(round(seconds * 1000)):
        cell.feel(step, tension(step * 1e-3), angle)
    received = cell.received(seconds)
    return np.array([s.time for s in received]), np.array([s.force for s in received])


def wave(time):
    return 0.8 + 0.1 * np.sin(6.0 * time)


def test_samples_come_every_ten_milliseconds_with_the_true_force():
    time, force = _samples(wave)
    np.testing.assert_allclose(np.diff(time), 0.01, atol=1e-12)
    np.testing.assert_allclose(force, wave(time), atol=1e-12)


def test_samples_are_stamped_at_reception():
    time, force = _samples(wave, latency=0.0137)
    np.testing.assert_allclose(force, wave(time - 0.0137), atol=1e-12)


def test_samples_on_the_way_are_not_handed_out_and_none_is_handed_out_twice():
    cell = SimulatedCell(CellSettings(**QUIET), resolve_hidden({}), 0.0, 0.025, np.random.default_rng(0))
    for step in range(51):
        cell.feel(step, 1.0, 0.0)
    assert [s.time for s in cell.received(0.05)] == pytest.approx([0.025, 0.035, 0.045])
    assert cell.received(0.05) == []
    assert [s.time for s in cell.received(0.06)] == pytest.approx([0.055])


def test_noise_has_the_standard_deviation_of_the_settings():
    _, force = _samples(lambda _: 0.8, 60.0, noise=5e-3)
    assert np.std(force) == pytest.approx(5e-3, rel=0.05)
    assert np.mean(force) == pytest.approx(0.8, abs=2e-4)


def test_readings_are_multiples_of_the_resolution():
    _, force = _samples(wave, resolution=5e-4)
    np.testing.assert_allclose(force / 5e-4, np.round(force / 5e-4), atol=1e-9)


def test_reading_stays_within_full_scale():
    _, force = _samples(lambda t: 20.0 * np.sin(6.0 * t), full_scale=9.8)
    assert force.max() == 9.8
    assert force.min() == -9.8


class TestHiddenEffects:
    def test_sensor_bias_adds_to_the_drawn_one(self):
        time, force = _samples(wave, hidden={"sensor_bias": 0.03}, bias=0.01)
        np.testing.assert_allclose(force, wave(time) + 0.04, atol=1e-12)

    def test_sensor_gain_scales_the_force(self):
        time, force = _samples(wave, hidden={"sensor_gain": -0.1})
        np.testing.assert_allclose(force, 0.9 * wave(time), atol=1e-12)

    def test_sensor_drift_grows_with_time(self):
        time, force = _samples(wave, hidden={"sensor_drift": 2e-3})
        np.testing.assert_allclose(force, wave(time) + 2e-3 * time, atol=1e-12)

    def test_sensor_delay_adds_to_the_latency(self):
        time, force = _samples(wave, hidden={"sensor_delay": 0.04}, latency=0.005)
        np.testing.assert_allclose(force, wave(time - 0.045), atol=1e-12)

    def test_sensor_lag_answers_a_sine_as_a_first_order_filter(self):
        time, force = _samples(wave, 4.0, hidden={"sensor_lag": 0.05})
        response = 1.0 / (1.0 + 6.0j * 0.05)
        expected = 0.8 + 0.1 * np.abs(response) * np.sin(6.0 * time + np.angle(response))
        np.testing.assert_allclose(force[time > 1.0], expected[time > 1.0], atol=4e-4)

    def test_vertical_sensing_axis_measures_the_vertical_part(self):
        time, force = _samples(wave, hidden={"vertical_sensing_axis": None}, angle=0.4)
        np.testing.assert_allclose(force, wave(time) * np.cos(0.4), atol=1e-12)

    def test_cross_axis_sensitivity_adds_a_share_of_the_pull_along_the_line(self):
        time, force = _samples(wave, hidden={"cross_axis_sensitivity": 0.05}, angle=-0.4)
        np.testing.assert_allclose(force, wave(time) * (1.0 - 0.05 * np.sin(0.4)), atol=1e-12)

    def test_sensor_nonlinearity_adds_the_square(self):
        time, force = _samples(wave, hidden={"sensor_nonlinearity": 0.05})
        np.testing.assert_allclose(force, wave(time) + 0.05 * wave(time) ** 2, atol=1e-12)

    @pytest.mark.parametrize("name", ["vertical_sensing_axis", "cross_axis_sensitivity"])
    def test_direction_of_the_swinging_string_reaches_the_cell(self, still_pendulum, name):
        plant = still_pendulum(0.4, {name: 0.5})
        plant.advance(0.5)
        load = plant.load_truth()
        plant.advance(0.001)
        share = np.cos(load.swing_angle) if name == "vertical_sensing_axis" else 1 + np.sin(load.swing_angle)
        assert plant.load_cell()[-1].force == pytest.approx(load.tension * (1 + share) / 2, abs=1e-6)
