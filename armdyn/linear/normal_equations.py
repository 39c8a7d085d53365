"""Normal equations of a linear model: sums over samples that give the fit, and its errors, of any set of unknowns."""

from dataclasses import dataclass

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
        c = np.flatnonzero(change)
        d = change[c]
        gram = self.gram[units[:, None, None], c[:, None], c]
        return np.maximum(self.square[units] - 2.0 * self.slope[units[:, None], c] @ d + (gram @ d) @ d, 0.0)

    def squared_errors(self, changes: np.ndarray) -> np.ndarray:
        """(U, k) sums of squared residuals after each of k changes (P, k) of the unknowns."""
        total = np.sum(changes * (self.gram @ changes), axis=1) - 2.0 * self.slope @ changes + self.square[:, None]
        return np.maximum(total, 0.0)

    def weighted(self, weight: np.ndarray, units: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(P, P) and (P,) sums of X'X and X'r over some units.

        Args:
            weight: (u,) weights of the units.
            units: (u,) indices of the units.
        """
        return np.tensordot(weight, self.gram[units], 1), weight @ self.slope[units]
