"""Plan fast motions of the gripper from a moving state to rest, such as the last motion over the box."""

from collections.abc import Callable

import numpy as np

from armdyn.errors import InputError, TaskFailedError
from pipeline.motion.limits import LineLimits
from pipeline.motion.planner import LinePlanner
from pipeline.motion.profile import JerkProfile
from pipeline.motion.speed_limit_curve import SpeedLimitCurve
from pipeline.motion.trajectory import LineState, LineTrajectory
from urdf.robot import Array

MAX_FINISH_ACCELERATION = 8.0
"""Largest acceleration of the last motion over the box [m/s^2]; with 5 m/s^2 the load swings back before its end."""
MAX_FINISH_SHARE_OF_SPEED_LIMIT = 0.70
"""Largest speed of the last motion over the box, as a share of the speed limit."""
MIN_TRIED_SHARE_OF_SPEED_LIMIT = 0.02
"""Share of the highest speed at which the search for a slower motion ends."""
SPEED_LIMIT_MEETING_SPACING = 5e-3
"""Distance between the positions at which a motion may reach or leave the speed limit [m]."""

MotionPieces = list[tuple[float, Callable[[float], LineState]]]
"""Successive parts of a motion: the duration of each [s], and a function from the time since its begin [s] to state."""


def motion_to_finish_over_box(start: LineState, s_end: float, limits: LineLimits, dt: float) -> LineTrajectory:
    """Plan the gripper's motion from its state at the end of the swing to rest over the box.

    Args:
        start: state of the gripper at the end of the swing.
        s_end: position over the box [m].
        limits: limits along the line.
        dt: time between samples [s].

    Returns:
        The motion, from time 0; its last sample is at rest at `s_end`.

    Raises:
        InputError: the end is not on the line.
        TaskFailedError: no such motion exists within the limits.
    """
    reduced = limits.scaled(MAX_FINISH_SHARE_OF_SPEED_LIMIT, 1.0, MAX_FINISH_ACCELERATION)
    # Where the swing ends faster than the finish may go, braking needs the whole limit.
    slow_enough = LinePlanner(reduced).stop(start) is not None
    return point_to_point_motion(start, s_end, reduced if slow_enough else limits, dt)


def point_to_point_motion(start: LineState, s_end: float, limits: LineLimits, dt: float) -> LineTrajectory:
    """Plan a fast motion from a moving state to rest, under a speed limit that depends on the position.

    If the fastest motion with constant limits exceeds the speed limit somewhere, the motion has three parts: Ruckig
    plans a motion to the speed limit, the gripper follows the limit, and Ruckig plans a motion to rest. If this is
    impossible, Ruckig plans one motion with the highest constant speed within the limits.

    Args:
        start: first state.
        s_end: last position [m].
        limits: limits along the line.
        dt: time between samples [s].

    Returns:
        The motion, from time 0; its last sample is at rest at `s_end`.

    Raises:
        InputError: the end is not on the line.
        TaskFailedError: no such motion exists within the limits.
    """
    if not limits.s_min <= s_end <= limits.s_max:
        raise InputError(
            f"move to s = {s_end} m: its end must lie on the line, {limits.s_min:.4g} to {limits.s_max:.4g} m"
        )
    planner, target = LinePlanner(limits.limits_reduced_for_planning()), LineState(s_end)
    pieces = _fastest(planner, start, target) if planner.stop(start) is not None else []
    if not pieces:
        raise TaskFailedError(
            f"move to s = {s_end:.4g} m: there is none within the limits from s = {start.s:.4g} m, "
            f"v = {start.v:.4g} m/s, a = {start.a:.4g} m/s^2: start slower, or further from the line's ends"
        )
    ends = np.cumsum([0.0] + [duration for duration, _ in pieces])
    count = int(np.ceil(ends[-1] / dt - 1e-9))
    states = []
    for t in dt * np.arange(count):
        k = min(int(np.searchsorted(ends, t, "right")) - 1, len(pieces) - 1)
        states.append(pieces[k][1](float(t - ends[k])))
    s, v, a = np.array([*states, target]).T
    return LineTrajectory(np.linspace(0.0, count * dt, count + 1), s, v, a)


