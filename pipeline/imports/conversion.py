"""Convert a recording in another format to a run by a mapping of its columns; all mistakes are reported together.

A column without numbers is left out and named; the other columns are imported all the same.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np
import numpy.typing as npt

from armdyn.errors import InputError, UnknownNameError, collect_errors, error_location
from armdyn.inspection.check import Check
from armdyn.inspection.correction import CorrectedReading
from armdyn.quoting import name_list
from armdyn.recording.channels import (
    MAX_PLAUSIBLE_SIZE_BY_UNIT,
    MAX_PLAUSIBLE_SIZE_OF_OTHER_UNITS,
    MIN_COMPARED_CHANNEL_SAMPLES,
    Channel,
    Conversion,
    FloatArray,
    channel_kind,
    check_joint_units,
    unit_conversion,
)
from armdyn.recording.units import parse_quantity, si_factor
from armdyn.run import Run
from pipeline.imports.commands import COMMAND_OF, with_commands
from pipeline.imports.foreign import ForeignColumn, ForeignRecording, ImportedSampleCounts
from pipeline.imports.guess import map_unambiguous_columns, map_unambiguous_commands
from pipeline.imports.joints import RobotJoints
from pipeline.imports.mapping import TIME_HINT, ColumnEntry, ColumnMap
from pipeline.imports.pendulum import tracked_swing
from pipeline.imports.register_entries import NO_DRIVES, DriveKinds
from pipeline.imports.registers import decoded
from pipeline.imports.stamps import samples_with_valid_stamps, without_rounding
from pipeline.imports.words import is_unit_like
from urdf.toml_tables import join_problems

DATE_STAMP_YEARS = 2000, 2100
"""First and last year of time stamps that count as dates, in seconds since 1970; no recording lasts that long."""
GEAR_RATIO_POWERS = {"q": -1, "v": -1, "a": -1, "tau": 1, "q_cmd": -1, "v_cmd": -1, "tau_ff": 1}
"""Exponent of the gear ratio in the factor that converts a motor's value to the joint's, by quantity."""
QUANTITIES_ZERO_IF_UNMEASURED = ("v", "a", "tau")
"""Quantities of a joint for which drivers send 0 if they do not measure them."""
RowIndices = npt.NDArray[np.intp]


@dataclass(frozen=True)
class ImportedRun:
    """A run that was converted from a recording in another format.

    Attributes:
        run: run with the channels of the mapping.
        accounts: numbers of used and left-out samples, for each topic, or for the table.
    """

    run: Run
    accounts: tuple[ImportedSampleCounts, ...]

    @property
    def checks(self) -> list[Check]:
        """Findings of the import that the user must know before using the run."""
        return [check for account in self.accounts for check in account.checks(self.run.name)]


def runs_from_recordings(
    recordings: Sequence[ForeignRecording],
    mappings: Mapping[str, ColumnMap] | None = None,
    joints: RobotJoints | None = None,
    drives: DriveKinds = NO_DRIVES,
    commands: Sequence[ForeignRecording] | None = None,
    rate: str = "",
) -> list[ImportedRun]:
    """Convert recordings in other formats to runs.

    Args:
        recordings: the recordings.
        mappings: meanings of columns by the name of the run, ``""`` for a single one; None where the columns' names
            are unambiguous.
        joints: joints of the robot; None where it is unknown.
        drives: kinds of drives whose registers the columns are.
        commands: recordings of what the joints were told; None where none was given.
        rate: rate of the rows of tables without stamps, with its unit; empty where there are stamps.

    Raises:
        InputError: the message lists every mistake.
    """
    told = None if commands is None else single_recording_of_commands(commands, recordings)
    columns = {name for foreign in recordings for name in foreign.columns}
    found: list[ImportedRun] = []
    problems: list[str] = []
    for foreign in recordings:
        for name, own in (mappings if mappings is not None else {"": None}).items():
            with collect_errors(problems):
                read = own or map_unambiguous_columns(foreign, joints, drives)
                if own is None and told is not None:
                    read = replace(read, commands=map_unambiguous_commands(told, joints, drives))
                read = replace(read, rate=rate) if rate else read
                part = replace(foreign, name=f"{foreign.name}_{name}") if name else foreign
                found.append(run_from_recording(part, read, columns, told))
    if problems:
        raise InputError("; ".join(problems))
    return found


def single_recording_of_commands(
    commands: Sequence[ForeignRecording], measured: Sequence[ForeignRecording]
) -> ForeignRecording:
    """The recording of commands that belongs to a recording of measurements.

    Raises:
        InputError: there are several of either.
    """
    if not len(commands) == len(measured) == 1:
        counts = f"{len(commands)} recordings of commands for {len(measured)} of measurements"
        raise InputError(f"{commands[0].name}: {counts}: give one of each")
    return commands[0]


def run_from_recording(
    foreign: ForeignRecording,
    mapping: ColumnMap,
    elsewhere: Collection[str] = (),
    commands: ForeignRecording | None = None,
) -> ImportedRun:
    """Convert a recording in another format to a run.

    Args:
        foreign: the recording.
        mapping: meaning of its columns.
        elsewhere: columns of other recordings that are imported together with it; this one may lack them.
        commands: recording of what the joints were told, with stamps of its own on the same clock; None without one.

    Raises:
        InputError: the message lists every mistake.
    """
    problems: list[str] = []
    notes = [*foreign.notes, *mapping.notes]
    channels, accounts = _channels(foreign, mapping, elsewhere, notes, problems)
    if commands is None and mapping.commands is not None:
        problems.append("the mapping has [commands], of a second file: give that with --commands FILE")
    elif commands is not None and mapping.commands is None:
        problems.append("the mapping has no [commands] for the columns of --commands FILE: let --guess propose both")
    elif channels and all(name.partition(".")[0] in COMMAND_OF.values() for name in channels):
        problems.append("holds only commands: give it as --commands FILE, together with the measurements")
    if commands is not None and mapping.commands is not None:
        notes += [*commands.notes, *mapping.commands.notes]
        said: list[str] = []
        told, of_commands = _channels(commands, mapping.commands, (), notes, said)
        accounts += [replace(account, source=account.source or commands.name) for account in of_commands]
        problems += [f"{commands.name}: {problem}" for problem in said]
        if not problems:
            with collect_errors(problems, commands.name):
                channels, more = with_commands(channels, told, commands.name)
                notes += more
    with collect_errors(problems):
        check_joint_units((name, channel.unit) for name, channel in channels.items())
    if problems:
        raise InputError(f"{foreign.name}: {join_problems(problems)}")
    first = min(channel.time[0] for channel in channels.values())
    run = Run(
        foreign.name,
        {name: Channel(c.time - first, c.value, c.unit) for name, c in channels.items()},
        mapping.sidecar.known,
        {name: noise.value for name, noise in mapping.sidecar.noise.items()},
        mapping.sidecar.description,
        warnings=tuple(notes),
        recorded=mapping.sidecar.recorded or _date(first),
        asked={channel: doubt for channel, doubt in mapping.asked.items() if channel in {"time", *channels}},
    )
    return ImportedRun(run, tuple(accounts))


def _channels(
    foreign: ForeignRecording, mapping: ColumnMap, elsewhere: Collection[str], notes: list[str], problems: list[str]
) -> tuple[dict[str, Channel], list[ImportedSampleCounts]]:
    """Channels of a recording with its own times [s], and numbers of used samples; adds to notes and problems."""
    table: tuple[FloatArray, RowIndices] | None = None
    accounts: list[ImportedSampleCounts] = []
    empty: list[str] = []
    if foreign.is_table:
        with collect_errors(problems):
            time, rows, account = _table_time(foreign, mapping, notes)
            table = time, rows
            accounts.append(account)
    channels: dict[str, Channel] = {}
    used: dict[str, str] = {}
    mended: dict[str, list[str]] = {}
    for name, entry in mapping.entries.items():
        if name not in foreign.columns and name in elsewhere:
            notes.append(f"no column '{name}', which others have: no {entry.channel}")
        elif name not in foreign.columns:
            problems.append(str(UnknownNameError("column", name, foreign.columns)))
        elif used.setdefault(entry.channel, name) != name:
            problems.append(f"'{used[entry.channel]}' and '{name}' are both {entry.channel}: keep one of them")
        elif why := _is_empty(foreign.columns[name], entry):
            empty.append(f"'{name}' {why}: no {entry.channel}")
        else:
            with collect_errors(problems, f"'{name}'"):
                column = _swing(name, foreign, entry, notes) if entry.height else foreign.columns[name]
                channels[entry.channel] = _channel(name, column, entry, table, notes)
                if decoded(foreign.columns[name].value, entry.negative)[1]:
                    mended.setdefault(entry.negative, []).append(f"'{name}'")
    if not (problems or channels):
        problems += empty or ["it has none of the columns of the mapping"]
    notes += empty
    notes += [f"raw negative numbers ({how}) are mended in {name_list(names, 3)}" for how, names in mended.items()]
    sources = dict.fromkeys(column.source for name, column in foreign.columns.items() if name in mapping.entries)
    return channels, accounts + [foreign.accounts[source] for source in sources if source in foreign.accounts]


def _swing(name: str, foreign: ForeignRecording, entry: ColumnEntry, notes: list[str]) -> ForeignColumn:
    """The swing of a load whose place was tracked in a picture, as a column."""
    if entry.channel != "swing_angle":
        raise InputError(f"its height '{entry.height}' makes a swing_angle of it, not {entry.channel}")
    if entry.height not in foreign.columns:
        raise UnknownNameError("column", entry.height, foreign.columns)
    angle, said = tracked_swing(foreign.columns[name].value, foreign.columns[entry.height].value, entry.pivot)
    notes += [f"'{name}', '{entry.height}': {said}"] if said else []
    return ForeignColumn(angle, "rad")


def _is_empty(column: ForeignColumn, entry: ColumnEntry) -> str:
    """Reason why a column becomes no channel; empty where it becomes one."""
    present = column.value[np.isfinite(column.value)]
    if len(present) < MIN_COMPARED_CHANNEL_SAMPLES:
        return f"holds {len(present)} numbers where at least {MIN_COMPARED_CHANNEL_SAMPLES} are needed"
    return "holds nothing but zeros" if entry.quantity in QUANTITIES_ZERO_IF_UNMEASURED and not present.any() else ""


def _date(stamp: float) -> datetime | None:
    """Date of a stamp in seconds since 1970; None where the stamp counts from another moment."""
    first, last = (datetime(year, 1, 1, tzinfo=UTC).timestamp() for year in DATE_STAMP_YEARS)
    return datetime.fromtimestamp(round(stamp), UTC).replace(tzinfo=None) if first <= stamp < last else None


def _channel(
    name: str, column: ForeignColumn, entry: ColumnEntry, table: tuple[FloatArray, RowIndices] | None, notes: list[str]
) -> Channel:
    """The channel that a column becomes; `table` contains the stamps [s] and indices of the rows of a table."""
    to_si = _conversion(entry, entry.unit or column.unit)
    value = to_si(decoded(column.value, entry.negative)[0])
    if table is not None:
        time, value = table[0], value[table[1]]
    elif column.time is not None:
        time = column.time
    else:  # the time of the table is unusable, which is reported once
        time = np.arange(len(value), dtype=float)
    present = np.isfinite(value)
    if table is None and not present.all():
        notes.append(f"'{name}': {np.count_nonzero(~present)} of {len(value)} values are not numbers: they are missing")
    largest = MAX_PLAUSIBLE_SIZE_BY_UNIT.get(to_si.unit, MAX_PLAUSIBLE_SIZE_OF_OTHER_UNITS)
    beyond = np.abs(np.where(present, value, 0.0)) > largest
    if beyond.any() and 2 * beyond.sum() < present.sum():
        notes.append(
            f"'{name}': {beyond.sum()} values, such as {value[beyond][0]:.4g} {to_si.unit}, are nothing that a sensor "
            "measures: they are missing"
        )
        present &= ~beyond
    late = parse_quantity(entry.late, "s").value if entry.late else 0.0
    turn = parse_quantity(entry.turn, to_si.unit).value if entry.turn else 0.0
    reading = CorrectedReading(name, delay=late, clock_rate_error=entry.fast, wrap_period=turn)
    return Channel(reading.true_times(time[present]), reading.values(value[present]), to_si.unit)


def _conversion(entry: ColumnEntry, unit: str) -> Conversion:
    """The conversion of values in `unit` to those of the entry's channel."""
    zero = 0.0
    if not unit:
        units = " or ".join(channel_kind(entry.channel).units)
        raise InputError(f'its unit is not known: add unit = "..." to its line, such as {units}')
    if entry.torque_constant:
        if entry.quantity != "tau":
            raise InputError(f"a torque constant makes torques of currents, not {entry.channel}")
        try:
            constant, si = parse_quantity(entry.torque_constant, "N m/A").value, "N m"
        except InputError:
            constant, si = parse_quantity(entry.torque_constant, "N/A").value, "N"
        factor = si_factor(unit, "A") * constant
    elif entry.quantity == "tau" and is_unit_like(unit, "A"):
        raise InputError('is a current: add torque_constant = "... N m/A" to its line')
    else:
        si, factor, zero = unit_conversion(entry.channel, unit)
    if entry.gear_ratio != 1.0 and entry.quantity not in GEAR_RATIO_POWERS:
        raise InputError(f"{entry.channel} has no gear")
    factor *= entry.sign * entry.scale * entry.gear_ratio ** GEAR_RATIO_POWERS.get(entry.quantity, 0)
    offset = parse_quantity(entry.offset, si).value if entry.offset else 0.0
    return Conversion(si, factor, zero + offset)


