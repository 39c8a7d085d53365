"""Normal equations of a linear model: sums over samples that give the fit, and its errors, of any set of unknowns."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Normal equations of a linear model with P unknowns, for each of U units, such as one channel in one recording.

    Attributes:
        gram: (U, P, P) products X'X of the derivatives X of the predictions with respect to the unknowns.
        slope: (U, P) products X'r with the residual r, measured minus predicted.
        square: (U,) squared residuals r'r.
        count: (U,) number of samples.
    """

    gram: np.ndarray
    slope: np.ndarray
    square: np.ndarray
    count: np.ndarray

    def squared_error(self, change: np.ndarray, units: np.ndarray) -> np.ndarray:
        """(u,) sums of squared residuals of `units` (u,) after a change (P,) of the unknowns."""
        total = self.square[units] - 2.0 * self.slope[units] @ change
        for i, (own, gram) in enumerate(self._moving[unit] for unit in units):
            total[i] += change[own] @ gram @ change[own]
        return np.maximum(total, 0.0)

    def squared_errors(self, changes: np.ndarray) -> np.ndarray:
        """(U, k) sums of squared residuals after each of k changes (P, k) of the unknowns."""
        total = self.square[:, None] - 2.0 * self.slope @ changes
        for square, (own, gram) in zip(total, self._moving, strict=True):
            change = changes[own]
            square += np.einsum("pk,pk->k", change, gram @ change)
        return np.maximum(total, 0.0)

    @cached_property
    def _moving(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each unit the (p,) unknowns that change its predictions, and their (p, p) products X'X."""
        moving = [np.flatnonzero(np.diag(gram)) for gram in self.gram]
        return [(own, gram[np.ix_(own, own)]) for own, gram in zip(moving, self.gram, strict=True)]

    def weighted(self, weight: np.ndarray, units: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(P, P) and (P,) sums of X'X and X'r over some units.

        Args:
            weight: (u,) weights of the units.
            units: (u,) indices of the units.
        """
        return np.tensordot(weight, self.gram[units], 1), weight @ self.slope[units]
