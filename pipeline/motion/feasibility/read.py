"""Trajectories from files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.interpolate import UnivariateSpline, make_interp_spline

import urdf
from armdyn.channels import Channel
from armdyn.csv_run import read_csv
from armdyn.differences import normalised_differences
from armdyn.errors import InputError, UnknownNameError
from armdyn.run import read_run
from pipeline.motion.trajectory import JointTrajectory, LineTrajectory
from urdf.robot import Array

ORDER = 6
"""Order of the differences in which noise remains and motion vanishes: of a swing at 1 Hz, sampled at 100 Hz, 1e-7."""

EVEN = 0.01
"""Unevenness of the sampling up to which the differences can be used [1]."""


def differentiated(time: Array, position: Array) -> tuple[Array, Array, Array]:
    """Speed and acceleration by a quintic smoothing spline for the noise that the positions have.

    The noise is taken from sixth differences, so that rounding is smoothed away and a clean motion is left alone.

    Args:
        time: (n,), increasing [s].
        position: (n, k).

    Returns:
        Smoothed positions, speeds, accelerations, (n, k) each.
    """
    columns = [_differentiated(time, column) for column in position.T]
    q, v, a = (np.column_stack([column[order] for column in columns]) for order in range(3))
    return q, v, a


def noise(time: Array, position: Array) -> float:
    """Standard deviation of the noise of positions, 0 where it cannot be estimated.

    Args:
        time: (n,) [s].
        position: (n,).

    Returns:
        In the unit of the positions. Source: robust difference estimator, Gasser et al., Biometrika 73 (1986) 625.
    """
    steps = np.diff(time)
    if time.size < 4 * ORDER or np.ptp(steps) > EVEN * np.mean(steps):
        return 0.0
    return float(np.nanmedian(np.abs(normalised_differences(time, position, ORDER))) / 0.6745)


def _differentiated(time: Array, column: Array) -> tuple[Array, Array, Array]:
    if np.ptp(column) == 0.0:
        return column, np.zeros_like(column), np.zeros_like(column)
    if time.size < ORDER:
        v = np.gradient(column, time)
        return column, v, np.gradient(v, time)
    std = noise(time, column)
    # Below this the differences show only the rounding of floats, which a smoothing spline cannot follow.
    if std < 1e-10 * np.max(np.abs(column)):
        spline = make_interp_spline(time, column, k=5)
        return column, spline.derivative(1)(time), spline.derivative(2)(time)
    smooth = UnivariateSpline(time, column, k=5, s=time.size * std**2)
    return smooth(time), smooth.derivative(1)(time), smooth.derivative(2)(time)


UNITS = {"time": "s", "s": "m", "v": "m/s", "a": "m/s^2"}


def is_line_csv(path: Path) -> bool:
    """Whether a file is text whose header has a column ``s``."""
    try:
        with path.open(encoding="utf-8-sig") as file:
            header = file.readline()
    except (OSError, UnicodeDecodeError):
        return False
    return "s" in [cell.partition("[")[0].strip().strip('"') for cell in header.split(",")]


FAR_BEYOND = 2.0
"""Times its range beyond which a joint position is taken for degrees."""


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
            return _line(read_csv(path, UNITS), ("s", "v", "a"))
        channels = read_run(path).channels
        if any(name.startswith("q.") for name in channels):
            return _joints(channels, robot)
        if "gripper_x" in channels:
            return _line(channels, ("gripper_x", "gripper_v", "gripper_a"))
    except InputError as error:
        text = str(error)
        raise InputError(text if text.startswith(str(path)) else f"{path}: {text}") from error
    raise InputError(
        f"{path}: no motion in it: add columns 'q.{robot.joint_names[0]} [rad]' and so on for every joint, or 's [m]'"
    )


def _line(channels: Mapping[str, Channel], names: tuple[str, str, str]) -> LineTrajectory:
    """The motion of the channels that hold position, speed and acceleration, of which the last two may be missing."""
    time = _common_time(channels, [name for name in names if name in channels])
    s = channels[names[0]].value
    v, a = (channels[name].value if name in channels else None for name in names[1:])
    if v is None:
        return LineTrajectory(time, *(column[:, 0] for column in differentiated(time, s[:, None])))
    return LineTrajectory(time, s, v, differentiated(time, v[:, None])[1][:, 0] if a is None else a)


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
    return JointTrajectory(time, q, v, values["a"] if "a" in given else differentiated(time, v)[1], robot.joint_names)


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
