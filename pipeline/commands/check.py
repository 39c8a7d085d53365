"""The command `armdyn check`: check whether a trajectory is feasible; if not, which limit, which joint, and when."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armdyn.document import NextStep
from armdyn.errors import InputError, error_location
from armdyn.quoting import shell_quoted_command
from pipeline.console.options import (
    ArmModelOption,
    EffectsOption,
    JsonOption,
    ReportOption,
    RobotChoice,
    parse_number_list,
    parse_option_quantity,
)
from pipeline.console.outputs import check_outputs
from pipeline.console.screen import finish_command, progress_display

if TYPE_CHECKING:
    import urdf
    from pipeline.motion.feasibility.as_modelled import ModelledArm
    from pipeline.motion.trajectory import JointTrajectory, LineTrajectory

HELP_PANEL = "Motions of an arm"
LIMITS_OF_SPEED = {"velocity", "acceleration", "jerk", "torque"}
"""Limits that a slower motion may keep."""


def check(
    trajectory: Annotated[
        Path,
        typer.Argument(help="CSV or recording with 'time [s]' and `q.<joint> [rad]` for each joint, or with 's [m]'."),
    ],
    choice: RobotChoice,
    model: ArmModelOption = None,
    effects: EffectsOption = None,
    load_mass: Annotated[str, typer.Option(help="Mass of the load at the tool, such as '80 g'.")] = "0 kg",
    springs: Annotated[
        bool | None,
        typer.Option(
            "--springs/--no-springs", help="Whether the robot's gravity springs help; by default as in its settings."
        ),
    ] = None,
    box: Annotated[
        bool | None,
        typer.Option(
            "--box/--no-box",
            help="Whether the box and table of the task are obstacles; by default if the tool starts on the line.",
        ),
    ] = None,
    on_line: Annotated[bool, typer.Option("--on-line", help="The tool must stay on the robot's line.")] = False,
    start: Annotated[
        str | None, typer.Option(help="Present joint positions of the arm [rad], separated by commas.")
    ] = None,
    ros: Annotated[
        str | None,
        typer.Option("--ros", help="Address of the arm's rosbridge, ws://HOST:9090, to read its present position."),
    ] = None,
    retime: Annotated[
        Path | None,
        typer.Option(
            "--retime",
            metavar="OUT.csv",
            help="File for the same path at the fastest feasible speed; it is what is checked then. "
            "TRAJECTORY may be waypoints without times, or a JSON of MoveIt's or ros2_control's; velocities in it, "
            "`v.<joint>`, hold at its ends, which are at rest without any.",
        ),
    ] = None,
    start_velocity: Annotated[
        str | None,
        typer.Option(
            help="Velocities of the joints at the start of a retimed motion [rad/s], separated by commas; 0 is rest."
        ),
    ] = None,
    end_velocity: Annotated[str | None, typer.Option(help="The same at its end.")] = None,
    report: ReportOption = None,
    json_file: JsonOption = None,
) -> int:
    """Check whether a trajectory is feasible on the arm: exit status 0 if it is, 1 if not."""
    import numpy as np

    import urdf
    from armdyn.atomic import write_text
    from armdyn.recording.csv_run import csv_text
    from ik import default_table
    from pipeline.box import Box
    from pipeline.motion.feasibility import CheckSettings, box_and_table_obstacles, check_joints, check_line
    from pipeline.motion.feasibility.check import joint_position_units
    from pipeline.motion.feasibility.read import read_trajectory, read_waypoints
    from pipeline.motion.retime import retimed_on_arm
    from pipeline.motion.trajectory import EndVelocities, JointTrajectory, LineTrajectory
    from pipeline.report.feasibility import feasibility_document, feasibility_report

    mass = parse_option_quantity(load_mass, "kg", "--load-mass").value
    if mass < 0.0:
        raise InputError(f"--load-mass {load_mass}: a mass is not negative")
    if model is not None and (choice or mass > 0.0 or springs is not None):
        raise InputError("--model holds robot, load and springs: leave out --robot, --urdf, --load-mass and --springs")
    if retime is None and (start_velocity or end_velocity):
        raise InputError("--start-velocity and --end-velocity are for a motion that is retimed: add --retime OUT.csv")
    check_outputs(
        retime, report, json_file, inputs=[trajectory, *(file for file in (model, effects) if file is not None)]
    )
    with progress_display() as say:
        say("reading the robot")
        known = choice.robot or "baxter"
        modelled = None if model is None else _modelled(model, effects)
        if modelled is not None:
            arm = modelled.model.robot
        else:
            arm = urdf.load(known) if choice.urdf_file is None else urdf.load(choice.urdf_file, meshes=False)
        line = arm.line_or_none
        if (on_line or box) and line is None:
            option = "--on-line" if on_line else "--box"
            raise InputError(f"{option}: robot '{arm.name}' has no line in its settings: choose a robot that has one")
        motion: JointTrajectory | LineTrajectory
        if retime is None:
            motion = read_trajectory(trajectory, arm)
        else:
            say("looking for the fastest feasible speed")
            unobstructed = CheckSettings(load_mass=mass, springs=springs, modelled=modelled)
            points, ends = read_waypoints(trajectory, arm)
            ends = EndVelocities(
                *(
                    recorded
                    if told is None
                    else np.array(parse_number_list(len(points[0]), told, option, arm.joint_names))
                    for recorded, told, option in (
                        (ends.start, start_velocity, "--start-velocity"),
                        (ends.end, end_velocity, "--end-velocity"),
                    )
                )
            )
            rests = ends.are_rest(arm.limits.velocity)
            motion = retimed_on_arm(arm, points, ends, unobstructed)
        near = line is not None and (on_line or _starts_on(line, motion, arm))
        obstacles = box_and_table_obstacles(line, Box()) if line is not None and (near if box is None else box) else ()
        settings = CheckSettings(load_mass=mass, springs=springs, obstacles=obstacles, modelled=modelled)
        if not (near or isinstance(motion, LineTrajectory)):
            settings = replace(settings, min_singular_value=0.0)  # joint motions may pass singularities
        at = (
            (None if start is None else parse_number_list(len(arm.joint_names), start, "--start", arm.joint_names))
            if ros is None
            else _where(ros, known, start, arm)
        )
        say("checking the motion on the whole arm")
        if isinstance(motion, LineTrajectory):
            result = check_line(default_table(arm), arm, motion, settings, at=at)
        else:
            result = check_joints(arm, motion, settings, line=line if on_line else None, at=at)
    written, answer = list[str](), result.to_json
    if retime is not None and isinstance(motion, JointTrajectory) and result.feasible:
        write_text(retime, csv_text(motion.channels(joint_position_units(arm))))
        seconds = float(motion.time[-1])
        between = "from rest to rest" if rests else "with the velocities that are given at its ends"
        written.append(f"{seconds:.3f} s {between}, written to {retime}")

        def answer() -> dict[str, Any]:
            return result.to_json() | {"retimed": {"seconds": seconds, "output": str(retime)}}

    title, steps = f"Feasibility of {trajectory.name}", list[NextStep]()
    broken = {violation.limit for violation in result.violations}
    if retime is None and broken and broken <= LIMITS_OF_SPEED:
        chosen = {"--model": model, "--effects": effects, "--robot": choice.robot, "--urdf": choice.urdf_file}
        chosen["--load-mass"] = load_mass if mass > 0.0 else None
        own = [word for option, value in chosen.items() if value is not None for word in (option, value)]
        own += [] if springs is None else ["--springs" if springs else "--no-springs"]
        steps = [NextStep("retime it", shell_quoted_command("check", trajectory, *own, "--retime", "retimed.csv"))]
    finish_command(
        replace(feasibility_document(result, title), next_steps=steps),
        answer,
        json_file,
        report,
        lambda: feasibility_report(result, title),
        written,
    )
    return 0 if result.feasible else 1


def _modelled(model: Path, effects: Path | None) -> "ModelledArm":
    """The arm of a model file."""
    from armdyn.effects.user import load_effects
    from armdyn.model_file import read_model_file
    from pipeline.motion.feasibility.as_modelled import ModelledArm

    with error_location(model):
        return ModelledArm.of_file(read_model_file(model, load_effects(effects)))


MAX_DISTANCE_TO_COUNT_AS_ON_LINE = 0.05
"""Largest distance from the robot's line at which the tool counts as being on the line [m]."""


def _starts_on(line: "urdf.Line", motion: "LineTrajectory | JointTrajectory", arm: "urdf.Robot") -> bool:
    """Whether a motion begins on the robot's line, where the box and table of its task are."""
    import numpy as np

    from pipeline.motion.trajectory import LineTrajectory

    if isinstance(motion, LineTrajectory):
        return True
    aside = arm.tool_pose(motion.q[0]).translation - line.origin
    along = float(np.clip(aside @ line.direction, line.s_min, line.s_max))
    return bool(np.linalg.norm(aside - along * line.direction) < MAX_DISTANCE_TO_COUNT_AS_ON_LINE)


def _where(uri: str, robot: str, start: str | None, arm: "urdf.Robot") -> "list[float]":
    """Read the present joint positions of an arm from its rosbridge."""
    from pipeline.ros.states import present_joint_state
    from pipeline.ros.topics import read_topics, settings_file

    if start is not None:
        raise InputError("--start and --ros: give one of them")
    at = present_joint_state(uri, arm.joint_names, read_topics(settings_file(robot)).joint_states)
    return [float(angle) for angle in at.q]
