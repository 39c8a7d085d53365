"""Fast moves of the gripper from a moving state to rest, among them the finish over the box."""

from collections.abc import Callable

import numpy as np

from armdyn.errors import InputError, TaskFailedError
from pipeline.motion.limits import LineLimits
from pipeline.motion.planner import LinePlanner
from pipeline.motion.profile import JerkProfile
from pipeline.motion.ride import RideCurve
from pipeline.motion.trajectory import LineState, LineTrajectory
from urdf.robot import Array

FINISH_ACCELERATION = 8.0
"""Acceleration of the finish [m/s^2]: the gripper must be there before the load has swung back; at 5 it is not."""
FINISH_SPEED_SHARE = 0.70
"""Share of the speed limit that the finish uses [1]."""
MIN_SPEED_SHARE = 0.02
"""Share of the highest speed below which the search for a slower move ends [1]."""
MEETING_SPACING = 5e-3
"""Spacing of the positions at which the speed limit may be met or left [m]."""

Pieces = list[tuple[float, Callable[[float], LineState]]]
"""Parts of a move, one after the other: how long each takes [s], and its state at a time of its own [s]."""


def finish_over_box(start: LineState, s_end: float, limits: LineLimits, dt: float) -> LineTrajectory:
    """Bring the gripper from the state at the end of the swing to rest over the box, at `s_end` [m].

    Returns:
        The move from time 0, sampled every `dt` [s]; its last sample is at rest at `s_end`.

    Raises:
        InputError: if the end is not on the line.
        TaskFailedError: if no such move exists within the limits.
    """
    reduced = limits.scaled(FINISH_SPEED_SHARE, 1.0, FINISH_ACCELERATION)
    # Where the swing ends faster than the finish may go, braking needs the whole limit.
    slow_enough = LinePlanner(reduced).stop(start) is not None
    return point_to_point(start, s_end, reduced if slow_enough else limits, dt)


def point_to_point(start: LineState, s_end: float, limits: LineLimits, dt: float) -> LineTrajectory:
    """Fast move from a moving state to rest at `s_end` [m], under a speed limit that depends on the place.

    Where the fastest move at constant limits does not fit under the speed limit, three parts are joined: ruckig up to
    the limit, meeting it with its own slope; along the limit; ruckig down to rest. Where there is no such stretch, one
    ruckig move at the highest constant speed that fits.

    Returns:
        The move from time 0, sampled every `dt` [s]; its last sample is at rest at `s_end`.

    Raises:
        InputError: if the end is not a position on the line.
        TaskFailedError: if no such move exists within the limits.
    """
    if not limits.s_min <= s_end <= limits.s_max:
        raise InputError(
            f"move to s = {s_end} m: its end must lie on the line, {limits.s_min:.4g} to {limits.s_max:.4g} m"
        )
    planner, target = LinePlanner(limits.tight()), LineState(s_end)
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


def _fastest(planner: LinePlanner, start: LineState, target: LineState) -> Pieces:
    """The move with the shortest duration of those within the limits; empty where there is none."""
    acceleration = _acceleration(planner, start, target)
    direct = planner.to_state(start, target, acceleration=acceleration)
    if direct is not None and direct.respects(planner.limits):
        return [(direct.duration, direct.at)]
    moves = _ridden(planner, start, target), _slower(planner, start, target, acceleration)
    return min(filter(None, moves), key=lambda pieces: sum(duration for duration, _ in pieces), default=[])


def _ridden(planner: LinePlanner, start: LineState, target: LineState) -> Pieces:
    """Move up to the speed limit, along it and down to rest; empty where the limit is not met or cannot be followed."""
    limits, direction = planner.limits, 1.0 if target.s > start.s else -1.0
    curve = RideCurve(limits)
    stretch = curve.nodes[(curve.nodes - start.s) * direction >= 0.0]
    stretch = stretch[(target.s - stretch) * direction >= 0.0][:: int(direction)]
    skip = max(int(MEETING_SPACING / (curve.nodes[1] - curve.nodes[0])), 1)
    places = stretch[::skip]
    if len(places) < 2:
        return []

    def best(begins: list[LineState], ends: list[LineState], riding: Array) -> tuple[int, JerkProfile | None]:
        """Place on the limit for which the whole move is the fastest, and the motion to or from this place."""
        shortest, place, chosen = np.inf, 0, None
        for k, (begin, end) in enumerate(zip(begins, ends, strict=True)):
            motion = planner.to_state(begin, end, acceleration=_acceleration(planner, begin, end))
            if motion is not None and motion.duration + riding[k] < shortest and motion.respects(limits):
                shortest, place, chosen = motion.duration + riding[k], k, motion
        return place, chosen

    on_curve = [curve.at(float(s), direction) for s in places]
    passed = np.cumsum(np.abs(np.gradient(places)) / np.abs([state.v for state in on_curve]))
    first, up = best([start] * len(places), on_curve, passed[-1] - passed)
    last, down = best(on_curve, [target] * len(places), passed)
    if up is None or down is None or first >= last:
        return []
    inside = stretch[skip * first : skip * last + 1]
    states = np.array([curve.at(float(s), direction) for s in inside])
    too_strong = np.abs(states[:, 2]) > limits.acceleration_at(inside)
    if np.max(curve.jerk(inside)) > limits.jerk or np.any(too_strong):
        return []
    ride = curve.between(float(places[first]), float(places[last]))
    return [(up.duration, up.at), ride, (down.duration, down.at)]


def _acceleration(planner: LinePlanner, begin: LineState, end: LineState) -> float:
    """Smallest acceleration limit on the way; a move that starts away from its end includes the stopping distance."""
    stop = planner.stop(begin)
    reached = begin.s, end.s, begin.s if stop is None else stop.end.s
    return planner.limits.lowest_acceleration(min(reached), max(reached))


def _slower(planner: LinePlanner, start: LineState, target: LineState, acceleration: float) -> Pieces:
    """The move at the highest constant speed within the limits, by bisection; empty where there is none."""
    best: Pieces = []
    fits, fails = 0.0, planner.limits.fastest
    for _ in range(12):
        speed = 0.5 * (fits + fails)
        if speed < MIN_SPEED_SHARE * planner.limits.fastest:
            break
        motion = planner.to_state(start, target, speed=speed, acceleration=acceleration)
        if motion is not None and motion.respects(planner.limits):
            best, fits = [(motion.duration, motion.at)], speed
        else:
            fails = speed
    return best
