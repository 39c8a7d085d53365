"""One smooth branch of postures along a path, as the solution of a square system of equations.

An arm with more joints than the task has equations can hold the tool in a whole family of postures. The branch picks
one of them by appending rows to the task,

    tool(q) = target(s),    W q = h(s),

with W constant, (r, n), spanning the mean null space, and h a Chebyshev polynomial. The system is square, so that
q(s), q'(s) and q''(s) are as exact and as smooth as the path itself: with A = [J; W] and the path's twist xi,

    A q' = [xi; h'],    A q'' = [xi' - J' q'; h''].
"""

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev

from ik.chain import Chain, shortened
from ik.path import Path
from urdf.robot import Array

TOLERANCE = 1e-12  # m and rad; what double precision lets Newton's method reach on a metre-sized arm
ITERATIONS = 30
LONGEST_STEP = 0.3  # rad or m per iteration; Newton's method is trusted no further


@dataclass(frozen=True)
class Solution:
    """Postures on a branch.

    Attributes:
        q: postures, (k, n) [rad or m].
        residual: largest entry of what is left of each equation, (k,) [m or rad].
    """

    q: Array
    residual: Array


@dataclass(frozen=True)
class Branch:
    """The rows that make the task square.

    Attributes:
        weights: W, (r, n); r = n - 6 may be 0.
        coefficients: Chebyshev coefficients of h, (r, degree + 1) [rad or m].
        s_min: where h's interval starts [m].
        s_max: where it ends [m].
    """

    weights: Array
    coefficients: Array
    s_min: float
    s_max: float

    def basis(self, s: Array, derivative: int = 0) -> Array:
        """Chebyshev polynomials at s, or one of their derivatives by s: (k, degree + 1)."""
        terms = self.coefficients.shape[1]
        scale = (2.0 / (self.s_max - self.s_min)) ** derivative
        derived = chebyshev.chebder(np.eye(terms), derivative, axis=0)
        return scale * chebyshev.chebvander(self._scaled(s), len(derived) - 1) @ derived

    def height(self, s: Array, derivative: int = 0) -> Array:
        """The polynomial h or one of its derivatives by s: (k, r)."""
        return self.basis(s, derivative) @ self.coefficients.T

    def _scaled(self, s: Array) -> Array:
        return (2.0 * s - self.s_min - self.s_max) / (self.s_max - self.s_min)

    def solve(self, chain: Chain, path: Path, s: Array, guess: Array) -> Solution:
        """Newton's method on the square system, for all coordinates at once.

        Args:
            chain: the arm.
            path: where the tool should be.
            s: path coordinates, (k,) [m].
            guess: postures to start from, (k, n).
        """
        rotation, position = path.pose(s)
        height = self.height(s)
        q = guess.copy()
        residual = np.full(len(s), np.inf)
        for _ in range(ITERATIONS):
            motion = chain.motion(q)
            error = np.concatenate((motion.error(rotation, position), height.T - self.weights @ q.T))
            previous, residual = residual, np.abs(error).max(axis=0)
            # Below the tolerance, or at the level of rounding, where the residual no longer falls.
            if np.all((residual < TOLERANCE) | ((residual < 1e2 * TOLERANCE) & (residual >= previous))):
                break
            q += shortened(_solve(self.matrix(chain.jacobian(motion)), error), LONGEST_STEP)
        return Solution(q, residual)

    def matrix(self, jacobian: Array) -> Array:
        """A = [J; W] for a Jacobian of shape (6, n, k): (k, n, n)."""
        batch = jacobian.shape[2]
        rows = np.broadcast_to(self.weights[:, :, None], (*self.weights.shape, batch))
        return np.concatenate((jacobian, rows)).transpose(2, 0, 1)

    def derivatives(self, chain: Chain, path: Path, s: Array, q: Array) -> tuple[Array, Array, Array]:
        """Exact derivatives along the branch.

        Args:
            chain: the arm.
            path: where the tool is.
            s: path coordinates, (k,) [m].
            q: postures on the branch, (k, n).

        Returns:
            q' and q'', (k, n) each [rad/m, rad/m^2], and the Jacobians, (k, 6, n).
        """
        motion = chain.motion(q)
        jacobian = chain.jacobian(motion)
        matrix = self.matrix(jacobian)
        first = np.concatenate((path.twist(s), self.height(s, 1).T))
        rate = _solve(matrix, first)
        second = np.concatenate((path.twist_rate(s) - chain.velocity_product(motion, rate), self.height(s, 2).T))
        return rate, _solve(matrix, second), jacobian.transpose(2, 0, 1)


def _solve(matrix: Array, right: Array) -> Array:
    """Solutions (k, n) of k systems with matrices (k, n, n) and right-hand sides (n, k)."""
    return np.asarray(np.linalg.solve(matrix, right.T[:, :, None])[:, :, 0], dtype=np.float64)
