import numpy as np
import pytest

from armdyn.experiments.series import LONGEST_PERIOD, Series


@pytest.fixture
def coefficients():
    return lambda series: np.random.default_rng(3).standard_normal((2, series.size))


@pytest.mark.parametrize("seconds", [2.0, 7.3, 20.0, 50.0])
def test_a_motion_starts_and_ends_at_rest_with_zero_acceleration(seconds, coefficients):
    series = Series(seconds)
    ends = series.motion(coefficients(series), np.array([0.0, seconds]))
    inside = series.motion(coefficients(series), np.linspace(0.0, seconds, 200))
    assert np.abs(ends.v).max() < 1e-9 * np.abs(inside.v).max()
    assert np.abs(ends.a).max() < 1e-9 * np.abs(inside.a).max()
    assert ends.q[0] == pytest.approx(ends.q[1])


def test_velocity_and_acceleration_are_the_derivatives_of_position(coefficients):
    series = Series(20.0)
    time, h = np.linspace(0.5, 19.0, 60), 1e-4
    x = coefficients(series)
    before, here, after = (series.motion(x, time + k * h) for k in (-1, 0, 1))
    assert here.v == pytest.approx((after.q - before.q) / (2 * h), abs=1e-5)
    assert here.a == pytest.approx((after.v - before.v) / (2 * h), abs=1e-4)


def test_a_long_motion_repeats_a_period(coefficients):
    series = Series(50.0)
    assert series.period <= LONGEST_PERIOD
    time = np.linspace(0.0, 5.0, 20)
    x = coefficients(series)
    assert series.motion(x, time + series.period).q == pytest.approx(series.motion(x, time).q)


def test_few_harmonics_hold_no_higher_frequency(coefficients):
    series = Series(20.0)
    x = coefficients(series) @ series.low(5)
    samples = series.motion(x, series.period * np.arange(256) / 256).q
    power = np.abs(np.fft.rfft(samples, axis=0)) ** 2
    assert power[6:].max() < 1e-18 * power.max()
    ends = series.motion(x, np.zeros(1))
    assert np.abs([ends.v, ends.a]).max() < 1e-9
