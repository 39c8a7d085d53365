"""Export of models for other tools; the formats are found in the constants `FORMATS` of this package's modules."""

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
    from pipeline.exports.left_out import ExportDeviation


@cache
def formats() -> "dict[str, Format]":
    """All formats by the ending of their files."""
    modules = [import_module(f"{__name__}.{module.name}") for module in iter_modules(__path__)]
    return {made.ending: made for module in modules for made in getattr(module, "FORMATS", ())}


def format_of_file(output: Path) -> "Format":
    """The format of a file, by the ending of its name.

    Raises:
        InputError: there is no such format.
    """
    known = formats()
    if output.suffix.lower() not in known:
        raise InputError(f"{output}: end its name in {', '.join(known)}, which says what it is to be")
    return known[output.suffix.lower()]


@dataclass(frozen=True)
class ExportResult:
    """Result of an export.

    Attributes:
        refused: whether nothing was written, because the file would lack too much of the model.
        notes: sentences on parts of the model that the format cannot express.
        missing: error of the exported model; None if it has none or the error is unknown.
        usage: command or line of code that uses the file.
    """

    refused: bool
    notes: tuple[str, ...]
    missing: "ExportDeviation | None"
    usage: str


def write_export(file: "ModelFile", output: Path, name: str, *, incomplete: bool = False) -> ExportResult:
    """Write a model for other tools, unless the file would lack much of what a repair found.

    Args:
        file: the model, with its history.
        output: file to write; its ending defines the format.
        name: name of the model, for the file's first line.
        incomplete: whether to write a file that lacks much of the model.

    Raises:
        InputError: the format is not for such a model, or the file cannot be written.
    """
    from pipeline.exports.left_out import export_deviation

    made = format_of_file(output)
    found = made.export(file, output, f"{made.kind} of {name}")
    missing = export_deviation(file, found.held)
    refused = missing is not None and missing.needs_explicit_request and not incomplete
    if not refused:
        atomic.write_text(output, found.text)
    return ExportResult(refused, tuple(found.notes), missing, found.usage)
