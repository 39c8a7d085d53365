"""Time-optimal motions of one coordinate by ruckig: to a state, and to rest.

Ruckig sends intermediate waypoints to a cloud service. They are never set here, and only this file talks to ruckig.
"""

from __future__ import annotations

import ruckig

from pipeline.motion.profile import JerkProfile
from pipeline.motion.state import LineState

ROUNDING = 1e-9
"""Time within which a motion is on time [s]."""


class LinePlanner:
    """Ruckig on the line coordinate, with its input and output kept between calls.

    Source: Berscheid and Kröger, "Jerk-limited Real-time Trajectory Generation with Arbitrary Target States", RSS 2021.

    Args:
        jerk: largest jerk [m/s^3].
    """

    def __init__(self, jerk: float) -> None:
        self._ruckig = ruckig.Ruckig(1)
        self._trajectory = ruckig.Trajectory(1)
        self._to_state = ruckig.InputParameter(1)
        self._to_rest = ruckig.InputParameter(1)
        self._to_rest.control_interface = ruckig.ControlInterface.Velocity
        for parameters in (self._to_state, self._to_rest):
            parameters.max_jerk = [jerk]

    def to_state(
        self,
        start: LineState,
        target: LineState,
        speed: float,
        acceleration: float,
        duration: float | None = None,
    ) -> JerkProfile | None:
        """Fastest motion between two moving states, or one that takes a given time.

        Args:
            start: present state, finite.
            target: wanted state, finite.
            speed: largest speed [m/s].
            acceleration: largest acceleration [m/s^2].
            duration: time to take, to arrive on a sample [s].

        Returns:
            The motion, or None where ruckig finds none: the time is too short, or a target is beyond the limits.
        """
        p = self._to_state
        p.current_position, p.current_velocity, p.current_acceleration = [start.s], [start.v], [start.a]
        p.target_position, p.target_velocity, p.target_acceleration = [target.s], [target.v], [target.a]
        p.max_velocity, p.max_acceleration = [speed], [acceleration]
        p.minimum_duration = duration
        return self._calculate(p, start, duration)

    def to_rest(self, start: LineState, acceleration: float) -> JerkProfile | None:
        """Fastest motion to rest, wherever that is.

        Args:
            start: present state, finite.
            acceleration: largest acceleration [m/s^2].
        """
        p = self._to_rest
        p.current_position, p.current_velocity, p.current_acceleration = [start.s], [start.v], [start.a]
        p.max_acceleration = [acceleration]
        return self._calculate(p, start)

    def _calculate(
        self, parameters: ruckig.InputParameter, start: LineState, duration: float | None = None
    ) -> JerkProfile | None:
        try:
            result = self._ruckig.calculate(parameters, self._trajectory)
        except ruckig.RuckigError:
            return None
        if result not in (ruckig.Result.Working, ruckig.Result.Finished):
            return None
        if duration is not None and self._trajectory.duration > duration + ROUNDING:
            return None
        profile = self._trajectory.profiles[0][0]
        brake = profile.brake
        return JerkProfile(start, [*brake.t, *profile.t], [*brake.j, *profile.j])