def _fastest(planner: LinePlanner, start: LineState, target: LineState) -> MotionPieces:
    """The motion within the limits with the shortest duration; empty without one."""
    acceleration = _acceleration(planner, start, target)
    direct = planner.plan_motion_to_state(start, target, acceleration=acceleration)
    if direct is not None and direct.respects(planner.limits):
        return [(direct.duration, direct.state_at)]
    moves = _ridden(planner, start, target), _slower(planner, start, target, acceleration)
    return min(filter(None, moves), key=lambda pieces: sum(duration for duration, _ in pieces), default=[])


def _ridden(planner: LinePlanner, start: LineState, target: LineState) -> MotionPieces:
    """Motion to the speed limit, along the limit, and to rest; empty if there is none."""
    limits, direction = planner.limits, 1.0 if target.s > start.s else -1.0
    curve = SpeedLimitCurve(limits)
    stretch = curve.nodes[(curve.nodes - start.s) * direction >= 0.0]
    stretch = stretch[(target.s - stretch) * direction >= 0.0][:: int(direction)]
    skip = max(int(SPEED_LIMIT_MEETING_SPACING / (curve.nodes[1] - curve.nodes[0])), 1)
    places = stretch[::skip]
    if len(places) < 2:
        return []

    def best(begins: list[LineState], ends: list[LineState], riding: Array) -> tuple[int, JerkProfile | None]:
        """Index of the position on the limit for which the whole motion is fastest, and the motion to or from it."""
        shortest, place, chosen = np.inf, 0, None
        for k, (begin, end) in enumerate(zip(begins, ends, strict=True)):
            motion = planner.plan_motion_to_state(begin, end, acceleration=_acceleration(planner, begin, end))
            if motion is not None and motion.duration + riding[k] < shortest and motion.respects(limits):
                shortest, place, chosen = motion.duration + riding[k], k, motion
        return place, chosen

    on_curve = [curve.state_at(float(s), direction) for s in places]
    passed = np.cumsum(np.abs(np.gradient(places)) / np.abs([state.v for state in on_curve]))
    first, up = best([start] * len(places), on_curve, passed[-1] - passed)
    last, down = best(on_curve, [target] * len(places), passed)
    if up is None or down is None or first >= last:
        return []
    inside = stretch[skip * first : skip * last + 1]
    states = np.array([curve.state_at(float(s), direction) for s in inside])
    too_strong = np.abs(states[:, 2]) > limits.acceleration_at(inside)
    if np.max(curve.jerk(inside)) > limits.jerk or np.any(too_strong):
        return []
    ride = curve.motion_between(float(places[first]), float(places[last]))
    return [(up.duration, up.state_at), ride, (down.duration, down.state_at)]


def _acceleration(planner: LinePlanner, begin: LineState, end: LineState) -> float:
    """Smallest acceleration limit between two states, the stopping distance of the first included."""
    stop = planner.stop(begin)
    reached = begin.s, end.s, begin.s if stop is None else stop.end.s
    return planner.limits.min_acceleration_between(min(reached), max(reached))


def _slower(planner: LinePlanner, start: LineState, target: LineState, acceleration: float) -> MotionPieces:
    """The motion with the highest constant speed limit within the limits, by bisection; empty without one."""
    best: MotionPieces = []
    fits, fails = 0.0, planner.limits.max_speed_limit
    for _ in range(12):
        speed = 0.5 * (fits + fails)
        if speed < MIN_TRIED_SHARE_OF_SPEED_LIMIT * planner.limits.max_speed_limit:
            break
        motion = planner.plan_motion_to_state(start, target, speed=speed, acceleration=acceleration)
        if motion is not None and motion.respects(planner.limits):
            best, fits = [(motion.duration, motion.state_at)], speed
        else:
            fails = speed
    return best
