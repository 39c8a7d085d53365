"""The feasibility of a whole motion, along the line or of the joints, before it is run."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

import urdf
from armdyn.errors import InputError
from ik import LineTable
from pipeline.motion.feasibility.clearance import collision_series, swing_series
from pipeline.motion.feasibility.series import (
    SampledMotion,
    between,
    fine_times,
    joint_series,
    off_line_series,
    start_series,
)
from pipeline.motion.feasibility.settings import CheckSettings, Swing
from pipeline.motion.feasibility.verdict import Bounded, FeasibilityReport
from pipeline.motion.trajectory import JointTrajectory, LineTrajectory


def check_line(
    table: LineTable,
    robot: urdf.Robot,
    trajectory: LineTrajectory,
    settings: CheckSettings | None = None,
    swing: Swing | None = None,
    at: ArrayLike | None = None,
) -> FeasibilityReport:
    """Judge a motion along the line: whether it stays on the line, and whether the joints can follow.

    Args:
        table: from the line to the joints.
        robot: the arm.
        trajectory: the motion.
        settings: what the check takes into account, and the least distances.
        swing: of the load; None where nothing hangs.
        at: where the arm is (n,); None where nobody knows [rad].

    Returns:
        Every violation and all margins.
    """
    settings = settings or CheckSettings()
    low, high = float(table.s[0]), float(table.s[-1])
    time, fine = trajectory.time, fine_times(trajectory.time)
    s = between(time, trajectory.s, trajectory.v, fine)
    v, a = between(time, trajectory.v, trajectory.a, fine), np.interp(fine, time, trajectory.a)
    # Beyond the ends there are no postures: the joints are judged as if the tool waited at the end.
    samples = table.joint_motion(np.clip(trajectory.s, low, high), trajectory.v, trajectory.a)
    postures = table.joint_motion(np.clip(s, low, high), v, a)
    motion = SampledMotion(time, *samples, fine, *postures)
    series = [Bounded.between("line", "m", (robot.tool_frame,), fine, s, low, high)]
    series += joint_series(robot, motion, settings)
    series += off_line_series(robot, table.line, motion, settings)
    series += _start_and_collision(robot, motion, settings, at)
    if swing is not None:
        series += swing_series(robot, table.line, motion, swing, settings)
    return FeasibilityReport.of(series)


def check_joints(
    robot: urdf.Robot,
    trajectory: JointTrajectory,
    settings: CheckSettings | None = None,
    line: urdf.Line | None = None,
    at: ArrayLike | None = None,
) -> FeasibilityReport:
    """Judge a motion of the joints.

    Args:
        robot: the arm.
        trajectory: the motion.
        settings: what the check takes into account, and the least distances.
        line: on which the tool must stay; None where it is free.
        at: where the arm is (n,); None where nobody knows [rad].

    Returns:
        Every violation and all margins.

    Raises:
        InputError: if the trajectory is of other joints.
    """
    settings = settings or CheckSettings()
    if trajectory.joint_names != robot.joint_names:
        raise InputError(
            f"trajectory: its joints are {', '.join(trajectory.joint_names)}; those of {robot.name} are "
            f"{', '.join(robot.joint_names)}, in this order"
        )
    t, fine = trajectory.time, fine_times(trajectory.time)
    motion = SampledMotion(
        t,
        trajectory.q,
        trajectory.v,
        trajectory.a,
        fine,
        between(t, trajectory.q, trajectory.v, fine),
        between(t, trajectory.v, trajectory.a, fine),
        np.column_stack([np.interp(fine, t, column) for column in trajectory.a.T]),
    )
    series = joint_series(robot, motion, settings)
    if line is not None:
        series += off_line_series(robot, line, motion, settings)
    return FeasibilityReport.of([*series, *_start_and_collision(robot, motion, settings, at)])


def _start_and_collision(
    robot: urdf.Robot, motion: SampledMotion, settings: CheckSettings, at: ArrayLike | None
) -> list[Bounded]:
    """Distance of the first posture from where the arm is, and of the arm from everything that it may touch."""
    series = []
    if at is not None:
        here = np.asarray(at, dtype=float)
        if here.shape != (len(robot.joint_names),) or not np.all(np.isfinite(here)):
            raise InputError(f"where the arm is: give {len(robot.joint_names)} finite joint positions of {robot.name}")
        series.append(start_series(robot, motion, here, settings))
    if settings.collision:
        series += collision_series(robot, motion, settings)
    return series
