"""The CSV form of a recording: ``name [unit]`` per column, a row per time stamp, empty cells for missing samples.

Rows are counted as a spreadsheet shows them: the header is row 1.
"""

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from armdyn.bytes_in import read_bytes
from armdyn.channels import (
    LARGEST,
    MIN_SAMPLES,
    Channel,
    FloatArray,
    channel_unit,
    channel_units,
    check_joint_units,
    first_implausible,
    in_contract,
    name_and_unit,
)
from armdyn.errors import InputError, UnknownNameError
from armdyn.units import si_factor
from armdyn.whole_end import cut_off, is_whole
from urdf.bounds import LONGEST_NAME, MOST_COLUMNS, MOST_ROWS, number, shown

SHOWN = 60
"""Characters of a header that a message shows."""
MISSING = ("", "nan", "-nan", "+nan")
"""Cells of missing samples, in small letters."""
IntArray = npt.NDArray[np.int64]
_HEADER = re.compile(r"(?P<name>[^\[\]]*?)\s*\[(?P<unit>[^\[\]]*)\]")


def read_csv(path: Path, units: Mapping[str, str] | None = None) -> dict[str, Channel]:
    """Read and check every column.

    Args:
        path: the CSV file.
        units: SI unit of every column that there may be, where they are not those of a recording; then no sample may
            be missing, however few they are.

    Returns:
        Channel by name, in SI units, without missing samples.

    Raises:
        InputError: names the file, the row or column, what is wrong and what to do.
    """
    text = _text(path)
    header = text[: text.find("\n")] if "\n" in text else text
    if units is None and _is_foreign(header):
        raise InputError(
            f"{path}: its columns ({shown(header.strip(), SHOWN)}) are not written as a run's, such as 'time [s]': "
            f"make a run of it, 'armdyn import {path} --output runs --guess'"
        )
    try:
        columns = _columns(header, units)
        names = [name for name, _, _ in columns]
        if units is None:
            check_joint_units((name, unit) for name, unit, _ in columns if name != "time")
        numbers, rows = _numbers(text, len(header) + 1, names, complete=units is not None)
        samples = {
            name: _scaled(name, unit, factor, numbers[:, i], rows) for i, (name, unit, factor) in enumerate(columns)
        }
        time = samples.pop("time")
        _check_time(time, rows)
        found = {name: unit for name, unit, _ in columns}
        return {name: _channel(time, value, found[name]) for name, value in samples.items()}
    except UnknownNameError as error:
        strange = f"; if it is another program's: 'armdyn import {path} --output runs --guess'" if units is None else ""
        raise InputError(f"{path}: {error}{strange}") from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _is_foreign(header: str) -> bool:
    """Whether a header is no run's, not even with mistakes: no unit in brackets, or neither the time nor a channel."""
    cells = [name_and_unit(cell.strip().strip('"')) for cell in re.split("[,;\t]", header)]
    known = any(name == "time" or in_contract(name) for name, _ in cells)
    return len(cells) > 1 and not (known and "[" in header)


def csv_text(channels: Mapping[str, Channel]) -> str:
    """Channels as one table; stamps that a channel does not have get an empty cell.

    Numbers have all their digits: reading them back gives the same floats.
    """
    time = np.unique(np.concatenate([channel.time for channel in channels.values()]))
    columns = [[repr(t) for t in time.tolist()]]
    for channel in channels.values():
        cells = [""] * time.size
        for row, value in zip(np.searchsorted(time, channel.time).tolist(), channel.value.tolist(), strict=True):
            cells[row] = repr(value)
        columns.append(cells)
    header = ",".join(["time [s]", *(f"{name} [{channel.unit}]" for name, channel in channels.items())])
    return "\n".join([header, *map(",".join, zip(*columns, strict=True))]) + "\n"


