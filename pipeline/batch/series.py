"""Test one series, a parameter over time, for a step and for a slope.

With y_i the values at times t_i, w_i = 1/scale_i and u_k the unit step after recording k, the test statistic is

    t_k: the t statistic of the coefficient of w u_k in the regression of w y on w, w t, w u_k,

and the largest t_k is converted to the normal deviate of the same probability (Wallace 1959). Neighbouring recordings
may be correlated, for example by the temperature: they are modelled as an AR(1) process with coefficient phi, which is
shared by a quantity's series on all joints of all robots. The correlation is removed from both sides of the regression
by replacing z_i by z_i - phi z_i-1 (Prais and Winsten 1954).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.signal import lfilter

from armdyn.recording.channels import FloatArray
from armdyn.recording.noise import ABS_NORMAL_MEDIAN_OVER_STD

MIN_RECORDINGS_PER_SIDE_OF_STEP = 4
"""Smallest number of recordings before and after a step: fewer may be a temporary disturbance."""
MIN_SERIES_RECORDINGS = 10
"""Smallest number of recordings of a series that is tested."""
EQUAL_VALUES_RELATIVE_SPREAD = 1e-12
"""Relative spread below which all values of a series count as equal."""
OUTLIER_STANDARD_DEVIATIONS = 3.0
"""Distance from the median of five neighbouring recordings beyond which a recording is an outlier.

