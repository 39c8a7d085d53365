"""Trajectories from files, in the form of a recording."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import urdf
from armdyn.channels import Channel
from armdyn.errors import InputError, UnknownNameError
from armdyn.run import read_run
from pipeline.motion.feasibility.derive import differentiated
from pipeline.motion.feasibility.line_csv import is_line_csv, read_line_csv
from pipeline.motion.trajectory import JointTrajectory, LineTrajectory, check_samples

Array = NDArray[np.float64]

FAR_BEYOND = 2.0
"""How many times its range a joint must be beyond, to look as if it were written in degrees."""


def read_trajectory(path: Path | str, robot: urdf.Robot) -> JointTrajectory | LineTrajectory:
    """Read a motion of the joints, or else one along the line.

    Columns ``q.<joint>`` make a motion of the joints, ``s`` or ``gripper_x`` one along the line. Speeds and
    accelerations are taken from the file where it has them all, else derived by a smoothing spline.

    Args:
        path: a CSV file or a recording.
        robot: whose joints these are.

    Raises:
        InputError: names the file, what is wrong and what to do.
    """
    path = Path(path)
    try:
        if is_line_csv(path):
            columns = read_line_csv(path)
            time = columns.pop("time")
            check_samples(time, columns)
            return _line(time, columns["s"], columns.get("v"), columns.get("a"))
        channels = read_run(path).channels
        if any(name.startswith("q.") for name in channels):
            return _joints(channels, robot)
        if "gripper_x" in channels:
            return _line_of_run(channels)
    except InputError as error:
        text = str(error)
        raise InputError(text if text.startswith(str(path)) else f"{path}: {text}") from error
    raise InputError(
        f"{path}: no motion in it: add columns 'q.{robot.joint_names[0]} [rad]' and so on for every joint, or 's [m]'"
    )


def _line_of_run(channels: Mapping[str, Channel]) -> LineTrajectory:
    names = [name for name in ("gripper_x", "gripper_v", "gripper_a") if name in channels]
    time = _common_time(channels, names)
    values = {name: channels[name].value for name in names}
    return _line(time, values["gripper_x"], values.get("gripper_v"), values.get("gripper_a"))


def _line(time: Array, s: Array, v: Array | None, a: Array | None) -> LineTrajectory:
    derived = differentiated(time, s[:, None])
    if v is None:
        return LineTrajectory(time, derived.q[:, 0], derived.v[:, 0], derived.a[:, 0])
    return LineTrajectory(time, s, v, differentiated(time, v[:, None]).v[:, 0] if a is None else a)


def _joints(channels: Mapping[str, Channel], robot: urdf.Robot) -> JointTrajectory:
    for name in channels:
        kind, dot, joint = name.partition(".")
        if dot and kind in ("q", "v", "a") and joint not in robot.joint_names:
            raise UnknownNameError(f"joint of {robot.name}", joint, robot.joint_names)
    missing = [joint for joint in robot.joint_names if f"q.{joint}" not in channels]
    if missing:
        raise InputError(
            f"joint {', '.join(missing)} is missing: add a column 'q.{missing[0]} [rad]'; a joint that stands still "
            "has the same position in every row"
        )
    given = [kind for kind in ("q", "v", "a") if all(f"{kind}.{joint}" in channels for joint in robot.joint_names)]
    names = [f"{kind}.{joint}" for kind in given for joint in robot.joint_names]
    time = _common_time(channels, names)
    values = {
        kind: np.column_stack([channels[f"{kind}.{joint}"].value for joint in robot.joint_names]) for kind in given
    }
    units = [channels[f"q.{joint}"].unit for joint in robot.joint_names]
    _refuse_degrees(values["q"], units, robot)
    q = values["q"]
    if "v" not in given:
        return JointTrajectory(time, *differentiated(time, q), robot.joint_names)
    v = values["v"]
    return JointTrajectory(time, q, v, values["a"] if "a" in given else differentiated(time, v).v, robot.joint_names)


def _common_time(channels: Mapping[str, Channel], names: list[str]) -> Array:
    """The time stamps, which the channels must share.

    A recording leaves missing samples out, so a channel with fewer of them has holes.
    """
    fullest = max(names, key=lambda name: len(channels[name]))
    time = channels[fullest].time
    for name in names:
        if not np.array_equal(channels[name].time, time):
            missing = np.setdiff1d(time, channels[name].time)
            where = f" at {missing[0]:.6g} s" if missing.size else ""
            raise InputError(f"{name} has no sample{where}: a trajectory has no missing samples; fill them in")
    return time


def _refuse_degrees(q: Array, units: list[str], robot: urdf.Robot) -> None:
    """Refuse positions that are far beyond the joints' ranges as radians and within them as degrees."""
    lower, upper = robot.limits.lower, robot.limits.upper
    turning = np.array([unit == "rad" for unit in units]) & np.isfinite(lower) & np.isfinite(upper)
    if not np.any(turning):
        return
    widest = np.maximum(np.abs(lower), np.abs(upper))
    reached = np.max(np.abs(q), axis=0)
    far = turning & (reached > FAR_BEYOND * widest)
    as_degrees = np.radians(q)
    inside = np.all((as_degrees >= lower) & (as_degrees <= upper), axis=0) | ~turning
    if np.any(far) and np.all(inside):
        joint = int(np.argmax(np.where(far, reached, 0.0)))
        name = robot.joint_names[joint]
        raise InputError(
            f"q.{name} reaches {reached[joint]:.4g} rad, where its limit is {widest[joint]:.4g} rad: this looks like "
            f"degrees; write the columns as 'q.{name} [deg]', or convert them"
        )
