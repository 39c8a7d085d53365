"""`armdyn export`: a model for other tools."""

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pipeline.commands.identify import EffectsOption, ModelArgument
from pipeline.commands.output import JsonOption, answered, check_outputs, free_to_write, spinner

if TYPE_CHECKING:
    from armdyn.arm.model import ArmModel
    from armdyn.model import Model
    from armdyn.model_file import ModelFile
    from pipeline.exports.left_out import LeftOut

KINDS = {
    ".urdf": "URDF",
    ".xml": "MuJoCo model",
    ".c": "C functions",
    ".py": "Python functions",
    ".json": "parameters",
}


def register(app: typer.Typer) -> None:
    """Add the command of this file."""
    app.command()(export)


def export(
    model: ModelArgument,
    output: Annotated[
        Path,
        typer.Option(
            "--output", "--out", help="FILE.urdf, .xml (MuJoCo's), .c, .py or .json: its ending says what it is."
        ),
    ],
    effects: EffectsOption = None,
    force: Annotated[
        bool, typer.Option("--force", help="Write over the file where it is there, and what lacks much of the model.")
    ] = False,
    json_file: JsonOption = None,
) -> None:
    """Write a model for other tools, and say what the format cannot hold: exit status 1 where that is much."""
    from armdyn.effects.user import load_effects
    from armdyn.errors import InputError
    from armdyn.model_file import read_model_file

    kind = kind_of(output)
    check_outputs(output, json_file, inputs=[model])
    free_to_write(output, force)
    with spinner() as say:
        file = read_model_file(model, load_effects(effects, stages=None) if effects is not None else ())
        say(f"writing {output}")
        try:
            written = write_export(file, output, model.name, force=force)
        except InputError as error:
            raise InputError(f"{model}: {error}") from error
    refused, missing = written.refused, written.missing
    answer: dict[str, Any] = {
        "schema": "armdyn.export/1",
        "file": None if refused else str(output),
        "kind": kind,
        "not_held": list(written.notes),
    }
    if missing is not None:
        answer |= {"error": dict(missing.error), "share_of_removed_error": missing.share}
    if answered(json_file, lambda: answer):
        typer.echo(f"{kind} {'not ' * refused}written to {output}")
        for note in written.notes:
            typer.echo(f"  not in it: {note}")
        if missing is not None:
            typer.echo(f"  {missing.sentence}")
        typer.echo("to write it all the same: --force" if refused else f"next: {_next(file.model, output)}")
    if refused:
        raise typer.Exit(1)


def held_by(model: "Model", output: Path) -> frozenset[str]:
    """Names of the effects of a model that a file of this kind holds."""
    from pipeline.exports.parts import HELD, SENSOR

    every = frozenset(effect.name for effect in model.effects)
    kinds = {".urdf": HELD["urdf"], ".xml": HELD["mujoco"], ".json": every}
    return frozenset(kinds.get(output.suffix.lower(), every - SENSOR))


def kind_of(output: Path) -> str:
    """What a file is to be, by the ending of its name.

    Raises:
        InputError: there is no such kind.
    """
    from armdyn.errors import InputError

    kind = KINDS.get(output.suffix.lower())
    if kind is None:
        raise InputError(f"{output}: end its name in {', '.join(KINDS)}, which says what it is to be")
    return kind


@dataclass(frozen=True)
class Written:
    """What became of an export.

    Attributes:
        refused: whether nothing was written, because the file would lack too much.
        notes: what the format cannot hold.
        missing: how much that is; None where it is nothing, or not known.
    """

    refused: bool
    notes: tuple[str, ...]
    missing: "LeftOut | None"


def write_export(file: "ModelFile", output: Path, name: str, *, force: bool = False) -> Written:
    """Write a model for other tools, unless the file would lack much of what a repair found.

    Args:
        file: the model, with its history.
        output: to write; its ending says the format.
        name: of the model, for the file's first line.
        force: write it all the same.

    Raises:
        InputError: the format is not for such a model, or the file cannot be written.
    """
    from armdyn import atomic
    from pipeline.exports.left_out import left_out

    missing = left_out(file, held_by(file.model, output))
    refused = missing is not None and missing.matters and not force
    text, notes = _text(file, output, f"{kind_of(output)} of {name}")
    if not refused:
        atomic.write_text(output, text)
    return Written(refused, tuple(notes), missing)


def _text(file: "ModelFile", output: Path, about: str) -> tuple[str, list[str]]:
    """What is written, and what the format cannot hold."""
    import json

    from armdyn import __version__

    model = file.model
    match output.suffix.lower():
        case ".urdf":
            from pipeline.exports.urdf_file import urdf_text

            return urdf_text(_arm(model, output), output.resolve().parent)
        case ".xml":
            from pipeline.exports.mujoco_file import mujoco_text

            return mujoco_text(_arm(model, output))
        case ".json":
            from pipeline.exports.json_file import parameters_answer

            return json.dumps(parameters_answer(file), indent=1, allow_nan=False) + "\n", []
    from pipeline.exports.functions import c_text, functions_of, python_text

    functions, notes = functions_of(model)
    lines = [f"{about}, by armdyn {__version__}.", *(f"Not in it: {note}." for note in notes)]
    return (c_text if output.suffix.lower() == ".c" else python_text)(functions, lines), notes


def _arm(model: "Model", output: Path) -> "ArmModel":
    from armdyn.arm.model import ArmModel
    from armdyn.errors import InputError

    if not isinstance(model, ArmModel):
        raise InputError(
            f"{output.suffix} is for arms, and this model's base is '{model.base}': write it as .c, .py or .json"
        )
    return model


def _next(model: "Model", output: Path) -> str:
    name = shlex.quote(str(output))
    match output.suffix.lower():
        case ".urdf":
            return f"armdyn new arm M.toml --urdf {name}, or give it to your simulator"
        case ".xml":
            return f"python -m mujoco.viewer --mjcf={name}"
        case ".c":
            return f"cc -O2 -shared -fPIC {name} -o {shlex.quote(str(output.with_suffix('.so')))} -lm"
        case ".py":
            function = "step" if model.base == "pendulum" else "inverse_dynamics"
            return f"from {output.stem} import {function}"
    return "its units are in it"
