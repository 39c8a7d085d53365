"""Check a whole motion, of the tool along the line or of the joints, against every limit before it is run."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline, make_interp_spline

import urdf
from armdyn.errors import InputError
from ik import LineTable
from ik.torque import JointTorque
from pipeline.motion.feasibility.as_modelled import ModelledArm
from pipeline.motion.feasibility.clearance import (
    Obstacle,
    PlannedSwing,
    collision_limited_quantities,
    swing_limited_quantities,
)
from pipeline.motion.feasibility.verdict import FeasibilityReport, LimitedQuantity, TrackingError
from pipeline.motion.trajectory import JointTrajectory, LineTrajectory
from urdf.robot import Array

CHECKED_INSTANTS_PER_SAMPLE = 5
"""Number of checked instants per sample of the motion, so that peaks between two samples are found."""
MAX_TOOL_TO_LINE_DISTANCE, MAX_TOOL_TO_LINE_ANGLE = 1e-4, 1e-3
"""Largest distance of the tool point from the line [m], and largest angle between tool and line's orientation [rad]."""
MAX_FIRST_TO_MEASURED_JOINT_ANGLE = 0.02
"""Largest distance of a joint's first position from its measured position [rad]."""


@dataclass(frozen=True)
class CheckSettings:
    """Settings of the feasibility check.

    Attributes:
        load_mass: mass of the load at the tool [kg].
        springs: True to include all springs of the robot, False for none; None for those that its settings enable.
        obstacles: obstacles around the arm.
        collision: whether to check for collisions.
        min_singular_value: smallest allowed singular value of the tool's Jacobian; near a singularity, a slow motion of
            the tool needs fast joints.
        modelled: the arm as its model describes it, which then gives the torques; None for the description alone.
    """

    load_mass: float = 0.0
    springs: bool | None = None
    obstacles: tuple[Obstacle, ...] = ()
    collision: bool = True
    min_singular_value: float = 0.01
    modelled: ModelledArm | None = None


def check_line(
    table: LineTable,
    robot: urdf.Robot,
    trajectory: LineTrajectory,
    settings: CheckSettings | None = None,
    swing: PlannedSwing | None = None,
    at: ArrayLike | None = None,
) -> FeasibilityReport:
    """Check the feasibility of a motion along the line.

    Args:
        table: IK table of the line.
        robot: the arm.
        trajectory: the motion.
        settings: settings of the check; by default `CheckSettings()`.
        swing: planned swing of a load that hangs from the tool, whose distance from the arm is checked; None without.
        at: measured joint positions at which the motion must start, (n,) [rad]; None if they are unknown.
    """
    settings = settings or CheckSettings()
    low, high = float(table.s[0]), float(table.s[-1])

    def joints(time: Array, s: Array, v: Array, a: Array) -> JointTrajectory:
        # Beyond the ends there are no postures: the joints are judged as if the tool waited at the end.
        return JointTrajectory(time, *table.joint_motion(np.clip(s, low, high), v, a), robot.joint_names)

    samples = trajectory.time, trajectory.s, trajectory.v, trajectory.a
    fine = interpolated_samples(*samples)
    motion, between = joints(*samples), joints(*fine)
    series = [LimitedQuantity.from_values("line", "m", (robot.tool_frame,), fine[0], fine[1], low, high)]
    series += _series(robot, motion, between, settings, table.line, at)
    if swing is not None:
        series += swing_limited_quantities(robot, table.line, between, swing, settings.collision)
    return _report(robot, series, motion, settings)


def check_joints(
    robot: urdf.Robot,
    trajectory: JointTrajectory,
    settings: CheckSettings | None = None,
    line: urdf.Line | None = None,
    at: ArrayLike | None = None,
) -> FeasibilityReport:
    """Check the feasibility of a motion of the joints.

    Args:
        robot: the arm.
        trajectory: the motion.
        settings: settings of the check; by default `CheckSettings()`.
        line: line on which the tool must stay; None if it may move anywhere.
        at: measured joint positions at which the motion must start, (n,) [rad]; None if they are unknown.

    Raises:
        InputError: the trajectory's joints are not those of the arm.
    """
    settings = settings or CheckSettings()
    if trajectory.joint_names != robot.joint_names:
        raise InputError(
            f"trajectory: its joints are {', '.join(trajectory.joint_names)}; those of {robot.name} are "
            f"{', '.join(robot.joint_names)}, in this order"
        )
    fine = interpolated_samples(trajectory.time, trajectory.q, trajectory.v, trajectory.a)
    between = JointTrajectory(*fine, robot.joint_names)
    return _report(robot, _series(robot, trajectory, between, settings, line, at), trajectory, settings)


