"""True values and true motion of a simulated robot, for reports and pictures."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pipeline.robot.protocol import Vector


@dataclass(frozen=True)
class TruePlantParameters:
    """Random and hidden true values of a simulated robot, which its controller and its models do not know.

    Attributes:
        mass: true mass of the load [kg].
        bias: zero error of the load cell [N].
        latency: latency of the load cell [s].
        link_scale: factor on mass and inertia of the link behind each joint (n,).
        length: distance from the string's upper end to the load's centre, hanging at rest [m].
        string_length: length of the unstretched string to the load's centre [m].
        hidden: size of every present hidden effect.
    """

    mass: float
    bias: float
    latency: float
    link_scale: Vector
    length: float
    string_length: float
    hidden: Mapping[str, float]


@dataclass(frozen=True)
class TrueMotion:
    """True motion of a simulated robot, sampled at a fixed period.

    Attributes:
        time: times of the samples (k,) [s].
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

    def from_time(self, time: float) -> "TrueMotion":
        """The part of the motion from `time` [s] on."""
        kept = self.time >= time
        return TrueMotion(self.time[kept], self.q[kept], self.pivot[kept], self.load[kept], self.tension[kept])


def swing_angle(string: Vector, along: Vector) -> float:
    """Swing angle: angle of the string from the vertical, in the plane of the gripper's line and the vertical [rad].

    Args:
        string: vector from the string's upper end to the load (3,).
        along: direction of the line (3,).
    """
    return float(np.arctan2(-(string @ along), -string[2]))
