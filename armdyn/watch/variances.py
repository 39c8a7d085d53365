"""How large a sound robot's error is, at every instant: by its sources, and by what it was a moment ago."""

import numpy as np
from scipy.optimize import nnls

from armdyn.recording.channels import FloatArray

LOCAL, STRIKING = 3.0, 5.0
"""s, and sizes from which on an error is no sound one and counts as so many. On three simulated arms 3 s and 10 s give
the rates that are asked for, where one size for all motions gives up to 30 times as many."""
PASSES = 4
"""Of a fit of variances with weights that follow from it; it changes by less than 1 % after three."""
LEAST, TINY = 1e-3, 1e-18
"""Share of the mean variance that is there always at least, and (N m)^2 of a joint without any error."""


class Level:
    """The standard deviation of a joint's error now: by its sources, and larger where it was in the last `LOCAL` s.

    Args:
        variance: (nj, k) by source, see `Step`.
    """

    def __init__(self, variance: FloatArray) -> None:
        self._variance, self._squares = variance, np.ones(len(variance))

    def std(self, sources: FloatArray) -> FloatArray:
        """(nj,) of (nj, k) sources, N m or N."""
        by_source = (self._variance * sources).sum(axis=1)
        return np.asarray(np.sqrt(np.maximum(1.0, self._squares) * by_source))

    def take(self, error: FloatArray, sources: FloatArray, interval: float) -> None:
        """Take in a sound (nj,) error, an interval [s] after the last one."""
        square = error**2 / (self._variance * sources).sum(axis=1)
        share = 1.0 - np.exp(-interval / LOCAL)
        self._squares = self._squares + share * (np.minimum(square, STRIKING**2) - self._squares)


def variances(errors: np.ndarray, sources: np.ndarray) -> np.ndarray:
    """(nj, k) v >= 0 of the variance sum_k v_k s_k of (n, nj) errors with (n, nj, k) sources.

    The squares of errors are fitted, each weighted by what it varies by itself, 1 over the square of its mean.
    """
    found = np.zeros(sources.shape[1:])
    for j, square in enumerate((errors**2).T):
        mean = np.full(len(square), max(float(square.mean()), TINY))
        for _ in range(PASSES):
            weight = 1.0 / mean
            found[j] = nnls(sources[:, j] * weight[:, None], square * weight)[0]
            found[j, 0] = max(found[j, 0], LEAST * float(square.mean()), TINY)
            mean = sources[:, j] @ found[j]
    return found
