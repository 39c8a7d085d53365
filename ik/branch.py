"""A smooth branch of postures along a path, as the solution of a square system of equations.

A posture is the vector of all joint positions. An arm with more than six joints can hold the tool at one pose in
infinitely many postures. A branch selects one of them at each point of the path, by additional equations,

    tool(q) = target(s),    W q = h(s),

with W constant, (r, n), spanning the mean null space, and h a Chebyshev polynomial. The system is square, so that
q(s), q'(s) and q''(s) are as exact and as smooth as the path itself: with A = [J; W] and the path's twist xi,

    A q' = [xi; h'],    A q'' = [xi' - J' q'; h''].

The best smooth branch near a given one follows from a short sequence of convex quadratic programs (Clarabel).
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import clarabel
import numpy as np
from numpy.polynomial import chebyshev
from scipy import sparse

from ik.chain import POSE_EQUATIONS, KinematicChain, scale_down_steps
from ik.path import Path
from urdf import Limits
from urdf.robot import Array

NEWTON_TOLERANCE = 1e-12
"""Largest error of the pose and the branch's equation at which Newton's method ends [m, rad]: double precision allows
no less for an arm of about 1 m."""
MAX_NEWTON_ITERATIONS = 30
"""Largest number of iterations of Newton's method."""
MAX_NEWTON_STEP = 0.3
"""Largest change of a joint in one iteration of Newton's method [rad or m]; it is not accurate for larger changes."""


@dataclass(frozen=True)
class IkBranchEquations:
    """The additional equations W q = h(s) that select one posture q of a redundant arm at each path coordinate s.

    Attributes:
        weights: the matrix W, (r, n), for n joints; r = n - 6 may be 0.
        coefficients: Chebyshev coefficients of the polynomial h, (r, degree + 1) [rad or m].
        s_min: lower end of the interval of h [m].
        s_max: upper end of the interval of h [m].
    """

    weights: Array
    coefficients: Array
    s_min: float
    s_max: float

    def chebyshev_basis(self, s: Array, derivative: int = 0) -> Array:
        """Chebyshev polynomials at path coordinates s (k,), or their derivatives of a given order: (k, degree + 1)."""
        terms = self.coefficients.shape[1]
        scale = 2.0 / (self.s_max - self.s_min)
        derived = chebyshev.chebder(np.eye(terms), derivative, axis=0)
        return scale**derivative * chebyshev.chebvander(scale * (s - self.s_min) - 1.0, len(derived) - 1) @ derived

    def polynomial(self, s: Array, derivative: int = 0) -> Array:
        """The polynomial h at path coordinates s (k,), or its derivative of a given order: (k, r)."""
        return self.chebyshev_basis(s, derivative) @ self.coefficients.T

    def solve(self, chain: KinematicChain, path: Path, s: Array, guess: Array) -> tuple[Array, Array]:
        """Solve tool(q) = target(s) and W q = h(s) for the postures q by Newton's method.

        Args:
            chain: kinematics of the arm.
            path: the tool's path.
            s: path coordinates, (k,) [m].
            guess: postures from which the iteration starts, (k, n) [rad or m].

        Returns:
            Postures, (k, n) [rad or m], and the largest remaining error of the equations at each coordinate, (k,)
            [m or rad].
        """
        rotation, position = path.pose(s)
        height = self.polynomial(s)
        q = guess.copy()
        residual = np.full(len(s), np.inf)
        for _ in range(MAX_NEWTON_ITERATIONS):
            motion = chain.forward_kinematics(q)
            error = np.concatenate((motion.pose_error(rotation, position), height.T - self.weights @ q.T))
            previous, residual = residual, np.abs(error).max(axis=0)
            # Below the tolerance, or at the level of rounding, where the residual no longer falls.
            if np.all((residual < NEWTON_TOLERANCE) | ((residual < 1e2 * NEWTON_TOLERANCE) & (residual >= previous))):
                break
            q += scale_down_steps(_solve(self.system_matrix(chain.jacobian(motion)), error), MAX_NEWTON_STEP)
        return q, residual

    def system_matrix(self, jacobian: Array) -> Array:
        """Matrix A = [J; W] of the linearised equations, (k, n, n), from the tool's Jacobians J (6, n, k)."""
        batch = jacobian.shape[2]
        rows = np.broadcast_to(self.weights[:, :, None], (*self.weights.shape, batch))
        return np.concatenate((jacobian, rows)).transpose(2, 0, 1)

    def derivatives(self, chain: KinematicChain, path: Path, s: Array, q: Array) -> tuple[Array, Array, Array]:
        """First and second derivatives of the branch's postures with respect to the path coordinate.

        Args:
            chain: kinematics of the arm.
            path: the tool's path.
            s: path coordinates, (k,) [m].
            q: postures of the branch at these coordinates, (k, n) [rad or m].

        Returns:
            The derivatives q' and q'', (k, n) each [rad/m, rad/m^2], and the tool's Jacobians, (k, 6, n).
        """
        motion = chain.forward_kinematics(q)
        jacobian = chain.jacobian(motion)
        matrix = self.system_matrix(jacobian)
        first = np.concatenate((path.twist(s), self.polynomial(s, 1).T))
        rate = _solve(matrix, first)
        second = np.concatenate((path.twist_rate(s) - chain.velocity_product(motion, rate), self.polynomial(s, 2).T))
        return rate, _solve(matrix, second), jacobian.transpose(2, 0, 1)


