"""Transitions: blending into a stream, motion from rest to rest, and braking of joints without commands."""

import numpy as np
from ruckig import ControlInterface, InputParameter, Result, Ruckig, Trajectory

import urdf
from pipeline.motion.gate import PERIOD
from urdf.robot import Array

BRAKING_SHARE = 0.5
"""Of the joints' acceleration and jerk limits with which an arm brakes on its own."""
MAX_START_OFFSET = 0.02
"""How far from where the arm is a stream may begin [rad]: an arm at rest sags under its weight by less than that."""
BLEND_SECONDS = 0.5
"""Time in which the difference goes [s]; its peaks are 0.08 rad/s, 0.5 rad/s^2, 10 rad/s^3."""


class Brake:
    """Braking motion: each joint comes to rest as fast as a share of its acceleration and jerk limits allows.

    It begins at positions, velocities and accelerations (n,) [rad, rad/s, rad/s^2].

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
        given.max_acceleration = np.maximum(BRAKING_SHARE * limits.acceleration, np.abs(a)).tolist()
        given.max_jerk = (BRAKING_SHARE * limits.jerk).tolist()
        given.max_velocity = limits.velocity.tolist()
        if Ruckig(n).calculate(given, self._way) in (Result.Working, Result.Finished):
            self.duration = float(self._way.duration)
            self._rest = np.array(self._way.at_time(self.duration)[0])

    def at(self, time: float) -> tuple[Array, Array, Array]:
        """Positions, velocities and accelerations (n,) at a time after braking began [s]."""
        if time >= self.duration:
            return self._rest, np.zeros_like(self._rest), np.zeros_like(self._rest)
        q, v, a = (np.array(x) for x in self._way.at_time(max(time, 0.0)))
        return q, v, a


def minimum_jerk(u: Array, duration: float) -> tuple[Array, Array, Array]:
    """Motion from rest to rest with the least jerk (Flash & Hogan, J. Neuroscience 5, 1985).

    Returns:
        At elapsed shares `u` of the duration [s]: covered share of the distance, its rate [1/s], acceleration [1/s^2].
    """
    share = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    speed = 30.0 * u**2 * (1.0 - u) ** 2 / duration
    acceleration = 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / duration**2
    return share, speed, acceleration


class Blend:
    """Adds an offset to a stream of commands so that it begins at the arm's position; the offset fades smoothly.

    An offset above `MAX_START_OFFSET` between the present position and the first command, (n,) [rad] each, is not
    bridged; the gate refuses it.
    """

    def __init__(self, here: Array, told: Array) -> None:
        self._offset = np.clip(here - told, -MAX_START_OFFSET, MAX_START_OFFSET)
        self._cycle = 0

    def next(self, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
        """The next command with its offset: positions, velocities, accelerations (n,) each [rad, rad/s, rad/s^2]."""
        u = min(self._cycle * PERIOD / BLEND_SECONDS, 1.0)
        self._cycle += 1
        if u == 1.0:
            return q, v, a
        share, speed, acceleration = minimum_jerk(np.asarray(u), BLEND_SECONDS)
        return q + (1.0 - share) * self._offset, v - speed * self._offset, a - acceleration * self._offset
