"""One smooth branch of postures along a path, as the solution of a square system of equations.

An arm with more joints than the task has equations can hold the tool in a whole family of postures. The branch picks
one of them by appending rows to the task,

    tool(q) = target(s),    W q = h(s),

with W constant, (r, n), spanning the mean null space, and h a Chebyshev polynomial. The system is square, so that
q(s), q'(s) and q''(s) are as exact and as smooth as the path itself: with A = [J; W] and the path's twist xi,

    A q' = [xi; h'],    A q'' = [xi' - J' q'; h''].

The best smooth branch near a given one follows from a short sequence of convex quadratic programs (Clarabel).
"""

from dataclasses import dataclass, replace

import clarabel
import numpy as np
from numpy.polynomial import chebyshev
from scipy import sparse

from ik.chain import Chain, shortened
from ik.path import Path
from ik.selfmotion import Goal
from urdf import Limits
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


CURVATURE = 3e-3  # m^2 s: cost of bending; it keeps accelerations small and costs little speed
ROUNDS = 40
ENOUGH = 1e-5  # s of traverse time


@dataclass(frozen=True)
class _State:
    branch: Branch
    q: Array
    rate: Array
    bending: Array
    lift: Array  # dq/dh, (k, n, r)
    cost: float


def refine(
    chain: Chain, limits: Limits, path: Path, goal: Goal, branch: Branch, s: Array, q: Array
) -> tuple[Branch, Array]:
    r"""Change the polynomial h so that the path can be travelled faster.

    Minimises the traverse time at full speed plus bending and the goal's own terms,

        \int \max_j |q_j'| / v_j  ds + CURVATURE/2 \int |q'' / v|^2 ds + penalties,

    where each round linearises the branch in h, within a trust region.

    Args:
        chain: the arm.
        limits: of its joints.
        path: where the tool is.
        goal: what to optimise for.
        branch: where to start.
        s: evenly spaced coordinates, (k,) [m].
        q: postures near the branch, (k, n).

    Returns:
        The branch and its postures at s, (k, n).
    """
    best = _state(chain, limits, path, goal, branch, s, q)
    if best is None or len(branch.weights) == 0:
        return branch, q
    trust = 0.2
    for _ in range(ROUNDS):
        change = _propose(limits, goal, best, s, trust)
        candidate = replace(best.branch, coefficients=best.branch.coefficients + change)
        state = _state(chain, limits, path, goal, candidate, s, best.q)
        if state is None or state.cost >= best.cost:
            trust *= 0.3
            if trust < 1e-4:
                break
            continue
        gained, best, trust = best.cost - state.cost, state, min(0.4, 2.0 * trust)
        if gained < ENOUGH:
            break
    return best.branch, best.q


def _state(chain: Chain, limits: Limits, path: Path, goal: Goal, branch: Branch, s: Array, q: Array) -> _State | None:
    solution = branch.solve(chain, path, s, q)
    if solution.residual.max() > 1e-9:
        return None
    step = s[1] - s[0]
    rate, bending, jacobian = branch.derivatives(chain, path, s, solution.q)
    slowness = np.abs(rate / limits.velocity).max(axis=1)
    missing = np.maximum(0.0, slowness - 1.0 / goal.core_speed)[goal.in_core(s)].sum()
    cost = step * (slowness.sum() + goal.core_weight * missing)
    cost += step * CURVATURE / 2 * ((bending / limits.velocity) ** 2).sum()
    cost += goal.margin_weight * max(0.0, goal.margin - float(limits.margin(solution.q).min()))
    lift = np.asarray(np.linalg.inv(branch.matrix(jacobian.transpose(1, 2, 0)))[:, :, 6:], dtype=np.float64)
    return _State(branch, solution.q, rate, bending, lift, float(cost))


def _propose(limits: Limits, goal: Goal, state: _State, s: Array, trust: float) -> Array:
    """Change of the coefficients, (r, degree + 1), that is best to first order within the trust region."""
    rows, degree = state.branch.coefficients.shape
    nodes, joints = state.q.shape
    step = s[1] - s[0]
    basis, slopes, bends = (state.branch.basis(s, derivative) for derivative in range(3))
    # dq = L dh, hence dq' = L dh' + L' dh and so on, with L = dq/dh.
    lift = state.lift
    lift_slope = np.gradient(lift, step, axis=0)
    lift_bend = np.gradient(lift_slope, step, axis=0)

    def effect(*terms: tuple[Array, Array]) -> Array:
        total = sum(np.einsum("knr,kd->nkrd", left, right) for left, right in terms)
        return np.reshape(total, (joints, nodes, rows * degree))

    moves = effect((lift, basis))
    speed = limits.velocity[:, None, None]
    first = effect((lift, slopes), (lift_slope, basis)) / speed
    second = effect((lift, bends), (2 * lift_slope, slopes), (lift_bend, basis)) / speed
    slope, bend = state.rate.T / speed[:, 0], state.bending.T / speed[:, 0]
    core = goal.in_core(s)
    # Unknowns: coefficients, slowness per node, missing slowness per node of the core, missing margin.
    sizes = (rows * degree, nodes, int(core.sum()), 1)
    blocks: list[tuple[tuple[Array | None, ...], Array]] = []
    unit = np.eye(nodes)
    for joint in range(joints):
        for sign in (1.0, -1.0):
            blocks.append(((sign * first[joint], -unit, None, None), -sign * slope[joint]))
        for sign, bound in ((1.0, limits.lower[joint]), (-1.0, limits.upper[joint])):
            room = sign * (state.q[:, joint] - bound) - goal.margin
            blocks.append(((-sign * moves[joint], None, None, -np.ones((nodes, 1))), room))
    blocks.append(((None, unit[core], -np.eye(sizes[2]), None), np.full(sizes[2], 1.0 / goal.core_speed)))
    blocks.append(((None, None, -np.eye(sizes[2]), None), np.zeros(sizes[2])))
    blocks.append(((None, None, None, -np.eye(1)), np.zeros(1)))
    for row in range(rows):
        reach = np.zeros((nodes, rows, degree))
        reach[:, row] = basis
        for sign in (1.0, -1.0):
            blocks.append(((sign * reach.reshape(nodes, -1), None, None, None), np.full(nodes, trust)))
    constraints = sparse.vstack([_row(parts, sizes) for parts, _ in blocks])
    quadratic = CURVATURE * step * np.einsum("jka,jkb->ab", second, second) + 1e-9 * np.eye(sizes[0])
    linear = np.concatenate(
        (
            CURVATURE * step * np.einsum("jka,jk->a", second, bend),
            np.full(sizes[1], step),
            np.full(sizes[2], goal.core_weight * step),
            np.full(1, goal.margin_weight),
        )
    )
    padding = sparse.csc_matrix((sum(sizes[1:]), sum(sizes[1:])))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    bounds = np.concatenate([bound for _, bound in blocks])
    solver = clarabel.DefaultSolver(
        sparse.csc_matrix(sparse.triu(sparse.block_diag((quadratic, padding)))),
        linear,
        sparse.csc_matrix(constraints),
        bounds,
        [clarabel.NonnegativeConeT(len(bounds))],
        settings,
    )
    return np.array(solver.solve().x)[: sizes[0]].reshape(rows, degree)


def _row(parts: tuple[Array | None, ...], sizes: tuple[int, ...]) -> sparse.csr_matrix:
    height = next(part.shape[0] for part in parts if part is not None)
    return sparse.hstack(
        [
            sparse.csr_matrix((height, size)) if part is None else sparse.csr_matrix(part)
            for part, size in zip(parts, sizes, strict=True)
        ]
    )
