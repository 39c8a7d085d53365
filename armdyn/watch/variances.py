"""Variance of a fault-free robot's error at each instant, from `ObserverOutput.sources` and from recent errors."""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np

from armdyn.estimation.equations import NormalEquations
from armdyn.estimation.solve import solve_bounded
from armdyn.recording.channels import FloatArray

RECENT_ERROR_MEMORY_SECONDS, MAX_COUNTED_ERROR_STDS = 3.0, 5.0
"""Memory of recent errors, s; largest error that counts, in standard deviations. On three simulated arms 3 s and 10 s
give the wanted rate of false alarms; without recent errors it is up to 30 times as high."""
VARIANCE_FIT_PASSES = 4
"""Iterations of the reweighted fit of variances; it changes by less than 1 % after three."""
MIN_SAMPLES_OF_FIT = 100
"""Least number of samples from which a joint's variance is fitted, apart from reversals or near them."""
MIN_NOISE_VARIANCE_SHARE, MIN_TORQUE_VARIANCE = 1e-3, 1e-18
"""Least share of the mean variance that is noise, and least variance, (N m)^2."""


@dataclass(frozen=True, eq=False)
class ErrorBand:
    """How large each joint's error may be, by `ObserverOutput.sources` and `ObserverOutput.sticking`.

    Where a joint reverses or sticks, its dry friction has any value up to its size: what it may leave in the error is a
    bound. What exceeds the bound has a variance.

    Attributes:
        variance: (nj, k) factors of the variance.
        reversal: (nj,) least friction of unknown value near a reversal, N m.
        gain: (nj,) largest error that a friction of unknown value, up to 1 N m, leaves, N m.
    """

    variance: np.ndarray
    reversal: FloatArray
    gain: FloatArray

    @classmethod
    def of(
        cls, errors: np.ndarray, sources: np.ndarray, sticking: np.ndarray, reversal: FloatArray, gain: FloatArray
    ) -> Self:
        """Fit to errors (n, nj) with sources (n, nj, k) and frictions of unknown value (n, nj)."""
        apart = sticking <= reversal
        used = apart | (apart.sum(axis=0) < MIN_SAMPLES_OF_FIT)
        return cls(fitted_variance_factors(excess(errors, gain * sticking), sources, used), reversal, gain)

    def only(self, asked: np.ndarray) -> Self:
        """The band of joints (nj,) whose torque the model predicts; others have an infinite one."""
        unknown = np.array([np.inf, *[0.0] * (self.variance.shape[1] - 1)])
        return replace(self, variance=np.where(asked[:, None], self.variance, unknown))

    def at(self, sources: np.ndarray, sticking: np.ndarray) -> "ErrorSize":
        """Sizes (..., nj) for sources (..., nj, k) and frictions of unknown value (..., nj), N m or N."""
        variance = (sources * self.variance).sum(axis=-1)
        return ErrorSize(variance, self.gain * sticking, sticking > self.reversal)


class ErrorSize(NamedTuple):
    """Size of each joint's error.

    Attributes:
        variance: (..., nj) variances of what exceeds the bound, (N m)^2.
        bound: (..., nj) what the friction may leave, N m or N.
        near: (..., nj) whether each joint is near a reversal.
    """

    variance: FloatArray
    bound: FloatArray
    near: np.ndarray


class AdaptiveErrorStd:
    """Present standard deviation of each joint's error, increased if recent errors were larger than expected.

    Errors near a reversal say nothing of those elsewhere, and are not increased.

    Args:
        joints: number of joints.
    """

    def __init__(self, joints: int) -> None:
        self._squares = np.ones(joints)

    def std(self, at: ErrorSize) -> FloatArray:
        """(nj,) standard deviations of the joints' torque errors, N m or N, where errors have the size `at`."""
        return np.asarray(np.sqrt(np.where(at.near, at.variance, np.maximum(1.0, self._squares) * at.variance)))

    def update(self, excess: FloatArray, at: ErrorSize, interval: float) -> None:
        """Update with what of a fault-free error exceeds its bound (nj,), N m or N, `interval` s after the last one."""
        share = np.where(at.near, 0.0, 1.0 - math.exp(-interval / RECENT_ERROR_MEMORY_SECONDS))
        counted = np.minimum(excess**2 / at.variance, MAX_COUNTED_ERROR_STDS**2)
        self._squares = self._squares + share * (counted - self._squares)


def excess(error: np.ndarray, bound: np.ndarray) -> np.ndarray:
    """What of each error's size exceeds its bound."""
    return np.asarray(np.maximum(np.abs(error) - bound, 0.0))


def fitted_variance_factors(errors: np.ndarray, sources: np.ndarray, used: np.ndarray) -> np.ndarray:
    """(nj, k) factors v >= 0 of the variance sum_k v_k s_k of errors (n, nj) with sources s (n, nj, k).

    Non-negative least squares on the squared errors, each weighted by 1 over the square of its expected value; of the
    samples that `used` (n, nj) marks.
    """
    square, x, used = (errors**2).T, sources.swapaxes(0, 1), used.T
    level = np.where(used, square, 0.0).sum(axis=1) / np.maximum(used.sum(axis=1), 1)
    mean = np.maximum(level, MIN_TORQUE_VARIANCE)[:, None] + np.zeros(square.shape)
    for _ in range(VARIANCE_FIT_PASSES):
        sums = NormalEquations.of_units(x, square, np.where(used, mean, np.inf))
        # A joint without friction has no information about its factor.
        absent = np.einsum("jkk->jk", sums.gram) == 0.0
        gram = sums.gram + absent[:, :, None] * np.eye(x.shape[2])
        found = solve_bounded(gram, sums.slope, np.zeros(absent.shape), np.inf).x
        found[:, 0] = np.maximum(found[:, 0], np.maximum(MIN_NOISE_VARIANCE_SHARE * level, MIN_TORQUE_VARIANCE))
        mean = (x @ found[..., None])[..., 0]
    return found
