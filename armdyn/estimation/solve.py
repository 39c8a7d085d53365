r"""Positive definite systems, and the minimum of a quadratic function within bounds.

    x = argmin  x' A x / 2 - b' x,      lower <= x <= upper,      A positive definite

Karush-Kuhn-Tucker: with the gradient g = A x - b, every unknown is free with g = 0, on its lower bound with g >= 0, or
on its upper bound with g <= 0. The case of each unknown is found by block principal pivoting: all unknowns that violate
a condition change sides at once while their number falls, and one alone otherwise, so that the search ends (Judice &
Pires, Comput. Oper. Res. 21, 1994).
"""

import math
from dataclasses import dataclass
from itertools import count

import numpy as np

DIAGONAL_LOADING = 1e-13
"""Added to the diagonal of a matrix whose diagonal is one, as rounding may have reduced its eigenvalues by as much."""
KKT_TOLERANCE = 1e-11
"""Violation of an optimality condition, relative to the unknowns, up to which it counts as rounding."""
MAX_FAILED_EXCHANGES = 3
"""Number of exchanges of many unknowns at once that may fail to reduce the violations before one is exchanged alone."""
MAX_EXCHANGES_PER_UNKNOWN = 20
"""Number of exchanges per unknown after which the matrix counts as indefinite by rounding, for which the search may
never end; 20,000 random positive definite problems of 1 to 20 unknowns needed at most 2.4."""
MIN_EIGENVALUE = 1e-9
"""Smallest eigenvalue that an indefinite matrix, scaled to a diagonal of ones, is given."""


@dataclass(frozen=True, eq=False)
class BoundedSolution:
    """Solution of one bounded quadratic problem, or of many.

    Attributes:
        x: (..., n) unknowns at the minimum.
        on_bound: (..., n) -1 for an unknown on its lower bound, 1 on its upper bound, 0 between them.
        gradient: (..., n) gradient A x - b.
    """

    x: np.ndarray
    on_bound: np.ndarray
    gradient: np.ndarray


