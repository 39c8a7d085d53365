"""The grid of target poses of a volume, divided into blocks."""

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np

from armdyn.errors import InputError
from urdf.robot import Array, freeze_arrays

TARGETS_PER_BLOCK_EDGE = 25
"""Number of targets along each edge of a block: a second of computation, a megabyte on disk."""
MAX_GRID_COORDINATE = 100.0
"""Largest coordinate of a target [m]; no arm on a fixed base reaches further."""
MAX_VOLUME_TARGETS = 10**9
"""Largest number of targets; such a volume takes 60 GB and a day."""
SKELETON_TARGET_SPACING = (
    0.06  # m between the targets of the coarse grid; postures are nearly linear over this distance
)
"""Distance between the targets of the coarse grid [m]; postures are nearly linear over it."""

Block = tuple[int, int, int, int]
"""Index of an orientation, and indices of a block of its targets along x, y and z."""


class TargetStatus(IntEnum):
    """Result of the inverse kinematics of one target pose."""

    UNREACHABLE = 0  # no posture within the joint limits close to those of the neighbouring targets
    REACHED = 1
    COLLIDING = 2  # reached, but with a collision


@dataclass(frozen=True)
class TargetGrid:
    """Target poses of a tool: evenly spaced positions in the robot's base frame, each with every orientation.

    Attributes:
        low: lowest corner, (3,) [m].
        high: highest corner, (3,) [m].
        counts: number of targets along x, y and z, each at least 2.
        rotations: orientations of the tool, (m, 3, 3).
    """

    low: Array
    high: Array
    counts: tuple[int, int, int]
    rotations: Array

    def __post_init__(self) -> None:
        freeze_arrays(self, "low", "high", "rotations")
        if not (np.all(np.abs(self.low) <= MAX_GRID_COORDINATE) and np.all(np.abs(self.high) <= MAX_GRID_COORDINATE)):
            raise InputError(f"volume: a corner is farther than {MAX_GRID_COORDINATE:g} m from the robot; give metres")
        if self.low.shape != (3,) or self.high.shape != (3,) or not np.all(self.low < self.high):
            raise InputError(
                f"volume: the corners {self.low.tolist()} and {self.high.tolist()} enclose nothing: give low < high"
            )
        if len(self.counts) != 3 or min(self.counts) < 2:
            raise InputError(f"volume: {self.counts} targets along x, y, z; give at least 2 along each")
        if self.targets > MAX_VOLUME_TARGETS:
            raise InputError(
                f"volume: {self.counts} targets along x, y, z are too many; {MAX_VOLUME_TARGETS:.0e} is the most"
            )
        if self.rotations.ndim != 3 or self.rotations.shape[1:] != (3, 3) or not len(self.rotations):
            raise InputError(f"volume: orientations of shape {self.rotations.shape} should be (m, 3, 3)")

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Number of orientations, and number of targets along x, y and z."""
        return len(self.rotations), *self.counts

    @property
    def targets(self) -> int:
        """Number of targets, orientations included."""
        return math.prod(self.shape)

    @property
    def block_counts(self) -> tuple[int, int, int, int]:
        """Number of orientations, and number of blocks along x, y and z."""
        x, y, z = (-(-count // TARGETS_PER_BLOCK_EDGE) for count in self.counts)
        return len(self.rotations), x, y, z

    def indices(self, block: Block) -> tuple[int, slice, slice, slice]:
        """Index of a block's orientation, and slices of its targets along x, y and z, to index arrays of the grid."""
        rotation, *numbers = block
        x, y, z = (
            slice(TARGETS_PER_BLOCK_EDGE * number, min(TARGETS_PER_BLOCK_EDGE * (number + 1), count))
            for number, count in zip(numbers, self.counts, strict=True)
        )
        return rotation, x, y, z

    def positions(self, block: Block | None = None) -> Array:
        """Positions of the targets of a block, or by default of the whole grid, (x, y, z, 3) [m]."""
        bounds = zip(self.low, self.high, self.counts, strict=True)
        axes = [np.linspace(low, high, count) for low, high, count in bounds]
        if block is not None:
            axes = [axis[part] for axis, part in zip(axes, self.indices(block)[1:], strict=True)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)

    def coarse_grid(self) -> "TargetGrid":
        """A coarser grid with the corners of this one and a few centimetres between targets."""
        wanted = np.ceil((self.high - self.low) / SKELETON_TARGET_SPACING).astype(int) + 1
        x, y, z = (max(2, min(count, int(most))) for count, most in zip(self.counts, wanted, strict=True))
        return TargetGrid(self.low, self.high, (x, y, z), self.rotations)

    def describe(self) -> dict[str, Any]:
        """The grid as a dictionary of numbers and lists, from which `TargetGrid.from_description` restores it."""
        arrays = {name: getattr(self, name).tolist() for name in ("low", "high", "rotations")}
        return arrays | {"counts": list(self.counts)}

    @classmethod
    def from_description(cls, content: dict[str, Any]) -> "TargetGrid":
        """Make a grid from a dictionary that `describe` returned."""
        x, y, z = content["counts"]
        return cls(np.array(content["low"]), np.array(content["high"]), (x, y, z), np.array(content["rotations"]))