def _report(
    robot: urdf.Robot, series: list[LimitedQuantity], motion: JointTrajectory, settings: CheckSettings
) -> FeasibilityReport:
    """The report, with assumed limits, and with how an arm's servos follow the motion as its model says."""
    arm, tracking = settings.modelled, tuple[TrackingError, ...]()
    followed = None if arm is None else arm.followed(motion)
    if followed is not None:
        series.append(
            LimitedQuantity.from_values(
                "drive",
                "N m or N",
                robot.joint_names,
                followed.time,
                followed.demanded,
                -followed.limit,
                followed.limit,
            )
        )
        beyond = np.mean(np.abs(followed.demanded) > followed.limit, axis=0)
        sizes = np.abs(followed.error).max(axis=0), np.sqrt(np.mean(followed.error**2, axis=0)), beyond
        tracking = tuple(
            TrackingError(name, unit, *map(float, own))
            for name, unit, *own in zip(robot.joint_names, joint_position_units(robot), *sizes, strict=True)
        )
    notes = _notes(robot, series, arm)
    return replace(FeasibilityReport.from_quantities(series), tracking=tracking, notes=notes)


def missing_mesh_sentences(robot: urdf.Robot) -> list[str]:
    """A list with one sentence about the missing mesh files of a robot; empty if none is missing."""
    missing = [defect for defect in robot.defects if defect.startswith("mesh ")]
    return [missing[0] + (f"; and {len(missing) - 1} more" if missing[1:] else "")] if missing else []


def _notes(robot: urdf.Robot, series: Sequence[LimitedQuantity], arm: ModelledArm | None) -> tuple[str, ...]:
    """Sentences on what was assumed, and what could not be checked."""
    found = missing_mesh_sentences(robot)
    checked = [one.limit for one in series if one.limit in robot.assumed_limits]
    if checked:
        found.append(f"limits of {' and '.join(checked)} are assumed, as no description of {robot.name} states them")
    if arm is not None:
        margin = "farther from 0 by half their band of 95 %"
        if not arm.error.any():
            margin = "which no repair has compared with measured ones: their margin counts only its values' deviations"
        found.append(f"torques are those of the model, {margin}")
        if arm.left_out:
            found.append(f"left out, as they depend on what was before: {', '.join(arm.left_out)}")
    return tuple(found)


def _series(
    robot: urdf.Robot,
    motion: JointTrajectory,
    fine: JointTrajectory,
    settings: CheckSettings,
    line: urdf.Line | None,
    at: ArrayLike | None,
) -> list[LimitedQuantity]:
    """All limited quantities of a motion of the joints, from its samples and from interpolated ones."""
    series = _joint_series(robot, motion, fine, settings)
    if line is not None:
        series += _off_line_series(robot, line, fine)
    if at is not None:
        here = np.asarray(at, dtype=float)
        if here.shape != (len(robot.joint_names),) or not np.all(np.isfinite(here)):
            raise InputError(f"where the arm is: give {len(robot.joint_names)} finite joint positions of {robot.name}")
        start = -MAX_FIRST_TO_MEASURED_JOINT_ANGLE, MAX_FIRST_TO_MEASURED_JOINT_ANGLE
        apart = fine.q[:1] - here
        series.append(
            LimitedQuantity.from_values("start", _unit(robot), robot.joint_names, fine.time[:1], apart, *start)
        )
    return series + (collision_limited_quantities(robot, fine, settings.obstacles) if settings.collision else [])


def interpolated_samples(time: Array, x: Array, v: Array, a: Array) -> tuple[Array, Array, Array, Array]:
    """Interpolate samples (n, ...) `CHECKED_INSTANTS_PER_SAMPLE` times finer: x and v by cubics, a linearly."""
    if time.size == 1:
        return time, x, v, a
    fine = np.interp(
        np.arange(CHECKED_INSTANTS_PER_SAMPLE * (time.size - 1) + 1) / CHECKED_INSTANTS_PER_SAMPLE,
        np.arange(time.size),
        time,
    )
    return (
        fine,
        CubicHermiteSpline(time, x, v)(fine),
        CubicHermiteSpline(time, v, a)(fine),
        make_interp_spline(time, a, k=1)(fine),
    )


