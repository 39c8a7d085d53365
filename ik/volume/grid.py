"""Which targets a volume has, how it is cut into blocks, and how a worker process solves one of them."""

import itertools
import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from armdyn.errors import InputError
from ik.chain import Chain, least_motion
from urdf.robot import Array, read_only

BLOCK = 25  # targets per edge of a block: a second of work, and a chunk of a megabyte
FARTHEST = 100.0
"""m; no arm on a fixed base reaches so far."""
MOST_TARGETS = 10**9
"""A volume of so many takes 60 GB and a day."""
SKELETON = 0.06  # m between the targets of the coarse skeleton; postures bend little over that


class Status(IntEnum):
    """What became of a target."""

    UNREACHABLE = 0  # within the joint limits on the branch of its neighbours
    REACHED = 1
    TOUCHING = 2  # reached, but the arm touches something there


class Block(NamedTuple):
    """A part of a volume: one orientation, and ranges of indices along x, y and z."""

    rotation: int
    ranges: tuple[tuple[int, int], tuple[int, int], tuple[int, int]]

    @property
    def slices(self) -> tuple[slice, slice, slice]:
        """The three ranges as slices."""
        x, y, z = (slice(*bounds) for bounds in self.ranges)
        return x, y, z


@dataclass(frozen=True)
class Grid:
    """Evenly spaced positions of the tool point in the robot's base frame, each with every orientation.

    Attributes:
        low: lowest corner, (3,) [m].
        high: highest corner, (3,) [m].
        counts: targets along x, y and z, each at least 2.
        rotations: orientations of the tool, (m, 3, 3).
    """

    low: Array
    high: Array
    counts: tuple[int, int, int]
    rotations: Array

    def __post_init__(self) -> None:
        for name in ("low", "high", "rotations"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        if not (np.all(np.abs(self.low) <= FARTHEST) and np.all(np.abs(self.high) <= FARTHEST)):
            raise InputError(f"volume: a corner is farther than {FARTHEST:g} m from the robot; give metres")
        if self.low.shape != (3,) or self.high.shape != (3,) or not np.all(self.low < self.high):
            raise InputError(f"volume: corners {self.low.tolist()} and {self.high.tolist()} span nothing; low < high")
        if len(self.counts) != 3 or min(self.counts) < 2:
            raise InputError(f"volume: {self.counts} targets along x, y, z; give at least 2 along each")
        if len(self.rotations) * math.prod(self.counts) > MOST_TARGETS:
            raise InputError(
                f"volume: {self.counts} targets along x, y, z are too many; {MOST_TARGETS:.0e} is the most"
            )
        if self.rotations.ndim != 3 or self.rotations.shape[1:] != (3, 3) or not len(self.rotations):
            raise InputError(f"volume: orientations of shape {self.rotations.shape} should be (m, 3, 3)")

    @property
    def targets(self) -> int:
        """Number of targets, orientations included."""
        return len(self.rotations) * int(np.prod(self.counts))

    def axes(self) -> tuple[Array, Array, Array]:
        """Coordinates along x, y and z [m]."""
        bounds = zip(self.low, self.high, self.counts, strict=True)
        x, y, z = (np.linspace(low, high, count) for low, high, count in bounds)
        return x, y, z

    def positions(self, block: Block | None = None) -> Array:
        """Positions of a block or of all, (x, y, z, 3) [m]."""
        axes = self.axes()
        if block is not None:
            axes = axes[0][block.slices[0]], axes[1][block.slices[1]], axes[2][block.slices[2]]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)

    def blocks(self) -> list[Block]:
        """All blocks, one orientation after the other."""
        cuts = [[(start, min(start + BLOCK, count)) for start in range(0, count, BLOCK)] for count in self.counts]
        return [
            Block(rotation, (x, y, z))
            for rotation in range(len(self.rotations))
            for x, y, z in itertools.product(*cuts)
        ]

    def coarse(self) -> "Grid":
        """The grid of the skeleton: the same corners, a few centimetres between targets."""
        spans = self.high - self.low
        counts = [
            max(2, min(count, int(np.ceil(span / SKELETON)) + 1))
            for span, count in zip(spans, self.counts, strict=True)
        ]
        return Grid(self.low, self.high, (counts[0], counts[1], counts[2]), self.rotations)

    def describe(self) -> dict[str, Any]:
        """Numbers and lists only, to be kept beside the table."""
        return {
            "low": self.low.tolist(),
            "high": self.high.tolist(),
            "counts": list(self.counts),
            "rotations": self.rotations.tolist(),
        }

    @classmethod
    def of(cls, content: dict[str, Any]) -> "Grid":
        """The grid that `describe` described."""
        x, y, z = content["counts"]
        return cls(np.array(content["low"]), np.array(content["high"]), (x, y, z), np.array(content["rotations"]))


TOLERANCE = 1e-9  # m and rad
NEWTON = 8  # steps; three are enough wherever the skeleton is smooth
PATIENCE, HOPEFUL = 4, 1e-2  # after so many steps a target that is further off, in m or rad, is given up
LONGEST_STEP = 0.4  # rad or m
BATCH = 4096  # targets at once: what the caches hold
APART = 1.5  # rad between corners of a cell of the skeleton that are not to be mixed


