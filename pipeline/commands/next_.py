"""The command `armdyn next`: plan an experiment that distinguishes effects between which recordings cannot decide."""

from collections.abc import Sequence
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from armdyn.errors import InputError
from armdyn.quoting import shell_quoted_command
from pipeline.console.inputs import StudyInputsWithoutExam
from pipeline.console.options import split_names
from pipeline.console.screen import ProgressDisplay, finish_command

if TYPE_CHECKING:
    from armdyn.checked_study import CheckedStudy

HELP_PANEL = "What a model lacks"


def next_(
    inputs: StudyInputsWithoutExam,
    rivals: Annotated[
        str | None,
        typer.Option(
            help="Effects to distinguish, separated by commas; by default those that the diagnosis cannot distinguish."
        ),
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(
            help="Duration of the designed motion [s]; by default 8 s, for a base of your own as the last recording."
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "--out",
            help="CSV file for the designed motion: the gripper on its line, an arm's joints, or a process's inputs.",
        ),
    ] = None,
    input_ranges: Annotated[
        list[str] | None,
        typer.Option(
            "--input",
            help="Range of a process's input in its unit: extra.pump=0:10; by default that of the last recording.",
        ),
    ] = None,
    travel: Annotated[
        float | None,
        typer.Option(help="If the robot is not Baxter: largest distance of the gripper from the line's middle [m]."),
    ] = None,
    speed: Annotated[
        float | None, typer.Option(help="If the robot is not Baxter: largest speed of the gripper [m/s].")
    ] = None,
    acceleration: Annotated[
        float | None, typer.Option(help="If the robot is not Baxter: largest acceleration of the gripper [m/s^2].")
    ] = None,
    swing: Annotated[
        float | None, typer.Option(help="If the robot is not Baxter: largest angle of the load [rad].")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the random motions from which the design starts.")] = 0,
) -> None:
    """Plan the experiment that best distinguishes effects which may be missing, or tells values that are not known."""
    from armdyn.arm.model import ArmModel
    from armdyn.experiments.gripper import motion_series
    from armdyn.experiments.plan import USUAL_MOTION_SECONDS
    from armdyn.experiments.rivals import rivals_of_study
    from pipeline.answers_motion import next_experiment_json
    from pipeline.front import plan_experiment, user_given_gripper_limits
    from pipeline.motion.feasible_motion import write_designed
    from pipeline.report.next_experiment import next_experiment_document, next_experiment_report

    limits = user_given_gripper_limits(travel, speed, acceleration, swing)
    ranges = _ranges(input_ranges or ())
    if seconds is not None:
        motion_series(seconds)  # an impossible duration is refused before the fit
    with inputs.begin(output) as (given, say):
        if given.study.model.capability(ArmModel) is not None:
            if limits is not None or ranges:
                raise InputError(
                    "--travel, --speed, --acceleration and --swing are of a gripper, --input of a base of your own: an "
                    "arm has its URDF's limits"
                )
            lasting = USUAL_MOTION_SECONDS if seconds is None else seconds
            return _next_of_arm(inputs, given, split_names(rivals), lasting, output, seed, say)
        verdict, sentence, found = rivals_of_study(given.study, split_names(rivals), say)
        made, offer = None, None
        if found is not None:
            made, offer = plan_experiment(found, seconds, limits, ranges, seed, say)
            sentence = " ".join([*([sentence] if sentence else []), made.sentence])
    written = output if offer is not None else None
    if offer is not None and output is not None:
        write_designed(offer, output)
    process = made is not None and made.rivals.of_process
    document = next_experiment_document(made, sentence, written if limits is None and not process else None)
    notes = []
    if made is not None and offer is None and output is not None and (process or made.rivals.pivot_stands):
        what = "No input drives this process usefully" if process else "No gripper moves in these runs"
        notes = [f"{what}: there is nothing to write to {output}."]
    document = replace(document, notes=[*document.notes, *notes, *(f"{text}." for text in given.set_aside)])
    finish_command(
        document,
        lambda: next_experiment_json(made, verdict, sentence, written),
        inputs.json_file,
        inputs.report,
        lambda: next_experiment_report(document, made),
        [] if written is None else [f"{'inputs' if process else 'motion'} {written}"],
    )


def _next_of_arm(
    inputs: StudyInputsWithoutExam,
    given: "CheckedStudy",
    rivals: list[str] | None,
    seconds: float,
    output: Path | None,
    seed: int,
    say: ProgressDisplay,
) -> None:
    """The next motion of an arm, by the criterion of `armdyn excite`."""
    import numpy as np

    from armdyn.atomic import write_text
    from armdyn.document import NextStep
    from armdyn.experiments.recorded import question_of_study
    from armdyn.recording.csv_run import csv_text
    from pipeline.answers_motion import next_motion_json
    from pipeline.motion.excitation import design_excitation
    from pipeline.motion.feasibility.as_modelled import ModelledArm
    from pipeline.report.excitation import next_motion_document, next_motion_report

    asked, found = question_of_study(given.study, rivals, say), None
    if asked.goal is not None:
        arm = ModelledArm(asked.model, np.zeros(len(asked.model.arm.joints)))
        found = design_excitation(asked.goal, seconds, compare=False, seed=seed, say=say, modelled=arm)
        if output is not None:
            write_text(output, csv_text(found.motion.channels))
    written = output if found is not None else None
    steps = [NextStep("check it", shell_quoted_command("check", output, "--model", inputs.model))] if written else []
    notes = [f"{text}." for text in given.set_aside]
    finish_command(
        replace(next_motion_document(asked, found, notes), next_steps=steps),
        lambda: next_motion_json(asked, found, written),
        inputs.json_file,
        inputs.report,
        lambda: next_motion_report(asked, found, notes),
        [] if written is None else [f"motion {written}"],
    )


def _ranges(texts: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Ranges of inputs from texts such as ``extra.pump=0:10``.

    Raises:
        InputError: a text is not of this form.
    """
    found = {}
    for text in texts:
        name, _, span = text.partition("=")
        try:
            low, high = map(float, span.split(":"))
        except ValueError:
            raise InputError(f"--input {text}: write a channel and its range, as in extra.pump=0:10") from None
        if not (isfinite(low) and isfinite(high)):
            raise InputError(f"--input {text}: write finite numbers, as in extra.pump=0:10")
        found[name] = (low, high)
    return found
