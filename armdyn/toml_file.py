"""Read TOML files that people write, with errors as sentences."""

from pathlib import Path
from typing import Any

from armdyn.errors import InputError, error_location
from urdf.toml_tables import read_toml_with_text


def read_toml(path: Path, absent: str = "", *, finite: bool = False) -> dict[str, Any]:
    """Read the content of a TOML file.

    Args:
        path: path of the file.
        absent: advice where there is no file, such as ``": make one with 'armdyn new'"``.
        finite: refuse `nan` and `inf` everywhere.

    Raises:
        InputError: the file is not valid; the message names the file, the mistake and a remedy.
    """
    try:
        with error_location(path):
            return read_toml_with_text(path, finite=finite)[1]
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file{absent}") from error
