"""Which targets a volume has, and how it is cut into blocks."""

import itertools
import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from armdyn.errors import InputError
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
