"""Choose the cut-off and order of smoothing under which samples are most probable, and smooth a signal."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from armdyn.smoothing.spline import (
    MAX_UNDISTORTED_CUTOFF_PER_KNOT,
    PENALTY_ORDER,
    LowPass,
    SplineCurve,
    SplineSamples,
    basis_matrix,
)

SPLINE_ORDERS = (4, 3, 5, 6)
MAX_SMOOTHING_CUTOFF_SHARE_OF_RATE = 0.3
"""Highest cut-off of smoothing that is tried, as a share of the sampling rate."""
MAX_RATE_WEIGHT = 1e8
"""Largest weight of a sample of a derivative, per knot interval, in those of a sample of the signal: with more, as of a
simulation without noise, the equations lose the digits that determine the signal's constant part."""
KNOT_INTERVAL_FACTOR = 4
"""Ratio of the spline's knot intervals in two successive searches for a cut-off."""
CUTOFFS_TRIED, FIRST_CUTOFF_STRIDE = 12, 3
"""Number of cut-offs in a search, and stride between the cut-offs that are tried first."""
MIN_ORDER_CHANGE_DEVIANCE = 20.0
"""Twice the log-likelihood by which another order of smoothing must exceed the preferred one."""


class SmoothingChoice(NamedTuple):
    """Choice of smoothing: cut-off, Hz, standard deviation of the noise, and order of the penalised differences."""

    cutoff: float
    noise: float
    order: int = PENALTY_ORDER


def best_smoothing(time: np.ndarray, values: np.ndarray, orders: Sequence[int] = (PENALTY_ORDER,)) -> SmoothingChoice:
    """Find the smoothing under which a signal is most probable.

    Args:
        time: (n,) time stamps, s.
        values: (n,) samples; a constant has no noise.
        orders: orders to choose from, the preferred one first.
    """
    span = float(np.std(values))
    if span == 0.0:
        return SmoothingChoice(2.0 / float(time[-1] - time[0]), 0.0, orders[0])
    scaled = values / span  # so that orders with different numbers of free coefficients can be compared
    rounding = resolution(scaled) / np.sqrt(12.0)
    first = _best_cutoff(time, scaled, rounding, orders[0])
    best, best_score = first, -np.inf
    if len(orders) > 1:
        near = SplineSamples(time, 0.5 * MAX_UNDISTORTED_CUTOFF_PER_KNOT / first.cutoff)
        others = [_best_near(near.with_order(order), first.cutoff, scaled, rounding) for order in orders[1:]]
        all_alike = SplineSamples(
            time, MAX_UNDISTORTED_CUTOFF_PER_KNOT / max(choice.cutoff for choice in (first, *others))
        )
        best_score = (
            _score(all_alike.with_order(first.order), first.cutoff, scaled, rounding) - MIN_ORDER_CHANGE_DEVIANCE
        )
        for choice in others:
            score = _score(all_alike.with_order(choice.order), choice.cutoff, scaled, rounding)
            if score < best_score:
                best, best_score = choice, score
    return best._replace(noise=best.noise * span)


def resolution(values: np.ndarray) -> float:
    """Resolution of an encoder or a file's digits: smallest difference of (n,) values, except rounding errors."""
    differences = np.diff(np.unique(values))
    return float(np.min(differences[differences > 1e-9 * np.ptp(values)], initial=np.ptp(values)))


def _best_cutoff(time: np.ndarray, values: np.ndarray, least_noise: float, order: int) -> SmoothingChoice:
    """The most probable cut-off for one order; knots become coarser while it is below the finer ones' range."""
    samples = SplineSamples(time, None, order)
    slowest = 2.0 / float(time[-1] - time[0])
    low, high = samples.lowest_cutoff, MAX_SMOOTHING_CUTOFF_SHARE_OF_RATE / samples.interval
    while True:
        cutoffs = np.geomspace(max(low, slowest), max(high, 2.0 * slowest), CUTOFFS_TRIED)
        choice = _best_of(cutoffs, samples, values, least_noise)
        if choice.cutoff > cutoffs[0] or low <= slowest or samples.size < 8 * KNOT_INTERVAL_FACTOR:
            return choice
        samples = SplineSamples(time, KNOT_INTERVAL_FACTOR * samples.step, order)
        low, high = samples.lowest_cutoff, MAX_UNDISTORTED_CUTOFF_PER_KNOT / samples.step


