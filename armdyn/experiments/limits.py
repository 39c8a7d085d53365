"""How far, how fast and how strongly joints or a gripper may move."""

from dataclasses import dataclass, replace

import numpy as np

import urdf
from armdyn.errors import InputError
from armdyn.experiments.series import AxisMotion

TURN = 2.0 * np.pi
"""rad; a joint that turns further from its zero comes to the same postures again."""
KINEMATIC, STRENGTH = 0.97, 0.93
"""Shares of the limits of position, speed and acceleration, and of torque, that an arm's motion uses: an arm does not
follow exactly, and its torques are not those of its description."""


def two_sided(share: np.ndarray) -> np.ndarray:
    """(2, ...) by how much shares of a limit are beyond 1, and beyond -1; negative inside."""
    return np.stack([share - 1.0, -share - 1.0])


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """Limits of every axis of a motion; all (axes,).

    Attributes:
        lower: rad or m.
        upper: rad or m.
        velocity: per s.
        acceleration: per s^2.
        effort: N m or N; infinite where no effort is watched.
    """

    lower: np.ndarray
    upper: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    effort: np.ndarray

    @classmethod
    def of(cls, robot: urdf.Robot) -> "MotionLimits":
        """The shares of a robot's limits that a motion uses."""
        limits = robot.limits
        lower, upper = np.maximum(limits.lower, -TURN), np.minimum(limits.upper, TURN)
        middle, half = (lower + upper) / 2.0, (upper - lower) / 2.0
        return cls(
            middle - KINEMATIC * half,
            middle + KINEMATIC * half,
            KINEMATIC * np.asarray(limits.velocity),
            KINEMATIC * np.asarray(limits.acceleration),
            STRENGTH * np.asarray(limits.effort),
        )

    @property
    def middle(self) -> np.ndarray:
        """Of the positions, rad or m."""
        return np.asarray((self.lower + self.upper) / 2.0)

    @property
    def half(self) -> np.ndarray:
        """Half the range of the positions, rad or m."""
        return np.asarray((self.upper - self.lower) / 2.0)

    @property
    def sizes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(axes,) position from the middle, velocity and acceleration that count as 1."""
        return self.half, self.velocity, self.acceleration

    def beyond(self, motion: AxisMotion) -> list[np.ndarray]:
        """(2, n, axes) by which share position, velocity and acceleration are beyond their limits; negative inside."""
        away = (motion.q - self.middle, motion.v, motion.a)
        return [two_sided(part / size) for part, size in zip(away, self.sizes, strict=True)]

    def narrower(self, limit: str, joint: int, factor: float) -> "MotionLimits":
        """Less room for one joint in one respect, counted from the middle."""
        if limit == "position":
            half = self.half.copy()
            half[joint] *= factor
            return replace(self, lower=self.middle - half, upper=self.middle + half)
        name = {"velocity": "velocity", "acceleration": "acceleration", "torque": "effort"}[limit]
        values = np.array(getattr(self, name))
        values[joint] *= factor
        return replace(self, **{name: values})


@dataclass(frozen=True)
class GripperLimits:
    """What a motion of a gripper with a load on a string may need.

    Attributes:
        travel: largest distance of the gripper from its start, m.
        speed: of the gripper, m/s.
        acceleration: of the gripper, m/s^2.
        swing: largest angle of the load, rad.

    Raises:
        InputError: one is not positive.
    """

    travel: float = 0.15
    speed: float = 0.9
    acceleration: float = 2.0
    swing: float = 1.0

    def __post_init__(self) -> None:
        for name in ("travel", "speed", "acceleration", "swing"):
            if not getattr(self, name) > 0.0:
                raise InputError(f"limit of the {name} {getattr(self, name):g}: give a positive number")

    @property
    def along(self) -> MotionLimits:
        """Those of the one axis along the line."""
        travel, speed, acceleration = (np.array([x]) for x in (self.travel, self.speed, self.acceleration))
        return MotionLimits(-travel, travel, speed, acceleration, np.array([np.inf]))
