"""The true motion of gripper, load and arm, which only the simulation knows: for reports and pictures."""

from dataclasses import dataclass

import numpy as np

from pipeline.robot.protocol import Vector


@dataclass(frozen=True)
class History:
    """The true motion, sampled at a fixed period.

    Attributes:
        time: (k,) [s].
        q: joint positions (k, n) [rad].
        pivot: the string's upper end in the base frame (k, 3) [m].
        load: the load's centre in the base frame (k, 3) [m].
        tension: tension of the string (k,) [N].
    """

    time: Vector
    q: Vector
    pivot: Vector
    load: Vector
    tension: Vector

    def from_time(self, time: float) -> "History":
        """The part of the motion from `time` [s] on."""
        kept = self.time >= time
        return History(self.time[kept], self.q[kept], self.pivot[kept], self.load[kept], self.tension[kept])


def swing_angle(string: Vector, along: Vector) -> float:
    """Angle of the string (3,), from pivot to load, from the vertical in the plane of line and vertical [rad]."""
    return float(np.arctan2(-(string @ along), -string[2]))