def _best_near(samples: SplineSamples, around: float, values: np.ndarray, least_noise: float) -> SmoothingChoice:
    """The most probable of the cut-offs near `around`, Hz."""
    slowest = 2.0 / float(samples.time[-1] - samples.time[0])
    low, high = 0.4 * around, min(2.0 * around, MAX_SMOOTHING_CUTOFF_SHARE_OF_RATE / samples.interval)
    cutoffs = np.geomspace(max(low, slowest), max(high, 2.0 * slowest), CUTOFFS_TRIED // 2)
    return _best_of(cutoffs, samples, values, least_noise)


def _best_of(cutoffs: np.ndarray, samples: SplineSamples, values: np.ndarray, least_noise: float) -> SmoothingChoice:
    """The most probable of (k,) cut-offs, or one between it and its neighbours.

    Every third is tried, then the neighbours of the best so far; the first one is tried only where it could be the
    best.
    """
    scores: dict[int, float] = {}
    new = {*range(0, len(cutoffs), FIRST_CUTOFF_STRIDE), len(cutoffs) - 1}
    while new:
        scores |= {i: _score(samples, float(cutoffs[i]), values, least_noise) for i in sorted(new)}
        best = min(scores, key=lambda i: (scores[i], i))
        new = {i for i in (best - 1, best + 1) if 0 <= i < len(cutoffs)} - scores.keys()
    cutoff = _vertex(cutoffs, scores, best)
    return SmoothingChoice(cutoff, LowPass(samples, cutoff).evidence(values, least_noise)[1], samples.order)


def derivative_noise(choice: SmoothingChoice, interval: float, derivative: int) -> float:
    """Standard deviation of a smoothed signal's derivative, in 1/s^k.

    It is sigma^2 dt 2 int (2 pi f)^(2k) / (1 + (f/f_c)^2m) df: the part of the spectrum that the samples do not
    determine.

    Args:
        choice: the smoothing; see `best_smoothing`.
        interval: interval between samples, s.
        derivative: order k of the derivative, k < m.
    """
    integral = np.pi / (2 * choice.order) / np.sin((2 * derivative + 1) * np.pi / (2 * choice.order))
    spread = np.sqrt(2.0 * interval * choice.cutoff * integral) * (2.0 * np.pi * choice.cutoff) ** derivative
    return float(choice.noise * spread)


def _score(samples: SplineSamples, cutoff: float, values: np.ndarray, least_noise: float) -> float:
    return LowPass(samples, cutoff).evidence(values, least_noise)[0]


def _vertex(cutoffs: np.ndarray, scores: Mapping[int, float], best: int) -> float:
    """Minimum of the parabola through the best score and its neighbours, over the logarithm of the cut-off."""
    if not 0 < best < len(cutoffs) - 1:
        return float(cutoffs[best])
    left, middle, right = scores[best - 1], scores[best], scores[best + 1]
    bend = left - 2.0 * middle + right
    shift = 0.5 * (left - right) / bend if bend > 0.0 else 0.0
    return float(cutoffs[best] * (cutoffs[1] / cutoffs[0]) ** shift)


class MeasuredDerivative(NamedTuple):
    """Measured derivative of a signal: (n,) times, s, (n,) values, and the order of the derivative."""

    time: np.ndarray
    values: np.ndarray
    derivative: int


def smooth_curve(
    time: np.ndarray, values: np.ndarray, choice: SmoothingChoice, rates: Sequence[MeasuredDerivative] = ()
) -> SplineCurve:
    """Fit a curve through a noisy signal and its measured derivatives, each weighted by its agreement.

    The noise of a derivative is its difference from the curve through the other signals: a derivative that is filtered
    or late gets little weight where it contradicts the signal itself.

    Args:
        time: (n,) time stamps, s.
        values: (n,) samples of the signal.
        choice: the smoothing; see `best_smoothing`.
        rates: measured derivatives of the signal.
    """
    # Measured derivatives resolve more than the cut-off of the signal alone.
    samples = SplineSamples(time, None if rates else MAX_UNDISTORTED_CUTOFF_PER_KNOT / choice.cutoff, choice.order)
    while samples.lowest_cutoff > choice.cutoff:
        samples = SplineSamples(time, KNOT_INTERVAL_FACTOR * samples.step, choice.order)
    curve = LowPass(samples, choice.cutoff).curve(values)
    if not rates or choice.noise == 0.0:
        return curve
    offset = values[0]
    matrices = [basis_matrix(r.time, samples.start, samples.step, samples.size, r.derivative) for r in rates]
    for _ in range(3):  # the weights converge to a few per cent
        bands = samples.normal + samples.penalty_weight(choice.cutoff) * samples.penalty
        right = samples.matrix.T @ (values - offset)
        for rate, matrix in zip(rates, matrices, strict=True):
            deviation = max(float(np.std(rate.values - matrix @ curve.coefficients[:, 0])), 1e-9)
            weight = min((choice.noise / deviation) ** 2, MAX_RATE_WEIGHT * samples.step ** (2 * rate.derivative))
            bands = bands + weight * samples.bands(matrix)
            right = right + weight * (matrix.T @ rate.values)
        factor = cholesky_banded(bands, lower=True, check_finite=False)
        c = cho_solve_banded((factor, True), right, check_finite=False)
        curve = SplineCurve(samples.start, samples.step, c[:, None] + offset)
    return curve
