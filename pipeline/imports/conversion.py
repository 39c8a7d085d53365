"""Makes a run of a foreign recording by a mapping; every problem is told at once."""

from collections.abc import Collection
from datetime import UTC, datetime

import numpy as np
import numpy.typing as npt

from armdyn.channels import MIN_SAMPLES, Channel, Conversion, FloatArray, channel_kind, channel_unit, check_joint_units
from armdyn.errors import InputError, UnknownNameError, at, collect
from armdyn.run import Run
from armdyn.units import parse_quantity, si_factor
from pipeline.imports.foreign import Column, Foreign
from pipeline.imports.mapping import ColumnMap, Entry
from pipeline.imports.words import fits
from urdf.table_file import join_problems

YEARS = 2000, 2100
"""Between which stamps since 1970 are dates; no recording lasts so long that its own time goes so far."""
MOTOR_SIDE = {"q": -1, "v": -1, "a": -1, "tau": 1}
"""Power of the gear ratio by which a motor's value is multiplied to be the joint's."""
Rows = npt.NDArray[np.intp]


def run_of(foreign: Foreign, mapping: ColumnMap, elsewhere: Collection[str] = ()) -> Run:
    """The run that a recording becomes.

    Args:
        foreign: the recording.
        mapping: which column is which channel.
        elsewhere: columns that other recordings have which are imported with it; this one may lack them.

    Raises:
        InputError: lists everything that is wrong.
    """
    problems: list[str] = []
    notes = list(foreign.notes)
    table: tuple[FloatArray, Rows] | None = None
    if foreign.is_table:
        with collect(problems):
            table = _table_time(foreign, mapping, notes)
    channels: dict[str, Channel] = {}
    taken: dict[str, str] = {}
    for name, entry in mapping.entries.items():
        if name not in foreign.columns and name in elsewhere:
            notes.append(f"no column '{name}', which others have: no {entry.channel}")
        elif name not in foreign.columns:
            problems.append(str(UnknownNameError("column", name, foreign.columns)))
        elif taken.setdefault(entry.channel, name) != name:
            problems.append(f"'{taken[entry.channel]}' and '{name}' are both {entry.channel}: keep one of them")
        else:
            with collect(problems, f"'{name}'"):
                channels[entry.channel] = _channel(foreign.columns[name], entry, table)
    if not (problems or channels):
        problems.append("it has none of the columns of the mapping")
    with collect(problems):
        check_joint_units((name, channel.unit) for name, channel in channels.items())
    if problems:
        raise InputError(f"{foreign.name}: {join_problems(problems)}")
    first = min(channel.time[0] for channel in channels.values())
    channels = {name: Channel(c.time - first, c.value, c.unit) for name, c in channels.items()}
    return Run(
        foreign.name, channels, mapping.sidecar.known, {n: k.value for n, k in mapping.sidecar.noise.items()},
        mapping.sidecar.description, warnings=tuple(notes), recorded=mapping.sidecar.recorded or _date(first),
    )  # fmt: skip


def _date(stamp: float) -> datetime | None:
    """When a recording began whose stamps are s since 1970; None where they count from anything else."""
    first, last = (datetime(year, 1, 1, tzinfo=UTC).timestamp() for year in YEARS)
    return datetime.fromtimestamp(round(stamp), UTC).replace(tzinfo=None) if first <= stamp < last else None


def _channel(column: Column, entry: Entry, table: tuple[FloatArray, Rows] | None) -> Channel:
    """The channel that a column becomes, with the time of its table, or with its own where that is None."""
    to_si = _conversion(entry, entry.unit or column.unit)
    value = to_si(column.value)
    if table is not None:
        time, value = table[0], value[table[1]]
    elif column.time is not None:
        time = column.time
    else:  # the time of the table cannot be used, which is told once
        time = np.arange(len(value), dtype=float)
    present = np.isfinite(value)
    if present.sum() < MIN_SAMPLES:
        raise InputError(f"holds {present.sum()} numbers where at least {MIN_SAMPLES} are needed")
    late = parse_quantity(entry.late, "s").value if entry.late else 0.0
    return Channel(time[present] - late, value[present], to_si.unit)


def _conversion(entry: Entry, unit: str) -> Conversion:
    """From values in `unit` to those of the channel that they become.

    Raises:
        InputError: the unit is missing or of another kind, or a gear stands where none can be.
    """
    quantity = entry.channel.partition(".")[0]
    zero = 0.0
    if not unit:
        units = " or ".join(channel_kind(entry.channel).units)
        raise InputError(f'its unit is not known: add unit = "..." to its line, such as {units}')
    if entry.torque_constant:
        if quantity != "tau":
            raise InputError(f"a torque constant makes torques of currents, not {entry.channel}")
        try:
            constant, si = parse_quantity(entry.torque_constant, "N m/A").value, "N m"
        except InputError:
            constant, si = parse_quantity(entry.torque_constant, "N/A").value, "N"
        factor = si_factor(unit, "A") * constant
    elif quantity == "tau" and fits(unit, "A"):
        raise InputError('is a current: add torque_constant = "... N m/A" to its line')
    else:
        si, factor, zero = channel_unit(entry.channel, unit)
    if entry.gear_ratio != 1.0 and quantity not in MOTOR_SIDE:
        raise InputError(f"{entry.channel} has no gear")
    factor *= entry.sign * entry.scale * entry.gear_ratio ** MOTOR_SIDE.get(quantity, 0)
    offset = parse_quantity(entry.offset, si).value if entry.offset else 0.0
    return Conversion(si, factor, zero + offset)


def _table_time(foreign: Foreign, mapping: ColumnMap, notes: list[str]) -> tuple[FloatArray, Rows]:
    """Stamps of a table in s, and the rows that have one of their own."""
    if not mapping.time:
        raise InputError('no time: add time = { column = "...", unit = "s" } to the mapping')
    if mapping.time not in foreign.columns:
        raise UnknownNameError("column", mapping.time, foreign.columns)
    column, where = foreign.columns[mapping.time], f"'{mapping.time}'"
    with at(where):
        time = column.value * si_factor(mapping.time_unit or column.unit or "s", "s")
    missing = ~np.isfinite(time)
    if missing.any():
        notes.append(f"{missing.sum()} rows without a time left out")
    rows = np.flatnonzero(~missing)
    repeated = np.diff(time[rows], prepend=-np.inf) == 0.0
    if repeated.any():
        notes.append(f"{repeated.sum()} rows with the time of the row before left out")
    rows = rows[~repeated]
    late = np.flatnonzero(np.diff(time[rows]) < 0.0)
    if late.size:
        i = int(late[0])
        raise InputError(
            f"{where} goes back from {time[rows[i]]:.9g} to {time[rows[i + 1]]:.9g} s in row {rows[i + 1] + 2}: cut "
            "the recording there"
        )
    return time[rows], rows
