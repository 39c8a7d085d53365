"""The last part of the commands `add` and `repair`: write model, report and JSON, and print the result."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from armdyn.document import NextStep
from armdyn.errors import InputError
from armdyn.quoting import shell_quoted_command
from pipeline.console.inputs import StudyInputs

if TYPE_CHECKING:
    from armdyn.checked_study import CheckedStudy
    from armdyn.identify.repair import Repair
    from armdyn.identify.study import Study


def repair_output_options(model: Path) -> tuple[str, ...]:
    """Options of a proposed repair of a model file, whose outputs are neither this file nor its report."""
    again = "_again" if model.stem.startswith("repaired") else ""
    return "--output", f"{model.stem if again else 'repaired'}{again}.toml", "--report", f"repair{again}.html"


"""Options for the output files in a proposed command `armdyn repair`."""


def report_and_save_repair(
    inputs: StudyInputs, given: "CheckedStudy", found: "Repair", output: Path, *, named_only: bool = False
) -> None:
    """Write the repaired model, its report and JSON, and print how the error fell.

    No model is written if the fit failed.

    Args:
        inputs: arguments and options of the command.
        given: the study.
        found: the repair.
        output: file for the repaired model.
        named_only: whether the background, the force without a named effect, is left out of the file.
    """
    from armdyn.identify.sentence import Verdict
    from armdyn.model_file import ModelFile, write_model_file
    from pipeline.answers import repair_json
    from pipeline.report.repair import repair_report

    lost, written = found.verdict is Verdict.LOST, list[str]()
    steps = [] if lost else repair_next_steps(given.study, output, inputs.effects)
    if any(step.tied_with for step in found.path):
        steps[:0] = next_experiment_steps(inputs, given)
    if found.verdict is Verdict.UNKNOWN_EFFECT and given.commanded is None:
        beyond = replace(inputs, model=output).proposed_command("discover", "--output", f"{output.stem}_effect.py")
        steps.insert(0, NextStep("a formula for what is left", beyond))
    if not lost:
        written.append(f"written to {output}{' (over the earlier one)' * output.exists()}")
        history = (*given.known.file.history, *found.history)
        model = found.model_without_background if named_only else found.model
        write_model_file(output, ModelFile(model, given.known.file.description, history))
    inputs.finish(
        given,
        replace(found.document(given.study.holdout_kinds), next_steps=steps),
        lambda: repair_json(found),
        lambda: repair_report(found.study, found, steps),
        written,
        failed=lost,
    )


def next_experiment_steps(inputs: StudyInputs, given: "CheckedStudy") -> list[NextStep]:
    """Command to propose where effects cannot be distinguished; empty where no experiment can be planned."""
    from armdyn.arm.model import ArmModel
    from armdyn.experiments.rivals import require_plannable

    if given.study.model.capability(ArmModel) is None:
        try:
            require_plannable(given.study)
        except InputError:
            return []
    elif given.commanded is not None:  # an arm that is judged by motion
        return []
    command = inputs.proposed_command("next", "--output", "motion.csv", "--report", "next.html")
    return [NextStep("distinguish them", command)]


def swings_from_gripper(study: "Study") -> bool:
    """Whether the recordings are of a load below a gripper, whose motion a robot can choose."""
    return study.model.hangs_from_gripper and all("gripper_x" in run.channels for run in study.runs)


def repair_next_steps(study: "Study", output: Path, effects: Path | None) -> list[NextStep]:
    """Commands to propose after a repair: use the model in a trial, and export it.

    Args:
        study: the model before the repair, and its recordings.
        output: file of the repaired model.
        effects: file with effects that the user has written; None without one.
    """
    own = ["--effects", effects] if effects is not None else []
    model, swings = study.model, swings_from_gripper(study)
    kind = ".py" if model.hangs_from_gripper else ".xml" if model.robot is not None else ".json"
    export = shell_quoted_command("export", output, *own, "--output", f"{output.stem}{kind}")
    swing = shell_quoted_command("trial", "--model", output, *own)
    steps = [NextStep("swing with it", swing)] if swings else []
    return [*steps, NextStep("use it in another program", export)]
