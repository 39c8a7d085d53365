"""The best smooth branch near a given one: a short sequence of convex quadratic programs (Clarabel)."""

from dataclasses import dataclass, replace

import clarabel
import numpy as np
from scipy import sparse

from ik.branch import Branch
from ik.chain import Chain
from ik.path import Path
from ik.selfmotion import Goal
from urdf import Limits
from urdf.robot import Array

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