def scale_to_unit_diagonal(A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Scale positive definite matrices (..., n, n) to a diagonal of ones, so that units do not matter.

    Returns:
        (..., n) square roots of the diagonals, and the (..., n, n) scaled matrices.
    """
    size = np.sqrt(np.diagonal(A, axis1=-2, axis2=-1))
    return size, A / (size[..., :, None] * size[..., None, :]) + DIAGONAL_LOADING * np.eye(A.shape[-1])


def solve_positive(A: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(..., n) solutions x of A x = b for (..., n, n) positive definite matrices."""
    size, unit = scale_to_unit_diagonal(A)
    return np.asarray(np.linalg.solve(unit, (b / size)[..., None])[..., 0] / size)


def inverse_positive(A: np.ndarray) -> np.ndarray:
    """(..., n, n) inverses of positive definite matrices (..., n, n)."""
    size, unit = scale_to_unit_diagonal(A)
    return np.asarray(np.linalg.inv(unit) / (size[..., :, None] * size[..., None, :]))


def pseudo_inverse(A: np.ndarray, rcond: float = 1e-15) -> np.ndarray:
    """(n, n) pseudo-inverse of a symmetric matrix, without eigenvalues below a share `rcond` of the largest."""
    return np.asarray(np.linalg.pinv(A, rcond, hermitian=True))


def pseudo_inverses(matrices: np.ndarray, negligible: float = 1e-15) -> np.ndarray:
    """Pseudo-inverses of (..., n, m) matrices; zeros for a matrix with an entry that is not finite.

    Args:
        matrices: the matrices.
        negligible: singular values below this share of the largest count as zero.
    """
    finite = np.isfinite(matrices).all(axis=(-2, -1), keepdims=True)
    return np.asarray(np.linalg.pinv(np.where(finite, matrices, 0.0), negligible))


def least_squares(X: np.ndarray, y: np.ndarray, rcond: float | None = None) -> np.ndarray:
    """(p, ...) shortest of the solutions b of min |X b - y|, without singular values below a share `rcond`."""
    return np.asarray(np.linalg.lstsq(X, y, rcond)[0])


def log_det(A: np.ndarray) -> np.ndarray:
    """(...) logarithms of the determinants of (..., n, n) positive definite matrices."""
    size, unit = scale_to_unit_diagonal(A)
    return np.asarray(2.0 * np.sum(np.log(size), axis=-1) + np.linalg.slogdet(unit)[1])


def marginal_information(A: np.ndarray, own: np.ndarray, others: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Information matrix of some unknowns when others are unknown as well (nuisance parameters).

    It is the Schur complement A_oo - A_on A_nn^+ A_no, with the pseudo-inverse of A_nn.

    Args:
        A: (n, n) information matrix (inverse covariance) of all unknowns.
        own: (o,) indices of the unknowns of interest.
        others: (m,) indices of the nuisance parameters.

    Returns:
        (o, o) information matrix, and (m, o) change of the best nuisance parameters per change of the unknowns.
    """
    between = A[np.ix_(others, own)]
    follow = -np.linalg.pinv(A[np.ix_(others, others)], hermitian=True) @ between
    return A[np.ix_(own, own)] + between.T @ follow, follow


def solve_bounded(A: np.ndarray, b: np.ndarray, lower: np.ndarray, upper: np.ndarray | float) -> BoundedSolution:
    """Minimise x' A x / 2 - b' x within bounds: one problem, or many of one size at once.

    Args:
        A: (..., n, n) symmetric positive definite matrices.
        b: (..., n) right-hand sides.
        lower: (..., n) lower bounds, which may be minus infinity.
        upper: (..., n) upper bounds, or one for all, which may be infinity; not below `lower`.
    """
    size, unit = scale_to_unit_diagonal(A)
    shape = np.broadcast_shapes(size.shape, b.shape)
    flat = math.prod(shape[:-1]), shape[-1]
    problems = (np.broadcast_to(part, shape).reshape(flat) for part in (b / size, lower * size, upper * size))
    x, held = _pivoted(np.broadcast_to(unit, (*shape, shape[-1])).reshape(*flat, shape[-1]), *problems)
    x = (x.reshape(shape) / size).clip(lower, upper)
    return BoundedSolution(x, held.reshape(shape), (A @ x[..., None])[..., 0] - b)


def _pivoted(A: np.ndarray, b: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(k, n) minima of k problems whose matrices have diagonals of one, and (k, n) bounds on which the unknowns are."""
    x, held = np.linalg.solve(A, b[..., None])[..., 0], np.zeros(b.shape, dtype=int)
    gradient = np.zeros_like(x)
    fewest, patience = np.full(len(b), b.shape[1] + 1), np.full(len(b), MAX_FAILED_EXCHANGES)
    for exchange in count(1):
        room = KKT_TOLERANCE * (1.0 + np.abs(x))
        beyond = (x > upper + room).astype(int) - (x < lower - room)
        moved = np.where(held == 0, beyond, np.where(gradient * held > room, 0, held))
        broken = moved != held
        many = broken.sum(axis=1)
        left = np.flatnonzero(many)
        if len(left) == 0:
            break
        if exchange % (MAX_EXCHANGES_PER_UNKNOWN * b.shape[1]) == 0:
            A, least = A.copy(), np.linalg.eigvalsh(A[left])[:, 0]
            A[left] += np.maximum(MIN_EIGENVALUE, 2.0 * MIN_EIGENVALUE - least)[:, None, None] * np.eye(b.shape[1])
        patience = np.where(many < fewest, MAX_FAILED_EXCHANGES, patience - 1)
        fewest = np.minimum(many, fewest)
        last = broken & (np.cumsum(broken[:, ::-1], axis=1)[:, ::-1] == 1)
        held = np.where(np.where((patience < 0)[:, None], last, broken), moved, held)
        x[left], gradient[left] = _with_held(A[left], b[left], lower[left], upper[left], held[left])
    return x, held


def _with_held(
    A: np.ndarray, b: np.ndarray, lower: np.ndarray, upper: np.ndarray, held: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(k, n) best unknowns with those on bounds fixed there, and (k, n) the gradient there."""
    free = held == 0
    fixed = np.where(free, 0.0, np.where(held < 0, lower, upper))
    right = np.where(free, b - (A @ fixed[..., None])[..., 0], fixed)
    alone = np.where(free[:, :, None] & free[:, None, :], A, np.eye(A.shape[1]))
    x = np.linalg.solve(alone, right[..., None])[..., 0]
    return x, np.where(free, 0.0, (A @ x[..., None])[..., 0] - b)
