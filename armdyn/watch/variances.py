"""Variance of a fault-free robot's error at each instant, from `ObserverOutput.sources` and from recent errors."""

import numpy as np

from armdyn.estimation.equations import NormalEquations
from armdyn.estimation.solve import solve_bounded
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
    square, x = (errors**2).T, sources.swapaxes(0, 1)
    level = square.mean(axis=1)
    mean = np.maximum(level, MIN_TORQUE_VARIANCE)[:, None] + np.zeros(square.shape)
    for _ in range(VARIANCE_FIT_PASSES):
        sums = NormalEquations.of_units(x, square, mean)
        # A joint without friction has no information about its factor.
        absent = np.einsum("jkk->jk", sums.gram) == 0.0
        gram = sums.gram + absent[:, :, None] * np.eye(x.shape[2])
        found = solve_bounded(gram, sums.slope, np.zeros(absent.shape), np.inf).x
        found[:, 0] = np.maximum(found[:, 0], np.maximum(MIN_NOISE_VARIANCE_SHARE * level, MIN_TORQUE_VARIANCE))
        mean = (x @ found[..., None])[..., 0]
    return found
