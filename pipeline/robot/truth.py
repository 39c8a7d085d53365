"""True values and motion of the plant, which only the simulation knows: for reports and pictures."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pipeline.robot.protocol import Vector


@dataclass(frozen=True)
class PlantTruth:
    """True values that were drawn or hidden in the plant; the controller never sees them.

    Attributes:
        mass: true mass of the load [kg].
        bias: zero error of the load cell [N].
        latency: latency of the load cell [s].
        link_scale: factor on mass and inertia of the link behind each joint (n,).
        length: from the string's upper end to the load's centre, hanging at rest [m].
        string_length: length of the unstretched string to the load's centre [m].
        hidden: value of every present effect.
    """

    mass: float
    bias: float
    latency: float
    link_scale: Vector
    length: float
    string_length: float
    hidden: Mapping[str, float]


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
