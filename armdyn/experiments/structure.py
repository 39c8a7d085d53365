"""What no motion can tell: unknowns whose columns others span at every state of the arm."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr

from armdyn.experiments.columns import Columns, random_states

STATES = 300
"""Random states that stand for all; each gives a row per joint, many times the unknowns."""
SPANNED = 1e-6
"""Share of a column's length that is left where others span it; rounding leaves 1e-12, what a motion tells 1e-3."""

SHOWS = 0.5
"""Of the noise: root mean square over random states, all joints together, of a change that a motion can show. A
designed motion has a quarter of their accelerations; in 20 s at 100 Hz such a change then stands out by 5 standard
deviations."""
ROUNDING = 1e-6
"""Of the noise of a sample: a torque so small is the rounding of an unknown that changes nothing."""
PART = 1e-3
"""Share that an unknown has at least in a change that no motion shows, if it has one at all."""


@dataclass(frozen=True, eq=False)
class Structure:
    """The columns at random states all over the limits.

    Attributes:
        rows: (N, P) in typical sizes of the unknowns.
    """

    rows: np.ndarray

    @classmethod
    def of(cls, columns: Columns) -> "Structure":
        """The structure of an arm's unknowns."""
        found = columns.at(random_states(columns.arm, STATES))
        rows = found.reshape(-1, found.shape[2])
        rows[:, np.abs(rows).max(axis=0) < ROUNDING] = 0.0
        return cls(rows)

    def distinguishable(self, own: np.ndarray, others: np.ndarray) -> np.ndarray:
        """(len(own), k) orthonormal changes of some unknowns that some motion tells from changes of others.

        One of typical size that the noise hides even at full speed and acceleration counts as one that no motion tells.
        """
        X = self.rows[:, own]
        left = X - self._span(others) @ (self._span(others).T @ X)
        _, sizes, directions = np.linalg.svd(left, full_matrices=False)
        whole = np.linalg.norm(X @ directions.T, axis=0)
        shows = sizes > np.maximum(SPANNED * whole, SHOWS * np.sqrt(STATES))
        return np.asarray(directions[shows].T)

    def hopeless(self, own: np.ndarray, others: np.ndarray) -> np.ndarray:
        """Those of some unknowns, by index, that no motion tells from the rest of them and from `others`."""
        everything = np.concatenate([own, others])
        X = self.rows[:, everything]
        lengths = np.linalg.norm(X, axis=0)
        _, sizes, directions = np.linalg.svd(X / np.maximum(lengths, np.finfo(float).tiny), full_matrices=False)
        nothing = directions[sizes <= SPANNED * sizes[0]]  # changes of the unknowns that change no torque
        takes_part = np.linalg.norm(nothing[:, : len(own)], axis=0) > PART
        return np.asarray(own[takes_part])

    def independent(self) -> np.ndarray:
        """Indices of columns that are independent and span all others: base parameters by a QR decomposition.

        Gautier, Numerical calculation of the base inertial parameters of robots, J. Robotic Systems 8(4), 1991.
        """
        lengths = np.linalg.norm(self.rows, axis=0)
        acting = np.flatnonzero(lengths > 0.0)
        _, R, order = qr(self.rows[:, acting] / lengths[acting], mode="economic", pivoting=True)
        rank = int(np.count_nonzero(np.abs(np.diag(R)) > SPANNED))
        return np.sort(acting[order[:rank]])

    def _span(self, indices: np.ndarray) -> np.ndarray:
        """(N, r) orthonormal basis of columns."""
        X = self.rows[:, indices]
        lengths = np.linalg.norm(X, axis=0)
        X = X[:, lengths > 0.0] / lengths[lengths > 0.0]
        if X.shape[1] == 0:
            return np.zeros((len(X), 0))
        U, sizes, _ = np.linalg.svd(X, full_matrices=False)
        return np.asarray(U[:, sizes > SPANNED * sizes[0]])
