"""TOML files that people write: read with limits, and their entries held against what they are declared to be."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from armdyn.errors import InputError, UnknownNameError, at
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


def is_number(value: object) -> bool:
    """Whether a value of TOML is a number; in Python, True is one too."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def is_text(value: object) -> bool:
    """Whether a value of TOML is a text."""
    return isinstance(value, str)


def is_names(value: object) -> bool:
    """Whether a value of TOML is a list of texts."""
    return isinstance(value, list) and all(map(is_text, value))


@dataclass(frozen=True)
class Entry:
    """What an entry of a table is declared to be.

    Attributes:
        fits: whether a value can be used.
        remedy: what to write instead.
    """

    fits: Callable[[Any], bool]
    remedy: str


def problems_in(table: Mapping[str, Any], declared: Mapping[str, Entry]) -> Iterator[str]:
    """A sentence for each entry that is unknown or not what it is declared to be."""
    for key, value in table.items():
        if key not in declared:
            yield str(UnknownNameError("key", key, declared))
        elif not declared[key].fits(value):
            yield f"{key} = {value!r:.60}: {declared[key].remedy}"
