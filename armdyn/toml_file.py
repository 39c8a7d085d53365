"""TOML files that people write, and what is wrong with one in a sentence that says which it is."""

from pathlib import Path
from typing import Any

from armdyn.errors import InputError, at
from urdf.table_file import read_table


def read_toml(path: Path, absent: str = "", *, finite: bool = False) -> dict[str, Any]:
    """The content of a file.

    Args:
        path: of the file.
        absent: what to do where there is none, such as ``": make one with 'armdyn new'"``.
        finite: refuse `nan` and `inf` anywhere.

    Raises:
        InputError: names the file, what is wrong and what to do.
    """
    try:
        with at(path):
            return read_table(path, finite=finite)[1]
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file{absent}") from error
