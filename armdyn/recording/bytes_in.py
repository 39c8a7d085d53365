"""Bytes of a file from outside: never more of them than fit, no device that never ends."""

from pathlib import Path

from armdyn.errors import InputError
from urdf.bounds import LARGEST_RECORDING


def read_bytes(path: Path, largest: int = LARGEST_RECORDING) -> bytes:
    """The content of a file or pipe.

    Args:
        path: of the file.
        largest: number of bytes beyond which it is refused, before more of it is read.

    Raises:
        InputError: it is absent, a directory, unreadable or too large.
    """
    try:
        with path.open("rb") as file:
            data = file.read(largest + 1)
    except IsADirectoryError as error:
        raise InputError(f"{path} is a directory: give the recording's file") from error
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file") from error
    except (OSError, ValueError) as error:  # a name with a null character is a ValueError
        raise InputError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    if len(data) > largest:
        raise InputError(f"{path}: is larger than {largest / 2**20:g} MiB: cut it, or record at a lower rate")
    return data
