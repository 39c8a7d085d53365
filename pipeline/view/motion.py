"""3-D scenes of motions: an arm from its joint positions, a load on a string from gripper and angle, or both."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from armdyn.errors import InputError
from armdyn.identify.fit import Fit
from armdyn.model import Model
from armdyn.recording.channels import Channel, FloatArray
from armdyn.run import Run
from pipeline.box import LOAD_RADIUS, Box
from pipeline.view.scene import (
    BODY_DARK,
    STEEL_COLOUR,
    WOOD_COLOUR,
    Mesh,
    Scene,
    SceneBody,
    TimeMark,
    ball_mesh,
    block_mesh,
    fixed_pose,
    frame_times,
    translated_poses,
)
from pipeline.view.shapes import ArmShapes
from urdf import Line, Robot

DRAWN_LENGTH_OF_UNKNOWN_STRING = 0.35
"""Drawn length of a string of unknown length [m]."""
VERTICAL_DIRECTION = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class LoadSwing:
    """Motion of a load on a string below a gripper.

    Attributes:
        gripper: position of the string's upper end along its line [m]; None if it does not move.
        angle: swing angle of the string, 0 for a hanging load [rad].
        length: length of the string [m].
        height: height of the string's upper end [m]; None if it is constant.
        note: sentences on an angle or a length that was not recorded; empty if both were.
    """

    gripper: Channel | None
    angle: Channel
    length: float
    height: Channel | None = None
    note: str = ""


def arm_scene(
    title: str,
    kind: str,
    links: ArmShapes,
    time: FloatArray,
    q: FloatArray,
    marks: Sequence[TimeMark] = (),
    note: str = "",
) -> Scene:
    """3-D scene of a moving arm.

    Args:
        title: title of the page.
        kind: kind of the scene, see `Scene`.
        links: shapes of the arm's links.
        time: times of the samples (n,) [s].
        q: joint positions (n, joints) [rad or m].
        marks: marked intervals of time.
        note: sentences for the viewer.
    """
    at = frame_times(float(time[0]), float(time[-1]))
    postures = _at(at, time, q)
    return Scene(
        title, kind, at, links.bodies(postures), trail=links.tool(postures), marks=marks,
        note=" ".join(filter(None, (note, links.note))),
    )  # fmt: skip


def joint_motion(run: Run, robot: Robot) -> tuple[FloatArray, FloatArray]:
    """Recorded joint positions of an arm; a joint that was not recorded stays at its home position.

    Returns:
        Times (n,) [s] and joint positions (n, joints) [rad or m].

    Raises:
        InputError: no joint of this arm was recorded.
    """
    known = [f"q.{joint}" for joint in robot.joint_names if f"q.{joint}" in run.channels]
    if not known:
        raise InputError(
            f"{run.source or run.name}: holds no joint of '{robot.name}' ({', '.join(robot.joint_names)}): "
            "give the robot that it was recorded of with --urdf"
        )
    time = run.channels[known[0]].time
    q = np.tile(robot.home, (len(time), 1))
    for i, joint in enumerate(robot.joint_names):
        if (channel := run.channels.get(f"q.{joint}")) is not None:
            q[:, i] = np.interp(time, channel.time, channel.value)
    return time, q


def swing_scene(title: str, kind: str, swing: LoadSwing) -> Scene:
    """3-D scene of a load on a string below a gripper on a rail.

    Args:
        title: title of the page.
        kind: kind of the scene, see `Scene`.
        swing: motion of gripper and load.
    """
    at = _frames_of(swing)
    pivot = np.column_stack([_follow(at, swing.gripper), np.zeros(len(at)), _follow(at, swing.height)])
    load = pivot + swing.length * _hanging(at, swing, np.array([1.0, 0.0, 0.0]))
    low, high = float(pivot[:, 0].min()) - 0.15, float(pivot[:, 0].max()) + 0.15
    rail = SceneBody("rail", [block_mesh((high - low, 0.012, 0.012), STEEL_COLOUR)],
                fixed_pose((0.5 * (low + high), 0.0, float(pivot[:, 2].max()) + 0.02)))  # fmt: skip
    bodies = [rail, SceneBody("gripper", [block_mesh((0.05, 0.035, 0.03), BODY_DARK)], translated_poses(pivot)),
              SceneBody("load", [ball_mesh(LOAD_RADIUS)], translated_poses(load))]  # fmt: skip
    return Scene(title, kind, at, bodies, [np.stack([pivot, load], axis=1)], load, note=swing.note)


def trial_scene(title: str, links: ArmShapes, run: Run, swing: LoadSwing, box: Box | None) -> Scene:
    """3-D scene of a trial: an arm that swings a load along its line into a box.

    Args:
        title: title of the page.
        links: shapes of the arm's links.
        run: recording of the trial.
        swing: motion of the load.
        box: the box; None for no box.
    """
    robot, at = links.robot, _frames_of(swing)
    postures = _at(at, *joint_motion(run, robot))
    line = robot.line
    pivot = links.tool(postures)
    load = pivot + swing.length * _hanging(at, swing, line.direction)
    bodies = [*links.bodies(postures), SceneBody("load", [ball_mesh(LOAD_RADIUS)], translated_poses(load))]
    if box is not None:
        bodies.append(SceneBody("box", _walls(line, box), fixed_pose(line.origin)))
    cords = [np.stack([pivot, load], axis=1)]
    return Scene(title, "trial", at, bodies, cords, load, note=" ".join(filter(None, (swing.note, links.note))))


def load_swing(run: Run, model: Model | None, fit: Fit | None = None) -> LoadSwing:
    """Motion of a recorded load, with its measured swing angle, or else with a model's prediction.

    Args:
        run: the recording.
        model: model that gives the length, and the angle if it was not measured; None for no model.
        fit: fit of this model to recordings that include this one; None to fit the model where a fit is needed.

    Raises:
        InputError: the angle was not measured, and no model predicts it.
    """
    values: Mapping[str, float] = {} if model is None else {n: model.value(n) for n in model.names}
    angle, note = run.channels.get("swing_angle"), ""
    if angle is None:
        if model is None or model.robot is not None:
            raise InputError(
                f"{run.source or run.name}: holds neither joints nor a swing angle: give the model of the load with "
                "--model M.toml, which says how it swings"
            )
        angle, values = _predicted_angle(run, model, fit)
        note = "The angle of the string is the model's: none was measured."
    known = run.known.get("length")
    length = known.value if known is not None else values.get("length")
    if length is None:
        length = DRAWN_LENGTH_OF_UNKNOWN_STRING
        note = f"{note} The length of the string is not known: drawn as {length} m.".strip()
    channels = run.channels
    return LoadSwing(channels.get("gripper_x"), angle, float(length), channels.get("gripper_z"), note)


def _predicted_angle(run: Run, model: Model, fit: Fit | None) -> tuple[Channel, Mapping[str, float]]:
    if fit is None:
        from armdyn.identify.studies import make_study

        fit = make_study(model, [run], [], []).first()
    problem = fit.problem
    index = [other.name for other in problem.runs].index(run.name)
    theta = problem.theta(index, fit.values)
    angle = problem.model.covariates(problem.runs[index], theta).get("swing_angle")
    if angle is None:
        raise InputError(f"{run.source or run.name}: the model of base '{model.base}' says no swing angle")
    return angle, dict(zip(problem.model.names, theta.tolist(), strict=True))


def _frames_of(swing: LoadSwing) -> FloatArray:
    start, end = float(swing.angle.time[0]), float(swing.angle.time[-1])
    if swing.gripper is not None:
        start, end = max(start, float(swing.gripper.time[0])), min(end, float(swing.gripper.time[-1]))
    return frame_times(start, end)


def _hanging(at: FloatArray, swing: LoadSwing, along: FloatArray) -> FloatArray:
    """Unit vectors from the upper end of the string to the load (k, 3)."""
    angle = _follow(at, swing.angle)
    return -np.sin(angle)[:, None] * along - np.cos(angle)[:, None] * VERTICAL_DIRECTION


def _follow(at: FloatArray, channel: Channel | None) -> FloatArray:
    return np.zeros(len(at)) if channel is None else np.interp(at, channel.time, channel.value)


def _at(at: FloatArray, time: FloatArray, q: FloatArray) -> FloatArray:
    return np.column_stack([np.interp(at, time, column) for column in q.T])


def _walls(line: Line, box: Box) -> list[Mesh]:
    walls = []
    for plate in box.plates(line):
        wall = block_mesh(
            (2.0 * plate.half).tolist(), WOOD_COLOUR, opacity=0.35 if plate.name in ("front", "back", "near") else 0.8
        )
        walls.append(Mesh(wall.vertices @ line.axes.T + plate.centre - line.origin, wall.faces, wall.colour,
                                wall.opacity))  # fmt: skip
    return walls
