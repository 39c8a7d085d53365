"""A model for other tools. Each file here that has `FORMATS` adds formats; nothing else lists them."""

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


def write_export(file: "ModelFile", output: Path, name: str) -> list[str]:
    """Write a model for other tools.

    Args:
        file: the model.
        output: file to write; its ending says what it is.
        name: of the model, for a comment in the file.

    Returns:
        A sentence for each thing that the format cannot hold.

    Raises:
        InputError: the format is not for such a model, or the file cannot be written.
    """
    made = format_of(output)
    text, notes = made.text(file, output, f"{made.kind} of {name}")
    atomic.write_text(output, text)
    return notes
