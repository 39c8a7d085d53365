"""The quantities of a joint motion that have limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicHermiteSpline

import urdf
from ik.torque import JointTorque
from pipeline.motion.feasibility.settings import CheckSettings
from pipeline.motion.feasibility.verdict import Bounded
from urdf.robot import Array

FINER = 5
"""How many times a motion is looked at per sample, so that no peak between two samples is missed."""


@dataclass(frozen=True)
class SampledMotion:
    """A joint motion as it was sampled, and at more instants between the samples.

    Attributes:
        time: of the samples (n,) [s].
        q, v, a: at the samples (n, k).
        fine_time: of all instants, the samples among them (m,) [s].
        fine_q, fine_v, fine_a: at all instants (m, k).
    """

    time: Array
    q: Array
    v: Array
    a: Array
    fine_time: Array
    fine_q: Array
    fine_v: Array
    fine_a: Array


def fine_times(time: Array) -> Array:
    """The samples and `FINER` - 1 instants between each two of them."""
    shares = np.arange(FINER) / FINER
    between = time[:-1, None] + np.diff(time)[:, None] * shares
    return np.append(between.ravel(), time[-1])


def between(time: Array, value: Array, slope: Array, at: Array) -> Array:
    """Values at times (m,) between samples with slopes (n, ...), by cubics; a single sample stays as it is."""
    if time.size == 1:
        return np.repeat(value, at.size, axis=0)
    return np.asarray(CubicHermiteSpline(time, value, slope)(at))


def joint_series(robot: urdf.Robot, motion: SampledMotion, settings: CheckSettings) -> list[Bounded]:
    """Position, speed, acceleration, jerk, torque and singularity against the robot's limits.

    Speeds and accelerations are also taken from differences of the samples, so that columns which do not belong to each
    other, or a jump of the position, are seen.
    """
    names, limits, fine = robot.joint_names, robot.limits, motion.fine_time
    unit = [_unit(robot, name) for name in names]
    rate = unit[0] if len(set(unit)) == 1 else "rad or m"
    torque = JointTorque(robot, settings.load_mass, settings.springs)
    speed = _with_differences(motion.time, motion.q, fine, motion.fine_v)
    acceleration = _with_differences(motion.time, motion.v, fine, motion.fine_a)
    series = [
        Bounded.between("position", rate, names, fine, motion.fine_q, limits.lower, limits.upper),
        Bounded.between("velocity", f"{rate}/s", names, *speed, -limits.velocity, limits.velocity),
        Bounded.between("acceleration", f"{rate}/s^2", names, *acceleration, -limits.acceleration, limits.acceleration),
    ]
    if motion.time.size > 1:
        jerk = _differences(motion.time, motion.a)
        series.append(Bounded.between("jerk", f"{rate}/s^3", names, *jerk, -limits.jerk, limits.jerk))
    tau = torque(motion.fine_q, motion.fine_v, motion.fine_a)
    force = "N m" if rate == "rad" else "N m or N"
    series.append(Bounded.between("torque", force, names, fine, tau, -limits.effort, limits.effort))
    values = singular_values(robot, motion.fine_q)
    series.append(Bounded.between("singularity", "1", (robot.tool_frame,), fine, values, settings.singular_value))
    return series


def singular_values(robot: urdf.Robot, q: Array) -> Array:
    """Smallest singular value of the tool's Jacobian: what the tool gets of the joints' speed in its worst direction.

    Args:
        robot: the arm.
        q: postures (m, k).

    Returns:
        (m,).
    """
    data = robot.model.createData()
    jacobians = np.array(
        [
            # Pinocchio drops the second axis of a single joint.
            pin.computeFrameJacobian(robot.model, data, row, robot.tool_frame_id, pin.LOCAL_WORLD_ALIGNED).reshape(
                6, -1
            )
            for row in np.asarray(q, dtype=float)
        ]
    )
    # Of a single joint Pinocchio gives a vector.
    jacobians = jacobians.reshape(-1, 6, robot.model.nv)
    return np.asarray(np.linalg.svd(jacobians, compute_uv=False)[:, -1])


def off_line_series(
    robot: urdf.Robot, line: urdf.Line, motion: SampledMotion, settings: CheckSettings
) -> list[Bounded]:
    """How far the tool point is from the line, and how far the tool is turned."""
    data, offset = robot.model.createData(), np.asarray(robot.tool_offset)
    distance, tilt = [], []
    for row in motion.fine_q:
        pin.framesForwardKinematics(robot.model, data, row)
        pose = data.oMf[robot.tool_frame_id]
        aside = pose.act(offset) - line.origin
        distance.append(np.linalg.norm(aside - (aside @ line.direction) * line.direction))
        tilt.append(np.linalg.norm(pin.log3(line.rotation.T @ pose.rotation)))
    name = (robot.tool_frame,)
    return [
        Bounded.between("distance_off_line", "m", name, motion.fine_time, distance, -np.inf, settings.off_line),
        Bounded.between("tilt", "rad", name, motion.fine_time, tilt, -np.inf, settings.tilt),
    ]


def start_series(robot: urdf.Robot, motion: SampledMotion, at: Array, settings: CheckSettings) -> Bounded:
    """How far the first posture is from where the arm is.

    Args:
        robot: the arm.
        motion: to be checked.
        at: joint positions now (k,).
        settings: of the check.
    """
    apart = (motion.q[:1] - at)[:1]
    unit = "rad" if all(_unit(robot, name) == "rad" for name in robot.joint_names) else "rad or m"
    return Bounded.between("start", unit, robot.joint_names, motion.time[:1], apart, -settings.start, settings.start)


def _differences(time: Array, value: Array) -> tuple[Array, Array]:
    """Mean slope between samples, at the middle of each two."""
    return (time[1:] + time[:-1]) / 2.0, np.diff(value, axis=0) / np.diff(time)[:, None]


def _with_differences(time: Array, value: Array, fine: Array, slope: Array) -> tuple[Array, Array]:
    """The given slopes and the slopes of the values themselves, in order of time."""
    middle, mean = _differences(time, value)
    when, slopes = np.concatenate([fine, middle]), np.concatenate([slope, mean])
    order = np.argsort(when, kind="stable")
    return when[order], slopes[order]


def _unit(robot: urdf.Robot, joint: str) -> str:
    kind = robot.model.joints[robot.model.getJointId(joint)].shortname()
    return "m" if "JointModelP" in kind else "rad"
