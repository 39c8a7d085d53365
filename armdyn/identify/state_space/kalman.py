"""Follow the covariance of a state through the pieces of a run, as a Kalman filter does, by compiled steps."""

from functools import cache, lru_cache

import casadi as ca
import numpy as np

from armdyn.codegen import PreallocatedFunction, compile_functions

ROUNDING_INFORMATION_SHARE = 1e-14
"""Ratio of a pivot to the diagonal in a Cholesky factorisation up to which the pivot is only rounding."""
PIECES_PER_BLOCK = 16
"""Number of pieces in one call of a compiled function."""


def semidefinite_cholesky(matrices: np.ndarray) -> np.ndarray:
    """(..., n, n) Cholesky factors L, L L' = A, of positive semidefinite matrices A; rounding errors become 0."""
    left, found = matrices.copy(), np.zeros_like(matrices)
    for k in range(left.shape[-1]):
        pivot = left[..., k, k]
        # A pivot that is only rounding would be a measurement without information.
        pivot = np.where(pivot <= ROUNDING_INFORMATION_SHARE * matrices[..., k, k], np.inf, pivot)
        found[..., k:, k] = left[..., k:, k] / np.sqrt(pivot)[..., None]
        below = found[..., k + 1 :, k]
        left[..., k + 1 :, k + 1 :] -= below[..., :, None] * below[..., None, :]
    return found


def kalman_covariances(
    variance: np.ndarray, factors: np.ndarray, transition: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Update the covariance P of a state by the measurements of b pieces, for S settings of the noise.

    Args:
        variance: (S, n, n) covariances before the first piece.
        factors: (S, b, n, n) factors L of the information matrices L L' of the measurements.
        transition: (b, n, n) matrices A that lead from each piece to the next.
        noise: (S, n, n) covariances of the kicks between two pieces.

    Returns:
        (S, b, n, n) covariances after the measurement of each piece; (S,) sums of log-determinants of 1 + P L L'; and
        (S, n, n) covariances before the piece that follows.
    """
    S, b, n, _ = factors.shape
    if n == 0:  # a process without states
        return factors, np.zeros(S), variance
    blocks = -(-b // PIECES_PER_BLOCK)
    # CasADi's matrices are column-major; a piece that pads the last block measures nothing.
    told, along = np.zeros((blocks, S, PIECES_PER_BLOCK, n, n)), np.zeros((blocks * PIECES_PER_BLOCK, n, n))
    after, size, now = np.empty((blocks, S, PIECES_PER_BLOCK, n, n)), np.zeros(S), variance
    for k in range(blocks):
        these = factors[:, k * PIECES_PER_BLOCK : (k + 1) * PIECES_PER_BLOCK]
        told[k, :, : these.shape[1]] = these.swapaxes(2, 3)
    along[:b] = transition.swapaxes(1, 2)
    update = _updates(n, S)
    for k, steps in enumerate(along.reshape(blocks, -1, n)):
        now, found, spread = update(_side_by_side(now), _side_by_side(told[k]), steps.T, _side_by_side(noise))
        now, after[k] = now.T.reshape(S, n, n), found.T.reshape(S, PIECES_PER_BLOCK, n, n)
        size += np.log(spread.reshape(S, PIECES_PER_BLOCK)).sum(axis=1)
    measured = after.swapaxes(0, 1).reshape(S, blocks * PIECES_PER_BLOCK, n, n)[:, :b]
    last = transition[-1]
    return measured, size, last @ measured[:, -1] @ last.T + noise


def _side_by_side(matrices: np.ndarray) -> np.ndarray:
    """(n, ... n) column-major matrices that are stored one after the other, (..., n, n)."""
    return matrices.reshape(-1, matrices.shape[-1]).T


@lru_cache(maxsize=256)
def _updates(n: int, settings: int) -> PreallocatedFunction:
    """The compiled updates for a number of settings of the noise, which share the transitions."""
    return PreallocatedFunction(_block(n).map(f"updates_{settings}", "serial", settings, [2], []))


@cache
def _block(n: int) -> ca.Function:
    """The updates of a block of pieces: ``(P, L, A, Q) -> (P before the next block, P after each, 1 + L' P L)``."""
    P, L, A, Q = (ca.SX.sym(name, n, n) for name in "PLAQ")
    now, spread = _update(P, L)
    step = ca.Function("step", [P, L, A, Q], [A @ now @ A.T + Q, now, spread])
    P, Q = ca.MX.sym("P", n, n), ca.MX.sym("Q", n, n)
    L, A = (ca.MX.sym(name, n, n * PIECES_PER_BLOCK) for name in "LA")
    following, now, spread = step.mapaccum("over", PIECES_PER_BLOCK, 1)(P, L, A, ca.repmat(Q, 1, PIECES_PER_BLOCK))
    block = ca.Function("block", [P, L, A, Q], [following[:, -n:], now, spread])
    return compile_functions(f"kalman_{n}", {"block": block})["block"]


def _update(variance: ca.SX, factor: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Covariance after a measurement with the information matrix L L', and the determinant of 1 + P L L'.

    The columns of L are used one by one, each as the measurement of one number, with a square root of P. So no matrix
    that may be singular is inverted, and a state that was unknown before is accurate to all digits afterwards (Potter's
    algorithm: Bierman, Factorization Methods for Discrete Sequential Estimation, 1977, §2).
    """
    root, size = _semidefinite_root(variance), ca.SX(1)
    for k in range(factor.shape[1]):
        seen = root.T @ factor[:, k]
        spread = 1 + ca.dot(seen, seen)
        root -= (root @ seen) @ seen.T / (spread + ca.sqrt(spread))
        size *= spread
    return ca.densify(root @ root.T), size


def _semidefinite_root(variance: ca.SX) -> ca.SX:
    """The factor that `semidefinite_cholesky` returns, symbolically."""
    n, left = variance.shape[0], ca.SX(variance)
    found = ca.SX(n, n)
    for k in range(n):
        pivot = left[k, k]
        rounding = pivot <= ROUNDING_INFORMATION_SHARE * variance[k, k]
        found[k:, k] = ca.if_else(rounding, 0, left[k:, k] / ca.sqrt(pivot))
        left[k + 1 :, k + 1 :] -= found[k + 1 :, k] @ found[k + 1 :, k].T
    return found
