"""`armdyn table`: the paper's Table I."""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.console.options import JsonOption
from pipeline.console.screen import command_line, phase_progress, to_screen, write_answer

PANEL = "Experiments"


def table(
    seeds: Annotated[int, typer.Option(help="Trials per guess, with estimation and without.")] = 3,
    first_seed: Annotated[int, typer.Option(help="Of the simulation's randomness; the others follow it.")] = 0,
    out: Annotated[Path, typer.Option("--out", "--output", help="Directory for the report.")] = Path("out/table"),
    json_file: JsonOption = None,
) -> None:
    """Table I of the paper: nine guesses of the length, with and without estimation."""
    from rich.table import Table as Grid

    from pipeline.report.table import BOX_NOTE, table_report
    from pipeline.trial.table import run_table

    with phase_progress() as show:
        result = run_table(seeds, first_seed, lambda done, total: show(f"{done} of {total} trials", done / total))
    answer = result.as_json()
    report = out / "report.html"
    out.mkdir(parents=True, exist_ok=True)
    table_report(result, f"{seeds} seeds per guess", command_line()).write(report)
    if write_answer(json_file, lambda: answer):
        grid = Grid("guess [m]", "without", "with", "estimates [m]")
        for row in result.rows:
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
