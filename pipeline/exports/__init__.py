"""A model for other tools. Each file here that has `FORMATS` adds formats; nothing else lists them."""

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
    """Every format, by the ending of its files."""
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
    """What became of an export.

    Attributes:
        refused: whether nothing was written, because the file would lack too much.
        notes: what the format cannot hold.
        missing: how much that is; None where it is nothing, or not known.
    """

    refused: bool
    notes: tuple[str, ...]
    missing: "LeftOut | None"


def write_export(file: "ModelFile", output: Path, name: str, *, incomplete: bool = False) -> Written:
    """Write a model for other tools, unless the file would lack much of what a repair found.

    Args:
        file: the model, with its history.
        output: to write; its ending says the format.
        name: of the model, for the file's first line.
        incomplete: write it all the same.

    Raises:
        InputError: the format is not for such a model, or the file cannot be written.
    """
    from pipeline.exports.left_out import left_out

    made = format_of(output)
    missing = left_out(file, made.held(file.model))
    refused = missing is not None and missing.matters and not incomplete
    text, notes = made.text(file, output, f"{made.kind} of {name}")
    if not refused:
        atomic.write_text(output, text)
    return Written(refused, tuple(notes), missing)
