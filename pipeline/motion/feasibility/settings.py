"""What a feasibility check takes into account: obstacles, the load's swing, and the least distances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import urdf
from armdyn.errors import InputError
from pipeline.box import Box
from pipeline.motion.trajectory import check_samples
from urdf.robot import Array, read_only

TABLE = (1.6, 0.7, 0.04)
"""Length, depth and thickness of the table top under the box [m]."""


@dataclass(frozen=True)
class Obstacle:
    """A block that stands still.

    Attributes:
        name: for messages.
        centre: (3,) in the robot's base frame [m].
        size: edge lengths (3,) [m].
        rotation: of the block in the base frame (3, 3).
    """

    name: str
    centre: Array
    size: Array
    rotation: Array


def box_and_table(line: urdf.Line, box: Box) -> tuple[Obstacle, ...]:
    """An open box on a table, under the line: four walls, the floor and the table top."""
    along, up = np.asarray(line.direction, dtype=float), np.array([0.0, 0.0, 1.0])
    axes = np.column_stack([along, np.cross(up, along), up])
    middle = np.asarray(line.origin) + box.middle * along - box.rim * up
    top = np.array([0.0, 0.0, -box.height - box.wall - TABLE[2] / 2.0])
    return (
        *(
            Obstacle(
                "box floor" if plate.name == "floor" else f"box {plate.name} wall",
                middle + axes @ plate.offset,
                2.0 * plate.half,
                axes,
            )
            for plate in box.plates()
        ),
        Obstacle("table", middle + axes @ top, np.array(TABLE), axes),
    )


@dataclass(frozen=True)
class CheckSettings:
    """What is taken into account besides the motion, and the least distances.

    Attributes:
        load_mass: hanging from the tool [kg].
        springs: count the springs of the robot's settings; None for those that the settings switch on.
        obstacles: blocks around the arm.
        collision: look at collisions at all.
        clearance: distance asked for between the arm and itself or an obstacle [m].
        swing_clearance: distance asked for between load or string and the arm [m].
        singular_value: smallest singular value of the tool's Jacobian; below it, joints race for a slow tool.
        off_line: farthest that the tool point may be from the line [m].
        tilt: farthest that the tool may be turned from the line's orientation [rad].
        start: farthest that a joint may be, at the start, from where the arm is [rad].
    """

    load_mass: float = 0.0
    springs: bool | None = None
    obstacles: tuple[Obstacle, ...] = ()
    collision: bool = True
    clearance: float = 0.01
    swing_clearance: float = 0.02
    singular_value: float = 0.01
    off_line: float = 1e-4
    tilt: float = 1e-3
    start: float = 0.02


@dataclass(frozen=True)
class Swing:
    """The load's swing that belongs to a motion along the line.

    Attributes:
        time: (n,) on the clock of the motion [s].
        angle: of the string, 0 hanging; the load is at ``gripper_x - l sin(angle)`` (n,) [rad].
        tension: of the string (n,) [N].
        length: of the string, to the load's centre [m].
        radius: of the load [m].
        least_tension: below it the string counts as slack [N].

    Raises:
        InputError: if the arrays do not fit together, or length or radius is not positive.
    """

    time: Array
    angle: Array
    tension: Array
    length: float
    radius: float = 0.014
    least_tension: float = 0.0

    def __post_init__(self) -> None:
        for name in ("time", "angle", "tension"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        if self.time.ndim != 1 or not self.time.shape == self.angle.shape == self.tension.shape:
            raise InputError("swing: time, angle and tension must be one-dimensional and equally long")
        check_samples(self.time, {"angle": self.angle, "tension": self.tension})
        if not (np.isfinite(self.length) and self.length > 0.0 and np.isfinite(self.radius) and self.radius > 0.0):
            raise InputError(f"swing: length {self.length} m and radius {self.radius} m must be greater than 0")