def _solve(matrix: Array, right: Array) -> Array:
    """Solutions (k, n) of k systems with matrices (k, n, n) and right-hand sides (n, k)."""
    return np.asarray(np.linalg.solve(matrix, right.T[:, :, None])[:, :, 0], dtype=np.float64)


WANTED_JOINT_LIMIT_MARGIN = 0.53
"""Wanted distance of every joint from its limits [rad or m]."""
MARGIN_COST_SECONDS_PER_RADIAN = 10.0
"""Cost of each radian by which the smallest distance from a joint limit is less than the wanted one, as seconds of
traverse time [s/rad]."""
CORE_SPEED_SHORTFALL_WEIGHT = 3000.0
"""Weight of missing speed on the core, the part of the path on which a speed is required, relative to traverse time."""
BRANCH_CURVATURE_WEIGHT = 3e-3
"""Weight of the squared second derivatives of the joint positions by the path coordinate, relative to the joints' speed
limits, in the cost of a branch [m^2 s]; it keeps accelerations small."""
MAX_BRANCH_REFINEMENT_ROUNDS = 40
"""Largest number of rounds in which a branch is improved."""
MIN_TIME_GAIN_PER_ROUND_SECONDS = 1e-5
"""Gain of traverse time in a round below which the improvement of a branch ends [s]."""
INITIAL_TRUST_RADIUS, MAX_TRUST_RADIUS, MIN_TRUST_RADIUS = 0.2, 0.4, 1e-4
"""Change of the branch's polynomial h that the first round allows, the largest and the smallest one of any round [rad
or m]."""


def inside_core_indicator(path: Path, s: Array) -> Array:
    """1 where path coordinates s (k,) [m] lie in the path's core, the part on which a speed is required; else 0."""
    low, high = path.core
    return ((s >= low - 1e-9) & (s <= high + 1e-9)).astype(np.float64)


class _Candidate(NamedTuple):
    """A branch with its postures, their derivatives q' and q'', the derivative dq/dh (k, n, r), and its cost [s]."""

    branch: IkBranchEquations
    q: Array
    rate: Array
    bending: Array
    lift: Array
    cost: float


def optimise_ik_branch(
    chain: KinematicChain, limits: Limits, path: Path, branch: IkBranchEquations, s: Array, q: Array
) -> tuple[IkBranchEquations, Array]:
    r"""Optimise the polynomial h of a branch so that the arm can travel the path faster.

    Minimises the traverse time at full joint speed, plus a cost of curvature, of missing speed on the path's core and
    of missing distance from the joint limits,

        \int \max_j |q_j'| / v_j  ds + CURVATURE/2 \int |q'' / v|^2 ds + penalties,

    with v the joints' speed limits. Each round solves a quadratic program, linearised in h, within a trust region.

    Args:
        chain: kinematics of the arm.
        limits: limits of the joints.
        path: the tool's path.
        branch: branch from which the optimisation starts.
        s: evenly spaced path coordinates, (k,) [m].
        q: postures near the branch at these coordinates, (k, n) [rad or m].

    Returns:
        The optimised branch, and its postures at s, (k, n).
    """
    best = _assess(chain, limits, path, branch, s, q)
    if best is None or len(branch.weights) == 0:
        return branch, q
    trust = INITIAL_TRUST_RADIUS
    for _ in range(MAX_BRANCH_REFINEMENT_ROUNDS):
        change = _best_change(limits, path, best, s, trust)
        proposed = replace(best.branch, coefficients=best.branch.coefficients + change)
        candidate = _assess(chain, limits, path, proposed, s, best.q)
        if candidate is None or candidate.cost >= best.cost:
            trust *= 0.3
            if trust < MIN_TRUST_RADIUS:
                break
            continue
        gained, best, trust = best.cost - candidate.cost, candidate, min(MAX_TRUST_RADIUS, 2.0 * trust)
        if gained < MIN_TIME_GAIN_PER_ROUND_SECONDS:
            break
    return best.branch, best.q


