"""Find unknowns that no motion identifies: their columns are spanned by others at every state of the arm."""

import numpy as np
from scipy.linalg import orth, qr

from armdyn.experiments.columns import TorqueRegressor, random_joint_states

RANDOM_STATES = 300
"""Number of random states that represent all states; each gives a row per joint, many times the number of unknowns."""
MAX_SPANNED_SHARE = 1e-6
"""Independent share of a column's length below which others span it: rounding leaves 1e-12, a motion reveals 1e-3."""

MIN_VISIBLE_CHANGE = 0.5
"""Root mean square over random states, all joints together, of a change that a motion can reveal, in units of the
noise. A designed motion has a quarter of their accelerations; in 20 s at 100 Hz such a change then stands out by 5
standard deviations."""
ROUNDING_TORQUE_DEVIATES = 1e-6
"""Change of a torque, in units of the noise, that is only rounding."""
MIN_CHANGE_SHARE = 1e-3
"""Least share of an unknown in a change that no motion reveals, if it takes part in the change at all."""


def regressor_at_random_states(columns: TorqueRegressor) -> np.ndarray:
    """(N, P) regressor at random states all over the arm's limits, in typical sizes of the unknowns."""
    found = columns.at(random_joint_states(columns.arm, RANDOM_STATES))
    rows = found.reshape(-1, found.shape[2])
    rows[:, np.abs(rows).max(axis=0) < ROUNDING_TORQUE_DEVIATES] = 0.0
    return rows


def distinguishable_changes(rows: np.ndarray, own: np.ndarray, others: np.ndarray) -> np.ndarray:
    """(len(own), k) orthonormal changes of the `own` unknowns that some motion distinguishes from the `others`.

    A change of typical size that the noise hides even at full speed and acceleration counts as indistinguishable.

    Args:
        rows: (N, P) see `regressor_at_random_states`.
        own: indices of some unknowns.
        others: indices of other unknowns.
    """
    X, span = rows[:, own], _span(rows[:, others])
    _, sizes, directions = np.linalg.svd(X - span @ (span.T @ X), full_matrices=False)
    whole = np.linalg.norm(X @ directions.T, axis=0)
    shows = sizes > np.maximum(MAX_SPANNED_SHARE * whole, MIN_VISIBLE_CHANGE * np.sqrt(RANDOM_STATES))
    return np.asarray(directions[shows].T)


def unidentifiable_unknowns(rows: np.ndarray, own: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Indices of the `own` unknowns that no motion distinguishes from the rest of them and from `others`."""
    X = rows[:, np.concatenate([own, others])]
    lengths = np.linalg.norm(X, axis=0)
    _, sizes, directions = np.linalg.svd(X / np.maximum(lengths, np.finfo(float).tiny), full_matrices=False)
    nothing = directions[sizes <= MAX_SPANNED_SHARE * sizes[0]]  # changes of the unknowns that change no torque
    return np.asarray(own[np.linalg.norm(nothing[:, : len(own)], axis=0) > MIN_CHANGE_SHARE])


def independent_columns(rows: np.ndarray) -> np.ndarray:
    """Indices of independent columns that span all others: base parameters by a QR decomposition.

    Source: Gautier, Numerical calculation of the base inertial parameters of robots, J. Robotic Systems 8(4), 1991.
    """
    lengths = np.linalg.norm(rows, axis=0)
    acting = np.flatnonzero(lengths > 0.0)
    _, R, order = qr(rows[:, acting] / lengths[acting], mode="economic", pivoting=True)
    rank = int(np.count_nonzero(np.abs(np.diag(R)) > MAX_SPANNED_SHARE))
    return np.sort(acting[order[:rank]])


def _span(X: np.ndarray) -> np.ndarray:
    """(N, r) orthonormal basis of (N, k) columns."""
    lengths = np.linalg.norm(X, axis=0)
    unit = X[:, lengths > 0.0] / lengths[lengths > 0.0]
    return np.asarray(orth(unit, MAX_SPANNED_SHARE)) if unit.shape[1] else unit