def _joint_series(
    robot: urdf.Robot, motion: JointTrajectory, fine: JointTrajectory, settings: CheckSettings
) -> list[LimitedQuantity]:
    """Position, velocity, acceleration, jerk, torque and singular value with the robot's limits.

    Velocities and accelerations are also computed from differences of the samples, so that a jump of the position, or
    columns that do not agree, are found.
    """
    names, limits, unit = robot.joint_names, robot.limits, _unit(robot)

    def both_ways(limit: str, per: str, time: Array, value: Array, bound: Array) -> LimitedQuantity:
        return LimitedQuantity.from_values(limit, per, names, time, value, -bound, bound)

    def with_differences(value: Array, slope: Array) -> tuple[Array, Array]:
        when = np.concatenate([fine.time, middle])
        order = np.argsort(when, kind="stable")
        return when[order], np.concatenate([slope, mean_slope(value)])[order]

    def mean_slope(value: Array) -> Array:
        return np.diff(value, axis=0) / np.diff(motion.time)[:, None]

    middle = (motion.time[1:] + motion.time[:-1]) / 2.0
    if settings.modelled is None:
        torque, effort = JointTorque(robot, settings.load_mass, settings.springs)(fine.q, fine.v, fine.a), limits.effort
    else:
        middle_torque, half = settings.modelled.torques(fine.q, fine.v, fine.a)
        torque, effort = middle_torque + np.copysign(half, middle_torque), settings.modelled.limit
    force = "N m" if unit == "rad" else "N m or N"
    tool = (robot.tool_frame,)
    series = [
        LimitedQuantity.from_values("position", unit, names, fine.time, fine.q, limits.lower, limits.upper),
        both_ways("velocity", f"{unit}/s", *with_differences(motion.q, fine.v), limits.velocity),
        both_ways("acceleration", f"{unit}/s^2", *with_differences(motion.v, fine.a), limits.acceleration),
        both_ways("jerk", f"{unit}/s^3", middle, mean_slope(motion.a), limits.jerk),
        both_ways("torque", force, fine.time, torque, effort),
        LimitedQuantity.from_values(
            "singularity", "1", tool, fine.time, _singular_values(robot, fine.q), settings.min_singular_value
        ),
    ]
    return [bounded for bounded in series if bounded.time.size]


def _singular_values(robot: urdf.Robot, q: Array) -> Array:
    """Smallest singular values (m,) of the tool's Jacobian at postures q (m, k)."""
    data, frame = robot.model.createData(), robot.tool_frame_id
    jacobians = [pin.computeFrameJacobian(robot.model, data, row, frame, pin.LOCAL_WORLD_ALIGNED) for row in q]
    # Of a single joint Pinocchio gives a vector.
    return np.asarray(np.linalg.svd(np.reshape(jacobians, (len(q), 6, -1)), compute_uv=False)[:, -1])


def _off_line_series(robot: urdf.Robot, line: urdf.Line, fine: JointTrajectory) -> list[LimitedQuantity]:
    """Distance of the tool point from the line, and angle between the tool and the line's orientation."""
    data = robot.model.createData()
    distance, tilt = [], []
    for row in fine.q:
        pose = robot.tool_pose(row, data)
        aside = pose.translation - line.origin
        distance.append(np.linalg.norm(aside - (aside @ line.direction) * line.direction))
        tilt.append(np.linalg.norm(pin.log3(line.rotation.T @ pose.rotation)))
    tool = (robot.tool_frame,)
    return [
        LimitedQuantity.from_values(
            "distance_off_line", "m", tool, fine.time, distance, upper=MAX_TOOL_TO_LINE_DISTANCE
        ),
        LimitedQuantity.from_values("tilt", "rad", tool, fine.time, tilt, upper=MAX_TOOL_TO_LINE_ANGLE),
    ]


def _unit(robot: urdf.Robot) -> str:
    """Unit of the joints' positions."""
    units = {*joint_position_units(robot)}
    return units.pop() if len(units) == 1 else "rad or m"


def joint_position_units(robot: urdf.Robot) -> list[str]:
    """Unit of each joint's position, rad or m."""
    kinds = [robot.model.joints[robot.model.getJointId(name)].shortname() for name in robot.joint_names]
    return ["m" if "JointModelP" in kind else "rad" for kind in kinds]