def _text(path: Path) -> str:
    data = read_bytes(path)
    if not data.strip():
        raise InputError(f"{path}: is empty: record again or give another file")
    if data.startswith(b"\x89MCAP"):
        raise InputError(f"{path}: is an MCAP recording: rename it to end in .mcap")
    if b"\0" in data:
        raise InputError(f"{path}: is not a text file: give a CSV or an .mcap recording")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        row = data.count(b"\n", 0, error.start) + 1
        raise InputError(f"{path}: row {row} is not UTF-8 text: give a CSV saved as UTF-8, or an .mcap") from error
    # Quotes are dropped: a comma inside them is a decimal comma, which gives the row too many cells: an error below.
    return text.replace("\r\n", "\n").replace("\r", "\n").replace('"', "")


def _columns(header: str, units: Mapping[str, str] | None) -> list[tuple[str, str, float]]:
    """Name, SI unit and factor to it per column."""
    for separator, name in ((";", "semicolons"), ("\t", "tabs")):
        if separator in header and "," not in header:
            raise InputError(f"columns are separated by {name}: save it with commas and decimal points")
    columns: list[tuple[str, str, float]] = []
    seen: dict[str, int] = {}
    if header.count(",") >= MOST_COLUMNS:
        raise InputError(f"has {header.count(',') + 1} columns where {MOST_COLUMNS} are the most: leave some out")
    for place, cell in enumerate(header.split(","), start=1):
        match = _HEADER.fullmatch(cell.strip())
        if match is None and "[" in cell:
            raise InputError(f"column {place} '{shown(cell.strip())}' is not 'name [unit]': the file may be cut off")
        name = match["name"].strip() if match else cell.strip()
        if not name:
            raise InputError(f"column {place} has no name: write it as 'name [unit]', or remove it")
        if len(name) > LONGEST_NAME or not name.isprintable():
            raise InputError(
                f"column {place} '{shown(name)}': a name has at most {LONGEST_NAME} printable letters: rename it"
            )
        if name in seen:
            raise InputError(f"columns {seen[name]} and {place} are both '{name}': rename or remove one")
        seen[name] = place
        if units is not None and name not in units:
            raise UnknownNameError("column", name, units)
        choices = channel_units(name, where="column") if units is None else (units[name],)
        if match is None or not match["unit"].strip():
            raise InputError(f"column '{name}' has no unit: write it as '{name} [{choices[0]}]'")
        try:
            unit = channel_unit(name, match["unit"]) if units is None else _unit(units[name], match["unit"])
            columns.append((name, *unit))
        except InputError as error:
            raise InputError(f"column '{name}': {error}") from error
    if "time" not in seen:
        raise InputError("no 'time' column: add one named 'time [s]'")
    if len(seen) < 2:
        raise InputError("nothing but time: add a measured column such as 'load_force [N]'")
    return columns


def _unit(si: str, written: str) -> tuple[str, float]:
    return si, si_factor(written, si)


BLOCK = 2**20
"""Characters that are split into cells at a time: a cell takes ten times as much memory as its text."""


def _numbers(text: str, start: int, names: list[str], *, complete: bool) -> tuple[FloatArray, IntArray]:
    """Cells of the rows from `start` on as numbers (n, c), missing ones as nan; the number of each row (n,)."""
    header = start
    unfinished = start < len(text) and not text.endswith("\n")  # a finished file ends in a newline
    tables, numbers, row = [np.empty((0, len(names)))], [np.empty(0, dtype=np.int64)], 2
    while start < len(text):
        end = text.find("\n", start + BLOCK) + 1 or len(text)
        block = text[start:end]
        table = _plain(block, len(names))
        count = block.count("\n")
        if table is not None:
            rows = np.arange(row, row + count)
        else:
            table, rows = _looked_through(block, row, names, unfinished and end == len(text))
        tables.append(table)
        numbers.append(rows)
        row, start = row + count, end
        if row > MOST_ROWS + 2:
            raise InputError(f"has more than {MOST_ROWS} rows: cut it, or record more slowly")
    if unfinished and text[text.rfind("\n") + 1 :].strip():
        tail = text[max(header, len(text) - BLOCK) :].split("\n")[1 if len(text) - BLOCK > header else 0 :]
        cells = [line.rpartition(",")[2] for line in tail if line.strip()]
        if not is_whole(cells):
            raise InputError(cut_off(row, cells[-1], names[-1]))
    table, found = np.concatenate(tables), np.concatenate(numbers)
    least = 1 if complete else MIN_SAMPLES
    if len(table) < least:
        raise InputError(f"holds {len(table)} samples where at least {least} are needed: record longer")
    if complete and not np.isfinite(table).all():
        at, column = np.argwhere(~np.isfinite(table))[0]
        raise InputError(
            f"row {found[at]}, column '{names[column]}' holds no finite number: a trajectory has no missing samples"
        )
    return table, found


