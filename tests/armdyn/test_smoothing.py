import numpy as np
import pytest
from scipy.interpolate import BSpline

from armdyn.errors import InputError
from armdyn.smoothing.choice import SPLINE_ORDERS, MeasuredDerivative, best_smoothing, derivative_noise, smooth_curve
from armdyn.smoothing.spline import (
    MAX_UNDISTORTED_CUTOFF_PER_KNOT,
    WHITE_RATE_OVER_TWICE_CUTOFF,
    LowPass,
    SplineCurve,
    SplineSamples,
)


def uneven(n=1500, interval=0.01, seed=0):
    """Stamps that wander by a third of the interval."""
    rng = np.random.default_rng(seed)
    return interval * (np.arange(n) + rng.uniform(-0.33, 0.33, n))


def swing(t, derivative=0):
    """Two sines, or their k-th derivative."""
    parts = [(1.0, 0.5, 0.0), (0.3, 1.7, 1.0)]
    return sum(
        a * (2 * np.pi * f) ** derivative * np.sin(2 * np.pi * f * t + p + derivative * np.pi / 2) for a, f, p in parts
    )


@pytest.mark.parametrize("derivative", range(4))
def test_a_basis_function_is_that_of_scipy(derivative):
    ours = SplineCurve(0.0, 0.5, np.eye(12))
    theirs = BSpline.basis_element(0.5 * np.arange(7))
    x = np.linspace(0.01, 2.99, 50)  # the seventh begins at its first knot
    expected = theirs(x) if derivative == 0 else theirs.derivative(derivative)(x)
    assert ours(x, derivative)[:, 5] == pytest.approx(expected, abs=1e-11)


@pytest.mark.parametrize("order", SPLINE_ORDERS)
def test_a_polynomial_below_the_order_passes_unchanged(order):
    t = uneven(400)
    x = np.polynomial.Polynomial([0.3, -1.0, 0.2, 0.1, 0.05, -0.01][:order])
    curve = LowPass(SplineSamples(t, MAX_UNDISTORTED_CUTOFF_PER_KNOT / 4.0, order), 2.0).curve(x(t))
    for k in range(3):
        assert np.abs(curve(t, k)[:, 0] - x.deriv(k)(t)).max() < 1e-6


@pytest.mark.parametrize("order", SPLINE_ORDERS)
def test_the_amplitude_is_halved_at_the_cutoff_without_phase_shift(order):
    t = np.arange(4000) / 100
    wave = np.exp(2j * np.pi * 2.0 * t)
    low = LowPass(SplineSamples(t, MAX_UNDISTORTED_CUTOFF_PER_KNOT / 4.0, order), 2.0)
    passed = (low.curve(wave.real)(t) + 1j * low.curve(wave.imag)(t))[1000:3000, 0] / wave[1000:3000]
    assert np.mean(passed).real == pytest.approx(0.5, abs=0.02)
    assert np.abs(passed.imag).max() < 0.01


@pytest.mark.parametrize("noise", [1e-5, 4e-4, 1e-2])
def test_noise_and_its_share_in_derivatives_are_found_at_uneven_stamps(noise):
    t = uneven()
    y = swing(t) + noise * np.random.default_rng(1).standard_normal(len(t))
    choice = best_smoothing(t, y, SPLINE_ORDERS)
    curve = smooth_curve(t, y, choice)
    assert choice.noise == pytest.approx(noise, rel=0.2)
    inside = slice(100, -100)
    for k in (1, 2):
        error = np.std((curve(t, k)[:, 0] - swing(t, k))[inside])
        assert error < 1.5 * derivative_noise(choice, 0.01, k)


def test_an_encoder_that_moves_a_few_steps_is_not_taken_for_jerky():
    t = np.arange(1500) / 100
    step = 2 * np.pi / 16384
    y = np.round(0.002 * swing(t) / step) * step
    choice = best_smoothing(t, y, SPLINE_ORDERS)
    assert choice.noise >= step / np.sqrt(12) * 0.999
    assert choice.cutoff < 6.0


def test_a_file_with_few_digits_is_smoothed_below_its_last_digit():
    t = np.arange(1500) / 100
    curve = smooth_curve(t, np.round(swing(t), 3), best_smoothing(t, np.round(swing(t), 3), SPLINE_ORDERS))
    assert np.std(curve(t)[:, 0] - swing(t)) < 0.5e-3 / np.sqrt(12)


