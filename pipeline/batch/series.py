"""One series of a parameter over time: how much of it a step or a slope explains beyond chance.

With y_i the values, w_i = 1/scale_i and u_k the step after recording k, the test statistic is

    t_k: the t statistic of the coefficient of w u_k in the regression of w y on w, w t, w u_k,

and the largest t_k is converted to a normal deviate of the same probability (Wallace 1959). Neighbours in time may be
correlated, for example by the weather: they are modelled as an AR(1) process, whose phi is shared by the same quantity
on all joints of all robots. It is removed from both sides of the regression by z_i - phi z_i-1 in place of z_i (Prais
and Winsten 1954).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.signal import lfilter

from armdyn.recording.channels import FloatArray
from armdyn.recording.noise import NORMAL_MEDIAN

MIN_SIDE_RECORDINGS = 4
"""Least number of recordings before and after a step: fewer may be due to a bad afternoon."""
MIN_SERIES_RECORDINGS = 10
"""Least number of recordings of a series that is tested."""
EQUAL_VALUES_SPREAD = 1e-12
"""Ratio of spread to size below which all values are equal."""
OUTLIER_DEVIATES = 3.0
"""Distance of a recording from the median of itself and two recordings on either side, in standard deviations, beyond
which it is an outlier. The first recording after a step has three of its own kind among these."""
SIMULATED_AT_ONCE = 2_000_000
"""Numbers that are simulated at once: 16 MB."""
PHI_GRID = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9])
"""Values of phi at which the residual of a step is simulated, to estimate phi from the residual of the batch."""
PHI_GRID_SERIES = 400


@dataclass(frozen=True)
class ParameterSeries:
    """Recorded values of one parameter of one robot.

    Attributes:
        time: (n,) times, s, not decreasing.
        value: (n,) values in any unit.
        std: (n,) standard deviation of each value; None where all are equally certain.
    """

    time: FloatArray
    value: FloatArray
    std: FloatArray | None = None

    def part(self, first: int, end: int) -> "ParameterSeries":
        """The recordings from number `first` to before `end`."""
        std = None if self.std is None else self.std[first:end]
        return ParameterSeries(self.time[first:end], self.value[first:end], std)

    @property
    def scale(self) -> FloatArray:
        """Standard deviation (n,) of each value: its own, and the variation from recording to recording.

        The variation is estimated from differences of neighbours beyond their own deviations: neither a step nor a
        drift increases it.
        """
        if self.std is None:
            return np.ones_like(self.value)
        jumps, own = np.abs(np.diff(self.value)), self.std[1:] ** 2 + self.std[:-1] ** 2
        tiny = EQUAL_VALUES_SPREAD * float(jumps.max(initial=0.0))

        def too_large(more: float) -> float:
            return float(np.median(jumps / np.sqrt(own + 2.0 * more**2 + tiny**2))) - NORMAL_MEDIAN

        top = 2.0 * float(jumps.max(initial=0.0))
        more = brentq(too_large, 0.0, top) if tiny > 0.0 and too_large(0.0) > 0.0 else 0.0
        return np.sqrt(self.std**2 + more**2 + tiny**2)


@dataclass(frozen=True)
class StepTest:
    """A series prepared for the tests of a step and of a slope.

    Attributes:
        time: (n,) times, s.
        value: (n,) values.
        weight: (n,) one over the scale of each value.
        phi: correlation of neighbours.
        scores: (n,) values over their scale, with outliers replaced and the correlation of neighbours removed.
        line: (n, 2) orthonormal constant and slope, with the correlation removed.
        splits: (k,) index of the first recording after each possible step.
        sums: (k, 2) components of each step along `line`, with the correlation removed.
        lengths: (k,) length of each step without its components along the line.
    """

    time: FloatArray
    value: FloatArray
    weight: FloatArray
    phi: float
    scores: FloatArray
    line: FloatArray
    splits: np.ndarray
    sums: FloatArray
    lengths: FloatArray

    @classmethod
    def of(cls, series: ParameterSeries, phi: float = 0.0) -> "StepTest | None":
        """Prepare a series; None where it is too short, or all its values or times are equal."""
        time, value = series.time, series.value
        count = len(value)
        if (
            count < MIN_SERIES_RECORDINGS
            or time[-1] <= time[0]
            or np.ptp(value) <= EQUAL_VALUES_SPREAD * np.abs(value).max()
        ):
            return None
        scale = series.scale
        weight = np.median(scale) / scale
        splits = np.arange(MIN_SIDE_RECORDINGS, count - MIN_SIDE_RECORDINGS + 1)
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

    def largest(self, scores: FloatArray) -> tuple[FloatArray, np.ndarray, FloatArray]:
        """For (m, n) scores: (m,) deviates of the best step, (m,) its split, (m, n) residual without it."""
        left = scores - scores @ self.line @ self.line.T
        along = _along_steps(left, self.weight, self.phi)[:, self.splits] / self.lengths
        best = np.argmax(np.abs(along), axis=1)
        size = along[np.arange(len(along)), best]
        stepped = _own(self.weight * (np.arange(left.shape[1]) >= self.splits[best][:, None]), self.phi)
        rest = left - (size / self.lengths[best])[:, None] * (stepped - self.sums[best] @ self.line.T)
        return _deviate(size, left, 3), best, rest

    def two_steps_left(self, scores: FloatArray) -> FloatArray:
        """(m, n) residual of (m, n) scores after the best step and the best second one, which may undo the first."""
        return self.largest(self.largest(scores)[2])[2]

    def trends(self, scores: FloatArray) -> FloatArray:
        """(m,) deviates of the slope for (m, n) scores."""
        left = scores - np.outer(scores @ self.line[:, 0], self.line[:, 0])
        return _deviate(left @ self.line[:, 1], left, 2)

    def beside(self, split: int, *, parabola: bool) -> float:
        """Deviate of one step, fitted together with a line or a parabola."""
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

    def by_chance(self, batches: int, rng: np.random.Generator) -> FloatArray:
        """(2, batches) deviates of the best step and of the slope in simulated noise."""
        found = np.empty((2, batches))
        size = max(1, SIMULATED_AT_ONCE // len(self.time))
        for first in range(0, batches, size):
            some = slice(first, min(first + size, batches))
            noise = _noise(self.phi, (some.stop - first, len(self.time)), rng)
            scores = _own(self.weight * _without_odd_ones(noise / self.weight, 1.0 / self.weight), self.phi)
            found[0, some] = self.largest(scores)[0]
            found[1, some] = self.trends(scores)
        return found


def correlation(group: Sequence[StepTest], rng: np.random.Generator) -> float:
    """Correlation of neighbours, from the residuals of two steps per series, compared with those of simulated noise."""
    seen = float(np.mean([_neighbours(test.two_steps_left(test.scores[None]))[0] for test in group]))
    typical = sorted(group, key=lambda test: len(test.time))[len(group) // 2]
    count = len(typical.time)
    expected = [
        float(np.mean(_neighbours(typical.two_steps_left(_noise(phi, (PHI_GRID_SERIES, count), rng)))))
        for phi in PHI_GRID
    ]
    return float(np.interp(seen, np.maximum.accumulate(expected), PHI_GRID))


def _neighbours(rest: FloatArray) -> FloatArray:
    """(m,) correlation of neighbours in (m, n) series."""
    return np.asarray(np.sum(rest[:, 1:] * rest[:, :-1], axis=1) / np.maximum(np.sum(rest**2, axis=1), 1e-300))


def _noise(phi: float, shape: tuple[int, int], rng: np.random.Generator) -> FloatArray:
    white = rng.standard_normal(shape)
    if phi <= 0.0:
        return white
    white[:, 0] /= np.sqrt(1.0 - phi**2)
    return np.asarray(lfilter([1.0], [1.0, -phi], white, axis=1))


def _without_odd_ones(values: FloatArray, scale: FloatArray) -> FloatArray:
    """(m, n) values, of which those far from the median of five neighbours (itself included) are replaced by it."""
    padded = np.concatenate([values[:, 2:0:-1], values, values[:, -2:-4:-1]], axis=1)
    count = values.shape[1]
    a, b, c, d, e = (padded[:, k : k + count] for k in range(5))
    a, b, c, d = np.minimum(a, b), np.maximum(a, b), np.minimum(c, d), np.maximum(c, d)
    low, high = np.maximum(a, c), np.minimum(b, d)  # the median of five is that of these two and the fifth
    around = np.maximum(np.minimum(low, high), np.minimum(np.maximum(low, high), e))
    jumps = np.abs(np.diff(values, axis=1)) / np.hypot(scale[1:], scale[:-1])
    usual = np.median(jumps, axis=1, keepdims=True) / NORMAL_MEDIAN
    return np.where(np.abs(values - around) > OUTLIER_DEVIATES * usual * scale, around, values)


def _own(values: FloatArray, phi: float) -> FloatArray:
    """(m, n) values without their share of the value before (Prais and Winsten 1954)."""
    left = values.copy()
    left[:, 1:] -= phi * values[:, :-1]
    left[:, 0] *= np.sqrt(1.0 - phi**2)
    return left


def _along_steps(left: FloatArray, weight: FloatArray, phi: float) -> FloatArray:
    """(m, n) products of (m, n) values with the step that begins at each recording, weighted and treated by `_own`."""
    after = np.concatenate([[0.0], phi * weight[:-1]])  # a step's first recording has none before it to share with
    return _from_the_end(left * (weight - after)) + left * after


def _from_the_end(values: FloatArray) -> FloatArray:
    """(m, n) sums of each value of (m, n) and all later ones."""
    return np.cumsum(values[:, ::-1], axis=1)[:, ::-1]


def _deviate(along: FloatArray, left: FloatArray, lost: int) -> FloatArray:
    """(m,) normal deviates with the probability of components along a direction of (m, n) values.

    The t statistic is sqrt(f s / (1 - s)), s the share of the squares that the direction explains and f the degrees of
    freedom, n without those that are lost; Wallace 1959, Ann. Math. Stat. 30:1121, eq. 5.1.
    """
    share = np.minimum(along**2 / np.maximum(np.sum(left**2, axis=1), 1e-300), 1.0 - 1e-12)
    freedom = left.shape[1] - lost
    return np.asarray((8.0 * freedom + 1.0) / (8.0 * freedom + 3.0) * np.sqrt(-freedom * np.log1p(-share)))
