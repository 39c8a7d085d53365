"""Solve the inverse kinematics of one block of a grid, starting from postures on a coarse grid, the skeleton."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik.chain import KinematicChain
from ik.solver import REACHED_POSE_TOLERANCE, damped_least_squares
from ik.volume.grid import Block, TargetGrid, TargetStatus
from urdf import CollisionModel, Robot
from urdf.robot import Array

MAX_ITERATIONS_PER_TARGET = 9
"""Largest number of iterations per target; four are enough where the skeleton is smooth."""
GIVE_UP_POSE_ERROR = 1e-2
"""Error above which a target is given up after a few iterations [m or rad]."""
TARGETS_SOLVED_TOGETHER = 4096
"""Number of targets that are solved together: their arrays fit into the processor's cache."""
MAX_CORNER_POSTURE_DIFFERENCE = 1.5
"""Largest difference of a joint between the postures at a skeleton cell's corners that are averaged [rad]."""


class BlockSolution(NamedTuple):
    """Inverse kinematics of one block of a grid.

    Attributes:
        q: postures, (x, y, z, n) [rad or m]; nan where a target is unreachable.
        status: result of each target, (x, y, z), a value of `TargetStatus`.
    """

    q: Array
    status: NDArray[np.uint8]


@dataclass(frozen=True)
class BlockSolver:
    """Solves the inverse kinematics of blocks of a grid; it can be pickled and sent to a worker process.

    Attributes:
        robot: the arm.
        grid: the targets.
        skeleton: postures on the coarse grid, (m, x, y, z, n) [rad or m]; nan where there is none.
        collisions: whether postures with a collision are marked.
    """

    robot: Robot
    grid: TargetGrid
    skeleton: Array
    collisions: bool

    def __call__(self, block: Block) -> BlockSolution:
        """Solve the targets of a block.

        The guess is the skeleton, interpolated at the target's position. The smallest joint motion leads from the guess
        to the target. Both depend smoothly on the position, and so do the postures, also across blocks.
        """
        chain, place = KinematicChain.from_robot(self.robot), self.grid.positions(block)
        position = place.reshape(-1, 3)
        q = self._guess(block[0], position)
        rotation = self.grid.rotations[block[0]][:, :, None]
        status = np.full(len(q), TargetStatus.UNREACHABLE, dtype=np.uint8)
        known = np.flatnonzero(~np.isnan(q[:, 0]))
        for start in range(0, len(known), TARGETS_SOLVED_TOGETHER):
            part = known[start : start + TARGETS_SOLVED_TOGETHER]
            placed = np.ascontiguousarray(position[part].T)
            q[part], error = damped_least_squares(
                chain,
                self.robot.limits,
                rotation,
                placed,
                q[part],
                iterations=MAX_ITERATIONS_PER_TARGET,
                hopeless=GIVE_UP_POSE_ERROR,
            )
            status[part[np.abs(error).max(axis=0) < REACHED_POSE_TOLERANCE]] = TargetStatus.REACHED
        q[status == TargetStatus.UNREACHABLE] = np.nan
        if self.collisions:
            model = CollisionModel(self.robot)
            touching = [i for i in np.flatnonzero(status) if model.touching(q[i]) is not None]
            status[touching] = TargetStatus.COLLIDING
        return BlockSolution(q.reshape(*place.shape[:3], -1), status.reshape(place.shape[:3]))

    def _guess(self, rotation: int, position: Array) -> Array:
        """Trilinear interpolation of the skeleton at positions (k, 3), (k, n); nan where no corner has a posture."""
        coarse = self.grid.coarse_grid()
        cells = np.array(coarse.counts) - 1
        place = (position - coarse.low) / (coarse.high - coarse.low) * cells
        cell = np.clip(place.astype(int), 0, cells - 1)
        share = place - cell
        skeleton = self.skeleton[rotation]
        corners, weights = [], []
        for corner in np.ndindex(2, 2, 2):
            corners.append(skeleton[tuple((cell + corner).T)])
            weights.append(np.prod(np.where(corner, share, 1.0 - share), axis=1))
        postures, weight = np.array(corners), np.array(weights)[:, :, None]
        solved = ~np.isnan(postures)
        # Where corners are missing or on different branches, only those close to the heaviest solved one are used.
        heaviest = np.where(solved[:, :, 0], weight[:, :, 0], -1.0).argmax(axis=0)
        reference = postures[heaviest, np.arange(len(position))]
        with np.errstate(invalid="ignore"):
            together = solved & (
                np.abs(postures - reference).max(axis=2, keepdims=True) < MAX_CORNER_POSTURE_DIFFERENCE
            )
        weight = np.where(together, weight + 1e-12, 0.0)
        total = weight.sum(axis=0)
        mixed = (np.where(together, postures, 0.0) * weight).sum(axis=0) / np.where(total > 0, total, np.nan)
        return np.asarray(mixed)
