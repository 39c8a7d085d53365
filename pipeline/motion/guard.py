"""What a motion may do: limits held against it, and the motion to rest that must always exist."""

from __future__ import annotations

from pipeline.motion.limits import LineLimits
from pipeline.motion.lookup import LimitLookup
from pipeline.motion.planner import LinePlanner
from pipeline.motion.profile import JerkProfile
from pipeline.motion.state import LineState

TOLERANCE = 1e-10
"""For rounding [SI units]."""


class Guard:
    """Holds motions against limits, quickly where the limits are far.

    Args:
        limits: along the line.
        planner: for the line's jerk.
    """

    def __init__(self, limits: LineLimits, planner: LinePlanner) -> None:
        self._limits, self._planner = limits, planner
        self.lookup = LimitLookup(limits)

    def allows(self, motion: JerkProfile) -> bool:
        """Whether a motion respects the limits.

        Args:
            motion: any.
        """
        extremes = motion.extremes()
        # Most motions that break a limit do so at an extreme already.
        if not all(self._allows_state(state) for state in extremes):
            return False
        s, v, a = zip(*extremes, strict=True)
        fastest, strongest, lower, upper = max(map(abs, v)), max(map(abs, a)), min(s), max(s)
        far = fastest <= self.lookup.speed(lower, upper) and strongest <= self.lookup.acceleration(lower, upper)
        return far or motion.respects(self._limits, TOLERANCE)

    def _allows_state(self, state: LineState) -> bool:
        s, v, a = state
        lookup = self.lookup
        return (
            lookup.s_min - TOLERANCE <= s <= lookup.s_max + TOLERANCE
            and abs(v) <= lookup.speed(s, s) + TOLERANCE
            and abs(a) <= lookup.acceleration(s, s) + TOLERANCE
        )

    def stop(self, state: LineState) -> JerkProfile | None:
        """The motion to rest, braking with what the whole stretch ahead allows; None where it breaks a limit.

        Args:
            state: to stop from; if it is beyond a limit itself the answer is None.
        """
        if not state.is_finite:
            return None
        lookup = self.lookup
        # Bounds of the speed (the acceleration is taken back first) and of the way to rest.
        fastest = abs(state.v) + state.a**2 / (2.0 * lookup.jerk)
        weakest = lookup.weakest_acceleration
        reach = fastest * (fastest / (2.0 * weakest) + (abs(state.a) + weakest) / lookup.jerk)
        if fastest > 10.0 * lookup.highest_speed:
            return None
        motion = self._planner.to_rest(state, lookup.acceleration(state.s - reach, state.s + reach))
        return motion if motion is not None and self.allows(motion) else None

    def drawn_back(self, target: LineState) -> LineState:
        """The nearest position on the line, with a share of the speed from which the tool can still stop.

        Args:
            target: anywhere, finite.
        """
        lookup = self.lookup
        s = min(max(target.s, lookup.s_min), lookup.s_max)
        speed, acceleration = lookup.speed(s, s), lookup.acceleration(s, s)
        v = min(max(target.v, -speed), speed)
        a = min(max(target.a, -acceleration), acceleration)
        for share in (1.0, 0.8, 0.5, 0.2):
            drawn = LineState(s, share * v, share * a)
            if self.stop(drawn) is not None:
                return drawn
        return LineState(s)
