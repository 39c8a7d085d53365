"""The way to rest of an arm that nobody leads any more: every joint by itself, within its limits."""

import numpy as np
from ruckig import ControlInterface, InputParameter, OutputParameter, Result, Ruckig

import urdf
from pipeline.robot.protocol import Vector
from pipeline.ros.gate import PERIOD

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
