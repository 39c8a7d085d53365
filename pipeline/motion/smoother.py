"""Online smoothing: follow a reference along the line, cycle by cycle, within the limits."""

import math
from collections.abc import Sequence

from armdyn.errors import InputError
from pipeline.motion.limits import LineLimits
from pipeline.motion.planner import LinePlanner
from pipeline.motion.profile import JerkProfile
from pipeline.motion.speed_limit_curve import SpeedLimitCurve
from pipeline.motion.trajectory import LineState

LOOK_AHEAD_CYCLES = (1, 2, 3, 4, 5, 6, 8, 10, 13, 16, 20, 25, 32, 40, 50)
"""Numbers of control cycles after which the motion may reach the reference or the speed limit."""
PURSUIT_LOOKAHEAD_SECONDS = 0.2
"""Time ahead at which the reference is pursued if it cannot be reached [s]; the arm can reverse in this time."""
ACCELERATION_FADE_SECONDS = 0.1
"""Time constant with which the acceleration of a single reference decays when it is extrapolated [s]."""


class LineSmoother:
    """Follows a reference on the line within the limits of range, speed, acceleration and jerk, cycle by cycle.

    In each cycle, motions are planned that reach the reference exactly after m = 1, 2, 3, ... cycles, and the first one
    within the limits is begun. A feasible reference is reached with m = 1 and is reproduced exactly; after an
    infeasible part the motion catches up with the reference. If no such motion exists, the reference is pursued in the
    shortest time.

    No limit is ever exceeded: a cycle is begun only if it is within every limit, and if a motion from its end to rest
    is too. The motion to rest is stored, and is continued if nothing better is found in the next cycle.

    Args:
        limits: limits along the line.
        dt: duration of a control cycle [s].
        state: first state of the tool.

    Attributes:
        state: state at the end of the last cycle.
        motion: motion of the last cycle, in phases of constant jerk.

    Raises:
        InputError: the tool cannot be brought to rest within the limits from its first state.
    """

    def __init__(self, limits: LineLimits, dt: float, state: LineState) -> None:
        self._dt = dt
        self._at_start, self._planner = LinePlanner(limits), LinePlanner(limits.limits_reduced_for_planning())
        self._limits = self._planner.limits
        self._ride = SpeedLimitCurve(self._limits)
        # A pursuit that went above the speed curve that it follows afterwards would oscillate about it.
        self._below_ride = LinePlanner(self._ride.limits)
        self.reset(state)

    @property
    def at_rest(self) -> bool:
        """Whether speed and acceleration of the last state are zero."""
        return self.state.v == 0.0 and self.state.a == 0.0

    def reset(self, state: LineState) -> None:
        """Continue from another state, which may be a moving one.

        Raises:
            InputError: the tool cannot be brought to rest within the limits from this state.
        """
        state = LineState(*(float(value) for value in state))
        stop = self._at_start.stop(state)
        if stop is None:
            raise InputError(
                f"smoother: from s = {state.s:.4g} m, v = {state.v:.4g} m/s, a = {state.a:.4g} m/s^2 the tool cannot "
                "be brought to rest within the limits of the line: start slower, or further from the line's ends"
            )
        self.state, self._stop, self._stop_age = state, stop, 0.0
        self.motion = JerkProfile(state, [], [])
        self._joining: JerkProfile | None = None

    def update(self, reference: LineState | Sequence[LineState]) -> LineState:
        """Advance by one cycle towards the reference; returns the state at the end of the cycle.

        Args:
            reference: state that the tool should have at the end of this cycle, or a sequence for this and the next
                cycles. A single state is extrapolated with a decaying acceleration. A state that is not finite ends the
                sequence; if it is the first one, the tool brakes. States beyond the limits are moved back to them.
        """
        targets = self._continue(reference) if isinstance(reference, LineState) else _until_not_finite(reference)
        if not targets:
            return self.stop()
        for m in LOOK_AHEAD_CYCLES:
            if m > len(targets):
                break
            if self._meet(self._planner.nearest_stoppable_state(targets[m - 1]), m):
                return self.state
        later = targets[min(round(PURSUIT_LOOKAHEAD_SECONDS / self._dt), len(targets) - 1)]
        return self.state if self._pursue(self._planner.nearest_stoppable_state(LineState(later.s))) else self.stop()

    def stop(self) -> LineState:
        """Advance by one cycle while braking to rest; returns the state at the end of the cycle."""
        self._joining = None
        self.motion = self._stop.section(self._stop_age, self._stop_age + self._dt)
        self._stop_age += self._dt
        if self._stop_age < self._stop.duration:
            self.state = self._stop.state_at(self._stop_age)
        else:
            # Rest is exact: rounding errors of speed and acceleration must not add up.
            self.state = LineState(min(max(self._stop.end.s, self._limits.s_min), self._limits.s_max))
        return self.state

    def _meet(self, target: LineState, cycles: int, keep: bool = False) -> bool:
        """Begin the motion that reaches a target after a number of cycles, if it exists and is within the limits."""
        motion = self._planner.plan_motion_to_state(self.state, target, duration=cycles * self._dt)
        return motion is not None and motion.respects(self._limits) and self._begin(motion, self._planner, keep)

    def _pursue(self, target: LineState) -> bool:
        """Begin the fastest motion towards a position, along the speed limit where necessary."""
        s = self.state.s
        acceleration = self._limits.min_acceleration_between(min(s, target.s), max(s, target.s))
        motion = self._planner.plan_motion_to_state(self.state, target, acceleration=acceleration)
        if motion is not None and self._begin(motion, self._below_ride):
            return True
        # Going faster breaks the speed limit ahead: join it, with its own slope, as early as possible.
        if self._joining is not None and self._begin(self._joining, self._planner, keep=True):
            return True
        direction = math.copysign(1.0, target.s - s)
        for m in LOOK_AHEAD_CYCLES:
            ahead = self._ride.state_after(s, m * self._dt, direction)
            if (target.s - ahead.s) * direction <= 0.0:
                break
            if self._meet(ahead, m, keep=True):
                return True
        for share in (0.9, 0.5):
            slower = max(share * min(abs(self.state.v), self._limits.min_speed_between(s, s)), 1e-3)
            motion = self._planner.plan_motion_to_state(
                self.state, LineState(target.s), speed=slower, acceleration=acceleration
            )
            if motion is not None and self._begin(motion, self._planner):
                return True
        return False

    def _begin(self, motion: JerkProfile, planner: LinePlanner, keep: bool = False) -> bool:
        """Begin a motion if its first cycle and a stop after it are within the limits; `keep` stores the remainder."""
        cycle = motion.section(end=self._dt)
        if not cycle.respects(planner.limits):
            return False
        state = motion.state_at(self._dt)
        stop = planner.stop(state)
        if stop is None:
            return False
        self.state, self.motion = state, cycle
        self._stop, self._stop_age = stop, 0.0
        self._joining = motion.section(self._dt) if keep and motion.duration > 1.5 * self._dt else None
        return True

    def _continue(self, reference: LineState) -> Sequence[LineState]:
        """Extrapolate a single reference over the next cycles with a decaying acceleration."""
        if not reference.is_finite:
            return ()
        s, v, a = reference
        targets = []
        for k in range(LOOK_AHEAD_CYCLES[-1]):
            t = k * self._dt
            fade = 1.0 - math.exp(-t / ACCELERATION_FADE_SECONDS)
            gained = a * ACCELERATION_FADE_SECONDS * fade
            targets.append(
                LineState(s + v * t + ACCELERATION_FADE_SECONDS * (a * t - gained), v + gained, a * (1.0 - fade))
            )
        return targets


def _until_not_finite(reference: Sequence[LineState]) -> Sequence[LineState]:
    """States before the first one that is not finite, at most as many as `LineSmoother` uses."""
    targets = [LineState(*target) for target in reference[: LOOK_AHEAD_CYCLES[-1]]]
    for k, target in enumerate(targets):
        if not target.is_finite:
            return targets[:k]
    return targets
