"""What a feasibility check takes into account."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armdyn.errors import InputError
from pipeline.motion.feasibility.surroundings import Obstacle
from pipeline.motion.feasibility.torque import ExtraTorque
from pipeline.motion.trajectory import check_samples, read_only


@dataclass(frozen=True)
class CheckSettings:
    """What is known besides the motion, and how much room is asked for.

    Attributes:
        load_mass: hanging from the tool [kg].
        springs: count the springs of the robot's settings; None for those that the settings switch on.
        extra_torques: further torques on the joints, such as of a model's effects.
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
    extra_torques: tuple[ExtraTorque, ...] = ()
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

    time: NDArray[np.float64]
    angle: NDArray[np.float64]
    tension: NDArray[np.float64]
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
