"""Read the bytes of a file up to a largest number, so that an endless device does not fill the memory."""

from pathlib import Path

from armdyn.errors import InputError
from urdf.bounds import MAX_RECORDING_BYTES
from urdf.toml_tables import files_beside


def directory_in_place_of_a_run(path: Path) -> str:
    """Message on a directory where a recording is expected: what to type for the runs in it, or for a bag."""
    if any(path.glob("*.csv")):
        return f"{path} is a directory: give its files, {path}/*.csv"
    return f"{path} is a directory: give a file; for a bag or a data set type 'armdyn import {path} --output runs'"


def read_bytes(path: Path, largest: int = MAX_RECORDING_BYTES) -> bytes:
    """Read the content of a file or pipe.

    Args:
        path: the file or pipe.
        largest: largest number of bytes; a larger file is refused before more of it is read.

    Raises:
        InputError: the file is absent, a directory, unreadable or too large.
    """
    try:
        with path.open("rb") as file:
            data = file.read(largest + 1)
    except IsADirectoryError as error:
        raise InputError(directory_in_place_of_a_run(path)) from error
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file{files_beside(path)}") from error
    except (OSError, ValueError) as error:  # a name with a null character is a ValueError
        raise InputError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    if len(data) > largest:
        raise InputError(f"{path}: is larger than {largest / 2**20:g} MiB: cut it, or record at a lower rate")
    return data
