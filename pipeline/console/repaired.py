"""How `add` and `repair` end: the model's file, the report, the answer, what to do next."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from pipeline.console.inputs import Given, Inputs, checked
from pipeline.console.screen import command_line, say_report, write_answer

if TYPE_CHECKING:
    from armdyn.identify.repair import Repair
    from armdyn.identify.study import Study

REPAIRED = ("--output", "repaired.toml", "--report", "repair.html")
"""Where the files of a repair go that is proposed."""


def _conclude(
    inputs: Inputs, given: Given, found: "Repair", output: Path, report: Path | None, json_file: Path | None
) -> None:
    """Write the repaired model, its report and its answer, and print how the error fell."""
    from armdyn.model_file import ModelFile, write_model_file
    from pipeline.answers import history_entries, repair_answer
    from pipeline.console.fit_text import say_repair

    if report is not None:
        from pipeline.report.page import NextStep
        from pipeline.report.repair import repair_report

        steps = [
            NextStep(f"{what}:", command) for what, command in next_steps(given.study, output, inputs.effects).items()
        ]
        repair_report(given.study, found, command_line(), steps).write(report)
    history = (*given.file.history, *history_entries(given.study, found))
    over = " (over the earlier one)" if output.exists() else ""
    write_model_file(output, ModelFile(found.model, given.file.description, history))
    if write_answer(json_file, lambda: {**repair_answer(found), **checked(given)}):
        say_repair(found, given.study.judges)
        typer.echo(f"written to {output}{over}")
        say_report(report)
        for what, command in next_steps(given.study, output, inputs.effects).items():
            typer.echo(f"{what}: {command}")


def next_steps(study: "Study", output: Path, effects: Path | None = None) -> dict[str, str]:
    """Commands that use a repaired model, by what they do; its own effects are in the file `effects`."""
    own = ["--effects", str(effects)] if effects is not None else []
    kind = {"pendulum": ".py", "arm": ".xml"}.get(study.model.base, ".json")
    export = shlex.join(["armdyn", "export", str(output), *own, "--output", f"{output.stem}{kind}"])
    if study.model.base == "pendulum":
        return {
            "swing with it": shlex.join(["armdyn", "trial", "--model", str(output), *own]),
            "take it elsewhere": export,
        }
    return {"take it elsewhere": export}
