"""Plan motions along the line with the library Ruckig, and find states from which the tool can stop."""

import math

import ruckig

from pipeline.motion.limits import LineLimits
from pipeline.motion.profile import JerkProfile
from pipeline.motion.trajectory import LineState

ARRIVAL_TOLERANCE_SECONDS = 1e-9
"""Tolerance of the time at which a planned motion arrives [s]."""


class LinePlanner:
    """Plans motions with bounded jerk along the line, by Ruckig.

    Source: Berscheid and Kröger, "Jerk-limited Real-time Trajectory Generation with Arbitrary Target States", RSS 2021.

    Attributes:
        limits: limits along the line.
    """

    def __init__(self, limits: LineLimits) -> None:
        self.limits = limits
        self._ruckig = ruckig.Ruckig(1)
        self._trajectory = ruckig.Trajectory(1)
        self._to_state = ruckig.InputParameter(1)
        self._to_rest = ruckig.InputParameter(1)
        self._to_rest.control_interface = ruckig.ControlInterface.Velocity
        for parameters in (self._to_state, self._to_rest):
            parameters.max_jerk = [limits.jerk]

    def plan_motion_to_state(
        self,
        start: LineState,
        target: LineState,
        *,
        speed: float | None = None,
        acceleration: float | None = None,
        duration: float | None = None,
    ) -> JerkProfile | None:
        """Plan the fastest motion between two moving states, or one of a given duration, with constant limits.

        The motion may exceed limits that depend on the position.

        Args:
            start: present state, finite.
            target: target state, finite.
            speed: largest speed [m/s]; by default the largest speed limit of the line.
            acceleration: largest acceleration [m/s^2]; by default the largest acceleration limit of the line.
            duration: duration of the motion [s]; by default the shortest one.

        Returns:
            The motion; None if the duration is too short, or the target is beyond the limits.
        """
        p = self._to_state
        p.target_position, p.target_velocity, p.target_acceleration = [target.s], [target.v], [target.a]
        p.max_velocity = [self.limits.max_speed_limit if speed is None else speed]
        p.max_acceleration = [self.limits.max_acceleration_limit if acceleration is None else acceleration]
        p.minimum_duration = duration
        return self._calculate(p, start, math.inf if duration is None else duration + ARRIVAL_TOLERANCE_SECONDS)

    def stop(self, state: LineState) -> JerkProfile | None:
        """Plan the motion from a state to rest, within the limits on the way; None if this is impossible."""
        limits = self.limits
        # Bounds of the speed (the acceleration is reduced to 0 first) and of the way to rest.
        fastest = abs(state.v) + state.a**2 / (2.0 * limits.jerk)
        if not state.is_finite or fastest > 10.0 * limits.max_speed_limit:
            return None
        weakest = limits.min_acceleration_limit
        reach = fastest * (fastest / (2.0 * weakest) + (abs(state.a) + weakest) / limits.jerk)
        self._to_rest.max_acceleration = [limits.min_acceleration_between(state.s - reach, state.s + reach)]
        motion = self._calculate(self._to_rest, state)
        return motion if motion is not None and motion.respects(limits) else None

    def nearest_stoppable_state(self, target: LineState) -> LineState:
        """Change a target state as little as possible so that it is on the line and the tool can stop from it."""
        limits = self.limits
        s = min(max(target.s, limits.s_min), limits.s_max)
        speed, acceleration = limits.min_speed_between(s, s), limits.min_acceleration_between(s, s)
        v = min(max(target.v, -speed), speed)
        a = min(max(target.a, -acceleration), acceleration)
        for share in (1.0, 0.8, 0.5, 0.2):
            drawn = LineState(s, share * v, share * a)
            if self.stop(drawn) is not None:
                return drawn
        return LineState(s)

    def _calculate(
        self, parameters: ruckig.InputParameter, start: LineState, longest: float = math.inf
    ) -> JerkProfile | None:
        parameters.current_position, parameters.current_velocity = [start.s], [start.v]
        parameters.current_acceleration = [start.a]
        try:
            result = self._ruckig.calculate(parameters, self._trajectory)
        except ruckig.RuckigError:
            return None
        if result not in (ruckig.Result.Working, ruckig.Result.Finished) or self._trajectory.duration > longest:
            return None
        profile = self._trajectory.profiles[0][0]
        brake = profile.brake
        return JerkProfile(start, [*brake.t, *profile.t], [*brake.j, *profile.j])