def _assess(
    chain: KinematicChain, limits: Limits, path: Path, branch: IkBranchEquations, s: Array, q: Array
) -> _Candidate | None:
    """Solve a branch from postures near it, and compute its cost; None where it cannot be solved."""
    q, residual = branch.solve(chain, path, s, q)
    if residual.max() > 1e-9:
        return None
    step = s[1] - s[0]
    rate, bending, jacobian = branch.derivatives(chain, path, s, q)
    slowness = np.abs(rate / limits.velocity).max(axis=1)
    missing = np.maximum(0.0, slowness - 1.0 / path.core_speed) @ inside_core_indicator(path, s)
    cost = step * (slowness.sum() + CORE_SPEED_SHORTFALL_WEIGHT * missing)
    cost += step * BRANCH_CURVATURE_WEIGHT / 2 * ((bending / limits.velocity) ** 2).sum()
    cost += MARGIN_COST_SECONDS_PER_RADIAN * max(0.0, WANTED_JOINT_LIMIT_MARGIN - float(limits.margin(q).min()))
    lift = np.asarray(
        np.linalg.inv(branch.system_matrix(jacobian.transpose(1, 2, 0)))[:, :, POSE_EQUATIONS:], dtype=np.float64
    )
    return _Candidate(branch, q, rate, bending, lift, float(cost))


def _best_change(limits: Limits, path: Path, now: _Candidate, s: Array, trust: float) -> Array:
    """Change of the coefficients, (r, degree + 1), that minimises the linearised cost within the trust region."""
    rows, degree = now.branch.coefficients.shape
    nodes, joints = now.q.shape
    step = s[1] - s[0]
    basis, slopes, bends = (now.branch.chebyshev_basis(s, derivative) for derivative in range(3))
    # dq = L dh, hence dq' = L dh' + L' dh and so on, with L = dq/dh.
    lift = now.lift
    lift_slope = np.gradient(lift, step, axis=0)
    lift_bend = np.gradient(lift_slope, step, axis=0)

    def effect(*terms: tuple[Array, Array]) -> Array:
        total = sum(np.einsum("knr,kd->nkrd", left, right) for left, right in terms)
        return np.reshape(total, (joints, nodes, rows * degree))

    moves = effect((lift, basis))
    speed = limits.velocity[:, None, None]
    first = effect((lift, slopes), (lift_slope, basis)) / speed
    second = effect((lift, bends), (2 * lift_slope, slopes), (lift_bend, basis)) / speed
    slope, bend = now.rate.T / speed[:, 0], now.bending.T / speed[:, 0]
    heights = np.einsum("kd,rp->rkpd", basis, np.eye(rows)).reshape(rows, nodes, rows * degree)
    core = np.flatnonzero(inside_core_indicator(path, s))
    # Unknowns: coefficients, slowness per node, missing slowness per node of the core, missing margin.
    ends = np.cumsum([rows * degree, nodes, len(core), 1])
    change, slow, missing, margin = (slice(start, end) for start, end in pairwise([0, *ends]))
    blocks, bounds = [], []

    def at_most(bound: Array, *parts: tuple[slice, Array | float]) -> None:
        block = np.zeros((len(bound), ends[-1]))
        for columns, values in parts:
            block[:, columns] = values
        blocks.append(sparse.csr_matrix(block))
        bounds.append(bound)

    for joint in range(joints):
        for sign in (1.0, -1.0):
            at_most(-sign * slope[joint], (change, sign * first[joint]), (slow, -np.eye(nodes)))
            limit = limits.upper[joint] if sign > 0 else limits.lower[joint]
            room = sign * (limit - now.q[:, joint])
            at_most(room - WANTED_JOINT_LIMIT_MARGIN, (change, sign * moves[joint]), (margin, -1.0))
    wanted = np.full(len(core), 1.0 / path.core_speed)
    at_most(wanted, (slow, np.eye(nodes)[core]), (missing, -np.eye(len(core))))
    at_most(np.zeros(len(core)), (missing, -np.eye(len(core))))
    at_most(np.zeros(1), (margin, -1.0))
    for height in heights:
        for sign in (1.0, -1.0):
            at_most(np.full(nodes, trust), (change, sign * height))
    quadratic = np.zeros((ends[-1], ends[-1]))
    quadratic[change, change] = BRANCH_CURVATURE_WEIGHT * step * np.einsum(
        "jka,jkb->ab", second, second
    ) + 1e-9 * np.eye(ends[0])
    linear = np.empty(ends[-1])
    linear[change] = BRANCH_CURVATURE_WEIGHT * step * np.einsum("jka,jk->a", second, bend)
    linear[slow], linear[missing], linear[margin] = (
        step,
        CORE_SPEED_SHORTFALL_WEIGHT * step,
        MARGIN_COST_SECONDS_PER_RADIAN,
    )
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    constraints, bound = sparse.csc_matrix(sparse.vstack(blocks)), np.concatenate(bounds)
    cone = [clarabel.NonnegativeConeT(len(bound))]
    solver = clarabel.DefaultSolver(sparse.csc_matrix(np.triu(quadratic)), linear, constraints, bound, cone, settings)
    return np.array(solver.solve().x)[change].reshape(rows, degree)