def _table_time(
    foreign: ForeignRecording, mapping: ColumnMap, notes: list[str]
) -> tuple[FloatArray, RowIndices, ImportedSampleCounts]:
    """Stamps [s] and indices of the rows of a table that are used, and their account; adds to the notes."""
    count = len(next(iter(foreign.columns.values())).value)
    if mapping.rate:
        return (
            np.arange(count) / parse_quantity(mapping.rate, "Hz").value,
            np.arange(count),
            ImportedSampleCounts("", count, count),
        )
    if not mapping.time:
        raise InputError(f"no time: {TIME_HINT}")
    if mapping.time not in foreign.columns:
        raise UnknownNameError("column", mapping.time, foreign.columns)
    column = foreign.columns[mapping.time]
    unit = mapping.time_unit or column.unit or "s"
    with error_location(f"'{mapping.time}'"):
        factor = si_factor(unit, "s")
    found = samples_with_valid_stamps(column.value * factor)
    account = ImportedSampleCounts("", count, len(found.rows), dict(found.left_out), found.steps)
    if account.kept < MIN_COMPARED_CHANNEL_SAMPLES:
        raise InputError(f"'{mapping.time}' is not a time: {account.sentence}: sort the rows by time, or {TIME_HINT}")
    if len(found.rows) == count:
        regular, step = without_rounding(column.value)
        if step:
            rate = 1.0 / (factor * (regular[1] - regular[0]))
            notes.append(
                f"'{mapping.time}' is rounded to {step:g} {unit}, and agrees with {rate:.6g} Hz: this rate is used"
            )
            return regular * factor, found.rows, account
    return found.time, found.rows, account
