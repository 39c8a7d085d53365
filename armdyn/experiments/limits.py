"""Limits of a designed motion: position, speed, acceleration and effort of joints or of a gripper."""

from dataclasses import dataclass, replace

import numpy as np

import urdf
from armdyn.errors import InputError
from armdyn.experiments.series import AxisMotion

FULL_TURN = 2.0 * np.pi
"""A full turn, rad: the farthest that a designed motion turns a joint from its zero."""
USED_KINEMATIC_LIMIT_SHARE, USED_TORQUE_LIMIT_SHARE = 0.97, 0.93
"""Shares of the limits of position, speed and acceleration, and of torque, that an arm's motion uses: an arm does not
follow its command exactly, and its torques are not exactly those of its description."""


def two_sided_excess(share: np.ndarray) -> np.ndarray:
    """(2, ...) excess of values, as shares of a limit, above 1 and below -1; negative within the limit."""
    return np.stack([share - 1.0, -share - 1.0])


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """Limits of every axis of a motion; all arrays are (axes,).

    Attributes:
        lower: lowest position, rad or m.
        upper: highest position, rad or m.
        velocity: largest speed, rad/s or m/s.
        acceleration: largest acceleration, rad/s^2 or m/s^2.
        effort: largest torque or force, N m or N; infinite where it is not limited.
    """

    lower: np.ndarray
    upper: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    effort: np.ndarray

    @classmethod
    def of_robot(cls, robot: urdf.Robot) -> "MotionLimits":
        """The limits of a designed motion of a robot: shares of the robot's own limits."""
        limits = robot.limits
        lower, upper = np.maximum(limits.lower, -FULL_TURN), np.minimum(limits.upper, FULL_TURN)
        middle, reach = (lower + upper) / 2.0, USED_KINEMATIC_LIMIT_SHARE * (upper - lower) / 2.0
        velocity, acceleration = (
            USED_KINEMATIC_LIMIT_SHARE * np.asarray(x) for x in (limits.velocity, limits.acceleration)
        )
        effort = USED_TORQUE_LIMIT_SHARE * np.asarray(limits.effort)
        return cls(middle - reach, middle + reach, velocity, acceleration, effort)

    @property
    def middle(self) -> np.ndarray:
        """Middle of the range of positions, rad or m."""
        return np.asarray((self.lower + self.upper) / 2.0)

    @property
    def half_range(self) -> np.ndarray:
        """Half the range of the positions, rad or m."""
        return np.asarray((self.upper - self.lower) / 2.0)

    @property
    def full_scale(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(axes,) largest distance from the middle of the range, largest velocity and largest acceleration."""
        return self.half_range, self.velocity, self.acceleration

    def excess(self, motion: AxisMotion) -> list[np.ndarray]:
        """(2, n, axes) excess of position, velocity and acceleration over their limits, as shares; negative within."""
        away = (motion.q - self.middle, motion.v, motion.a)
        return [two_sided_excess(part / size) for part, size in zip(away, self.full_scale, strict=True)]

    def reduced(self, limit: str, joint: int, factor: float) -> "MotionLimits":
        """Reduce one limit of one joint by a factor; positions are reduced towards the middle."""
        if limit == "position":
            half = self.half_range.copy()
            half[joint] *= factor
            return replace(self, lower=self.middle - half, upper=self.middle + half)
        name = "effort" if limit == "torque" else limit
        values = np.array(getattr(self, name))
        values[joint] *= factor
        return replace(self, **{name: values})


@dataclass(frozen=True)
class GripperLimits:
    """Limits of a gripper's motion with a load on a string.

    Attributes:
        travel: largest distance of the gripper from its start, m.
        speed: largest speed of the gripper, m/s.
        acceleration: largest acceleration of the gripper, m/s^2.
        swing: largest angle of the load, rad.

    Raises:
        InputError: a limit is not positive.
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
        """The limits of the gripper along its line, as limits of one axis."""
        travel, speed, acceleration = (np.array([x]) for x in (self.travel, self.speed, self.acceleration))
        return MotionLimits(-travel, travel, speed, acceleration, np.array([np.inf]))
