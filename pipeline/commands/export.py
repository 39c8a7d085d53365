"""The command `armdyn export`: write a model to a file for another program."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from armdyn.errors import error_location
from pipeline.console.options import EffectsOption, JsonOption, ModelArgument, NamedOnlyOption
from pipeline.console.outputs import check_outputs, check_overwrite
from pipeline.console.screen import progress_display, write_json_if_file_given

HELP_PANEL = "Models"


def export(
    model: ModelArgument,
    output: Annotated[
        Path,
        typer.Option(
            "--output", "--out", help="FILE.urdf, .xml (MuJoCo), .c, .py or .json: the ending selects the format."
        ),
    ],
    effects: EffectsOption = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite the file if it exists.")] = False,
    incomplete: Annotated[
        bool,
        typer.Option(
            "--incomplete", help="Write the file even if its format cannot contain much of what a repair found."
        ),
    ] = False,
    named_only: NamedOnlyOption = False,
    json_file: JsonOption = None,
) -> None:
    """Write a model for another program, and list what the format cannot contain; exit status 1 if that is much."""
    from armdyn.arm.model import ArmModel
    from armdyn.effects.user import load_effects
    from armdyn.model_file import read_model_file
    from pipeline.exports import format_of_file, write_export
    from pipeline.exports.load_commands import load_command, load_sentence

    made = format_of_file(output)
    check_outputs(output, json_file, inputs=[model])
    check_overwrite(output, force)
    with progress_display() as say:
        file = read_model_file(model, load_effects(effects, stages=None))
        file = replace(file, model=file.model.with_named_effects_only()) if named_only else file
        say(f"writing {output}")
        with error_location(model):
            written = write_export(file, output, model.name, incomplete=incomplete)
        arm = file.model.capability(ArmModel)
        load = None if arm is None else load_command(arm)
    refused, missing = written.refused, written.missing
    answer: dict[str, Any] = {
        "schema": "armdyn.export/1",
        "file": None if refused else str(output),
        "kind": made.kind,
        "not_held": list(written.notes),
    }
    if missing is not None:
        answer |= {"error": dict(missing.error), "share_of_removed_error": missing.share}
    if load is not None:
        answer["load"] = load
    if write_json_if_file_given(json_file, lambda: answer):
        typer.echo(f"{made.kind} {'not ' * refused}written to {output}")
        for note in written.notes:
            typer.echo(f"  not in it: {note}")
        if missing is not None:
            typer.echo(f"  {missing.sentence}")
        if load is not None:
            typer.echo(f"  {load_sentence(load)}")
        typer.echo("to write it all the same: --incomplete" if refused else f"next: {written.usage}")
    if refused:
        raise typer.Exit(1)
