"""Transitions of a robot's joints: smooth start of a stream of commands, motion from rest to rest, and braking."""

import numpy as np
from ruckig import ControlInterface, InputParameter, Result, Ruckig, Trajectory

import urdf
from pipeline.motion.gate import CONTROL_PERIOD_SECONDS
from urdf.robot import Array

BRAKING_SHARE_OF_JOINT_LIMITS = 0.5
"""Share of the joints' acceleration and jerk limits with which an arm brakes by itself."""
MAX_BRIDGED_COMMAND_OFFSET = 0.02
"""Largest distance of a stream's first command from the arm's position that is bridged smoothly [rad]."""
START_OFFSET_DECAY_SECONDS = 0.5
"""Time in which the distance of a stream's first command from the arm's position decays to zero [s]; peaks are 0.08
rad/s, 0.5 rad/s^2 and 10 rad/s^3."""


class BrakingMotion:
    """Motion of joints to rest, with the share `BRAKING_SHARE_OF_JOINT_LIMITS` of their acceleration and jerk limits.

    Args:
        start: positions [rad], velocities [rad/s] and accelerations [rad/s^2] at the begin, (n,) each.
        limits: limits of the joints.

    Attributes:
        duration: time until the last joint is at rest [s].
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
        # A motion may have a larger acceleration than the share with which it is braked.
        given.max_acceleration = np.maximum(BRAKING_SHARE_OF_JOINT_LIMITS * limits.acceleration, np.abs(a)).tolist()
        given.max_jerk = (BRAKING_SHARE_OF_JOINT_LIMITS * limits.jerk).tolist()
        given.max_velocity = limits.velocity.tolist()
        if Ruckig(n).calculate(given, self._way) in (Result.Working, Result.Finished):
            self.duration = float(self._way.duration)
            self._rest = np.array(self._way.at_time(self.duration)[0])

    def state_at(self, time: float) -> tuple[Array, Array, Array]:
        """Positions, velocities and accelerations, (n,) each, at a time since the begin of braking [s]."""
        if time >= self.duration:
            return self._rest, np.zeros_like(self._rest), np.zeros_like(self._rest)
        q, v, a = (np.array(x) for x in self._way.at_time(max(time, 0.0)))
        return q, v, a


def minimum_jerk(u: Array, duration: float) -> tuple[Array, Array, Array]:
    """Minimum-jerk motion from rest to rest over a unit distance (Flash & Hogan, J. Neuroscience 5, 1985).

    Args:
        u: elapsed time as a share of the duration, from 0 to 1, any shape.
        duration: duration of the motion [s].

    Returns:
        Position as a share of the distance, velocity [1/s] and acceleration [1/s^2], with the shape of u.
    """
    share = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    speed = 30.0 * u**2 * (1.0 - u) ** 2 / duration
    acceleration = 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / duration**2
    return share, speed, acceleration


class DecayingStartOffset:
    """Adds a decaying offset to a stream of commands, so that the stream begins at the arm's measured position.

    An offset above `MAX_BRIDGED_COMMAND_OFFSET` is cut to this value; the gate then refuses the command.

    Args:
        here: measured position, (n,) [rad].
        first_command: position of the first command, (n,) [rad].
    """

    def __init__(self, here: Array, first_command: Array) -> None:
        self._offset = np.clip(here - first_command, -MAX_BRIDGED_COMMAND_OFFSET, MAX_BRIDGED_COMMAND_OFFSET)
        self._cycle = 0

    def next_command(self, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
        """Add the offset to the next command: positions, velocities and accelerations (n,) [rad, rad/s, rad/s^2]."""
        u = min(self._cycle * CONTROL_PERIOD_SECONDS / START_OFFSET_DECAY_SECONDS, 1.0)
        self._cycle += 1
        if u == 1.0:
            return q, v, a
        share, speed, acceleration = minimum_jerk(np.asarray(u), START_OFFSET_DECAY_SECONDS)
        return q + (1.0 - share) * self._offset, v - speed * self._offset, a - acceleration * self._offset
