"""The command `armdyn batch`: compare or repair many models with many recordings."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armdyn.quoting import shell_quoted_command
from pipeline.console.options import JsonOption
from pipeline.console.outputs import check_outputs
from pipeline.console.screen import finish_command, progress_display

if TYPE_CHECKING:
    from pipeline.batch.history import ParameterHistory
    from pipeline.batch.run import BatchResult
    from pipeline.batch.spec import BatchSpec

HELP_PANEL = "What a model lacks"


def batch(
    spec: Annotated[
        Path, typer.Argument(metavar="SPEC.toml", help="File that lists models and recordings; see docs/batch.md.")
    ],
    output: Annotated[
        Path,
        typer.Option(
            "--output", "--out", metavar="DIR", help="Directory for results and report; a batch in it is continued."
        ),
    ],
    scheduler: Annotated[
        str | None, typer.Option(help="Address of a dask scheduler whose workers compute, such as tcp://host:8786.")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Number of processes on this computer; by default one per processor core.")
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Compare or repair models with many recordings, and find out which parameter changed on which day."""
    from pipeline.batch.history import parameter_history
    from pipeline.batch.run import JOURNAL_FILE, PARQUET_FILE, check_parquet, run_batch, write_parquet
    from pipeline.batch.spec import read_spec
    from pipeline.interrupts import Interrupt, deferred_signals
    from pipeline.report.batch import batch_report
    from pipeline.trial.folder import locked_folder

    check_parquet()
    asked = read_spec(spec)
    given = {file for item in asked.items for file in (item.model, item.run, item.run.with_suffix(".toml"))}
    own = (JOURNAL_FILE, PARQUET_FILE, "report.html")
    check_outputs(json_file, *map(output.joinpath, own) if output.is_dir() else (), inputs=[spec, *given])
    signals: list[int] = []
    with (
        locked_folder(output, output, "batch", own) as folder,
        deferred_signals(signals.append),
        progress_display() as say,
    ):
        done = run_batch(asked, folder, workers=workers, scheduler=scheduler, stopped=lambda: bool(signals), say=say)
        say("writing the rows")
        write_parquet(folder / PARQUET_FILE, asked, done.rows)
        if not signals:
            say("looking for changes")
            found = parameter_history(asked, done.rows)
    if signals:
        again = shell_quoted_command("batch", spec, "--output", output)
        typer.echo(
            f"{len(done.rows)} of {len(asked.items)} recordings are done and kept; continue with: {again}", err=True
        )
        raise Interrupt(signals[0])
    document = batch_report(asked, done, found)
    report = output / "report.html"
    written = [f"rows: {output / PARQUET_FILE}"]
    finish_command(document, lambda: _answer(asked, done, found), json_file, report, lambda: document, written)


def _answer(spec: "BatchSpec", done: "BatchResult", found: "ParameterHistory") -> dict[str, Any]:
    from pipeline.batch.history import utc_datetime
    from pipeline.fields import attributes_as_json
    from pipeline.report.batch import verdict_counts

    return {
        "schema": "armdyn.batch/1",
        "task": spec.task,
        "recordings": len(done.rows),
        "worked": done.computed,
        "verdicts": verdict_counts(done.rows),
        "bad": [
            {"recording": spec.relative_name(row.item.run), "problem": row.outcome.problem}
            for row in done.rows
            if row.outcome.problem
        ],
        "false_alarms": found.change_test.false_alarms,
        "changes": [
            attributes_as_json(
                step, "robot parameter unit= last_before= first_after= before after chance",
                unit=found.units[step.parameter],
                last_before=utc_datetime(step.last_before).isoformat(),
                first_after=utc_datetime(step.first_after).isoformat(),
            )
            for event in found.events
            for step in event
        ],
        "drifts": [
            attributes_as_json(
                d, "robot parameter per_day= unit= chance", per_day=86400.0 * d.slope, unit=found.units[d.parameter]
            )
            for d in found.change_test.drifts
        ],
    }  # fmt: skip
