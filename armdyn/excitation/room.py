"""How far, how fast and how strongly the joints may move, and which postures are free."""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

import urdf

TURN = 2.0 * np.pi
"""rad; a joint that turns further from its zero comes to the same postures again."""
KINEMATIC, STRENGTH = 0.97, 0.93
"""Shares of the limits of position, speed and acceleration, and of torque, that a motion uses: an arm does not follow
exactly, and its torques are not those of its description."""


class Postures(Protocol):
    """Which postures are free, of collisions for one."""

    def free(self, q: np.ndarray) -> bool:
        """Whether the posture (nj,) is allowed, without any distance asked for; quick."""
        ...

    def margins(self, q: np.ndarray) -> np.ndarray:
        """(k,) how far the posture (nj,) is from what is forbidden beyond what is asked for, about 1 for far."""
        ...


@dataclass(frozen=True, eq=False)
class Room:
    """Limits of a motion; all (nj,).

    Attributes:
        lower: rad or m.
        upper: rad or m.
        velocity: per s.
        acceleration: per s^2.
        effort: N m or N.
    """

    lower: np.ndarray
    upper: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    effort: np.ndarray

    @classmethod
    def of(cls, robot: urdf.Robot) -> "Room":
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

    def narrower(self, limit: str, joint: int, factor: float) -> "Room":
        """Less room for one joint in one respect, counted from the middle."""
        if limit == "position":
            half = self.half.copy()
            half[joint] *= factor
            return replace(self, lower=self.middle - half, upper=self.middle + half)
        name = {"velocity": "velocity", "acceleration": "acceleration", "torque": "effort"}[limit]
        values = np.array(getattr(self, name))
        values[joint] *= factor
        return replace(self, **{name: values})
