"""Mapping entries of columns that are registers of servo drives of a known kind, such as ``Present_Position_1``."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from armdyn.arm.drives import split_drive_option
from armdyn.errors import InputError, UnknownNameError
from armdyn.recording.channels import FloatArray
from pipeline.imports.foreign import ForeignColumn, ForeignRecording
from pipeline.imports.joints import MatchedJointName, RobotJoints, contains_phrase, match_joints
from pipeline.imports.mapping import ColumnEntry
from pipeline.imports.registers import REGISTERS, Register, decoded, fitting_complement
from pipeline.imports.units import (
    MAX_RELATIVE_SPEED_SLOPE_DIFFERENCE,
    MIN_SPEED_SLOPE_CORRELATION,
    joined_doubts,
    speed_to_slope,
)
from pipeline.imports.words import IRRELEVANT_WORDS, ColumnHeaderParts, name_words, word_set

_SPELLED = {"pos": "position", "vel": "velocity", "volt": "voltage", "cur": "current", "enabled": "enable"}
"""Words of registers' names, by how logs shorten them."""
_BESIDE_JOINTS = IRRELEVANT_WORDS | word_set("id dxl dynamixel servo raw register feetech sts")
"""Words of a register's header that name no joint."""
NOT_RAW = "no whole numbers, so no register's: degrees, radians or a share of the joint's range?"


@dataclass(frozen=True)
class DriveKinds:
    """Kinds of drives whose registers a log contains, by ``KIND=all`` or ``KIND=joint,joint``.

    Attributes:
        by_joint: series of drives, a key of `REGISTERS`, by joint.
        every: series of the other joints' drives; empty if they have none.
    """

    by_joint: Mapping[str, str]
    every: str = ""

    @classmethod
    def of(cls, chosen: Sequence[str]) -> "DriveKinds":
        """Kinds of drives from the options ``--drive``.

        Raises:
            InputError: a text has another form, or the registers of a kind are not known.
        """
        by_joint, every = dict[str, str](), ""
        for text in chosen:
            kind, colon, _, listed = split_drive_option(text)
            series = next((name for name in REGISTERS if kind == name or kind.startswith(f"{name}-")), "")
            if colon:
                raise InputError(f"--drive {text}: registers are those of a kind: write it as sts3215={listed}")
            if not series:
                raise UnknownNameError("series of drives", kind, REGISTERS)
            every = series if listed == "all" else every
            by_joint |= {} if listed == "all" else dict.fromkeys(listed.split(","), series)
        return cls(by_joint, every)

    @property
    def series(self) -> tuple[str, ...]:
        """All series, each once."""
        return tuple(dict.fromkeys((*self.by_joint.values(), *filter(None, (self.every,)))))

    def __bool__(self) -> bool:
        return bool(self.series)


NO_DRIVES = DriveKinds({})
"""Of no column is it known that it is a register."""


def register_entries(
    columns: Mapping[str, Sequence[ForeignColumn]],
    drives: DriveKinds,
    known: RobotJoints,
    first: ForeignRecording,
    time: FloatArray | None,
) -> tuple[dict[str, ColumnEntry], set[str]]:
    """Entries of all columns that are registers of the drives, with the scale and the sign of the register.

    Args:
        columns: columns of all recordings, by name.
        drives: kinds of the joints' drives.
        known: joints of the robot.
        first: recording whose positions are differentiated to check the scale of the speeds.
        time: stamps of its rows (n,) [s]; None where every column has its own time.

    Returns:
        Entries by column, and all columns that are called as registers, also those that become no channel.

    Raises:
        InputError: a joint with a kind of drive of its own has no register.
    """
    names = {words for series in drives.series for words in REGISTERS[series]}
    labels, registers = {}, {}
    for column in columns:
        words = tuple(_SPELLED.get(word, word) for word in name_words(column))
        if (phrase := max((n for n in names if contains_phrase(words, n)), key=len, default=None)) is not None:
            rest = tuple(word for word in words if word not in phrase and word not in _BESIDE_JOINTS)
            labels[column] = ColumnHeaderParts((*phrase, *rest), "q", "", True, rest)
            registers[column] = phrase
    matched = _matched(labels, known, first.texts)
    missing = set(drives.by_joint) - {match.joint for match in matched.values()}
    if registers and missing:
        named = dict.fromkeys(match.joint for match in matched.values() if match.joint)
        raise UnknownNameError("joint with registers", min(missing), named)
    found: dict[str, ColumnEntry] = {}
    used: dict[str, Register] = {}
    for column, (joint, doubt) in matched.items():
        series = drives.by_joint.get(joint, drives.every)
        register = REGISTERS.get(series, {}).get(registers[column])
        if joint and register is not None:
            used[column] = register
            entry = _entry(register, f"{register.quantity}.{joint}", [c.value for c in columns[column]])
            said = f"{' '.join(registers[column])} of {series}, {_scale_sentence(register)}"
            found[column] = replace(entry, check=joined_doubts([doubt, entry.check, register.doubt]), why=said)
    _check_speeds(found, used, first, time)
    return _one_of_each(found), set(registers)


