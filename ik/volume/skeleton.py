"""A coarse grid of postures on one branch: solved outwards from one target, then smoothed."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ik.errors import UnreachableError
from ik.solver import Solver
from ik.volume.grid import Grid
from urdf import Robot
from urdf.robot import Array

TOLERANCE = 1e-9  # m and rad
NEXT = 0.7  # rad between neighbours of the skeleton that still belong together
SWEEPS = 30  # of smoothing; more sweeps change nothing
PARTS = 8  # branches beside the first; each has a border on which postures jump, and later ones are small
COLD_STARTS = 4  # per target that no wave reached
CENTRING = 0.05  # share of the way to the middle of the joints' ranges per sweep: no posture creeps to a limit


def build_skeleton(robot: Robot, grid: Grid, free: Callable[[Array], bool] | None = None) -> Array:
    """Postures at the targets of a coarse grid, each close to those of its neighbours.

    The target nearest to the tool at home is solved from home; every target next to a solved one is then solved from
    the mean of its solved neighbours, wave by wave. Where the waves end and targets are left, another posture starts
    another part. Sweeps that replace each posture by the mean of its neighbours, brought back to its target, take the
    unevenness out. The next orientation starts from the postures of the one before.

    Args:
        robot: the arm and its home posture.
        grid: the coarse targets.
        free: says whether a posture (n,) touches nothing; None allows all.

    Returns:
        (m, x, y, z, n) [rad or m], nan where a target cannot be held.

    Raises:
        UnreachableError: no target of the grid can be held.
    """
    solver = Solver(robot)
    position = grid.positions().reshape(-1, 3)
    neighbours = _neighbours(grid.counts)
    parts = []
    guess = np.full((len(position), solver.chain.joints), np.nan)
    for rotation in grid.rotations:
        targets = np.broadcast_to(rotation, (len(position), 3, 3))
        q = _follow(solver, targets, position, guess)
        if np.isnan(q).all():
            nearest = int(np.linalg.norm(position - robot.tool_pose(robot.home).translation, axis=1).argmin())
            guess[nearest] = robot.home
            q = _follow(solver, targets, position, guess)
        q = _spread(solver, targets, position, q, neighbours)
        q = _smooth(robot, solver, targets, position, q, neighbours)
        q = _spread(solver, targets, position, q, neighbours)
        if free is not None:
            for index in np.flatnonzero(~np.isnan(q[:, 0])):
                if not free(q[index]):
                    q[index] = np.nan
        parts.append(q)
        guess = q
    skeleton = np.array(parts)
    if np.isnan(skeleton).all():
        raise UnreachableError(
            f"robot '{robot.name}': no target of the volume can be held; move it or turn the tool another way"
        )
    return skeleton.reshape(len(grid.rotations), *grid.counts, -1)


def _neighbours(counts: tuple[int, int, int]) -> NDArray[np.intp]:
    """Indices of the six neighbours of every target, (k, 6); -1 where there is none."""
    index = np.pad(np.arange(int(np.prod(counts))).reshape(counts), 1, constant_values=-1)
    inner = slice(1, -1)
    sides = []
    for axis in range(3):
        for side in (slice(None, -2), slice(2, None)):
            cut = [inner] * 3
            cut[axis] = side
            sides.append(index[tuple(cut)].ravel())
    return np.stack(sides, axis=1)


def _mean(q: Array, neighbours: NDArray[np.intp]) -> Array:
    """Mean posture of the solved ones among neighbours (k, 6), (k, n); nan where there is none."""
    around = np.where((neighbours >= 0)[:, :, None], q[neighbours], np.nan)
    solved = ~np.isnan(around)
    return np.asarray(
        np.where(solved, around, 0.0).sum(axis=1) / np.where(solved.any(axis=1), solved.sum(axis=1), np.nan)
    )


def _spread(solver: Solver, rotation: Array, position: Array, q: Array, neighbours: NDArray[np.intp]) -> Array:
    """Solve what is unsolved, outwards from what is solved; where that ends, from the library of postures."""
    q = q.copy()
    tried = np.full(len(q), -1)
    cold: Array | None = None
    parts = 0
    while True:
        count = ((neighbours >= 0) & ~np.isnan(q[neighbours][:, :, 0])).sum(axis=1)
        # A target is tried again when more of its neighbours are solved than the last time.
        wave = np.flatnonzero(np.isnan(q[:, 0]) & (count > tried) & (count > 0))
        if len(wave):
            tried[wave] = count[wave]
            mean = _mean(q, neighbours[wave])
            found, error = solver.descend(rotation[wave], position[wave], mean)
            good = (error < TOLERANCE) & (np.abs(found - mean).max(axis=1) < NEXT)
            q[wave[good]] = found[good]
            continue
        known = ~np.isnan(q[:, 0])
        if cold is None:
            cold = np.full_like(q, np.nan)
            answers = solver.solve(rotation[~known], position[~known], starts=COLD_STARTS)
            cold[~known] = np.where(answers.reached[:, None], answers.q, np.nan)
        left = np.flatnonzero(~known & ~np.isnan(cold[:, 0]))
        if not len(left) or parts == PARTS:
            return q
        # The posture closest to the solved ones starts the next part, from which the waves go on.
        centre = np.mean(q[known], axis=0) if known.any() else cold[left[0]]
        first = left[int(np.abs(cold[left] - centre).max(axis=1).argmin())]
        q[first] = cold[first]
        parts += 1


def _smooth(
    robot: Robot, solver: Solver, rotation: Array, position: Array, q: Array, neighbours: NDArray[np.intp]
) -> Array:
    """Sweeps of means of neighbours, each brought back to its target; a posture that would leave its limits stays."""
    middle = (robot.limits.lower + robot.limits.upper) / 2
    solved = np.flatnonzero(~np.isnan(q[:, 0]))
    for sweep in range(SWEEPS):
        mean = _mean(q, neighbours)
        guess = 0.5 * (q + np.where(np.isnan(mean), q, mean))[solved]
        guess += CENTRING * (1 - sweep / SWEEPS) * (middle - guess)
        found, error = solver.descend(rotation[solved], position[solved], guess)
        near = np.abs(found - q[solved]).max(axis=1) < NEXT
        q[solved] = np.where(((error < TOLERANCE) & near)[:, None], found, q[solved])
    return q


def _follow(solver: Solver, rotation: Array, position: Array, guess: Array) -> Array:
    """Postures from guesses (k, n), nan where there is none or the target is missed."""
    q = np.full_like(guess, np.nan)
    known = np.flatnonzero(~np.isnan(guess[:, 0]))
    if len(known):
        found, error = solver.descend(rotation[known], position[known], guess[known])
        q[known[error < TOLERANCE]] = found[error < TOLERANCE]
    return q
