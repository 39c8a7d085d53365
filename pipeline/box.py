"""The open box that the load shall come to rest in."""

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from armdyn.errors import InputError

if TYPE_CHECKING:
    from urdf import Line

LOAD_RADIUS = 0.014
"""Radius of the paper's load [m], a ball."""
SMALLEST_BOX_SIZES = {"near_wall": -math.inf, "rim": -math.inf, "friction": 0.0}
"""Smallest value of what may be less than a millimetre."""


class Plate(NamedTuple):
    """A wall or the floor of a box.

    Attributes:
        name: which.
        centre: in the robot's base frame (3,) [m].
        half: half of its edge lengths, along the line, across it and up (3,) [m].
    """

    name: str
    centre: npt.NDArray[np.float64]
    half: npt.NDArray[np.float64]


@dataclass(frozen=True)
class Box:
    """An open box, placed relative to the line that the string's upper end moves on.

    The paper gives no box; this one was chosen so that the paper's Table I comes out of the simulation.

    Attributes:
        near_wall: line coordinate of the middle of its near wall [m].
        width: between the middles of the near and the far wall, along the line [m].
        depth: between the middles of the other two walls [m].
        rim: how far its rim is below the line [m].
        height: from the inner floor to the rim [m].
        wall: thickness of walls and floor [m].
        friction: sliding friction coefficient against the load.
    """

    near_wall: float = 0.355
    width: float = 0.30
    depth: float = 0.24
    rim: float = 0.285
    height: float = 0.095
    wall: float = 0.004
    friction: float = 0.6

    def __post_init__(self) -> None:
        for name in (item.name for item in fields(self)):
            value, least = getattr(self, name), SMALLEST_BOX_SIZES.get(name, 1e-3)
            if not (math.isfinite(value) and value >= least):
                raise InputError(f"Box.{name} is {value:g}: give a finite value of at least {least:g}")

    @property
    def middle(self) -> float:
        """Line coordinate of its middle [m]."""
        return self.near_wall + self.width / 2

    def contains(self, along: float, across: float, above: float) -> bool:
        """Whether a point is between the walls and below the rim.

        Args:
            along: line coordinate [m].
            across: distance from the vertical plane of the line [m].
            above: height over the line, negative below it [m].
        """
        inside = abs(along - self.middle) < self.width / 2 and abs(across) < self.depth / 2
        return inside and -self.rim - self.height < above < -self.rim

    def rim_middle(self, line: "Line") -> npt.NDArray[np.float64]:
        """Middle of the rim under a line, in the robot's base frame (3,) [m]."""
        return line.position(self.middle) - np.array([0.0, 0.0, self.rim])

    def plates(self, line: "Line") -> tuple[Plate, ...]:
        """Four walls and the floor under a line."""
        w, d, h, half = self.width / 2, self.depth / 2, self.height / 2, self.wall / 2
        middle, axes = self.rim_middle(line), line.axes
        return tuple(
            Plate(name, middle + axes @ offset, np.array(size))
            for name, offset, size in (
                ("near", (-w, 0.0, -h), (half, d + half, h)),
                ("far", (w, 0.0, -h), (half, d + half, h)),
                ("front", (0.0, -d, -h), (w + half, half, h)),
                ("back", (0.0, d, -h), (w + half, half, h)),
                ("floor", (0.0, 0.0, -(self.height + half)), (w + half, d + half, half)),
            )
        )
