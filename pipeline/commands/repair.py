"""`armdyn repair`: diagnose and add until explained."""

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from pipeline.commands.identify_options import (
    EffectsOption,
    ExamOption,
    Given,
    HeldOutOption,
    ModelArgument,
    OutputOption,
    ReportOption,
    RunsArgument,
    check_outputs,
    inputs_of,
    read_study,
    say_fit,
    say_ladder,
    spinner,
)
from pipeline.commands.link_table import say_links
from pipeline.commands.output import JsonOption, write_json

if TYPE_CHECKING:
    from armdyn.identify.repair import Repair


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(repair)


def repair(
    model: ModelArgument,
    runs: RunsArgument,
    held_out: HeldOutOption = None,
    exam: ExamOption = None,
    output: OutputOption = None,
    effects: EffectsOption = None,
    report: ReportOption = None,
    json_file: JsonOption = None,
) -> None:
    """Add the effects that are missing, one after the other, and watch the error fall."""
    from armdyn.identify.repair import repair as mend

    check_outputs(output, report, json_file, inputs=inputs_of(model, output, [*runs, *(held_out or ()), *(exam or ())]))
    with spinner() as say:
        given = read_study(model, runs, held_out, effects, exam)
        found = mend(given.study, say)
    conclude(given, found, output or model, report, json_file)


def conclude(given: Given, found: "Repair", output: Path, report: Path | None, json_file: Path | None) -> None:
    """Write the repaired model, its report and its answer, and print the ladder."""
    from armdyn.model_file import ModelFile, write_model_file
    from pipeline.answers import errors, number, repair_answer

    study = given.study
    names = {"runs": [run.name for run in study.runs], "held_out": [run.name for run in study.held_out]}
    if study.exam:
        names["exam"] = [run.name for run in study.exam]
    entries = [
        {
            "added": " + ".join(rung.added) or None,
            "joints": list(rung.joints) or None,
            "removed": list(rung.removed) or None,
            **names,
            "rmse": errors(rung.rmse),
            "held_out_rmse": errors(rung.held_out_rmse) or None,
            "exam_rmse": errors(rung.exam_rmse) or None,
            "chi2_per_sample": number(rung.chi2_per_sample),
            "bic": number(rung.bic),
        }
        for rung in found.ladder[1:]
    ]
    if report is not None:
        from pipeline.report.repair import repair_report

        repair_report(study, found, shlex.join(["armdyn", *sys.argv[1:]])).write(report)
    write_model_file(output, ModelFile(found.model, given.file.description, (*given.file.history, *entries)))
    if json_file is not None:
        write_json(repair_answer(found), json_file)
    if json_file != Path("-"):
        typer.echo(found.sentence)
        say_ladder(found.ladder, found.after.scale.units, study.judges)
        say_links(found.links)
        say_fit(found.after)
        typer.echo(f"written to {output}")
