"""The ways to begin and to rest: into a stream of commands from where the arm is, and out of one that nobody leads."""

import numpy as np
from ruckig import ControlInterface, InputParameter, OutputParameter, Result, Ruckig

import urdf
from pipeline.robot.protocol import Vector
from pipeline.ros.gate import PERIOD

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


BRAKING = 0.5
"""Share of the joints' acceleration and jerk limits with which the arm brakes on its own."""


class Braking:
    """The way to rest of every joint by itself, with bounded acceleration and jerk, cycle by cycle."""

    def __init__(self, start: tuple[Vector, Vector, Vector], limits: urdf.Limits) -> None:
        n = len(start[0])
        self._otg, self._input, self._output = Ruckig(n, PERIOD), InputParameter(n), OutputParameter(n)
        given = self._input
        given.control_interface = ControlInterface.Velocity
        given.current_position, given.current_velocity, given.current_acceleration = (x.tolist() for x in start)
        given.target_velocity = given.target_acceleration = [0.0] * n
        # What is under way may accelerate more than the share with which it is braked.
        most = np.maximum(BRAKING * limits.acceleration, np.abs(start[2]))
        given.max_acceleration, given.max_jerk = most.tolist(), (BRAKING * limits.jerk).tolist()
        given.max_velocity = limits.velocity.tolist()
        self.done = False

    def next(self) -> tuple[Vector, Vector, Vector]:
        """Posture, velocity and acceleration one cycle on (n,)."""
        result = self._otg.update(self._input, self._output)
        self.done = result != Result.Working
        self._output.pass_to_input(self._input)
        out = self._output
        q, v, a = (np.array(x) for x in (out.new_position, out.new_velocity, out.new_acceleration))
        return (q, np.zeros_like(v), np.zeros_like(a)) if self.done else (q, v, a)