The unit is the standard deviation. The five are the recording itself and two on each side; the first recording after a
step is not an outlier, because three of its five have the new value.
"""
MAX_VALUES_SIMULATED_AT_ONCE = 2_000_000
"""Largest number of values of simulated series that are held in memory at once: 16 MB."""
AUTOCORRELATION_GRID = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9])
"""Values of phi, the correlation of neighbours, for which residuals are simulated in order to estimate phi."""
SERIES_PER_AUTOCORRELATION = 400
"""Number of series that are simulated for each value of phi."""


@dataclass(frozen=True)
class ParameterSeries:
    """Fitted values of one parameter of one robot, from n recordings.

    Attributes:
        time: times of the recordings, not decreasing, (n,) [s].
        value: values in the parameter's unit, (n,).
        std: standard deviations of the values, (n,); None if all are equally certain.
    """

    time: FloatArray
    value: FloatArray
    std: FloatArray | None = None

    def section(self, first: int, end: int) -> "ParameterSeries":
        """The series of the recordings with indices from `first` to before `end`."""
        std = None if self.std is None else self.std[first:end]
        return ParameterSeries(self.time[first:end], self.value[first:end], std)

    @property
    def scale(self) -> FloatArray:
        """Standard deviation of each value, (n,), the variation from recording to recording included.

        The variation is estimated from differences of neighbouring values, so that a step or a drift does not increase
        it.
        """
        if self.std is None:
            return np.ones_like(self.value)
        jumps, own = np.abs(np.diff(self.value)), self.std[1:] ** 2 + self.std[:-1] ** 2
        tiny = EQUAL_VALUES_RELATIVE_SPREAD * float(jumps.max(initial=0.0))

        def too_large(more: float) -> float:
            return float(np.median(jumps / np.sqrt(own + 2.0 * more**2 + tiny**2))) - ABS_NORMAL_MEDIAN_OVER_STD

        top = 2.0 * float(jumps.max(initial=0.0))
        more = brentq(too_large, 0.0, top) if tiny > 0.0 and too_large(0.0) > 0.0 else 0.0
        return np.sqrt(self.std**2 + more**2 + tiny**2)


@dataclass(frozen=True)
class ChangeTestSeries:
    """A series of n recordings, prepared for the tests of k possible steps and of a slope.

    Attributes:
        time: times of the recordings, (n,) [s].
        value: values, (n,).
        weight: weights, inversely proportional to the standard deviations of the values, (n,).
        phi: correlation of neighbouring recordings.
        scores: weighted values, with outliers replaced and the correlation of neighbours removed, (n,).
        line: orthonormal basis of a constant and a slope, with the correlation of neighbours removed, (n, 2).
        splits: index of the first recording after each possible step, (k,).
        step_components_along_line: components of each possible step along `line`, (k, 2).
        orthogonalised_step_norms: norm of each possible step after its components along `line` are removed, (k,).
    """

    time: FloatArray
    value: FloatArray
    weight: FloatArray
    phi: float
    scores: FloatArray
    line: FloatArray
    splits: np.ndarray
    step_components_along_line: FloatArray
    orthogonalised_step_norms: FloatArray

    @classmethod
    def from_series(cls, series: ParameterSeries, phi: float = 0.0) -> "ChangeTestSeries | None":
        """Prepare a series for the tests; None if it is too short, or all its values or times are equal."""
        time, value = series.time, series.value
        count = len(value)
        if (
            count < MIN_SERIES_RECORDINGS
            or time[-1] <= time[0]
            or np.ptp(value) <= EQUAL_VALUES_RELATIVE_SPREAD * np.abs(value).max()
        ):
            return None
        scale = series.scale
        weight = np.median(scale) / scale
        splits = np.arange(MIN_RECORDINGS_PER_SIDE_OF_STEP, count - MIN_RECORDINGS_PER_SIDE_OF_STEP + 1)
        splits = splits[time[splits] > time[splits - 1]]
        middle = np.average(time, weights=weight**2)
        straight = weight * np.array([np.ones(count), (time - middle) / np.ptp(time)])
        line = np.linalg.qr(_own(straight, phi).T)[0]
        sums = _along_steps(line.T, weight, phi)[:, splits].T
        after = _own(weight[None], phi)[0] ** 2
        squares = (_from_the_end(after[None])[0] - after + weight**2)[splits] - np.sum(sums**2, axis=1)
        kept = squares > 1e-6  # for two groups of times, a step is a line
        if not kept.any():
            return None
        scores = weight * (_without_odd_ones(value[None], scale)[0] - np.median(value))
        scores = _own(scores[None], phi)[0]
        return cls(time, value, weight, phi, scores, line, splits[kept], sums[kept], np.sqrt(squares[kept]))

    def best_step(self, scores: FloatArray) -> tuple[FloatArray, np.ndarray, FloatArray]:
        """Find the best step in each of m series of scores (m, n).

        Returns:
            The normal deviate of the best step, (m,), its index in `splits`, (m,), and the residual after its removal,
            (m, n).
        """
        left = scores - scores @ self.line @ self.line.T
        along = _along_steps(left, self.weight, self.phi)[:, self.splits] / self.orthogonalised_step_norms
        best = np.argmax(np.abs(along), axis=1)
        size = along[np.arange(len(along)), best]
        stepped = _own(self.weight * (np.arange(left.shape[1]) >= self.splits[best][:, None]), self.phi)
        rest = left - (size / self.orthogonalised_step_norms[best])[:, None] * (
            stepped - self.step_components_along_line[best] @ self.line.T
        )
        return _deviate(size, left, 3), best, rest

    def residual_after_two_steps(self, scores: FloatArray) -> FloatArray:
        """Residual of scores (m, n) after the best step, and then the best second step, were removed: (m, n)."""
        return self.best_step(self.best_step(scores)[2])[2]

    def slope_normal_deviates(self, scores: FloatArray) -> FloatArray:
        """Normal deviates of the slope of m series of scores (m, n): (m,)."""
        left = scores - np.outer(scores @ self.line[:, 0], self.line[:, 0])
        return _deviate(left @ self.line[:, 1], left, 2)

    def step_normal_deviate(self, split: int, *, parabola: bool) -> float:
        """Normal deviate of one possible step, an index in `splits`, fitted together with a line or a parabola."""
        smooth = self.line
        if parabola:
            curve = _own((self.weight * ((self.time - self.time.mean()) / np.ptp(self.time)) ** 2)[None], self.phi)[0]
            smooth = np.linalg.qr(np.column_stack([self.line, curve]))[0]
        step = _own((self.weight * (np.arange(len(self.time)) >= self.splits[split]))[None], self.phi)[0]
        left, step = (values - smooth @ (smooth.T @ values) for values in (self.scores, step))
        length = float(np.linalg.norm(step))
        if length < 1e-3:
            return 0.0
        return float(_deviate(np.array([left @ step / length]), left[None], smooth.shape[1] + 1)[0])

    def simulated_normal_deviates(self, batches: int, rng: np.random.Generator) -> FloatArray:
        """Z-scores of the best step and of the slope in simulated noise: the two rows of (2, batches)."""
        found = np.empty((2, batches))
        size = max(1, MAX_VALUES_SIMULATED_AT_ONCE // len(self.time))
        for first in range(0, batches, size):
            some = slice(first, min(first + size, batches))
            noise = _noise(self.phi, (some.stop - first, len(self.time)), rng)
            scores = _own(self.weight * _without_odd_ones(noise / self.weight, 1.0 / self.weight), self.phi)
            found[0, some] = self.best_step(scores)[0]
            found[1, some] = self.slope_normal_deviates(scores)
        return found


def estimate_lag_one_correlation(group: Sequence[ChangeTestSeries], rng: np.random.Generator) -> float:
    """Estimate the correlation of neighbouring recordings in a group of series.

    The correlation in the residuals, after two steps per series were removed, is compared with that of simulated noise.
    """
    seen = float(np.mean([_neighbours(test.residual_after_two_steps(test.scores[None]))[0] for test in group]))
    typical = sorted(group, key=lambda test: len(test.time))[len(group) // 2]
    count = len(typical.time)
    expected = [
        float(
            np.mean(
                _neighbours(typical.residual_after_two_steps(_noise(phi, (SERIES_PER_AUTOCORRELATION, count), rng)))
            )
        )
        for phi in AUTOCORRELATION_GRID
    ]
    return float(np.interp(seen, np.maximum.accumulate(expected), AUTOCORRELATION_GRID))


def _neighbours(rest: FloatArray) -> FloatArray:
    """Correlation of neighbours in each of m residuals (m, n): (m,)."""
    return np.asarray(np.sum(rest[:, 1:] * rest[:, :-1], axis=1) / np.maximum(np.sum(rest**2, axis=1), 1e-300))


def _noise(phi: float, shape: tuple[int, int], rng: np.random.Generator) -> FloatArray:
    white = rng.standard_normal(shape)
    if phi <= 0.0:
        return white
    white[:, 0] /= np.sqrt(1.0 - phi**2)
    return np.asarray(lfilter([1.0], [1.0, -phi], white, axis=1))


def _without_odd_ones(values: FloatArray, scale: FloatArray) -> FloatArray:
    """Values (m, n) in which each value far from the median of its five neighbours is replaced by this median."""
    padded = np.concatenate([values[:, 2:0:-1], values, values[:, -2:-4:-1]], axis=1)
    count = values.shape[1]
    a, b, c, d, e = (padded[:, k : k + count] for k in range(5))
    a, b, c, d = np.minimum(a, b), np.maximum(a, b), np.minimum(c, d), np.maximum(c, d)
    low, high = np.maximum(a, c), np.minimum(b, d)  # the median of five is that of these two and the fifth
    around = np.maximum(np.minimum(low, high), np.minimum(np.maximum(low, high), e))
    jumps = np.abs(np.diff(values, axis=1)) / np.hypot(scale[1:], scale[:-1])
    usual = np.median(jumps, axis=1, keepdims=True) / ABS_NORMAL_MEDIAN_OVER_STD
    return np.where(np.abs(values - around) > OUTLIER_STANDARD_DEVIATIONS * usual * scale, around, values)


def _own(values: FloatArray, phi: float) -> FloatArray:
    """Values (m, n) without the correlation of neighbours, z_i - phi z_i-1 (Prais and Winsten 1954)."""
    left = values.copy()
    left[:, 1:] -= phi * values[:, :-1]
    left[:, 0] *= np.sqrt(1.0 - phi**2)
    return left


def _along_steps(left: FloatArray, weight: FloatArray, phi: float) -> FloatArray:
    """Products of residuals (m, n) with the weighted, decorrelated step that begins at each recording: (m, n)."""
    after = np.concatenate([[0.0], phi * weight[:-1]])  # a step's first recording has none before it to share with
    return _from_the_end(left * (weight - after)) + left * after


def _from_the_end(values: FloatArray) -> FloatArray:
    """Sums of each value (m, n) and all later ones: (m, n)."""
    return np.cumsum(values[:, ::-1], axis=1)[:, ::-1]


def _deviate(along: FloatArray, left: FloatArray, lost: int) -> FloatArray:
    """Normal deviates (m,) that have the probability of the t statistics of components along a direction.

    The t statistic is sqrt(f s / (1 - s)), with s the share of the squares of the residuals (m, n) that the direction
    explains and f = n - lost the degrees of freedom; Wallace 1959, Ann. Math. Stat. 30:1121, eq. 5.1.
    """
    share = np.minimum(along**2 / np.maximum(np.sum(left**2, axis=1), 1e-300), 1.0 - 1e-12)
    freedom = left.shape[1] - lost
    return np.asarray((8.0 * freedom + 1.0) / (8.0 * freedom + 3.0) * np.sqrt(-freedom * np.log1p(-share)))
