"""Import of recordings in other formats; the readers are found in the constants `READERS` of this package's modules."""

from functools import cache
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import TYPE_CHECKING

from armdyn.errors import InputError
from urdf.toml_tables import files_beside

if TYPE_CHECKING:
    from pipeline.imports.foreign import ForeignReader, ForeignRecording


@cache
def readers() -> "tuple[ForeignReader, ...]":
    """Readers of all formats of recordings that can be imported."""
    modules = [import_module(f"{__name__}.{module.name}") for module in iter_modules(__path__)]
    return tuple(reader for module in modules for reader in getattr(module, "READERS", ()))


def read_foreign(path: Path) -> "list[ForeignRecording]":
    """Read a file or directory in another format, which may contain several recordings.

    Raises:
        InputError: the format is unknown, or the file cannot be read.
    """
    for reader in readers():
        if reader.accepts(path):
            return reader.read(path)
    folders = [reader for reader in readers() if reader.folder]
    if path.is_dir():
        kinds = " nor ".join(f"a {reader.folder} ({reader.marker})" for reader in folders)
        raise InputError(f"{path}: is a directory, and neither {kinds}: give a recording")
    if not path.exists():
        raise InputError(f"{path}: no such file{files_beside(path)}")
    endings = ", ".join(ending for reader in readers() for ending in reader.endings)
    kinds = " or of ".join(f"a {reader.folder}" for reader in folders)
    raise InputError(
        f"{path}: '{path.suffix.lower()}' is of no kind that can be read: give {endings}, the directory of {kinds}"
    )
