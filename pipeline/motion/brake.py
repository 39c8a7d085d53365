"""The brake: the way to rest of joints that nobody leads any more, on a real arm and on a simulated one."""

import numpy as np
from ruckig import ControlInterface, InputParameter, Result, Ruckig, Trajectory

import urdf
from urdf.robot import Array

SHARE = 0.5
"""Of the joints' acceleration and jerk limits with which an arm brakes on its own."""


class Brake:
    """Every joint comes to rest by itself, as soon as a share of its acceleration and jerk limits allows.

    Args:
        start: positions, velocities and accelerations (n,) from which it brakes [rad, rad/s, rad/s^2].
        limits: of the joints.

    Attributes:
        duration: until the last joint stands [s].
    """

    def __init__(self, start: tuple[Array, Array, Array], limits: urdf.Limits) -> None:
        self._rest, v, a = start
        n = len(v)
        self.duration, self._way = 0.0, Trajectory(n)
        if not (np.any(v) or np.any(a)):
            return
        given = InputParameter(n)
        given.control_interface = ControlInterface.Velocity
        given.current_position, given.current_velocity, given.current_acceleration = (x.tolist() for x in start)
        given.target_velocity = given.target_acceleration = [0.0] * n
        # What is under way may accelerate more than the share with which it is braked.
        given.max_acceleration = np.maximum(SHARE * limits.acceleration, np.abs(a)).tolist()
        given.max_jerk = (SHARE * limits.jerk).tolist()
        given.max_velocity = limits.velocity.tolist()
        if Ruckig(n).calculate(given, self._way) in (Result.Working, Result.Finished):
            self.duration = float(self._way.duration)
            self._rest = np.array(self._way.at_time(self.duration)[0])

    def at(self, time: float) -> tuple[Array, Array, Array]:
        """Positions, velocities and accelerations (n,) so long after braking began [s]."""
        if time >= self.duration:
            return self._rest, np.zeros_like(self._rest), np.zeros_like(self._rest)
        q, v, a = (np.array(x) for x in self._way.at_time(max(time, 0.0)))
        return q, v, a
