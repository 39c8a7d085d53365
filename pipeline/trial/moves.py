"""Slow motions of a real arm before a trial: to the start posture, and a rehearsal along its line."""

from collections.abc import Callable, Iterable
from functools import reduce
from itertools import pairwise

import numpy as np

import urdf
from armdyn.errors import TaskFailedError
from ik import LineTable
from pipeline.interrupts import deferred_signals
from pipeline.motion import LineTrajectory
from pipeline.motion.gate import CONTROL_PERIOD_SECONDS
from pipeline.motion.trajectory import JointTrajectory
from pipeline.motion.transitions import minimum_jerk
from pipeline.robot.protocol import RobotInterface, Vector
from pipeline.trial.ending import signal_sentence

MAX_APPROACH_JOINT_SPEED = 0.2
"""Largest joint speed of the motion to the start posture [rad/s], slow enough for a person to step back."""
MAX_REHEARSAL_SPEED = 0.1
"""Largest speed of the rehearsal along the line [m/s]."""
MIN_SLOW_MOTION_SECONDS = 2.0
"""Shortest duration of a slow motion [s], so that the load does not begin to swing."""
MAX_CHECKED_POSTURE_SPACING = 0.02
"""Largest distance between two checked postures along the line [m]; the check interpolates between them."""
MINIMUM_JERK_PEAK_RATIO = 1.875
"""Ratio of the largest to the mean speed of a minimum-jerk motion."""
MAX_BACKWARD_DISTANCE = 0.2
"""Largest distance by which a trial moves from the start away from the box [m]."""

JointReference = tuple[Vector, Vector, Vector]
"""Joint positions, velocities and accelerations (n,) each [rad, rad/s, rad/s^2]."""


def approach_motion(arm: urdf.Robot, start: Vector, goal: Vector) -> JointTrajectory:
    """Slow minimum-jerk motion of an arm from one posture (n,) [rad] to another."""
    return JointTrajectory(*_slow_move(start, goal, MAX_APPROACH_JOINT_SPEED, CONTROL_PERIOD_SECONDS), arm.joint_names)


def line_sweep(table: LineTable) -> LineTrajectory:
    """Slow motion from one end of the line to the other, sampled for a feasibility check."""
    begin, end = float(table.s[0]), float(table.s[-1])
    return LineTrajectory(
        *_slow_move(begin, end, MAX_REHEARSAL_SPEED, MAX_CHECKED_POSTURE_SPACING / MAX_REHEARSAL_SPEED)
    )


def rehearsal_motion(table: LineTable, finish: float) -> LineTrajectory:
    """Slow motion along the part of the line that a trial uses, from its start and back to it.

    Args:
        table: IK table of the line.
        finish: position over the box at which a trial ends [m].
    """
    stops = (0.0, max(-MAX_BACKWARD_DISTANCE, float(table.s[0])), min(finish, float(table.s[-1])), 0.0)
    parts = [
        LineTrajectory(*_slow_move(first, last, MAX_REHEARSAL_SPEED, CONTROL_PERIOD_SECONDS))
        for first, last in pairwise(stops)
    ]
    return reduce(LineTrajectory.followed_by, parts)


def play_motion(
    robot: RobotInterface,
    motion: Iterable[JointReference],
    total: float,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Command a motion cycle by cycle; a late cycle makes the motion longer, and never faster.

    Args:
        robot: robot that moves.
        motion: joint reference of each cycle; the motion was checked before.
        total: duration of the motion [s].
        progress: called with the finished share.

    Raises:
        TaskFailedError: the motion was interrupted or a command was refused; the arm is brought to rest.
    """
    signals: list[int] = []
    with deferred_signals(signals.append):
        begun = due = robot.time
        try:
            for posture in motion:
                if signals:
                    raise TaskFailedError(f"{signal_sentence(signals[0])}: the arm was brought to rest")
                robot.command(*posture)
                due = max(due + CONTROL_PERIOD_SECONDS, robot.time)
                robot.advance(due - robot.time)
                if progress is not None:
                    progress(min((robot.time - begun) / total, 1.0))
        except BaseException:
            robot.stop()
            raise


def postures_along(table: LineTable, motion: LineTrajectory) -> Iterable[JointReference]:
    """Joint references of an arm for a motion along its line, one for each sample of the motion."""
    for state in motion:
        joints = table.joint_motion(state.s, state.v, state.a)
        yield joints.q, joints.v, joints.a


def _slow_move(
    begin: float | Vector, end: float | Vector, max_speed: float, step: float
) -> tuple[Vector, Vector, Vector, Vector]:
    """Minimum-jerk motion between two positions, () or (n,), at most as fast as `max_speed`.

    Returns:
        Times (m,) [s], a `step` apart [s], positions, velocities and accelerations, (m,) or (m, n).
    """
    way = np.subtract(end, begin)
    duration = max(MIN_SLOW_MOTION_SECONDS, MINIMUM_JERK_PEAK_RATIO * float(np.max(np.abs(way))) / max_speed)
    number = np.arange(np.ceil(duration / step) + 1)
    time = step * number
    share, speed, acceleration = (np.multiply.outer(x, way) for x in minimum_jerk(number / number[-1], float(time[-1])))
    return time, begin + share, speed, acceleration
