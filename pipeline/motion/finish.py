"""The finish over the box, a fast move of the gripper, and any other move from point to point."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from armdyn.errors import InputError, TaskFailedError
from pipeline.motion.guard import Guard, Ride, RideCurve
from pipeline.motion.limits import LineLimits
from pipeline.motion.profile import JerkProfile, LinePlanner
from pipeline.motion.trajectory import LineState, LineTrajectory
from urdf.robot import Array

FINISH_ACCELERATION = 8.0
"""Acceleration of the finish [m/s^2]: the gripper must be there before the load has swung back; at 5 it is not."""

FINISH_SPEED_SHARE = 0.70
"""Share of the speed limit that the finish uses [1]."""

HEADROOM = 0.999
"""Share of the limits that is used, so that they also hold between the checked instants."""

SLOWEST = 0.02
"""Share of the highest speed below which the search for a slower move ends [1]."""

STEP = 5e-3
"""Spacing of the positions at which the speed limit may be met or left [m]."""


def finish_over_box(
    start: LineState,
    s_end: float,
    limits: LineLimits,
    dt: float,
    acceleration: float = FINISH_ACCELERATION,
    speed_share: float = FINISH_SPEED_SHARE,
) -> LineTrajectory:
    """Bring the gripper from the end of the swing to rest over the box.

    Args:
        start: state of the gripper at the end of the swing, moving.
        s_end: where it comes to rest [m].
        limits: along the line.
        dt: control cycle [s].
        acceleration: largest acceleration, where the line allows it [m/s^2].
        speed_share: share of the speed limit that is used, (0, 1].

    Returns:
        The move from time 0, sampled every `dt`; its last sample is at rest at `s_end`.

    Raises:
        InputError: if an argument cannot be used.
        TaskFailedError: if no such move exists within the limits.
    """
    if not (0.0 < speed_share <= 1.0 and acceleration > 0.0):
        raise InputError("finish: the speed share must lie in (0, 1] and the acceleration be greater than 0")
    reduced = limits.scaled(speed=speed_share).capped(acceleration)
    # Where the swing ends faster than the finish may go, braking needs the whole limit.
    slow_enough = Guard(reduced, LinePlanner(limits.jerk)).stop(start) is not None
    return point_to_point(start, s_end, reduced if slow_enough else limits, dt)


def point_to_point(start: LineState, s_end: float, limits: LineLimits, dt: float) -> LineTrajectory:
    """Fast move from a moving state to rest, under a speed limit that depends on the place.

    Where the fastest move at constant limits does not fit under the speed limit, three parts are joined: ruckig up to
    the limit, meeting it with its own slope; along the limit; ruckig down to rest. Where there is no such stretch, one
    ruckig move at the highest constant speed that fits.

    Args:
        start: state to start from.
        s_end: where to come to rest [m].
        limits: along the line.
        dt: sampling [s].

    Returns:
        The move from time 0, sampled every `dt`; its last sample is at rest at `s_end`.

    Raises:
        InputError: if the start or the end is not a position on the line.
        TaskFailedError: if no such move exists within the limits.
    """
    if not start.is_finite or not limits.s_min <= s_end <= limits.s_max:
        raise InputError(
            f"move to s = {s_end} m: start and end must lie on the line, {limits.s_min:.4g} to {limits.s_max:.4g} m"
        )
    if not (np.isfinite(dt) and dt > 0.0):
        raise InputError(f"move to s = {s_end} m: the cycle must be longer than 0 s, not {dt}")
    tight = limits.scaled(HEADROOM, HEADROOM)
    planner, target = LinePlanner(limits.jerk), LineState(s_end)
    guard = Guard(tight, planner)
    pieces = _fastest(planner, guard, start, target, tight) if guard.stop(start) is not None else None
    if pieces is None:
        raise TaskFailedError(
            f"move to s = {s_end:.4g} m: there is none within the limits from s = {start.s:.4g} m, "
            f"v = {start.v:.4g} m/s, a = {start.a:.4g} m/s^2: start slower, or further from the line's ends"
        )
    return _sampled(pieces, target, dt)


def _fastest(
    planner: LinePlanner, guard: Guard, start: LineState, target: LineState, limits: LineLimits
) -> list[JerkProfile | Ride] | None:
    """The shortest in time of the moves that fit."""
    acceleration = _acceleration(guard, start, target)
    direct = planner.to_state(start, target, guard.limits.fastest, acceleration)
    if direct is not None and guard.allows(direct):
        return [direct]
    moves = _ridden(planner, start, target, limits), _slower(planner, guard, start, target, acceleration)
    return min(filter(None, moves), key=lambda move: sum(piece.duration for piece in move), default=None)


def _ridden(planner: LinePlanner, start: LineState, target: LineState, limits: LineLimits) -> list[JerkProfile | Ride]:
    """Up to the limit, along it, down to rest; empty where the limit is not met or cannot be ridden."""
    direction = 1.0 if target.s > start.s else -1.0
    curve = RideCurve(limits)
    stretch = curve.nodes[(curve.nodes - start.s) * direction >= 0.0]
    stretch = stretch[(target.s - stretch) * direction >= 0.0][:: int(direction)]
    places = stretch[:: max(int(STEP / (curve.nodes[1] - curve.nodes[0])), 1)]
    if len(places) < 2:
        return []
    speed, guard = float(limits.speed.max()), Guard(limits, planner)

    def best(begins: list[LineState], ends: list[LineState], riding: Array) -> tuple[int, JerkProfile | None]:
        """The place for which the whole move takes the shortest time, and the motion to or from it."""
        shortest, place, chosen = np.inf, 0, None
        for k, (begin, end) in enumerate(zip(begins, ends, strict=True)):
            motion = planner.to_state(begin, end, speed, _acceleration(guard, begin, end))
            if motion is None or motion.duration + riding[k] >= shortest:
                continue
            if guard.allows(motion):
                shortest, place, chosen = motion.duration + riding[k], k, motion
        return place, chosen

    on_curve = [curve.at(float(s), direction) for s in places]
    pace = np.abs(np.gradient(places)) / np.abs([state.v for state in on_curve])
    passed = np.cumsum(pace)
    first, up = best([start] * len(places), on_curve, passed[-1] - passed)
    last, down = best(on_curve, [target] * len(places), passed)
    if up is None or down is None or first >= last:
        return []
    inside = stretch[((stretch - places[first]) * direction >= 0.0) & ((places[last] - stretch) * direction >= 0.0)]
    if np.max(curve.jerk(inside)) > limits.jerk:
        return []
    ride = curve.between(float(places[first]), float(places[last]))
    states = [curve.at(float(s), direction) for s in inside]
    if any(abs(state.a) > limits.acceleration_at(state.s) for state in states):
        return []
    return [up, ride, down]


def _acceleration(guard: Guard, begin: LineState, end: LineState) -> float:
    """The smallest limit on the way; a move that starts away from the end first goes on to where it can stop."""
    stop = guard.stop(begin)
    reached = begin.s, end.s, begin.s if stop is None else stop.end.s
    return guard.limits.lowest_acceleration(min(reached), max(reached))


def _slower(
    planner: LinePlanner, guard: Guard, start: LineState, target: LineState, acceleration: float
) -> list[JerkProfile | Ride]:
    """The move at the highest constant speed that fits, by bisection; empty where there is none."""
    best: list[JerkProfile | Ride] = []
    fits, fails = 0.0, guard.limits.fastest
    for _ in range(12):
        speed = 0.5 * (fits + fails)
        if speed < SLOWEST * guard.limits.fastest:
            break
        motion = planner.to_state(start, target, speed, acceleration)
        if motion is not None and guard.allows(motion):
            best, fits = [motion], speed
        else:
            fails = speed
    return best


def _sampled(pieces: Sequence[JerkProfile | Ride], target: LineState, dt: float) -> LineTrajectory:
    ends = np.cumsum([0.0] + [piece.duration for piece in pieces])
    count = int(np.ceil(ends[-1] / dt - 1e-9))
    states = []
    for k in range(count):
        t = k * dt
        for piece, (begin, end) in zip(pieces, pairwise(ends), strict=True):
            if t < end:
                states.append(piece.at(t - begin))
                break
    s, v, a = np.array([*states, target]).T
    return LineTrajectory(np.linspace(0.0, count * dt, count + 1), s, v, a)