def test_measured_velocities_that_agree_improve_the_acceleration():
    t, rng = uneven(), np.random.default_rng(3)
    y = swing(t) + 1e-2 * rng.standard_normal(len(t))
    v = swing(t, 1) + 1e-2 * rng.standard_normal(len(t))
    choice = best_smoothing(t, y, SPLINE_ORDERS)
    alone, with_v = (smooth_curve(t, y, choice, rates) for rates in ((), (MeasuredDerivative(t, v, 1),)))
    inside = slice(100, -100)
    errors = [np.std((c(t, 2)[:, 0] - swing(t, 2))[inside]) for c in (alone, with_v)]
    assert errors[1] < 0.6 * errors[0]


def test_velocities_that_arrive_late_do_little_harm():
    t, rng = uneven(), np.random.default_rng(4)
    y = swing(t) + 4e-4 * rng.standard_normal(len(t))
    choice = best_smoothing(t, y, SPLINE_ORDERS)
    late = smooth_curve(t, y, choice, (MeasuredDerivative(t, swing(t - 0.05, 1), 1),))
    inside = slice(100, -100)
    assert np.std((late(t, 1)[:, 0] - swing(t, 1))[inside]) < 0.1 * np.std(swing(t, 1) - swing(t - 0.05, 1))


def test_a_gap_is_bridged():
    t = uneven()
    t = t[(t < 6.0) | (t > 6.3)]
    y = swing(t) + 1e-4 * np.random.default_rng(5).standard_normal(len(t))
    curve = smooth_curve(t, y, best_smoothing(t, y, SPLINE_ORDERS))
    middle = np.linspace(6.0, 6.3, 20)
    assert np.abs(curve(middle)[:, 0] - swing(middle)).max() < 0.02


def test_white_noise_is_white_again_after_low_pass_and_thinning():
    rng, t, cutoff = np.random.default_rng(6), np.arange(40000) / 100, 4.0
    low = LowPass(SplineSamples(t, MAX_UNDISTORTED_CUTOFF_PER_KNOT / cutoff), cutoff).curve(rng.standard_normal(len(t)))
    step = 1 / (2 * WHITE_RATE_OVER_TWICE_CUTOFF * cutoff)
    kept = low(np.arange(2.0, 398.0, step))[:, 0]
    lags = [np.corrcoef(kept[k:], kept[:-k])[0, 1] for k in (1, 2, 3)]
    assert np.abs(lags).max() < 4 / np.sqrt(len(kept))
    assert np.std(kept) == pytest.approx(np.sqrt(0.01 / step), rel=0.05)


def test_a_signal_that_does_not_move_has_no_noise_and_no_rate():
    t = uneven(200)
    choice = best_smoothing(t, np.full(200, 0.7), SPLINE_ORDERS)
    curve = smooth_curve(t, np.full(200, 0.7), choice)
    assert choice.noise == 0.0
    assert np.all(curve(t)[:, 0] == pytest.approx(0.7, abs=1e-15))
    assert np.abs(curve(t, 2)).max() < 1e-9


def test_too_few_samples_are_refused(complains):
    with complains(InputError):
        SplineSamples(np.arange(7.0))


@pytest.mark.parametrize("order", SPLINE_ORDERS)
def test_a_gap_of_hundreds_of_samples_is_smoothed_at_every_order(order):
    time = np.arange(0.0, 40.0, 0.02)
    time = time[(time < 10.0) | (time > 20.0)]
    samples = np.sin(0.3 * time) + np.random.default_rng(4).normal(0.0, 1e-3, len(time))
    curve = smooth_curve(time, samples, best_smoothing(time, samples, (order,)))
    assert np.std(curve(time)[:, 0] - np.sin(0.3 * time)) < 5e-4


def test_exact_derivatives_leave_the_signal_where_it_is():
    """As of a simulation without noise: their weights must not drown the signal's constant part in rounding errors."""
    t = np.arange(0.0, 1.0, 0.002)
    value, rate, bend = 0.3 * np.sin(t) + 0.7, 0.3 * np.cos(t), -0.3 * np.sin(t)
    choice = best_smoothing(t, value, (2, 4, 6))
    curve = smooth_curve(t, value, choice, [MeasuredDerivative(t, rate, 1), MeasuredDerivative(t, bend, 2)])
    np.testing.assert_allclose(curve(t)[:, 0], value, atol=1e-5)
