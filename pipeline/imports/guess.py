"""Propose a mapping from names, units and ranges; a person reads it before it is used.

The names of the columns, of an arm or of a pendulum, give claims to channels. The best claim to a channel is compared
with the numbers: positions with the joints' ranges, speeds with the slopes of the positions, torques with the motors'
limits. A line that names and numbers leave open says CHECK.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

from armdyn.errors import InputError, error_location
from armdyn.quoting import name_list
from armdyn.recording.channels import WRENCH_CHANNELS, channel_kind, is_channel_name
from armdyn.recording.units import si_factor
from pipeline.imports.claims import Claim, best_claims
from pipeline.imports.commands import COMMAND_OF, as_command, command_entries
from pipeline.imports.foreign import ForeignColumn, ForeignRecording
from pipeline.imports.joint_claims import are_of_arm, joint_claims, labels_of_joints, wrench_entries
from pipeline.imports.joints import RobotJoints
from pipeline.imports.mapping import ColumnEntry, ColumnMap
from pipeline.imports.pendulum import PENDULUM_PARTS, pendulum_claims, tracked_entries
from pipeline.imports.register_entries import NO_DRIVES, DriveKinds, register_entries
from pipeline.imports.table_time import guess_time, in_seconds, unambiguous_time
from pipeline.imports.units import entries_with_inferred_units, joined_doubts, largest_magnitude, process_entries, span
from pipeline.imports.words import (
    ColumnHeaderParts,
    split_column_header,
)

MAX_COMMAND_TO_POSITION_RATIO = 5.0
"""Largest ratio of the largest command to the largest position in the same unit, or inverse; there are 57 degrees in a
radian."""


def map_unambiguous_columns(
    foreign: ForeignRecording, joints: RobotJoints | None = None, drives: DriveKinds = NO_DRIVES
) -> ColumnMap:
    """Mapping of columns whose names are unambiguous: joint states, names of armdyn's channels, registers of drives.

    Args:
        foreign: the recording.
        joints: joints of the robot, whose names are used where it is certain which joint is meant; None where the
            robot is unknown.
        drives: kinds of drives whose registers the recording contains.

    Raises:
        InputError: the names define no channel, or it is uncertain whether the joints are the robot's.
    """
    if drives:
        return _certain_registers(foreign, joints, drives)
    entries = _declared(foreign.columns, joints or RobotJoints())
    if not entries:
        shown = ", ".join(f"'{name}'" for name in list(foreign.columns)[:6])
        raise InputError(
            f"{foreign.name}: no column has the name of a channel (it has {shown}): let armdyn propose a mapping with "
            "--guess, or write one and give it with --map"
        )
    notes: list[str] = []
    if any(entry.quantity == "q" for entry in entries.values()):
        beside = {name: column for name, column in foreign.columns.items() if name not in entries}
        found = wrench_entries({name: split_column_header(name, column.unit) for name, column in beside.items()})
        entries |= {name: entry for name, entry in found.items() if not entry.check}
    if joints is not None:
        joined = (entry.joint for entry in entries.values() if entry.quantity not in WRENCH_CHANNELS)
        missing, own = _missing(entries, joints), dict.fromkeys(joined)
        if missing and not set(own) <= set(joints.names):
            guessed = guess_map([foreign], joints).entries
            found = {name: guessed[name] for name in entries if name in guessed}
            if any(entry.check for entry in found.values()) or not set(missing) - set(_missing(found, joints)):
                raise InputError(
                    f"{foreign.name}: its joints ({name_list(own)}) are not called as the robot's "
                    f"({name_list(joints.arm)}): let armdyn propose which is which with --guess, or give the right "
                    "robot"
                )
            renamed = {entries[name].joint: entry.joint for name, entry in found.items()}
            notes += [f"joint '{a}' of the recording is '{b}' of the robot" for a, b in renamed.items() if a != b]
            entries |= found
        notes += [f"joint '{joint}' of the robot was never sent" for joint in _missing(entries, joints)]
    time = unambiguous_time(foreign) if foreign.is_table else ColumnMap({})
    return replace(time, entries=entries, notes=tuple(notes))


def _certain_registers(foreign: ForeignRecording, joints: RobotJoints | None, drives: DriveKinds) -> ColumnMap:
    """Mapping of registers about whose positions and commands there is no doubt; other doubtful ones are left out."""
    guessed = guess_map([foreign], joints, drives=drives)
    entries = {name: entry for name, entry in guessed.entries.items() if not entry.check}
    doubtful = {name: entry for name, entry in guessed.entries.items() if entry.check}
    for name, entry in doubtful.items():
        if entry.quantity in ("q", "q_cmd") or not entries:
            raise InputError(f"{foreign.name}: '{name}': {entry.check}: let --guess propose a mapping, and read it")
    notes = dict.fromkeys(entry.why for entry in entries.values() if entry.why)
    left = [f"'{name}' is left out: {entry.check}" for name, entry in doubtful.items()]
    time = unambiguous_time(foreign) if foreign.is_table else ColumnMap({})
    return replace(time, entries=entries, notes=(*notes, *left))


def _declared(columns: Mapping[str, ForeignColumn], known: RobotJoints) -> dict[str, ColumnEntry]:
    """Columns whose channel the file itself defines."""
    found = {}
    for name, column in columns.items():
        entry = ColumnEntry(column.channel or name, column.unit)
        if is_channel_name(entry.channel) and not _is_repeated(name, columns):
            sliding = column.channel and entry.joint in known.sliding
            found[name] = replace(entry, unit=channel_kind(entry.channel).units[-1]) if sliding else entry
    return found


def _is_repeated(name: str, columns: Collection[str]) -> bool:
    """Whether a column is a second one with the same header, whose meaning is unknown."""
    return name.rpartition("#")[0] in columns


def _missing(entries: Mapping[str, ColumnEntry], joints: RobotJoints) -> tuple[str, ...]:
    present = {entry.joint for entry in entries.values()}
    return tuple(joint for joint in joints.arm if joint not in present)


def guess_map(
    recordings: Sequence[ForeignRecording],
    joints: RobotJoints | None = None,
    rate: str = "",
    drives: DriveKinds = NO_DRIVES,
) -> ColumnMap:
    """Mapping with the most likely meaning of the columns of recordings in one format.

    Args:
        recordings: one or more; the ranges of values are those of all of them.
        joints: joints of the robot; None where it is unknown.
        rate: rate of the rows of a table without stamps, with its unit.
        drives: kinds of drives whose registers the recordings contain.

    Raises:
        InputError: no column looks like a channel.
    """
    known, first = joints or RobotJoints(), recordings[0]
    columns: dict[str, list[ForeignColumn]] = {}
    for foreign in recordings:
        for name, column in foreign.columns.items():
            columns.setdefault(name, []).append(column)
    timing = guess_time(first) if first.is_table and not rate else ColumnMap({}, rate=rate)
    declared = _declared({name: found[0] for name, found in columns.items() if found[0].unit}, known)
    complete = not _missing(declared, known)
    seconds = first.columns[timing.time].value * si_factor(timing.time_unit, "s") if timing.time else None
    entries, registers = register_entries(columns, drives, known, first, seconds) if drives else ({}, set())
    if drives and not registers:
        raise InputError(
            f"{first.name}: no column is called as a register of {name_list(drives.series)}, such as Present_Position: "
            "leave out --drive"
        )
    labels: dict[str, ColumnHeaderParts] = {}
    of_joints: dict[str, ColumnHeaderParts] = {}
    for name, found in columns.items():
        if name == timing.time or name in registers or _is_repeated(name, columns):
            continue
        if (entry := declared.get(name)) is None:
            labels[name] = split_column_header(name, found[0].unit)
        elif complete or not entry.joint or entry.joint in known.beside or entry.quantity in WRENCH_CHANNELS:
            entries[name] = entry
        else:
            of_joints[name] = replace(
                split_column_header(entry.joint), quantity=entry.quantity, unit=entry.unit, doubt=""
            )
    of_joints = labels_of_joints(labels, known) | of_joints
    if known.arm or drives or are_of_arm(of_joints):
        entries |= wrench_entries(labels)
        of_joints = {name: label for name, label in of_joints.items() if name not in entries}
        spans = {name: max(span(column.value) for column in columns[name]) for name in of_joints}
        claims = joint_claims(of_joints, known, first.texts, spans)
    else:
        claims, known = pendulum_claims(labels), PENDULUM_PARTS
    if not first.headed:
        claims = _claims_by_order(first, timing.time, known)
    taken = {entry.channel for entry in entries.values()}
    best = best_claims(claim for claim in claims if claim.channel not in taken)
    entries |= entries_with_inferred_units(best, columns, known, first, seconds)
    if not entries and joints is None and first.is_table:
        with error_location(first.name):
            entries = tracked_entries(first.columns, labels)
        if not entries:
            entries, timing = process_entries(first.columns, timing.time), in_seconds(timing)
    if not entries:
        shown = ", ".join(f"'{name}'" for name in list(columns)[:6])
        raise InputError(f"{first.name}: none of its columns ({shown}) looks like a channel: write a mapping, --map")
    if not any(entry.quantity == "tau" for entry in entries.values()):
        # Without torques the error of a drive replaces the torque.
        entries |= command_entries(labels, entries, known, first.texts)
    return replace(timing, entries={name: entries[name] for name in columns if name in entries})


def guess_commands(
    commands: ForeignRecording,
    foreign: ForeignRecording,
    measured: ColumnMap,
    joints: RobotJoints | None = None,
    drives: DriveKinds = NO_DRIVES,
) -> ColumnMap:
    """Mapping of a file of commands, beside a recording of the same joints.

    Every column with a joint's position or speed is what the joint was told, whatever its header says.

    Args:
        commands: the file.
        foreign: the recording.
        measured: mapping of the recording.
        joints: joints of the robot; None where it is unknown.
        drives: kinds of drives whose registers the file contains.

    Raises:
        InputError: no column looks like a command of a measured joint.
    """
    timing = guess_time(commands) if commands.is_table else ColumnMap({})
    known = joints or RobotJoints()
    columns = {name: [column] for name, column in commands.columns.items()}
    raw, registers = register_entries(columns, drives, known, commands, None) if drives else ({}, set())
    stated = {name: entry for name, entry in _declared(commands.columns, known).items() if entry.unit}
    entries = {
        name: as_command(entry)
        for name, entry in (stated | raw).items()
        if entry.quantity in COMMAND_OF or entry.quantity in COMMAND_OF.values()
    }
    labels = {}
    for name, column in commands.columns.items():
        label = split_column_header(name, column.unit)
        if name not in (timing.time, *entries, *registers) and (label.measured or label.commanded):
            labels[name] = replace(label, commanded=True, quantity=label.quantity or "q")
    taken = {entry.channel for entry in entries.values()}
    for name, entry in command_entries(labels, measured.entries, known, commands.texts).items():
        if entry.channel not in taken:
            doubt = _size_doubt(name, entry, commands, foreign, measured)
            entries[name] = replace(entry, check=joined_doubts([entry.check, doubt]))
    if not entries:
        shown = ", ".join(f"'{name}'" for name in list(commands.columns)[:6])
        raise InputError(
            f"{commands.name}: none of its columns ({shown}) looks like a command of a measured joint: write "
            "[commands.columns] into a mapping, --map"
        )
    return replace(timing, entries={name: entries[name] for name in commands.columns if name in entries})


def _size_doubt(
    name: str, entry: ColumnEntry, commands: ForeignRecording, foreign: ForeignRecording, measured: ColumnMap
) -> str:
    """Doubt about a command of another size than its position, which has the same unit; empty for none."""
    at = next((column for column, own in measured.entries.items() if own.channel == f"q.{entry.joint}"), None)
    if entry.quantity != "q_cmd" or at is None or at not in foreign.columns:
        return ""
    told, gone = (largest_magnitude([of.columns[c]]) for of, c in ((commands, name), (foreign, at)))
    alike = gone / MAX_COMMAND_TO_POSITION_RATIO <= told <= gone * MAX_COMMAND_TO_POSITION_RATIO
    return "" if alike else f"up to {told:.4g}, and its position is up to {gone:.4g}: in another unit?"


def map_unambiguous_commands(
    commands: ForeignRecording, joints: RobotJoints | None = None, drives: DriveKinds = NO_DRIVES
) -> ColumnMap:
    """Mapping of a file of commands whose columns have the names of channels; `q.elbow` is then a commanded position.

    Raises:
        InputError: as `map_unambiguous_columns`; or a column is not a command.
    """
    found = map_unambiguous_columns(commands, joints, drives)
    with error_location(commands.name):
        return replace(found, entries={name: as_command(entry) for name, entry in found.entries.items()})


def _claims_by_order(foreign: ForeignRecording, time: str, known: RobotJoints) -> list[Claim]:
    """Claims of columns without a header: positions, speeds and torques of all joints, in this order."""
    names, arm = [name for name in foreign.columns if name != time], known.arm
    quantities = {1: ("q",), 2: ("q", "tau"), 3: ("q", "v", "tau")}.get(len(names) // len(arm) if arm else 0, ())
    if len(names) != len(quantities) * len(arm) or not names:
        raise InputError(
            f"{foreign.name}: has no header: say which column is what with a mapping, --map, whose columns are "
            f"{name_list(map(repr, foreign.columns))}"
        )
    doubt = f"no header says so: taken in the order {', '.join(quantities)}"
    places = [(quantity, joint) for quantity in quantities for joint in arm]
    return [
        Claim(name, f"{quantity}.{joint}", joint, ColumnHeaderParts((), quantity, "", True, ()), (doubt,))
        for name, (quantity, joint) in zip(names, places, strict=True)
    ]