def _scale_sentence(register: Register) -> str:
    scale, unit = register.scales[0], register.unit
    size = f"1/{1.0 / scale:.0f} {unit}" if unit.startswith("turn") else f"{scale:g} {unit}"
    size = f"{100.0 * scale:g} %" if unit == "1" else size
    zero = ", 2048 taken as the joint's zero" if register.offset else ""
    return "0 is off" if register.quantity == "enabled" else f"{size} a count{zero}"


def _matched(
    labels: Mapping[str, ColumnHeaderParts], known: RobotJoints, texts: Mapping[str, str]
) -> dict[str, MatchedJointName]:
    """Joint of every column; motors whose numbers begin with another one than 0 or 1 are taken in their order."""
    numbers = {int(word) for label in labels.values() for word in label.rest if word.isdigit()}
    alone = all(len(label.rest) == 1 for label in labels.values())
    if not (numbers and alone and min(numbers) > 1 and len(numbers) == len(known.arm)):
        return match_joints(labels, known, {column: texts[column] for column in labels if column in texts})
    order = dict(zip(sorted(numbers), known.arm, strict=True))
    doubt = f"motors {min(numbers)} to {max(numbers)} taken in the order of the arm's joints"
    return {column: MatchedJointName(order[int(label.rest[0])], doubt) for column, label in labels.items()}


def _entry(register: Register, channel: str, values: Sequence[FloatArray]) -> ColumnEntry:
    """Entry of one column of a register, whose numbers are those of all recordings."""
    negative = fitting_complement(values, register)
    raw = all(bool(np.all(np.isnan(value) | (value == np.round(value)))) for value in values)
    doubts = ["" if raw else NOT_RAW]
    try:
        for value in values:
            decoded(value, negative)
    except InputError as error:
        doubts.append(str(error))
    return ColumnEntry(
        channel,
        register.unit,
        scale=register.scales[0],
        offset=register.offset,
        negative=negative,
        check=joined_doubts(doubts),
    )


def _check_speeds(
    found: dict[str, ColumnEntry],
    registers: Mapping[str, Register],
    first: ForeignRecording,
    time: FloatArray | None,
) -> None:
    """Compare the speeds with the slopes of the positions, which choose between a register's scales."""
    for column, entry in found.items():
        at = next((name for name, own in found.items() if own.channel == f"q.{entry.joint}"), None)
        if entry.quantity != "v" or at is None or not {column, at} <= first.columns.keys():
            continue
        stamps = time if time is not None else first.columns[at].time
        if stamps is None or entry.check or found[at].check:
            continue
        x, v = (decoded(first.columns[name].value, found[name].negative)[0] for name in (at, column))
        slope = speed_to_slope(x * found[at].scale, v * entry.scale, stamps)
        if slope is None:
            continue
        ratio, correlation = slope[0] / (60.0 if entry.unit == "rpm" else 1.0), slope[1]
        scales = registers[column].scales
        fits = [s for s in scales if abs(ratio * s / entry.scale - 1.0) < MAX_RELATIVE_SPEED_SLOPE_DIFFERENCE]
        if correlation < MIN_SPEED_SLOPE_CORRELATION:
            found[column] = replace(entry, check="it does not follow the position's slope")
        elif not fits:
            found[column] = replace(entry, check=f"{ratio:.3g} times the position's slope")
        elif fits[0] != entry.scale:
            found[column] = replace(entry, scale=fits[0], why=f"{entry.why}; {fits[0] / entry.scale:g} by the slope")


def _one_of_each(found: Mapping[str, ColumnEntry]) -> dict[str, ColumnEntry]:
    """The first certain entry of every channel, else the first; a goal speed beside a goal position is its limit."""
    best: dict[str, str] = {}
    for column, entry in found.items():
        other = best.get(entry.channel)
        if other is None or (found[other].check and not entry.check):
            best[entry.channel] = column
    return {
        column: found[column]
        for channel, column in best.items()
        if not (channel.startswith("v_cmd.") and f"q_cmd.{found[column].joint}" in best)
    }
