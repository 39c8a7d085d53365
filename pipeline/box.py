"""The open box into which the swinging load is to be put."""

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
MIN_BOX_SIZES = {"near_wall": -math.inf, "rim": -math.inf, "friction": 0.0}
"""Smallest value of each field of `Box` that may be below 1 mm [m; friction has no unit]."""


class BoxPlate(NamedTuple):
    """A wall or the floor of a box, as a cuboid.

    Attributes:
        name: name of the wall, or "floor".
        centre: centre in the robot's base frame, (3,) [m].
        half: half the edge lengths along the gripper's line, across it and upwards, (3,) [m].
    """

    name: str
    centre: npt.NDArray[np.float64]
    half: npt.NDArray[np.float64]


@dataclass(frozen=True)
class Box:
    """An open box, placed relative to the line on which the upper end of the string moves.

    The paper gives no box; this one was chosen so that the simulation reproduces the paper's Table I.

    Attributes:
        near_wall: line coordinate of the middle of the near wall [m].
        width: distance between the middles of the near and the far wall, along the line [m].
        depth: distance between the middles of the other two walls [m].
        rim: distance of the rim below the line [m].
        height: height of the rim above the inner floor [m].
        wall: thickness of the walls and the floor [m].
        friction: coefficient of sliding friction between box and load.
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
            value, least = getattr(self, name), MIN_BOX_SIZES.get(name, 1e-3)
            if not (math.isfinite(value) and value >= least):
                raise InputError(f"Box.{name} is {value:g}: give a finite value of at least {least:g}")

    @property
    def middle(self) -> float:
        """Line coordinate of the middle of the box [m]."""
        return self.near_wall + self.width / 2

    def contains(self, along: float, across: float, above: float) -> bool:
        """Whether a point is inside the box, between the walls and below the rim.

        Args:
            along: line coordinate of the point [m].
            across: horizontal distance of the point from the line [m].
            above: height of the point above the line, negative below it [m].
        """
        inside = abs(along - self.middle) < self.width / 2 and abs(across) < self.depth / 2
        return inside and -self.rim - self.height < above < -self.rim

    def rim_middle(self, line: "Line") -> npt.NDArray[np.float64]:
        """Middle of the rim's opening, for a box under the given line, in the robot's base frame, (3,) [m]."""
        return line.position(self.middle) - np.array([0.0, 0.0, self.rim])

    def plates(self, line: "Line") -> tuple[BoxPlate, ...]:
        """The four walls and the floor of the box, placed under the given line."""
        w, d, h, half = self.width / 2, self.depth / 2, self.height / 2, self.wall / 2
        middle, axes = self.rim_middle(line), line.axes
        return tuple(
            BoxPlate(name, middle + axes @ offset, np.array(size))
            for name, offset, size in (
                ("near", (-w, 0.0, -h), (half, d + half, h)),
                ("far", (w, 0.0, -h), (half, d + half, h)),
                ("front", (0.0, -d, -h), (w + half, half, h)),
                ("back", (0.0, d, -h), (w + half, half, h)),
                ("floor", (0.0, 0.0, -(self.height + half)), (w + half, d + half, half)),
            )
        )
