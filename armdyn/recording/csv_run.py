"""Read and write recordings as CSV: columns ``name [unit]``, a row per time stamp, empty cells for missing samples."""

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from armdyn.errors import InputError, UnknownNameError, error_location
from armdyn.recording.channels import (
    MIN_COMPARED_CHANNEL_SAMPLES,
    Channel,
    Conversion,
    FloatArray,
    SampleError,
    channel_units,
    check_joint_units,
    is_auxiliary,
    is_channel_name,
    name_and_unit,
    unit_conversion,
)
from armdyn.recording.delimited import DelimitedTable, IntArray, header_of, labels_of, parse_delimited, read_text
from armdyn.recording.units import si_factor
from urdf.bounds import MAX_NAME_CHARACTERS, parse_number, printable_excerpt


def read_csv(path: Path, units: Mapping[str, str] | None = None) -> dict[str, Channel]:
    """Read and check all columns of a CSV file.

    Args:
        path: the CSV file.
        units: SI unit of every allowed column, for a table that is not a recording; then no sample may be missing,
            however few there are.

    Returns:
        The channels by name, in SI units, without missing samples.

    Raises:
        InputError: it names the file, the row or column, what is wrong and what to do.
    """
    # Quotes are dropped: a comma inside them is a decimal comma, which gives the row too many cells: an error below.
    text = read_text(path).replace('"', "")
    header, proposal = header_of(text), f"'armdyn import {path} --output runs --guess'"
    if units is None and _is_foreign(header):
        raise InputError(
            f"{path}: its columns ({printable_excerpt(header.strip())}) are not written as a run's, such as "
            "'time [s]': make a run "
            f"of it, {proposal}"
        )
    try:
        columns = header_columns(header, units)
        return _channels(parse_delimited(text), columns, complete=units is not None)
    except UnknownNameError as error:
        strange = f"; if it is another program's: {proposal}" if units is None else ""
        raise InputError(f"{path}: {error}{strange}") from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _is_foreign(header: str) -> bool:
    """Whether a header is not that of a run: it has no unit in brackets, or neither the time nor a channel."""
    cells = [name_and_unit(cell) for cell in re.split("[,;\t]", header)]
    known = any(name == "time" or is_channel_name(name) for name, _ in cells)
    return len(cells) > 1 and not (known and "[" in header)


def csv_text(channels: Mapping[str, Channel]) -> str:
    """Write channels as one table; a channel without a sample at a stamp gets an empty cell there.

    Numbers have all their digits: reading them back gives the same floats.

    Raises:
        InputError: a channel has a name that would be read as another one.
    """
    for name in channels:
        if set(name) & set(',"[]') or not name.isprintable() or len(name) > MAX_NAME_CHARACTERS:
            raise InputError(
                f"channel {printable_excerpt(name)}: a table cannot hold such a name: rename its joint, "
                "or map its column to another"
            )
    time = np.unique(np.concatenate([channel.time for channel in channels.values()]))
    columns = [[repr(t) for t in time.tolist()]]
    for channel in channels.values():
        cells = [""] * time.size
        for row, value in zip(np.searchsorted(time, channel.time).tolist(), channel.value.tolist(), strict=True):
            cells[row] = repr(value)
        columns.append(cells)
    header = ",".join(["time [s]", *(f"{name} [{channel.unit}]" for name, channel in channels.items())])
    return "\n".join([header, *map(",".join, zip(*columns, strict=True))]) + "\n"


def header_columns(header: str, units: Mapping[str, str] | None = None) -> dict[str, Conversion]:
    """Conversion of each column of a recording to its SI unit, by the column's name.

    Args:
        header: first line of the table.
        units: SI unit of every allowed column, for a table that is not a recording.

    Raises:
        InputError: the columns are not separated by commas, or one has no known name and unit.
    """
    for separator, separators in ((";", "semicolons"), ("\t", "tabs")):
        if separator in header and "," not in header:
            raise InputError(f"columns are separated by {separators}: save it with commas and decimal points")
    columns: dict[str, Conversion] = {}
    for place, label in enumerate(labels_of(header, ","), start=1):
        name, written = name_and_unit(label)
        if not written and "[" in label and not label.endswith("]"):
            raise InputError(
                f"column {place} '{printable_excerpt(label)}' is not 'name [unit]': the file may be cut off"
            )
        name = name.partition("[")[0].strip()
        if not name:
            raise InputError(f"column {place} has no name: write it as 'name [unit]', or remove it")
        if name in columns:
            first = list(columns).index(name) + 1
            raise InputError(f"columns {first} and {place} are both '{name}': rename or remove one")
        if units is not None and name not in units:
            raise UnknownNameError("column", name, units)
        choices = channel_units(name, where="column") if units is None else (units[name],)
        if not written and not is_auxiliary(name):
            raise InputError(f"column '{name}' has no unit: write it as '{name} [{choices[0]}]'")
        with error_location(f"column '{name}'"):
            columns[name] = (
                unit_conversion(name, written)
                if units is None
                else Conversion(choices[0], si_factor(written, choices[0]))
            )
    if "time" not in columns:
        raise InputError("no 'time' column: add one named 'time [s]'")
    if len(columns) < 2:
        raise InputError("nothing but time: add a measured column such as 'load_force [N]'")
    if units is None:
        check_joint_units((name, column.unit) for name, column in columns.items() if name != "time")
    return columns


def _channels(table: DelimitedTable, columns: Mapping[str, Conversion], *, complete: bool) -> dict[str, Channel]:
    """The channels of a table; `complete` where no sample may be missing."""
    names, rows, values = list(columns), table.rows, table.values
    for k, cells in table.texts.items():
        for i, cell in cells.items():
            try:
                parse_number(cell)
            except ValueError as error:
                where = f"row {rows[i]}, column '{names[k]}'"
                raise InputError(f"{where}: {error}: leave a missing sample's cell empty") from None
    least = 1 if complete else MIN_COMPARED_CHANNEL_SAMPLES
    if len(rows) < least:
        raise InputError(f"holds {len(rows)} samples where at least {least} are needed: record longer")
    if complete and not np.isfinite(values).all():
        i, k = np.argwhere(~np.isfinite(values))[0]
        raise InputError(
            f"row {rows[i]}, column '{names[k]}' holds no finite number: a trajectory has no missing samples"
        )
    samples = {name: to_si(column) for (name, to_si), column in zip(columns.items(), values.T, strict=True)}
    for name, value in samples.items():
        if np.isnan(value).all():
            raise InputError(f"column '{name}' holds no number at all: remove it or record it again")
    time = samples.pop("time")
    _check_time(time, rows)
    found = {}
    for name, value in samples.items():
        present = ~np.isnan(value)
        try:
            found[name] = Channel(time[present], value[present], columns[name].unit)
        except SampleError as error:
            raise InputError(f"row {rows[present][error.index]}, column '{name}': {error.fault}") from error
    return found


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
