"""`armdyn table`: the paper's Table I as success rates over seeds."""

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.output import JsonOption, to_screen, write_json


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(table)


def table(
    seeds: Annotated[int, typer.Option(help="Trials per guess, with estimation and without.")] = 3,
    first_seed: Annotated[int, typer.Option(help="Of the simulation's randomness; the others follow it.")] = 0,
    out: Annotated[Path, typer.Option(help="Directory for the report.")] = Path("out/table"),
    json_file: JsonOption = None,
) -> None:
    """Table I of the paper: nine guesses of the length, with and without estimation."""
    from rich.table import Table as Grid

    from pipeline.commands.progress import phase_progress
    from pipeline.report.table import BOX_NOTE, GuessRow, TableReportData, table_report
    from pipeline.trial.table import run_table

    with phase_progress() as show:
        result = run_table(seeds, first_seed, lambda done, total: show(f"{done} of {total} trials", done / total))
    answer = result.as_json()
    rows = tuple(
        GuessRow(r["length_guess"], r["without"], r["with"], tuple(r["length_estimates"])) for r in answer["rows"]
    )
    report = out / "report.html"
    out.mkdir(parents=True, exist_ok=True)
    table_report(
        TableReportData(rows, seeds, result.length, f"{seeds} seeds per guess", shlex.join(["armdyn", *sys.argv[1:]]))
    ).write(report)
    if json_file is not None:
        write_json(answer, json_file)
    if json_file != Path("-"):
        grid = Grid("guess [m]", "without", "with", "estimates [m]")
        for row in rows:
            mean = sum(row.length_estimates) / len(row.length_estimates)
            grid.add_row(f"{row.length_guess:.3f}", f"{row.without:.0%}", f"{row.with_estimation:.0%}", f"{mean:.4f}")
        console = to_screen()
        console.print(grid)
        console.print(
            f"length {answer['mean']:.4f} m, standard deviation {1e3 * answer['std']:.2f} mm over all trials; "
            f"the truth ({result.length:g} m) within 3 reported standard deviations in {result.covered:.0%}"
        )
        console.print(BOX_NOTE)
        console.print(f"report {report}")
