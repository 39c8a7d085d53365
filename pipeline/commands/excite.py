"""The command `armdyn excite`: design a motion of an arm that determines or distinguishes chosen effects."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from armdyn.document import MAX_CARD_ROWS, NextStep
from armdyn.errors import InputError, error_location
from armdyn.quoting import shell_quoted_command
from pipeline.console.options import (
    ArmModelOption,
    EffectsOption,
    JointsOption,
    JsonOption,
    ReportOption,
    RobotChoice,
    ToolOption,
    split_names,
)
from pipeline.console.outputs import check_outputs
from pipeline.console.screen import finish_command, progress_display

if TYPE_CHECKING:
    from armdyn.arm.model import ArmModel
    from armdyn.effects.effect import Effect
    from armdyn.experiments.goal import MotionGoal

HELP_PANEL = "Motions of an arm"


MIN_EXCITE_SECONDS, MAX_EXCITE_SECONDS = 2.0, 600.0
"""Shortest and longest designed motion [s]; a motion above 20 s repeats a period of 20 s."""
MIN_SAMPLE_RATE, MAX_SAMPLE_RATE = 20.0, 1000.0
"""Lowest and highest rate of samples of a designed motion [Hz]; torques are compared below 10 Hz."""
MAX_RANDOM_MOTIONS = 1000


def excite(
    output: Annotated[
        Path,
        typer.Option(
            "--output", "--out", help="CSV file to write, with position, velocity and acceleration of every joint."
        ),
    ],
    choice: RobotChoice,
    model_file: ArmModelOption = None,
    joints: JointsOption = None,
    tool: ToolOption = None,
    wanted: Annotated[
        str | None,
        typer.Option(
            "--for",
            metavar="EFFECT[:JOINT,...],...",
            help="Effects to determine, on some joints or on all; by default friction, offsets and inertias.",
        ),
    ] = None,
    rivals: Annotated[
        str | None,
        typer.Option(metavar="A,B", help="Two effects to distinguish, in place of --for; joints are written as there."),
    ] = None,
    effects_file: EffectsOption = None,
    seconds: Annotated[
        float,
        typer.Option(min=MIN_EXCITE_SECONDS, max=MAX_EXCITE_SECONDS, help="Duration of the motion [s]."),
    ] = 20.0,
    rate: Annotated[float, typer.Option(min=MIN_SAMPLE_RATE, max=MAX_SAMPLE_RATE, help="Samples per second.")] = 100.0,
    random: Annotated[
        int,
        typer.Option(
            min=1,
            max=MAX_RANDOM_MOTIONS,
            help="Number of random motions; the design starts from the best and is compared with it.",
        ),
    ] = 100,
    compare: Annotated[
        bool,
        typer.Option(
            "--compare/--no-compare", help="Compare the design with the motion of the smallest condition number."
        ),
    ] = True,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random motions.")] = 0,
    report: ReportOption = None,
    json_file: JsonOption = None,
) -> int:
    """Design the motion of an arm that determines chosen effects best, or distinguishes two effects."""
    if model_file is None:
        choice.require_robot()
    elif choice or joints is not None or tool is not None:
        raise InputError("--model holds robot, joints and tool: leave out --robot, --urdf, --joints and --tool")
    if wanted is not None and rivals is not None:
        raise InputError("a motion determines effects or tells two apart: give one of --for and --rivals")
    inputs = [file for file in (choice.urdf_file, effects_file, model_file) if file is not None]
    check_outputs(output, report, json_file, inputs=inputs)
    with progress_display() as say:
        from armdyn.arm.model import arm_model
        from armdyn.atomic import write_text
        from armdyn.effects.user import load_effects
        from armdyn.model_file import read_model_file
        from armdyn.recording.csv_run import csv_text
        from pipeline.answers_motion import excitation_json
        from pipeline.motion.excitation import design_excitation
        from pipeline.motion.feasibility.as_modelled import ModelledArm
        from pipeline.report.excitation import excitation_document, excitation_report

        say("reading the robot")
        modelled = None
        if model_file is None:
            model = arm_model(choice.urdf_file, choice.robot, split_names(joints), tool=tool)
        else:
            with error_location(model_file):
                modelled = ModelledArm.of_file(read_model_file(model_file, load_effects(effects_file)))
            model = modelled.model.without_background()
        say("looking for what a motion can tell")
        goal = _goal(model, wanted, rivals, effects_file, rate)
        found = design_excitation(goal, seconds, random=random, compare=compare, seed=seed, say=say, modelled=modelled)
    write_text(output, csv_text(found.motion.channels))
    # `check` reads the arm from its description again.
    known = ("--robot", choice.robot) if choice.robot else ("--urdf", choice.urdf_file)
    known = known if model_file is None else ("--model", model_file)
    again = [NextStep("check it again", shell_quoted_command("check", output, *known))]
    from pipeline.motion.feasibility.check import missing_mesh_sentences

    notes = missing_mesh_sentences(found.goal.columns.arm.robot)
    document = excitation_document(found, MAX_CARD_ROWS, notes)
    finish_command(
        replace(document, next_steps=again if joints is None and tool is None else []),
        lambda: excitation_json(found, output),
        json_file,
        report,
        lambda: excitation_report(found),
        [f"motion: {output}"],
    )
    return 0


def _goal(
    model: "ArmModel", wanted: str | None, rivals: str | None, effects_file: Path | None, rate: float
) -> "MotionGoal":
    from armdyn.effects.user import load_effects
    from armdyn.experiments.goal import goal_to_determine, goal_to_separate

    own = load_effects(effects_file)
    if rivals is None:
        return goal_to_determine(model, _effects(wanted, "--for", model, own) if wanted is not None else (), rate)
    pair = _effects(rivals, "--rivals", model, own)
    if len(pair) != 2:
        raise InputError(f"--rivals {rivals}: name two effects, separated by a comma")
    return goal_to_separate(model, pair[0], pair[1], rate)


def _effects(text: str, option: str, model: "ArmModel", own: "tuple[Effect, ...]") -> "list[Effect]":
    """Effects in a list such as ``"payload,rotor_inertia:elbow,wrist"``; joints belong to the effect before them."""
    from armdyn.effects.catalogue import find

    listed: list[str] = []
    for part in (piece.strip() for piece in text.split(",")):
        if listed and ":" in listed[-1] and part in model.joints:
            listed[-1] += f",{part}"
        elif part:
            listed.append(part)
    if not listed:
        raise InputError(f"{option}: names no effect; 'armdyn effects' lists them")
    found = [find(name, own) for name in listed]
    twice = [e.name for i, e in enumerate(found) if e.name in [other.name for other in found[:i]]]
    if twice:
        raise InputError(f"{option}: names {twice[0]} twice; write its joints in one list, {twice[0]}:JOINT,JOINT")
    for effect in found:
        if all(one.name != effect.name for one in model.effects):
            model.with_effect(effect)  # an effect that this arm cannot have is refused
    return found
