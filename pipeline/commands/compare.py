"""`armdyn compare`: hold a model against recordings."""

import shlex
import sys
from pathlib import Path

import typer

from pipeline.commands.identify_options import (
    EffectsOption,
    ExamOption,
    HeldOutOption,
    ModelArgument,
    ReportOption,
    RunsArgument,
    check_outputs,
    read_study,
    say_fit,
    say_parameters,
    say_places,
    spinner,
)
from pipeline.commands.output import JsonOption, write_json


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(compare)


def compare(
    model: ModelArgument,
    runs: RunsArgument,
    held_out: HeldOutOption = None,
    exam: ExamOption = None,
    effects: EffectsOption = None,
    report: ReportOption = None,
    json_file: JsonOption = None,
) -> None:
    """Fit what is free, and say how well the model does and where it fails."""
    from armdyn.identify.compare import compare as hold_against

    check_outputs(report, json_file, inputs=[model, *runs, *(held_out or ()), *(exam or ())])
    with spinner() as say:
        given = read_study(model, runs, held_out, effects, exam)
        say("fitting")
        found = hold_against(given.study)
        if report is not None:
            from pipeline.report.comparison import comparison_report

            comparison_report(given.study, found, shlex.join(["armdyn", *sys.argv[1:]])).write(report)
    if json_file is not None:
        from pipeline.answers import comparison_answer

        write_json(comparison_answer(given.study, found), json_file)
    if json_file != Path("-"):
        typer.echo(found.sentence)
        say_fit(found)
        say_places(found.places)
        if found.correction is not None:
            typer.echo("The right formula gives:")
            say_parameters(found.correction.parameters)
            typer.echo("For that motion the wrong one fails at:")
            say_places(found.correction.places)
