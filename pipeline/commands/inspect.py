"""`armdyn inspect`: are recordings what they say they are?"""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from armdyn.errors import InputError
from pipeline.console.options import EffectsOption, JsonOption, ReportOption
from pipeline.console.outputs import check_outputs, free_to_write
from pipeline.console.screen import command_line, plain_table, spinner, to_screen, write_answer

if TYPE_CHECKING:
    from armdyn.effects.effect import Effect
    from armdyn.inspection.check import Inspection
    from armdyn.model import Model

PANEL = "Recordings"


SHOWN = {"wrong": "bold red", "suspect": "yellow", "note": "dim"}
"""How a severity is printed."""


def inspect(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="[M.toml] RUN...", help="Recordings, and before them the model of what was recorded."),
    ],
    fix: Annotated[
        Path | None,
        typer.Option("--fix", help="Directory for corrected copies, and for maps that do the same at import."),
    ] = None,
    effects: EffectsOption = None,
    report: ReportOption = None,
    force: Annotated[bool, typer.Option("--force", help="Write over corrected copies that are there.")] = False,
    json_file: JsonOption = None,
) -> None:
    """Ask whether recordings are what they say they are: gaps, units, signs, swapped columns, clocks, mountings."""
    from armdyn.inspection.check import MODEL
    from armdyn.inspection.inspect import inspected
    from armdyn.run import read_run
    from pipeline.answers_inspection import inspection_answer

    model_file = files[0] if files[0].suffix.lower() == ".toml" else None
    run_files = files[1:] if model_file is not None else files
    if not run_files:
        raise InputError("no recording: give at least one, 'armdyn inspect M.toml RUN.csv'")
    check_outputs(report, json_file, inputs=files)
    with spinner() as say:
        runs = [read_run(path) for path in run_files]
        model, catalogue = _model(model_file, effects)
        say("looking")
        found = inspected(runs, model, catalogue).naming(model_file or Path(MODEL))
        if report is not None:
            from pipeline.report.inspection import inspection_report

            inspection_report(found, command_line()).write(report)
        written = write_fixed(found, fix, force) if fix is not None else []
    if write_answer(json_file, lambda: inspection_answer(found)):
        say_inspection(found)
        if fix is not None:
            _say_fixed(written, model_file)
        elif found.corrected():
            again = ["armdyn", "inspect", *map(str, files), "--fix", "fixed"]
            typer.echo(f"write corrected copies: {shlex.join(again)}")
        if report is not None:
            typer.echo(f"report {report}")
    if not found.usable:
        raise typer.Exit(1)


def _model(file: Path | None, effects: Path | None) -> "tuple[Model | None, tuple[Effect, ...]]":
    from armdyn.effects.user import available, load_effects
    from armdyn.model_file import read_model_file

    if file is None:
        return None, ()
    own = load_effects(effects, stages=None) if effects is not None else ()
    model = read_model_file(file, own).model
    return model, available(model, own, effects)


def say_inspection(found: "Inspection") -> None:
    """Print all checks, the worst first."""
    from rich.text import Text

    console = to_screen()
    console.print(found.sentence, style="bold")
    if not found.checks:
        return
    table = plain_table("", "kind", "run", "what", "remedy")
    for check in found.checks:
        key = check.severity.key
        table.add_row(Text(key, style=SHOWN[key]), check.kind, check.run or "", check.sentence, check.remedy)
    console.print(table)


def write_fixed(found: "Inspection", folder: Path, force: bool) -> list[Path]:
    """Corrected copies of recordings with a mistake that can be undone, each with its map for `import`.

    Raises:
        InputError: a file is there already or cannot be written.
    """
    from armdyn import atomic
    from armdyn.run import write_run_csv
    from pipeline.imports.mapping import correction_text

    corrected = found.corrected()
    runs = {run.name: run for run in found.runs if run.name in corrected}
    paths = {name: folder / Path(name.replace("/", "_")).with_suffix(".csv").name for name in runs}
    maps = {name: path.with_suffix(".map.toml") for name, path in paths.items()}
    for name, path in paths.items():
        for target in (path, path.with_suffix(".toml"), maps[name]):
            free_to_write(target, force)
    if runs:
        atomic.making_directory(folder)
    written = []
    for name, run in runs.items():
        write_run_csv(corrected[name].of(run), paths[name])
        atomic.write_text(maps[name], correction_text(run, corrected[name]))
        written += [paths[name], maps[name]]
    return written


def _say_fixed(written: list[Path], model: Path | None) -> None:
    if not written:
        typer.echo("nothing to correct in the files")
        return
    for path in written:
        typer.echo(f"written to {path}")
    runs = [str(path) for path in written if path.suffix == ".csv"]
    typer.echo(f"next: {shlex.join(['armdyn', 'inspect', *([str(model)] if model else []), *runs])}")
