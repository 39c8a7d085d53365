"""From a torque at the sensor's own stamps to the samples that are compared: as they are, or low-passed and thinned."""

from abc import ABC, abstractmethod

import numpy as np
from scipy.sparse import csr_matrix

from armdyn.smoothing import UNDISTORTED, LowPass, Samples, basis_matrix


class Sampler(ABC):
    """A linear map from signals at `stamps` (n,) s to samples at other times, which may be shifted."""

    stamps: np.ndarray

    @abstractmethod
    def coefficients(self, signals: np.ndarray) -> np.ndarray:
        """(N, m) what represents (n, m) signals in between; linear, and zero for zero."""

    @abstractmethod
    def matrix(self, delay: float, derivative: int = 0) -> csr_matrix:
        """(k, N) that takes coefficients to the samples' times minus `delay` s, or to the derivative there, in 1/s."""


class Unfiltered(Sampler):
    """Samples at the stamps themselves; in between, cubic interpolation.

    Args:
        stamps: (n,) s.
    """

    def __init__(self, stamps: np.ndarray) -> None:
        self.stamps = stamps

    def coefficients(self, signals: np.ndarray) -> np.ndarray:
        """See `Sampler.coefficients`."""
        return signals

    def matrix(self, delay: float, derivative: int = 0) -> csr_matrix:
        """See `Sampler.matrix`; before the first stamp the signal is what it was there."""
        n = len(self.stamps)
        time = np.clip(self.stamps - delay, self.stamps[0], self.stamps[-1])
        first = np.clip(np.searchsorted(self.stamps, time, side="right") - 2, 0, n - 4)
        nodes = first[:, None] + np.arange(4)
        at, x = self.stamps[nodes], time[:, None]
        values = np.empty((n, 4))
        for i in range(4):
            others = [k for k in range(4) if k != i]
            base = np.prod([at[:, i] - at[:, k] for k in others], axis=0)
            if derivative:
                pairs = [[m for m in others if m != k] for k in others]
                values[:, i] = sum((x[:, 0] - at[:, b]) * (x[:, 0] - at[:, c]) for b, c in pairs) / base
            else:
                values[:, i] = np.prod([x[:, 0] - at[:, k] for k in others], axis=0) / base
        if derivative:
            values[self.stamps - delay < self.stamps[0]] = 0.0
        return csr_matrix((values.ravel(), nodes.ravel(), np.arange(0, 4 * n + 1, 4)), shape=(n, n))


class LowPassed(Sampler):
    """Samples of the signal after a low-pass of zero phase.

    Args:
        stamps: (n,) s.
        cutoff: of the low-pass, Hz.
        time: (k,) s of the samples.
        used: (n,) bool, the stamps that the low-pass takes in; all when not given.
    """

    def __init__(self, stamps: np.ndarray, cutoff: float, time: np.ndarray, used: np.ndarray | None = None) -> None:
        self._used = np.ones(len(stamps), dtype=bool) if used is None else used
        self.stamps, self._time = stamps, time
        self._filter = LowPass(Samples(stamps[self._used], UNDISTORTED / cutoff), cutoff)

    def coefficients(self, signals: np.ndarray) -> np.ndarray:
        """See `Sampler.coefficients`."""
        return self._filter.curve(signals[self._used]).coefficients

    def matrix(self, delay: float, derivative: int = 0) -> csr_matrix:
        """See `Sampler.matrix`."""
        samples = self._filter.samples
        time = np.clip(self._time - delay, self.stamps[0], None)
        matrix = basis_matrix(time, samples.start, samples.step, samples.size, derivative)
        if derivative:
            matrix = matrix.multiply((self._time - delay >= self.stamps[0])[:, None]).tocsr()
        return matrix
