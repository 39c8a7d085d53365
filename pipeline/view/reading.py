"""3-D scene of the motion in a file: a recording, a trajectory, an IK table or a trial."""

from pathlib import Path

import numpy as np

import urdf
from armdyn.errors import InputError
from armdyn.model import Model
from armdyn.recording.channels import FloatArray
from armdyn.run import Run, read_run
from pipeline.box import Box
from pipeline.motion.feasibility.read import is_line_csv
from pipeline.view.motion import arm_scene, joint_motion, load_swing, swing_scene, trial_scene
from pipeline.view.scene import Scene, TimeMark
from pipeline.view.shapes import arm_shapes

MAX_VIOLATION_MARKS = 200
"""Largest number of marked violations of limits in the scene of a trajectory."""
IK_TABLE_PLAYBACK_SPEED = 0.15
"""Speed at which the scene of an IK table follows the path [m/s]."""


def scene_of_file(path: Path, model: Model | None = None, robot: urdf.Robot | None = None) -> Scene:
    """3-D scene of the motion in a file.

    Args:
        path: recording (CSV, MCAP), trajectory of joints or along a robot's line (CSV), IK table (npz), or the folder
            or MCAP file of a trial.
        model: model of the load, or of the arm whose joints were recorded; None for no model.
        robot: description of the robot; None for that of the model, or for a known robot with the recorded joints.

    Raises:
        InputError: the file cannot be read, or the moving robot or load is unknown.
    """
    if path.is_dir():
        path = _trial_in(path)
    if robot is None and model is not None:
        robot = model.robot
    if path.suffix.lower() == ".npz":
        return _table(path, robot)
    if path.suffix.lower() == ".csv" and is_line_csv(path):
        return _trajectory(path, robot or _known("baxter"), model)
    run = read_run(path)
    if (model is None and not run.joints) or "gripper_x" in run.channels:
        model = _model_beside(path, model)
    if not run.joints:
        return swing_scene(path.name, "run", load_swing(run, model))
    robot = robot or _robot_of(run)
    if {"gripper_x", "load_force"} <= set(run.channels):
        if robot.line_or_none is not None:
            swing = load_swing(run, None if model is None or model.robot is not None else model)
            return trial_scene(path.parent.name or path.name, arm_shapes(robot), run, swing, Box())
    elif not any(name.startswith("tau.") for name in run.channels) and set(robot.joint_names) <= set(run.joints):
        return _trajectory(path, robot, model)
    return arm_scene(path.name, "run", arm_shapes(robot), *joint_motion(run, robot))


def _trial_in(folder: Path) -> Path:
    for name in ("trial.mcap", "trial.csv"):
        if (folder / name).is_file():
            return folder / name
    raise InputError(f"{folder} is a directory without a trial: give a run, a trajectory, a table or a trial's folder")


def _model_beside(path: Path, model: Model | None) -> Model | None:
    """The given model, or else the model that a trial wrote beside its recording."""
    beside = path.parent / "model.toml"
    if model is not None or not beside.is_file():
        return model
    from armdyn.model_file import read_model

    return read_model(beside)


def _trajectory(path: Path, robot: urdf.Robot, model: Model | None) -> Scene:
    """Scene of a trajectory of joints or along the robot's line, with the check's verdict and marks at violations."""
    from armdyn.arm.model import ArmModel
    from ik import default_table
    from pipeline.motion.feasibility import CheckSettings, check_joints, check_line
    from pipeline.motion.feasibility.as_modelled import ModelledArm
    from pipeline.motion.feasibility.read import read_trajectory
    from pipeline.motion.trajectory import LineTrajectory

    arm = None if model is None else model.capability(ArmModel)
    modelled = None if arm is None or arm.robot is not robot else ModelledArm(arm, np.zeros(len(arm.joints)))
    motion, settings = read_trajectory(path, robot), CheckSettings(collision=False, modelled=modelled)
    if isinstance(motion, LineTrajectory):
        table = default_table(robot)
        beyond = np.flatnonzero((motion.s < table.s[0]) | (motion.s > table.s[-1]))
        if len(beyond):
            where = beyond[0]
            raise InputError(
                f"{path}: s is {motion.s[where]:.3g} m at {motion.time[where]:.3g} s, beyond the line of "
                f"'{robot.name}' from {table.s[0]:.3g} to {table.s[-1]:.3g} m"
            )
        found, q = check_line(table, robot, motion, settings), table.posture(motion.s).q
    else:
        found, q = check_joints(robot, motion, settings), motion.q
    marks = [
        TimeMark(
            v.time, v.time, f"{v.limit}{f' of {v.joint}' if v.joint else ''}: {v.value:.3g} of {v.bound:.3g} {v.unit}"
        )
        for v in found.violations[:MAX_VIOLATION_MARKS]
    ]
    note = f"{found.sentence} Collisions are not checked here: 'armdyn check' does."
    return arm_scene(path.name, "trajectory", arm_shapes(robot), motion.time, q, marks, note)


def _table(path: Path, robot: urdf.Robot | None) -> Scene:
    from ik import PathTable

    table = PathTable.load(path, robot)
    if robot is None:
        robot = _known(table.robot_name)
    s = np.concatenate([table.s, table.s[-2::-1]])
    q: FloatArray = np.concatenate([table.q, table.q[-2::-1]])
    time = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(s)))]) / IK_TABLE_PLAYBACK_SPEED
    note = f"The path of the table at {IK_TABLE_PLAYBACK_SPEED} m/s, there and back."
    return arm_scene(path.name, "table", arm_shapes(robot), time, q, note=note)


def _known(name: str) -> urdf.Robot:
    try:
        return urdf.load(name, meshes=False)
    except urdf.UrdfError as error:
        raise InputError(f"{error}: say which robot it is with --urdf FILE") from error


def _robot_of(run: Run) -> urdf.Robot:
    from urdf.loader import known_robots

    for name in known_robots():
        robot = urdf.load(name, meshes=False)
        if set(robot.joint_names) & set(run.joints):
            return robot
    raise InputError(
        f"{run.source or run.name}: no known robot has a joint '{run.joints[0]}': say which it is with --urdf FILE or "
        "--model M.toml"
    )
