"""A model for other tools. The formats are the `FORMATS` of every module here; nothing else lists them."""

from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import TYPE_CHECKING

from armdyn import atomic
from armdyn.errors import InputError

if TYPE_CHECKING:
    from armdyn.model_file import ModelFile
    from pipeline.exports.format import Format
    from pipeline.exports.left_out import LeftOut


@cache
def formats() -> "dict[str, Format]":
    """All formats by the ending of their files."""
    modules = [import_module(f"{__name__}.{module.name}") for module in iter_modules(__path__)]
    return {made.ending: made for module in modules for made in getattr(module, "FORMATS", ())}


def format_of(output: Path) -> "Format":
    """The format of a file, by the ending of its name.

    Raises:
        InputError: there is no such format.
    """
    known = formats()
    if output.suffix.lower() not in known:
        raise InputError(f"{output}: end its name in {', '.join(known)}, which says what it is to be")
    return known[output.suffix.lower()]


@dataclass(frozen=True)
class Written:
    """Result of an export.

    Attributes:
        refused: True where nothing was written, because the file would lack too much.
        notes: sentence on each thing that the format cannot hold.
        missing: error of the exported model; None where it has none, or the error is unknown.
        usage: command or line of code that uses the file.
    """

    refused: bool
    notes: tuple[str, ...]
    missing: "LeftOut | None"
    usage: str


def write_export(file: "ModelFile", output: Path, name: str, *, incomplete: bool = False) -> Written:
    """Write a model for other tools, unless the file would lack much of what a repair found.

    Args:
        file: the model, with its history.
        output: file to write; its ending defines the format.
        name: name of the model, for the file's first line.
        incomplete: whether to write it all the same.

    Raises:
        InputError: the format is not for such a model, or the file cannot be written.
    """
    from pipeline.exports.left_out import left_out

    made = format_of(output)
    found = made.export(file, output, f"{made.kind} of {name}")
    missing = left_out(file, found.held)
    refused = missing is not None and missing.matters and not incomplete
    if not refused:
        atomic.write_text(output, found.text)
    return Written(refused, tuple(found.notes), missing, found.usage)
