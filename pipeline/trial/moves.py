"""Slow motions of a real arm before the experiment: to the start posture, and the rehearsal along the line."""

from collections.abc import Callable, Iterable
from itertools import pairwise

import numpy as np

import urdf
from armdyn.errors import TaskFailedError
from ik import LineTable
from pipeline.interrupts import noted_signals
from pipeline.motion import LineTrajectory
from pipeline.motion.gate import PERIOD
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
LOOKED_AT = 0.02
"""Spacing of the postures that are looked at along the line [m]; the check looks between them, too."""
FASTEST_SHARE = 1.875
"""Largest speed of a minimum-jerk motion, as a share of its mean [1]."""
FORERUN = 0.2
"""How far a trial moves away from the box while it learns and swings back, at most [m]."""

Posture = tuple[Vector, Vector, Vector]
"""Positions, velocities and accelerations (n,) [rad, rad/s, rad/s^2]."""


def approach(arm: urdf.Robot, start: Vector, goal: Vector) -> JointTrajectory:
    """Postures from one posture to another: all joints move together, smoothly at both ends.

    Args:
        arm: arm that moves.
        start: first posture (n,) [rad].
        goal: last posture (n,) [rad].
    """
    way = goal - start
    time, u = _beat(float(np.max(np.abs(way))), JOINT_SPEED)
    share, speed, acceleration = minimum_jerk(u, float(time[-1]))
    return JointTrajectory(
        time, start + np.outer(share, way), np.outer(speed, way), np.outer(acceleration, way), arm.joint_names
    )


def sweep(table: LineTable) -> LineTrajectory:
    """Postures of a slow motion from one end of the line to the other, at most `LOOKED_AT` apart."""
    begin, end = float(table.s[0]), float(table.s[-1])
    u = np.linspace(0.0, 1.0, int(np.ceil(FASTEST_SHARE * (end - begin) / LOOKED_AT)) + 1)
    duration = FASTEST_SHARE * (end - begin) / LINE_SPEED
    share, speed, acceleration = ((end - begin) * x for x in minimum_jerk(u, duration))
    return LineTrajectory(duration * u, begin + share, speed, acceleration)


def rehearsal(table: LineTable, finish: float) -> LineTrajectory:
    """Slow motion along the whole stretch that a trial uses, and back to its middle.

    Args:
        table: IK table of the line.
        finish: position over the box at which a trial ends [m].
    """
    stops = (0.0, max(-FORERUN, float(table.s[0])), min(finish, float(table.s[-1])), 0.0)
    whole: LineTrajectory | None = None
    for first, last in pairwise(stops):
        time, u = _beat(abs(last - first), LINE_SPEED)
        share, speed, acceleration = ((last - first) * x for x in minimum_jerk(u, float(time[-1])))
        part = LineTrajectory(time, first + share, speed, acceleration)
        whole = part if whole is None else whole.then(part)
    assert whole is not None, "there are stops"
    return whole


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
    with noted_signals(signals.append):
        begun = due = robot.time
        try:
            for posture in motion:
                if signals:
                    raise TaskFailedError(f"{sentence_of_signal(signals[0])}: the arm was brought to rest")
                robot.command(*posture)
                due = max(due + PERIOD, robot.time)
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


def _beat(way: float, fastest: float) -> tuple[Vector, Vector]:
    """Sample times [s] of a minimum-jerk motion over a distance, and the elapsed share of its duration at each."""
    duration = max(MIN_MOVE_SECONDS, FASTEST_SHARE * way / fastest)
    count = int(np.ceil(duration / PERIOD))
    number = np.arange(count + 1, dtype=float)
    return PERIOD * number, number / count
