"""A motion along the line as a table: ``time [s], s [m]`` and, if known, ``v [m/s], a [m/s^2]``."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from armdyn.errors import InputError, UnknownNameError
from armdyn.units import si_factor

UNITS = {"time": "s", "s": "m", "v": "m/s", "a": "m/s^2"}

_HEADER = re.compile(r"\s*(?P<name>[^\[\]]*?)\s*\[(?P<unit>[^\[\]]+)\]\s*")


def is_line_csv(path: Path) -> bool:
    """Whether a file is text whose header has a column ``s``."""
    try:
        with path.open(encoding="utf-8-sig") as file:
            header = file.readline()
    except (OSError, UnicodeDecodeError):
        return False
    return "s" in [cell.partition("[")[0].strip().strip('"') for cell in header.split(",")]


def read_line_csv(path: Path) -> dict[str, NDArray[np.float64]]:
    """Read the columns of a line motion.

    Args:
        path: the CSV file.

    Returns:
        Values by name, in SI units, (n,) each.

    Raises:
        InputError: names the row or column at fault, counted as a spreadsheet does.
    """
    with path.open(encoding="utf-8-sig", newline="") as file:
        try:
            rows = [(number, row) for number, row in enumerate(csv.reader(file), start=1) if any(map(str.strip, row))]
        except (csv.Error, UnicodeDecodeError) as error:
            raise InputError(f"{path}: is no CSV text ({error}); save it as UTF-8") from error
    columns = [_column(path, cell) for cell in rows[0][1]]
    names = [name for name, _ in columns]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{path}: there are two columns '{name}'; rename or remove one")
    if "time" not in names:
        raise InputError(f"{path}: no 'time' column: add one named 'time [s]'")
    if len(rows) < 2:
        raise InputError(f"{path}: holds no samples; give a row per time")
    table = np.array([_numbers(path, number, row, names) for number, row in rows[1:]])
    return {name: table[:, k] * factor for k, (name, factor) in enumerate(columns)}


def _column(path: Path, cell: str) -> tuple[str, float]:
    match = _HEADER.fullmatch(cell)
    name = match["name"] if match else cell.strip()
    if name not in UNITS:
        raise InputError(f"{path}: {UnknownNameError('column of a line motion', name, UNITS)}")
    if match is None:
        raise InputError(f"{path}: column '{name}' has no unit: write it as '{name} [{UNITS[name]}]'")
    try:
        return name, si_factor(match["unit"], UNITS[name])
    except InputError as error:
        raise InputError(f"{path}: column '{name}': {error}") from error


def _numbers(path: Path, number: int, row: list[str], names: list[str]) -> list[float]:
    if len(row) != len(names):
        raise InputError(f"{path}: row {number} has {len(row)} cells where the header has {len(names)}; mend the row")
    values = []
    for name, cell in zip(names, row, strict=True):
        try:
            value = float(cell)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise InputError(
                f"{path}: row {number}, column '{name}': '{cell.strip()[:40]}' is not a finite number; "
                "a trajectory has no missing samples"
            )
        values.append(value)
    return values
