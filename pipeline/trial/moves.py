"""Slow motions of a real arm before the experiment: to the start posture, and the rehearsal along the line."""

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
from pipeline.trial.ending import sentence_of_signal

JOINT_SPEED = 0.2
"""Largest joint speed on the way to the start posture [rad/s]: somebody beside the arm can step back."""
LINE_SPEED = 0.1
"""Largest speed in the rehearsal [m/s]."""
MIN_MOVE_SECONDS = 2.0
"""Least time of one such motion [s]: the load shall not begin to swing."""
CHECK_SPACING = 0.02
"""Largest distance of the checked postures along the line [m]; the check interpolates between them."""
PEAK_SPEED_RATIO = 1.875
"""Largest speed of a minimum-jerk motion over its mean speed."""
MAX_BACKWARD = 0.2
"""Largest distance by which a trial moves away from the box while it learns and swings back [m]."""

Posture = tuple[Vector, Vector, Vector]
"""Positions, velocities and accelerations (n,) [rad, rad/s, rad/s^2]."""


def approach(arm: urdf.Robot, start: Vector, goal: Vector) -> JointTrajectory:
    """Smooth motion of all joints together from one posture (n,) [rad] to another."""
    return JointTrajectory(*_slow_move(start, goal, JOINT_SPEED, CONTROL_PERIOD_SECONDS), arm.joint_names)


def sweep(table: LineTable) -> LineTrajectory:
    """Postures of a slow motion from one end of the line to the other, at most `CHECK_SPACING` apart."""
    begin, end = float(table.s[0]), float(table.s[-1])
    return LineTrajectory(*_slow_move(begin, end, LINE_SPEED, CHECK_SPACING / LINE_SPEED))


def rehearsal(table: LineTable, finish: float) -> LineTrajectory:
    """Slow motion along the whole stretch that a trial uses, and back to its middle.

    Args:
        table: IK table of the line.
        finish: position over the box at which a trial ends [m].
    """
    stops = (0.0, max(-MAX_BACKWARD, float(table.s[0])), min(finish, float(table.s[-1])), 0.0)
    parts = [
        LineTrajectory(*_slow_move(first, last, LINE_SPEED, CONTROL_PERIOD_SECONDS)) for first, last in pairwise(stops)
    ]
    return reduce(LineTrajectory.then, parts)


def play(
    robot: RobotInterface, motion: Iterable[Posture], total: float, progress: Callable[[float], None] | None = None
) -> None:
    """Command a checked motion, cycle by cycle; a late cycle makes the motion longer, never faster.

    Args:
        robot: robot that moves.
        motion: a posture per cycle.
        total: duration of the motion [s].
        progress: called with the share that is done.

    Raises:
        TaskFailedError: the motion was interrupted, or the robot refused; the arm is brought to rest.
    """
    signals: list[int] = []
    with deferred_signals(signals.append):
        begun = due = robot.time
        try:
            for posture in motion:
                if signals:
                    raise TaskFailedError(f"{sentence_of_signal(signals[0])}: the arm was brought to rest")
                robot.command(*posture)
                due = max(due + CONTROL_PERIOD_SECONDS, robot.time)
                robot.advance(due - robot.time)
                if progress is not None:
                    progress(min((robot.time - begun) / total, 1.0))
        except BaseException:
            robot.stop()
            raise


def postures_along(table: LineTable, motion: LineTrajectory) -> Iterable[Posture]:
    """The arm's postures during a motion along the line."""
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
    duration = max(MIN_MOVE_SECONDS, PEAK_SPEED_RATIO * float(np.max(np.abs(way))) / max_speed)
    number = np.arange(np.ceil(duration / step) + 1)
    time = step * number
    share, speed, acceleration = (np.multiply.outer(x, way) for x in minimum_jerk(number / number[-1], float(time[-1])))
    return time, begin + share, speed, acceleration
