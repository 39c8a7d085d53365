"""Find unknowns that no motion identifies: their regressor columns are linear combinations of others."""

import numpy as np
from scipy.linalg import orth, qr

from armdyn.experiments.columns import TorqueRegressor, random_joint_states, random_times

RANDOM_STATE_COUNT = 300
"""Number of random states of an arm at which linear dependence of regressor columns is decided."""
MIN_INDEPENDENT_COLUMN_SHARE = 1e-6
"""Independent share of a regressor column's length below which it is a linear combination of others; rounding leaves
1e-12, and a motion reveals 1e-3."""

MIN_VISIBLE_TORQUE_CHANGE_PER_NOISE = 0.5
"""Least change of torques that a motion can reveal, in units of the noise: root mean square over random states, all
joints together. A designed motion has a quarter of their accelerations; in 20 s at 100 Hz such a change then stands out
by 5 standard deviations."""
ROUNDING_TORQUE_CHANGE_PER_NOISE = 1e-6
"""Change of a torque, in units of its noise, below which it is only rounding."""
MIN_UNIDENTIFIABLE_COMPONENT = 1e-3
"""Least component of an unknown in a unit change of all unknowns that no motion reveals, for the unknown to be
unidentifiable."""


def regressor_at_random_states(columns: TorqueRegressor) -> np.ndarray:
    """(N, P) regressor at random states within the arm's limits, for changes of typical size; a row is one torque."""
    found = columns.values_along(random_joint_states(columns.arm, RANDOM_STATE_COUNT), random_times(RANDOM_STATE_COUNT))
    rows = found.reshape(-1, found.shape[2])
    rows[:, np.abs(rows).max(axis=0) < ROUNDING_TORQUE_CHANGE_PER_NOISE] = 0.0
    return rows


def distinguishable_changes(rows: np.ndarray, own: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Find changes of some unknowns that a motion distinguishes from changes of other unknowns.

    A change of typical size that the noise hides even at full speed and acceleration counts as indistinguishable.

    Args:
        rows: (N, P) regressor at random states.
        own: indices of some unknowns.
        others: indices of other unknowns.

    Returns:
        (len(own), k) orthonormal changes.
    """
    X, span = rows[:, own], _span(rows[:, others])
    _, sizes, directions = np.linalg.svd(X - span @ (span.T @ X), full_matrices=False)
    whole = np.linalg.norm(X @ directions.T, axis=0)
    shows = sizes > np.maximum(
        MIN_INDEPENDENT_COLUMN_SHARE * whole, MIN_VISIBLE_TORQUE_CHANGE_PER_NOISE * np.sqrt(RANDOM_STATE_COUNT)
    )
    return np.asarray(directions[shows].T)


def unidentifiable_unknowns(rows: np.ndarray, own: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Indices of those `own` unknowns that no motion distinguishes from `others` or from the rest of `own`."""
    X = rows[:, np.concatenate([own, others])]
    lengths = np.linalg.norm(X, axis=0)
    _, sizes, directions = np.linalg.svd(X / np.maximum(lengths, np.finfo(float).tiny), full_matrices=False)
    nothing = directions[
        sizes <= MIN_INDEPENDENT_COLUMN_SHARE * sizes[0]
    ]  # changes of the unknowns that change no torque
    return np.asarray(own[np.linalg.norm(nothing[:, : len(own)], axis=0) > MIN_UNIDENTIFIABLE_COMPONENT])


def independent_columns(rows: np.ndarray) -> np.ndarray:
    """Indices of linearly independent columns that span all others: base parameters, by a QR decomposition.

    Source: Gautier, Numerical calculation of the base inertial parameters of robots, J. Robotic Systems 8(4), 1991.
    """
    lengths = np.linalg.norm(rows, axis=0)
    acting = np.flatnonzero(lengths > 0.0)
    _, R, order = qr(rows[:, acting] / lengths[acting], mode="economic", pivoting=True)
    rank = int(np.count_nonzero(np.abs(np.diag(R)) > MIN_INDEPENDENT_COLUMN_SHARE))
    return np.sort(acting[order[:rank]])


def _span(X: np.ndarray) -> np.ndarray:
    """(N, r) orthonormal basis of (N, k) columns."""
    lengths = np.linalg.norm(X, axis=0)
    unit = X[:, lengths > 0.0] / lengths[lengths > 0.0]
    return np.asarray(orth(unit, MIN_INDEPENDENT_COLUMN_SHARE)) if unit.shape[1] else unit
