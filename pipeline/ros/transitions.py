"""The way into a stream of commands from where the arm is."""

import numpy as np

from pipeline.motion.gate import PERIOD
from pipeline.robot.protocol import Vector

FARTHEST = 0.02
"""How far from where the arm is a stream may begin [rad]: an arm at rest sags under its weight by less than that."""
DURATION = 0.5
"""Time in which the difference goes [s]; its peaks are 0.08 rad/s, 0.5 rad/s^2, 10 rad/s^3."""


class Blend:
    """Adds to a stream of commands what makes it begin where the arm is; the addition fades without jerk.

    Args:
        here: where the arm is (n,) [rad].
        told: the first command (n,) [rad]. What is farther off than `FARTHEST` stays off, for the gate to refuse.
    """

    def __init__(self, here: Vector, told: Vector) -> None:
        self._offset = np.clip(here - told, -FARTHEST, FARTHEST)
        self._cycle = 0

    def next(self, q: Vector, v: Vector, a: Vector) -> tuple[Vector, Vector, Vector]:
        """The next command (n,) each [rad, rad/s, rad/s^2]."""
        u = min(self._cycle * PERIOD / DURATION, 1.0)
        self._cycle += 1
        if u == 1.0:
            return q, v, a
        share = 1.0 - u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
        speed = -30.0 * u**2 * (1.0 - u) ** 2 / DURATION
        acceleration = -60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / DURATION**2
        return q + share * self._offset, v + speed * self._offset, a + acceleration * self._offset
