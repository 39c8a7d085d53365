"""The end of `add` and `repair`: they write the model, report and answer, and print advice."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from armdyn.document import NextStep
from armdyn.quoting import command_text
from pipeline.console.inputs import StudyInputs

if TYPE_CHECKING:
    from armdyn.checked_study import CheckedStudy
    from armdyn.identify.repair import Repair
    from armdyn.model import Model

REPAIRED = ("--output", "repaired.toml", "--report", "repair.html")
"""Where the files of a repair go that is proposed."""


def conclude_repair(
    inputs: StudyInputs, given: "CheckedStudy", found: "Repair", output: Path, *, named_only: bool = False
) -> None:
    """Write the repaired model, its report and its answer, and print how the error fell.

    Where the fit failed, no model is written. With `named_only`, the written model has no background.
    """
    from armdyn.identify.sentence import Verdict
    from armdyn.model_file import ModelFile, write_model_file
    from pipeline.answers import history_entries, repair_answer
    from pipeline.report.repair import repair_report

    lost, written = found.verdict is Verdict.LOST, list[str]()
    steps = [] if lost else next_steps(given.study.model, output, inputs.effects)
    if not lost:
        written.append(f"written to {output}{' (over the earlier one)' * output.exists()}")
        history = (*given.known.file.history, *history_entries(given.study, found))
        model = found.model_without_background if named_only else found.model
        write_model_file(output, ModelFile(model, given.known.file.description, history))
    inputs.finish(
        given,
        replace(found.document(given.study.holdout_kinds), next_steps=steps),
        lambda: repair_answer(found),
        lambda: repair_report(given.study, found, steps),
        written,
        failed=lost,
    )


def next_steps(model: "Model", output: Path, effects: Path | None) -> list[NextStep]:
    """Texts of commands that use a repaired model; the user's own effects are in the file `effects`."""
    own = ["--effects", effects] if effects is not None else []
    kind = ".py" if model.hangs_from_gripper else ".xml" if model.robot is not None else ".json"
    export = command_text("export", output, *own, "--output", f"{output.stem}{kind}")
    swing = command_text("trial", "--model", output, *own)
    steps = [NextStep("swing with it", swing)] if model.hangs_from_gripper else []
    return [*steps, NextStep("take it elsewhere", export)]
