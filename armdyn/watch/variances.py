"""Variance of a fault-free robot's error at each instant, from `ObserverOutput.sources` and from recent errors."""

import numpy as np
from scipy.optimize import nnls

from armdyn.recording.channels import FloatArray

RECENT_ERROR_MEMORY_SECONDS, MAX_COUNTED_ERROR_STDS = 3.0, 5.0
"""Memory of recent errors, s; largest error that counts, in standard deviations. On three simulated arms 3 s and 10 s
give the wanted rate of false alarms; without recent errors it is up to 30 times as high."""
VARIANCE_FIT_PASSES = 4
"""Iterations of the reweighted fit of variances; it changes by less than 1 % after three."""
MIN_NOISE_VARIANCE_SHARE, MIN_TORQUE_VARIANCE = 1e-3, 1e-18
"""Least share of the mean variance that is noise, and least variance, (N m)^2."""


class AdaptiveErrorStd:
    """Present standard deviation of each joint's error, increased if recent errors were larger than expected.

    Args:
        variance: (nj, k) factors of the variance, see `ObserverOutput.sources`.
    """

    def __init__(self, variance: FloatArray) -> None:
        self._variance, self._squares = variance, np.ones(len(variance))

    def std(self, sources: FloatArray) -> FloatArray:
        """(nj,) standard deviations, N m or N, for sources (nj, k)."""
        by_source = (self._variance * sources).sum(axis=1)
        return np.asarray(np.sqrt(np.maximum(1.0, self._squares) * by_source))

    def update(self, error: FloatArray, sources: FloatArray, interval: float) -> None:
        """Update with a fault-free error (nj,), N m or N, `interval` s after the last one."""
        square = error**2 / (self._variance * sources).sum(axis=1)
        share = 1.0 - np.exp(-interval / RECENT_ERROR_MEMORY_SECONDS)
        self._squares = self._squares + share * (np.minimum(square, MAX_COUNTED_ERROR_STDS**2) - self._squares)


def fitted_variance_factors(errors: np.ndarray, sources: np.ndarray) -> np.ndarray:
    """(nj, k) factors v >= 0 of the variance sum_k v_k s_k of errors (n, nj) with sources s (n, nj, k).

    Non-negative least squares on the squared errors, each weighted by 1 over the square of its expected value.
    """
    found = np.zeros(sources.shape[1:])
    for j, square in enumerate((errors**2).T):
        mean = np.full(len(square), max(float(square.mean()), MIN_TORQUE_VARIANCE))
        for _ in range(VARIANCE_FIT_PASSES):
            weight = 1.0 / mean
            found[j] = nnls(sources[:, j] * weight[:, None], square * weight)[0]
            found[j, 0] = max(found[j, 0], MIN_NOISE_VARIANCE_SHARE * float(square.mean()), MIN_TORQUE_VARIANCE)
            mean = sources[:, j] @ found[j]
    return found