class Solved(NamedTuple):
    """A block's answer."""

    q: Array  # (x, y, z, n) [rad or m], nan where unreachable
    status: NDArray[np.uint8]  # (x, y, z), see Status


@dataclass(frozen=True)
class BlockSolver:
    """Everything a worker needs; small enough to be sent with every block.

    Attributes:
        chain: the arm.
        lower: position limits, (n,).
        upper: the same, (n,).
        grid: the targets.
        skeleton: postures on the coarse grid, (m, x, y, z, n), nan where there are none.
    """

    chain: Chain
    lower: Array
    upper: Array
    grid: Grid
    skeleton: Array

    def __call__(self, block: Block) -> Solved:
        """Postures of a block, each the nearest to the skeleton's at its position.

        The skeleton interpolated between its targets is a smooth guess; Newton's method with the smallest joint motion
        takes it onto the target. Both depend smoothly on the position, and so do the postures, across blocks too.
        """
        position = self.grid.positions(block).reshape(-1, 3)
        guess = self._guess(block.rotation, position)
        rotation = self.grid.rotations[block.rotation][:, :, None]
        q, reached = np.full_like(guess, np.nan), np.zeros(len(guess), dtype=bool)
        for start in range(0, len(guess), BATCH):
            part = np.arange(start, min(start + BATCH, len(guess)))
            part = part[~np.isnan(guess[part, 0])]
            if len(part):
                q[part], reached[part] = self._newton(rotation, np.ascontiguousarray(position[part].T), guess[part])
        q[~reached] = np.nan
        shape = tuple(stop - begin for begin, stop in block.ranges)
        status = np.where(reached, np.uint8(Status.REACHED), np.uint8(Status.UNREACHABLE))
        return Solved(q.reshape(*shape, -1), status.reshape(shape))

    def _newton(self, rotation: Array, position: Array, q: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Postures (k, n) and whether they hold their targets within the joint limits, (k,)."""
        final, reached = q.copy(), np.zeros(len(q), dtype=bool)
        active = np.arange(len(q))
        for step in range(NEWTON + 1):
            motion = self.chain.motion(q)
            error = motion.error(rotation, position)
            done = np.abs(error).max(axis=0) < TOLERANCE
            final[active[done]], reached[active[done]] = q[done], True
            going = ~done if step < PATIENCE else ~done & (np.abs(error).max(axis=0) < HOPEFUL)
            if not going.any() or step == NEWTON:
                break
            jacobian = self.chain.jacobian(motion).transpose(2, 0, 1)
            if not going.all():
                active, q, error, position = active[going], q[going], error[:, going], position[:, going]
                jacobian = jacobian[going]
            q = q + least_motion(jacobian, error.T, 1e-12, LONGEST_STEP)
            outside = (q < self.lower) | (q > self.upper)
            if outside.any():
                q = self._within(q, jacobian, outside)
        reached &= ((final >= self.lower - 1e-12) & (final <= self.upper + 1e-12)).all(axis=1)
        return final, reached

    def _within(self, q: Array, jacobian: Array, outside: NDArray[np.bool_]) -> Array:
        """Postures clipped to the limits, the lost motion given to the other joints."""
        rows = np.flatnonzero(outside.any(axis=1))
        clipped = np.clip(q[rows], self.lower, self.upper)
        lost = (jacobian[rows] @ (q[rows] - clipped)[:, :, None])[:, :, 0]
        open_joints = np.where(outside[rows][:, None, :], 0.0, jacobian[rows])
        more = least_motion(open_joints, lost, 1e-9, LONGEST_STEP)
        q = q.copy()
        q[rows] = np.clip(clipped + more, self.lower, self.upper)
        return q

    def _guess(self, rotation: int, position: Array) -> Array:
        """The skeleton between its targets, (k, n): trilinear; nan where none of a cell's corners is solved."""
        coarse = self.grid.coarse()
        counts = np.array(coarse.counts)
        place = (position - coarse.low) / (coarse.high - coarse.low) * (counts - 1)
        cell = np.clip(place.astype(int), 0, counts - 2)
        share = place - cell
        skeleton = self.skeleton[rotation]
        corners, weights = [], []
        for corner in np.ndindex(2, 2, 2):
            at = cell + corner
            corners.append(skeleton[at[:, 0], at[:, 1], at[:, 2]])
            weights.append(np.prod(np.where(corner, share, 1.0 - share), axis=1))
        postures, weight = np.array(corners), np.array(weights)[:, :, None]
        solved = ~np.isnan(postures)
        # Where corners are missing or on different branches, only those close to the heaviest solved one are used.
        heaviest = np.where(solved[:, :, 0], weight[:, :, 0], -1.0).argmax(axis=0)
        reference = postures[heaviest, np.arange(len(position))]
        with np.errstate(invalid="ignore"):
            together = solved & (np.abs(postures - reference).max(axis=2, keepdims=True) < APART)
        weight = np.where(together, weight + 1e-12, 0.0)
        total = weight.sum(axis=0)
        mixed = (np.where(together, postures, 0.0) * weight).sum(axis=0) / np.where(total > 0, total, np.nan)
        return np.asarray(mixed)