def _plain(block: str, width: int) -> FloatArray | None:
    """Whole rows of so many cells as numbers (n, width); None where anything is not as it mostly is."""
    if not block.endswith("\n") or not block.isascii() or "_" in block:
        return None
    marks = np.frombuffer(block.encode("ascii"), dtype=np.uint8)
    commas = np.cumsum(marks == ord(","))[marks == ord("\n")]
    if (np.diff(commas, prepend=0) != width - 1).any():
        return None
    cells = block[:-1].replace("\n", ",").split(",")
    try:
        if "" in cells:
            values = np.array([float(cell) if cell else np.nan for cell in cells])
        else:
            values = np.fromiter(map(float, cells), dtype=float, count=len(cells))
    except ValueError:
        return None
    return None if np.isinf(values).any() else values.reshape(-1, width)


def _looked_through(block: str, row: int, names: list[str], unfinished: bool) -> tuple[FloatArray, IntArray]:
    """As `_plain`, with the numbers (n,) of the rows, the first being `row`; says which cell is wrong.

    Args:
        block: the rows; those that are blank are left out.
        row: number of the first.
        names: of the columns.
        unfinished: whether the last row may be cut off.
    """
    lines = block.split("\n")
    if not lines[-1]:
        lines.pop()  # what follows the last newline
    kept = [(row + i, line) for i, line in enumerate(lines) if line and not line.isspace()]
    for at, line in kept:
        width = line.count(",") + 1
        if width < len(names) and unfinished and at == row + len(lines) - 1:
            raise InputError(cut_off(at, line.rpartition(",")[2], names[width - 1]))
        if width != len(names):
            raise InputError(f"row {at} has {width} cells where the header has {len(names)}: mend or remove the row")
    table = [[_number(cell, at, name) for cell, name in zip(line.split(","), names, strict=True)] for at, line in kept]
    return np.array(table).reshape(-1, len(names)), np.array([at for at, _ in kept], dtype=np.int64)


def _number(cell: str, row: int, name: str) -> float:
    text = cell.strip()
    if text.lower() in MISSING:
        return np.nan
    try:
        return number(text)
    except ValueError as error:
        raise InputError(f"row {row}, column '{name}': {error}: leave a missing sample's cell empty") from None


def _scaled(name: str, unit: str, factor: float, value: FloatArray, rows: IntArray) -> FloatArray:
    if np.isnan(value).all():
        raise InputError(f"column '{name}' holds no number at all: remove it or record it again")
    value = value if factor == 1.0 else value * factor
    beyond = first_implausible(unit, value)
    if beyond is not None:
        raise InputError(
            f"row {rows[beyond]}, column '{name}': {value[beyond]:.6g} {unit} is beyond {LARGEST[unit]:g} {unit}: "
            "check the column's unit, or empty the cell where the sensor failed"
        )
    return value


def _check_time(time: FloatArray, rows: IntArray) -> None:
    missing = np.flatnonzero(np.isnan(time))
    if missing.size:
        raise InputError(f"row {rows[missing[0]]} has no time: fill it in or remove the row")
    late = np.flatnonzero(np.diff(time) <= 0.0)
    if late.size:
        i = int(late[0])
        raise InputError(
            f"row {rows[i + 1]}: time does not increase, {time[i + 1]:.9g} s after {time[i]:.9g} s in row {rows[i]}: "
            "sort by time and remove repeated rows"
        )


def _channel(time: FloatArray, value: FloatArray, unit: str) -> Channel:
    present = ~np.isnan(value)
    return Channel(time[present], value[present], unit)
