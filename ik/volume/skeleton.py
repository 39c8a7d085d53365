"""Postures on a coarse grid that vary smoothly: solved outwards from one target, then smoothed."""

import numpy as np
from numpy.typing import NDArray

from ik.errors import UnreachableError
from ik.solver import REACHED_POSE_TOLERANCE, IkSolver, damped_least_squares
from ik.volume.grid import TargetGrid
from urdf import CollisionModel, Robot
from urdf.robot import Array

MAX_NEIGHBOUR_POSTURE_DIFFERENCE = 0.7
"""Largest difference of a joint between neighbouring postures of one branch [rad]."""
SMOOTHING_SWEEPS = 30
"""Number of sweeps in which postures are smoothed; more change nothing."""
MAX_EXTRA_BRANCHES = 8
"""Largest number of branches besides the first; postures jump at the border of each, and later ones are small."""
RANDOM_STARTS_PER_TARGET = 4
"""Number of random starting postures for a target to which no neighbour's posture leads."""
CENTRING_SHARE_PER_SWEEP = (
    0.05  # share of the way to the middle of the joints' ranges per sweep: no posture creeps to a limit
)
"""Share of the way to the middle of the joints' ranges by which the first sweep moves a posture, less in each later
sweep, so that no posture creeps to a limit."""


def build_skeleton(robot: Robot, grid: TargetGrid) -> Array:
    """Solve the inverse kinematics on a coarse grid, with postures close to their neighbours and without collisions.

    The target nearest to the tool at home is solved from the home posture. Then each neighbour of solved targets is
    solved from the mean of their postures, outwards step by step. Where targets remain, another starting posture begins
    a new region. Finally each posture is repeatedly moved towards the mean of its neighbours and corrected to reach its
    target. The next orientation starts from the postures of the one before.

    Returns:
        Postures, (m, x, y, z, n) [rad or m]; nan where a target is not reached.

    Raises:
        UnreachableError: no target of the grid can be reached.
    """
    solver, collisions = IkSolver(robot), CollisionModel(robot)
    position = grid.positions().reshape(-1, 3)
    parts = []
    q = np.full((len(position), len(robot.home)), np.nan)
    for rotation in grid.rotations:
        layer = _Layer(robot, solver, rotation, position, grid.counts)
        before, q = q, layer.follow(q)
        if np.isnan(q).all():
            nearest = int(np.linalg.norm(position - robot.tool_pose(robot.home).translation, axis=1).argmin())
            before[nearest] = robot.home
            q = layer.follow(before)
        q = layer.spread(layer.smooth(layer.spread(q)))
        for index in np.flatnonzero(~np.isnan(q[:, 0])):
            if collisions.touching(q[index]) is not None:
                q[index] = np.nan
        parts.append(q)
    skeleton = np.array(parts)
    if np.isnan(skeleton).all():
        raise UnreachableError(
            f"robot '{robot.name}': no target of the volume can be held; move it or turn the tool another way"
        )
    return skeleton.reshape(*grid.shape, -1)


class _Layer:
    """Solves the targets of one orientation; postures q are (k, n), nan where there is none."""

    def __init__(
        self, robot: Robot, solver: IkSolver, rotation: Array, position: Array, counts: tuple[int, int, int]
    ) -> None:
        self.limits, self.solver = robot.limits, solver
        self.rotation, self.position, self.neighbours = rotation, position, _neighbours(counts)

    def reach(self, targets: NDArray[np.intp], guess: Array, farthest: float) -> tuple[Array, NDArray[np.bool_]]:
        """Postures of targets (m,) from guesses (m, n), and which reach them within `farthest` rad of the guess."""
        placed = np.ascontiguousarray(self.position[targets].T)
        q, error = damped_least_squares(self.solver.chain, self.limits, self.rotation[:, :, None], placed, guess)
        return q, (np.abs(error).max(axis=0) < REACHED_POSE_TOLERANCE) & (np.abs(q - guess).max(axis=1) < farthest)

    def follow(self, guess: Array) -> Array:
        """Postures from guesses; nan where there is no guess or the target is not reached."""
        q = np.full_like(guess, np.nan)
        known = np.flatnonzero(~np.isnan(guess[:, 0]))
        found, good = self.reach(known, guess[known], np.inf)
        q[known[good]] = found[good]
        return q

    def spread(self, q: Array) -> Array:
        """Solve the unsolved targets, outwards from the solved ones; where this ends, from random postures."""
        q = q.copy()
        tried = np.full(len(q), -1)
        cold: Array | None = None
        parts = 0
        while True:
            count = ((self.neighbours >= 0) & ~np.isnan(q[self.neighbours][:, :, 0])).sum(axis=1)
            # A target is tried again when more of its neighbours are solved than the last time.
            wave = np.flatnonzero(np.isnan(q[:, 0]) & (count > tried) & (count > 0))
            if len(wave):
                tried[wave] = count[wave]
                found, good = self.reach(wave, _mean(q, self.neighbours[wave]), MAX_NEIGHBOUR_POSTURE_DIFFERENCE)
                q[wave[good]] = found[good]
                continue
            known = ~np.isnan(q[:, 0])
            if cold is None:
                cold = np.full_like(q, np.nan)
                rotations = np.broadcast_to(self.rotation, (int((~known).sum()), 3, 3))
                answers = self.solver.solve(rotations, self.position[~known], starts=RANDOM_STARTS_PER_TARGET)
                cold[~known] = np.where(answers.reached[:, None], answers.q, np.nan)
            left = np.flatnonzero(~known & ~np.isnan(cold[:, 0]))
            if not len(left) or parts == MAX_EXTRA_BRANCHES:
                return q
            # The posture closest to the solved ones starts the next part, from which the waves go on.
            centre = np.mean(q[known], axis=0) if known.any() else cold[left[0]]
            first = left[int(np.abs(cold[left] - centre).max(axis=1).argmin())]
            q[first] = cold[first]
            parts += 1

    def smooth(self, q: Array) -> Array:
        """Move each posture repeatedly towards the mean of its neighbours, corrected to reach its target."""
        q, middle = q.copy(), (self.limits.lower + self.limits.upper) / 2
        solved = np.flatnonzero(~np.isnan(q[:, 0]))
        for sweep in range(SMOOTHING_SWEEPS):
            mean = _mean(q, self.neighbours)
            guess = 0.5 * (q + np.where(np.isnan(mean), q, mean))[solved]
            guess += CENTRING_SHARE_PER_SWEEP * (1 - sweep / SMOOTHING_SWEEPS) * (middle - guess)
            found, good = self.reach(solved, guess, np.inf)
            good &= np.abs(found - q[solved]).max(axis=1) < MAX_NEIGHBOUR_POSTURE_DIFFERENCE
            q[solved[good]] = found[good]
        return q


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
    """Mean posture of the solved neighbours, (k, n); nan where none is solved. `neighbours` (k, 6) are indices."""
    around = np.where((neighbours >= 0)[:, :, None], q[neighbours], np.nan)
    solved = ~np.isnan(around)
    return np.asarray(
        np.where(solved, around, 0.0).sum(axis=1) / np.where(solved.any(axis=1), solved.sum(axis=1), np.nan)
    )
