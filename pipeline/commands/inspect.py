"""The command `armdyn inspect`: search recordings for mistakes such as wrong units and signs."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from armdyn.document import NextStep
from armdyn.errors import InputError
from armdyn.quoting import shell_quoted_command
from pipeline.console.options import EffectsOption, JsonOption, ReportOption
from pipeline.console.outputs import check_outputs, check_overwrite, write_runs
from pipeline.console.screen import finish_command, progress_display

if TYPE_CHECKING:
    from armdyn.inspection.check import Inspection

HELP_PANEL = "Recordings"


def inspect(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="[M.toml] RUN...", help="Recordings, and before them, optionally, the model that they belong to."
        ),
    ],
    fix: Annotated[
        Path | None,
        typer.Option(
            "--fix", help="Directory for corrected copies, and for mapping files that correct the data at import."
        ),
    ] = None,
    effects: EffectsOption = None,
    report: ReportOption = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite corrected copies that exist.")] = False,
    json_file: JsonOption = None,
) -> None:
    """Search recordings for mistakes: gaps, wrong units or signs, swapped columns, shifted clocks, tilted mountings."""
    from armdyn.checked_study import ModelWithCatalogue
    from armdyn.inspection.inspect import inspect_runs
    from armdyn.run import read_run
    from pipeline.answers import inspection_json
    from pipeline.report.inspection import inspection_document, inspection_report

    model_file = files[0] if files[0].suffix.lower() == ".toml" else None
    run_files = files[1:] if model_file is not None else files
    if not run_files:
        raise InputError("no recording: give at least one, 'armdyn inspect M.toml RUN.csv'")
    check_outputs(report, json_file, inputs=files)
    with progress_display() as say:
        runs = [read_run(path) for path in run_files]
        known = None if model_file is None else ModelWithCatalogue.of(model_file, effects)
        say("looking")
        found = inspect_runs(runs) if known is None else known.inspect(runs)
        written = write_corrected_copies(found, fix, force) if fix is not None else []
    steps, lines = [], [f"written to {path}" for path in written]
    if written:
        copies = [path for path in written if path.suffix == ".csv"]
        steps.append(NextStep("next", shell_quoted_command("inspect", *([model_file] if model_file else []), *copies)))
    elif fix is not None:
        lines.append("nothing to correct in the files")
    elif found.corrected():
        steps.append(NextStep("write corrected copies", shell_quoted_command("inspect", *files, "--fix", "fixed")))
    finish_command(
        replace(inspection_document(found), next_steps=steps),
        lambda: inspection_json(found),
        json_file,
        report,
        lambda: inspection_report(found),
        lines,
    )
    if not found.usable:
        raise typer.Exit(1)


def write_corrected_copies(found: "Inspection", folder: Path, force: bool) -> list[Path]:
    """Write corrected copies of the recordings with mistakes, each with a mapping file that corrects it at import.

    Args:
        found: result of inspecting the recordings.
        folder: folder of the copies.
        force: whether existing files may be overwritten.

    Returns:
        The files that were written.

    Raises:
        InputError: a file exists already or cannot be written.
    """
    from armdyn import atomic
    from pipeline.imports.mapping import correction_toml

    corrected = found.corrected()
    runs = {folder / Path(run.name.replace("/", "_")).with_suffix(".csv").name: run
            for run in found.runs if run.name in corrected}  # fmt: skip
    maps = {path.with_suffix(".map.toml"): run for path, run in runs.items()}
    for file in maps:
        check_overwrite(file, force)
    write_runs({path: corrected[run.name].applied_to(run) for path, run in runs.items()}, force)
    for file, run in maps.items():
        atomic.write_text(file, correction_toml(run, corrected[run.name]))
    return [file for pair in zip(runs, maps, strict=True) for file in pair]
