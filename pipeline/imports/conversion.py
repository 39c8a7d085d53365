"""Makes a run of a foreign recording by a mapping; every problem is told at once."""

import difflib
from collections.abc import Collection, Iterable
from datetime import UTC, datetime
from typing import Any

import numpy as np

from armdyn.channels import (
    MIN_SAMPLES,
    Channel,
    FloatArray,
    channel_kind,
    channel_unit,
    check_joint_units,
)
from armdyn.errors import InputError
from armdyn.run import Run
from armdyn.units import parse_quantity, si_factor
from pipeline.imports.foreign import Column, Foreign, ImportProblemsError
from pipeline.imports.mapping import ColumnMap, Entry

YEARS = 2000, 2100
"""Between which stamps since 1970 are dates; no recording lasts so long that its own time goes so far."""
MOTOR_SIDE = {"q": -1, "v": -1, "a": -1, "tau": 1}
"""Power of the gear ratio by which a motor's value is multiplied to be the joint's."""


def imported(foreign: Foreign, mapping: ColumnMap, elsewhere: Collection[str] = ()) -> Run:
    """The run that a recording becomes.

    Args:
        foreign: the recording.
        mapping: which column is which channel.
        elsewhere: columns that other recordings have which are imported with it; this one may lack them.

    Raises:
        ImportProblemsError: lists everything that is wrong.
    """
    problems: list[str] = []
    notes = list(foreign.notes)
    stamps = _table_time(foreign, mapping, problems, notes) if foreign.is_table else None
    channels: dict[str, Channel] = {}
    taken: dict[str, str] = {}
    for name, entry in mapping.entries.items():
        if name not in foreign.columns:
            if name in elsewhere:
                notes.append(f"no column '{name}', which others have: no {entry.channel}")
            else:
                problems.append(_absent(name, foreign.columns))
            continue
        if entry.channel in taken:
            problems.append(f"'{taken[entry.channel]}' and '{name}' are both {entry.channel}: keep one of them")
            continue
        taken[entry.channel] = name
        column = foreign.columns[name]
        try:
            unit, value = converted(column, entry)
        except InputError as error:
            problems.append(f"'{name}': {error}")
            continue
        time, kept = (column.time, slice(None)) if stamps is None else stamps
        if time is None:
            continue
        value = value[kept]
        present = np.isfinite(value)
        late = parse_quantity(entry.late, "s").value if entry.late else 0.0
        if present.sum() < MIN_SAMPLES:
            problems.append(f"'{name}' holds {present.sum()} numbers where at least {MIN_SAMPLES} are needed")
            continue
        try:
            channels[entry.channel] = Channel(time[present] - late, value[present], unit)
        except InputError as error:
            problems.append(f"'{name}' as {entry.channel}: {error}")
    if not (problems or channels):
        problems.append("it has none of the columns of the mapping")
    if not problems:
        try:
            check_joint_units((name, channel.unit) for name, channel in channels.items())
        except InputError as error:
            problems.append(str(error))
    if problems:
        raise ImportProblemsError(foreign.name, problems)
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


def converted(column: Column, entry: Entry) -> tuple[str, FloatArray]:
    """SI unit and (n,) values of a column as the channel that it becomes.

    Raises:
        InputError: a unit is missing or of another kind, or a gear stands where none can be.
    """
    quantity = entry.channel.partition(".")[0]
    unit = entry.unit or column.unit
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
    else:
        try:
            si, factor = channel_unit(entry.channel, unit)
        except InputError as error:
            if quantity == "tau" and _is_current(unit):
                raise InputError('is a current: add torque_constant = "... N m/A" to its line') from error
            raise
    if entry.gear_ratio != 1.0 and quantity not in MOTOR_SIDE:
        raise InputError(f"{entry.channel} has no gear")
    factor *= entry.sign * entry.scale * entry.gear_ratio ** MOTOR_SIDE.get(quantity, 0)
    offset = parse_quantity(entry.offset, si).value if entry.offset else 0.0
    return si, column.value * factor + offset


def _is_current(unit: str) -> bool:
    try:
        si_factor(unit, "A")
    except InputError:
        return False
    return True


def _table_time(
    foreign: Foreign, mapping: ColumnMap, problems: list[str], notes: list[str]
) -> tuple[FloatArray | None, Any]:
    """Stamps of a table in s, and the rows that have one of their own."""
    if not mapping.time:
        problems.append('no time: add time = { column = "...", unit = "s" } to the mapping')
        return None, slice(None)
    if mapping.time not in foreign.columns:
        problems.append(_absent(mapping.time, foreign.columns))
        return None, slice(None)
    column = foreign.columns[mapping.time]
    try:
        time = column.value * si_factor(mapping.time_unit or column.unit or "s", "s")
    except InputError as error:
        problems.append(f"'{mapping.time}': {error}")
        return None, slice(None)
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
        problems.append(
            f"'{mapping.time}' goes back from {time[rows[i]]:.9g} to {time[rows[i + 1]]:.9g} s in row "
            f"{rows[i + 1] + 2}: cut the recording there"
        )
        return None, rows
    return time[rows], rows


def _absent(name: str, columns: Iterable[str]) -> str:
    close = difflib.get_close_matches(name, list(columns), n=1, cutoff=0.5)
    return f"there is no column '{name}'" + (f": did you mean '{close[0]}'?" if close else "")
