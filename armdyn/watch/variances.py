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
UNCERTAIN_FRICTION_SOURCE = 3
"""Index of the squared uncertain friction among the sources."""
MIN_SAMPLES_OF_FIT = 100
"""Least number of samples from which a joint's variance is fitted, apart from reversals or near them."""
MIN_NOISE_VARIANCE_SHARE, MIN_TORQUE_VARIANCE = 1e-3, 1e-18
"""Least share of the mean variance that is noise, and least variance, (N m)^2."""


@dataclass(frozen=True, eq=False)
class ErrorBand:
    """How the variance of each joint's error follows from `ObserverOutput.sources`, apart from reversals and near them.

    Near a reversal the direction of the dry friction is uncertain, and its error has a distribution of its own.

    Attributes:
        variance: (2, nj, k) factors of the variance, apart from reversals and near them.
        reversal: (nj,) least source of the uncertain friction near a reversal, (N m)^2.
    """

    variance: np.ndarray
    reversal: FloatArray

    @classmethod
    def of(cls, errors: np.ndarray, sources: np.ndarray, reversal: FloatArray) -> Self:
        """Fit to errors (n, nj) with sources (n, nj, k)."""
        near = sources[:, :, UNCERTAIN_FRICTION_SOURCE] > reversal
        whole = fitted_variance_factors(errors, sources, np.ones(near.shape, dtype=bool))
        parts = [
            np.where((used.sum(axis=0) >= MIN_SAMPLES_OF_FIT)[:, None],
                     fitted_variance_factors(errors, sources, used), whole)
            for used in (~near, near)
        ]  # fmt: skip
        return cls(np.array(parts), reversal)

    def only(self, asked: np.ndarray) -> Self:
        """The band of joints (nj,) whose torque the model predicts; others have an infinite one."""
        unknown = np.array([np.inf, *[0.0] * (self.variance.shape[2] - 1)])
        return replace(self, variance=np.where(asked[:, None], self.variance, unknown))

    def is_near(self, sources: np.ndarray) -> np.ndarray:
        """(..., nj) whether each joint is near a reversal, for sources (..., nj, k)."""
        return np.asarray(sources[..., UNCERTAIN_FRICTION_SOURCE] > self.reversal)

    def at(self, sources: np.ndarray, near: np.ndarray | None = None) -> "ErrorVariance":
        """Variances (..., nj), (N m)^2, for sources (..., nj, k); `near` is `is_near`, where it is known."""
        near = self.is_near(sources) if near is None else near
        factors = np.where(near[..., None], self.variance[1], self.variance[0])
        return ErrorVariance(np.einsum("...jk,...jk->...j", sources, factors), near)


class ErrorVariance(NamedTuple):
    """Variance of each joint's error.

    Attributes:
        value: (..., nj) variances, (N m)^2.
        near: (..., nj) whether each joint is near a reversal.
    """

    value: FloatArray
    near: np.ndarray


class AdaptiveErrorStd:
    """Present standard deviation of each joint's error, increased if recent errors were larger than expected.

    Errors near a reversal say nothing of those elsewhere, and are not increased.

    Args:
        joints: number of joints.
    """

    def __init__(self, joints: int) -> None:
        self._squares = np.ones(joints)

    def std(self, at: ErrorVariance) -> FloatArray:
        """(nj,) standard deviations, N m or N."""
        return np.asarray(np.sqrt(np.where(at.near, 1.0, np.maximum(1.0, self._squares)) * at.value))

    def update(self, error: FloatArray, at: ErrorVariance, interval: float) -> None:
        """Update with a fault-free error (nj,), N m or N, `interval` s after the last one."""
        share = np.where(at.near, 0.0, 1.0 - math.exp(-interval / RECENT_ERROR_MEMORY_SECONDS))
        counted = np.minimum(error**2 / at.value, MAX_COUNTED_ERROR_STDS**2)
        self._squares = self._squares + share * (counted - self._squares)


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
