"""`armdyn table`: success by first guess of the length, with and without estimation (the paper's Table I)."""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.console.options import JsonOption
from pipeline.console.screen import finish, spinner

PANEL = "Experiments"


def table(
    seeds: Annotated[int, typer.Option(help="Trials per guess, with estimation and without.")] = 3,
    first_seed: Annotated[int, typer.Option(help="Of the simulation's randomness; the others follow it.")] = 0,
    out: Annotated[Path, typer.Option("--out", "--output", help="Directory for the report.")] = Path("out/table"),
    json_file: JsonOption = None,
) -> None:
    """Table I of the paper: nine guesses of the length, with and without estimation."""
    from pipeline.report.table import table_one_report
    from pipeline.trial.table import run_table_one

    with spinner() as show:
        result = run_table_one(seeds, first_seed, lambda done, total: show(f"{done} of {total} trials", done / total))
    report = out / "report.html"
    out.mkdir(parents=True, exist_ok=True)
    document = table_one_report(result)
    finish(document, result.as_json, json_file, report, lambda: document)
