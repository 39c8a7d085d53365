"""Solve one block of a volume, starting from the skeleton's targets around it."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik.chain import Chain
from ik.solver import REACHED_TOLERANCE, descend
from ik.volume.grid import Block, Grid, Status
from urdf import CollisionModel, Robot
from urdf.robot import Array

BLOCK_ITERATIONS = 9  # four are enough wherever the skeleton is smooth
HOPELESS_ERROR = 1e-2  # m or rad
TARGETS_AT_ONCE = 4096  # targets at once: what the caches hold
MAX_CORNER_DISTANCE = 1.5  # rad between corners of a cell of the skeleton that are not to be mixed


class Solved(NamedTuple):
    """Solution of one block."""

    q: Array  # (x, y, z, n) [rad or m], nan where unreachable
    status: NDArray[np.uint8]  # (x, y, z), see Status


@dataclass(frozen=True)
class BlockSolver:
    """Solves blocks in a worker; it is small enough to be sent with every block.

    Attributes:
        robot: the arm.
        grid: the targets.
        skeleton: postures on the coarse grid, (m, x, y, z, n), nan where there are none.
        collisions: whether postures at which the arm touches something are marked.
    """

    robot: Robot
    grid: Grid
    skeleton: Array
    collisions: bool

    def __call__(self, block: Block) -> Solved:
        """Postures of a block, each the nearest to the skeleton's at its position.

        The skeleton interpolated between its targets is a smooth guess; the smallest joint motion takes it onto the
        target. Both depend smoothly on the position, and so do the postures, across blocks too.
        """
        chain, place = Chain.of(self.robot), self.grid.positions(block)
        position = place.reshape(-1, 3)
        q = self._guess(block[0], position)
        rotation = self.grid.rotations[block[0]][:, :, None]
        status = np.full(len(q), Status.UNREACHABLE, dtype=np.uint8)
        known = np.flatnonzero(~np.isnan(q[:, 0]))
        for start in range(0, len(known), TARGETS_AT_ONCE):
            part = known[start : start + TARGETS_AT_ONCE]
            placed = np.ascontiguousarray(position[part].T)
            q[part], error = descend(
                chain,
                self.robot.limits,
                rotation,
                placed,
                q[part],
                iterations=BLOCK_ITERATIONS,
                hopeless=HOPELESS_ERROR,
            )
            status[part[np.abs(error).max(axis=0) < REACHED_TOLERANCE]] = Status.REACHED
        q[status == Status.UNREACHABLE] = np.nan
        if self.collisions:
            model = CollisionModel(self.robot)
            touching = [i for i in np.flatnonzero(status) if model.touching(q[i]) is not None]
            status[touching] = Status.TOUCHING
        return Solved(q.reshape(*place.shape[:3], -1), status.reshape(place.shape[:3]))

    def _guess(self, rotation: int, position: Array) -> Array:
        """The skeleton interpolated between its targets, (k, n): trilinear; nan where no corner of a cell is solved."""
        coarse = self.grid.coarse()
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
            together = solved & (np.abs(postures - reference).max(axis=2, keepdims=True) < MAX_CORNER_DISTANCE)
        weight = np.where(together, weight + 1e-12, 0.0)
        total = weight.sum(axis=0)
        mixed = (np.where(together, postures, 0.0) * weight).sum(axis=0) / np.where(total > 0, total, np.nan)
        return np.asarray(mixed)
