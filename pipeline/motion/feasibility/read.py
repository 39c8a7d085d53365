"""Read the trajectory of an arm's joints, or of its tool along the line, from a file."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy.interpolate import UnivariateSpline, make_interp_spline

import urdf
from armdyn.errors import InputError, UnknownNameError, error_location
from armdyn.inspection.kinematics import joint_in_degrees
from armdyn.recording.channels import Channel
from armdyn.recording.csv_run import read_csv
from armdyn.recording.noise import noise_std_from_differences
from armdyn.recording.units import to_base_units
from armdyn.run import Run, read_run
from pipeline.motion.trajectory import AT_REST, EndVelocities, JointTrajectory, LineTrajectory
from urdf.robot import Array

NOISE_DIFFERENCE_ORDER = 6
"""Order of the differences from which noise is estimated; a motion at 1 Hz, sampled at 100 Hz, contributes 1e-7."""


def smooth_and_differentiate(time: Array, position: Array) -> tuple[Array, Array, Array]:
    """Smooth positions (n, k) at increasing times (n,) [s], and compute velocities and accelerations.

    A quintic smoothing spline is fitted. The noise of the positions is estimated from their sixth differences, so that
    a motion without noise is not changed.

    Returns:
        Smoothed positions, velocities and accelerations, (n, k) each.
    """

    def column(x: Array) -> tuple[Array, Array, Array]:
        if np.ptp(x) == 0.0:
            return x, np.zeros_like(x), np.zeros_like(x)
        if time.size < NOISE_DIFFERENCE_ORDER:
            v = np.gradient(x, time)
            return x, v, np.gradient(v, time)
        std = noise_std_from_differences(time, x, NOISE_DIFFERENCE_ORDER)
        # Below this the differences show only the rounding of floats, which a smoothing spline cannot follow.
        if std < 1e-10 * np.max(np.abs(x)):
            spline = make_interp_spline(time, x, k=5)
        else:
            spline = UnivariateSpline(time, x, k=5, s=time.size * std**2)
            x = spline(time)
        return x, spline.derivative(1)(time), spline.derivative(2)(time)

    q, v, a = (np.column_stack(parts) for parts in zip(*map(column, position.T), strict=True))
    return q, v, a


def read_waypoints(source: Path | str | Run, robot: urdf.Robot) -> tuple[Array, EndVelocities]:
    """Read the positions of a path of the joints, (n, joints) [rad or m], and its velocities at both ends.

    Its times do not matter. Without recorded velocities the ends are at rest. Files are those of `read_trajectory`, CSV
    files without a time, and JSON files of a trajectory of ROS: a message ``trajectory_msgs/JointTrajectory``, as
    ``ros2_control`` takes it, or one that contains it, as MoveIt's.

    Raises:
        InputError: the file is not a path of this robot's joints.
    """
    if not isinstance(source, Run):
        path = Path(source)
        if path.suffix.lower() == ".json":
            with error_location(path):
                return _message_positions(path, robot)
        if path.suffix.lower() == ".csv" and "time" not in _header(path):
            with error_location(path):
                return _table_positions(path, robot)
    motion = read_trajectory(source, robot)
    if isinstance(motion, LineTrajectory):
        raise InputError(f"{source}: a motion along the line has no joints to retime: 'armdyn check' without --retime")
    run = source if isinstance(source, Run) else read_run(source)
    recorded = all(f"v.{joint}" in run.channels for joint in robot.joint_names)
    return motion.q, EndVelocities(motion.v[0], motion.v[-1]) if recorded else AT_REST


def _header(path: Path) -> list[str]:
    """Names of the columns of a CSV file, without their units."""
    try:
        with path.open(encoding="utf-8-sig") as file:
            return [cell.partition("[")[0].strip().strip('"') for cell in file.readline().split(",")]
    except (OSError, UnicodeDecodeError):
        return ["time"]  # the reader of recordings says what is wrong


def _table_positions(path: Path, robot: urdf.Robot) -> tuple[Array, EndVelocities]:
    """Positions in the columns of a CSV file, in the units of its first row, and velocities at its ends."""
    first, *rest = (row for row in path.read_text(encoding="utf-8-sig").splitlines() if row.strip())
    columns = dict[str, tuple[int, float]]()
    for k, cell in enumerate(first.split(",")):
        name, _, unit = cell.strip().strip('"').partition("[")
        if name.startswith(("q.", "v.")):
            usual = "rad" if name.startswith("q.") else "rad/s"
            columns[name.strip()] = k, to_base_units(unit.strip(" ]") or usual)[1]
    missing = [joint for joint in robot.joint_names if f"q.{joint}" not in columns]
    if missing:
        raise InputError(f"joint {', '.join(missing)} is missing: add a column 'q.{missing[0]} [rad]'")
    try:
        rows = np.array([[float(cell) for cell in row.split(",")] for row in rest])
    except ValueError as error:
        raise InputError(f"each row needs {first.count(',') + 1} numbers: {error}") from error
    if rows.ndim != 2 or not np.isfinite(rows).all():
        raise InputError("give two rows or more, with a finite number in every column")
    q, v = (
        [rows[:, k] * factor for k, factor in (columns[name] for name in names if name in columns)]
        for names in ([f"{kind}.{joint}" for joint in robot.joint_names] for kind in "qv")
    )
    ends = EndVelocities(*np.array(v).T[[0, -1]]) if len(v) == len(q) else AT_REST
    return np.column_stack(q), ends


def _message_positions(path: Path, robot: urdf.Robot) -> tuple[Array, EndVelocities]:
    """Positions of a message in a JSON file, and velocities of its first and last point."""
    try:
        message = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, ValueError) as error:
        raise InputError(f"it cannot be read as JSON: {error}") from error
    while isinstance(message, Mapping) and "points" not in message:
        inner = [part for name in ("joint_trajectory", "trajectory", "goal") if (part := message.get(name))]
        message = (inner[0][0] if isinstance(inner[0], list) else inner[0]) if inner else None
    try:
        names = [str(name) for name in message["joint_names"]]
        q = np.array([[float(x) for x in point["positions"]] for point in message["points"]])
        outer = [message["points"][i] for i in (0, -1) if message["points"]]
        ends = [[float(x) for x in point.get("velocities") or [0.0] * len(names)] for point in outer]
    except (TypeError, KeyError, ValueError) as error:
        raise InputError("it is not a trajectory: give 'joint_names' and 'points' with 'positions'") from error
    missing = [joint for joint in robot.joint_names if joint not in names]
    if missing:
        raise InputError(f"joint {', '.join(missing)} is missing in its joint_names")
    if q.ndim != 2 or q.shape[1] != len(names) or not np.isfinite(q).all():
        raise InputError(f"each point needs {len(names)} finite positions, one for each of its joint_names")
    if any(len(v) != len(names) or not np.isfinite(v).all() for v in ends):
        raise InputError(f"its first and last point need {len(names)} finite velocities, or none")
    order = [names.index(joint) for joint in robot.joint_names]
    return q[:, order], EndVelocities(*(np.array(v)[order] for v in ends))


LINE_COLUMN_UNITS = {"time": "s", "s": "m", "v": "m/s", "a": "m/s^2"}
"""SI unit of each column in the file of a motion along the line."""


def is_line_csv(path: Path) -> bool:
    """Whether a file is a CSV file of a motion along the line, with a column ``s``."""
    return "s" in _header(path)


def read_trajectory(source: Path | str | Run, robot: urdf.Robot) -> JointTrajectory | LineTrajectory:
    """Read a motion of the joints, or of the tool along the line, from a CSV file or a recording.

    Columns ``q.<joint>`` are a motion of the joints; a column ``s`` or ``gripper_x`` is a motion along the line.
    Velocities and accelerations are read from the file if it contains all of them, else computed by a smoothing spline.

    Args:
        source: the file, or a recording in memory.
        robot: the robot, whose joints the columns belong to.

    Raises:
        InputError: the file is not a motion of this robot; the message says what is wrong and what to do.
    """
    with error_location(source.name if isinstance(source, Run) else source):
        if not isinstance(source, Run) and is_line_csv(Path(source)):
            return _line(read_csv(Path(source), LINE_COLUMN_UNITS), ("s", "v", "a"))
        channels = (source if isinstance(source, Run) else read_run(source)).channels
        if any(name.startswith("q.") for name in channels):
            return _joints(channels, robot)
        if "gripper_x" in channels:
            return _line(channels, ("gripper_x", "gripper_v", "gripper_a"))
        raise InputError(
            f"no motion in it: add columns 'q.{robot.joint_names[0]} [rad]' and so on for every joint, or 's [m]'"
        )


def _line(channels: Mapping[str, Channel], names: tuple[str, str, str]) -> LineTrajectory:
    time, *parts = _sample(channels, [(name,) for name in names])
    return LineTrajectory(time, *(part[:, 0] for part in parts))


def _joints(channels: Mapping[str, Channel], robot: urdf.Robot) -> JointTrajectory:
    for name in channels:
        kind, dot, joint = name.partition(".")
        if dot and kind in ("q", "v", "a") and joint not in robot.joint_names:
            other = "; of another robot: --model M.toml or --urdf ROBOT.urdf"
            raise UnknownNameError(f"joint of {robot.name}", joint, robot.joint_names, other)
    _require_joints(channels, robot)
    names = [[f"{kind}.{joint}" for joint in robot.joint_names] for kind in "qva"]
    _refuse_degrees(channels, robot)
    return JointTrajectory(*_sample(channels, names), robot.joint_names)


def _require_joints(channels: Mapping[str, Channel], robot: urdf.Robot) -> None:
    missing = [joint for joint in robot.joint_names if f"q.{joint}" not in channels]
    if missing:
        raise InputError(
            f"joint {', '.join(missing)} is missing: add a column 'q.{missing[0]} [rad]'; a joint that stands still "
            "has the same position in every row"
        )


def _sample(channels: Mapping[str, Channel], kinds: Sequence[Sequence[str]]) -> tuple[Array, Array, Array, Array]:
    """Time (n,), positions, velocities and accelerations (n, k) from channels; `kinds` are the names of each kind.

    Velocities and accelerations that are not recorded are computed.
    """
    given = [kind for kind in kinds if all(name in channels for name in kind)]
    names = [name for kind in given for name in kind]
    time = channels[max(names, key=lambda name: len(channels[name]))].time
    for name in names:
        if not np.array_equal(channels[name].time, time):
            missing = np.setdiff1d(time, channels[name].time)
            where = f" at {missing[0]:.6g} s" if missing.size else ""
            raise InputError(f"{name} has no sample{where}: a trajectory has no missing samples; fill them in")
    values = [np.column_stack([channels[name].value for name in kind]) for kind in given]
    if kinds[1] not in given:
        return time, *smooth_and_differentiate(time, values[0])
    q, v, *a = values
    return time, q, v, a[0] if a else smooth_and_differentiate(time, v)[1]


def _refuse_degrees(channels: Mapping[str, Channel], robot: urdf.Robot) -> None:
    """Refuse positions that exceed the joints' ranges by far as radians, and are within them as degrees."""
    found = joint_in_degrees(channels, robot)
    if found is not None:
        name, far, widest = found
        raise InputError(
            f"q.{name} reaches {far:.4g} rad, where its limit is {widest:.4g} rad: this looks like degrees; write the "
            f"columns as 'q.{name} [deg]', or convert them"
        )
