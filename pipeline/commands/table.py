"""The command `armdyn table`: repeat Table I of the paper in simulation, success by first guess of the length."""

from pathlib import Path
from typing import Annotated

import typer

from armdyn.atomic import make_directory
from pipeline.console.options import JsonOption
from pipeline.console.screen import finish_command, progress_display

HELP_PANEL = "Experiments"


def table(
    seeds: Annotated[int, typer.Option(help="Number of trials per guess, each with and without estimation.")] = 3,
    first_seed: Annotated[int, typer.Option(help="Random seed of the first trial; the others follow it.")] = 0,
    out: Annotated[Path, typer.Option("--out", "--output", help="Directory for the report.")] = Path("out/table"),
    json_file: JsonOption = None,
) -> None:
    """Repeat Table I of the paper in simulation: nine guesses of the string's length, with and without estimation."""
    from pipeline.report.table import table_one_report
    from pipeline.trial.table import run_table_one

    make_directory(out)
    with progress_display() as show:
        result = run_table_one(seeds, first_seed, lambda done, total: show(f"{done} of {total} trials", done / total))
    report = out / "report.html"
    document = table_one_report(result)
    finish_command(document, result.as_json, json_file, report, lambda: document)
