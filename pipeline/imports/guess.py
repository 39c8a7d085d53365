"""Propose a mapping from names, units and ranges; a person reads it before it is used.

The names of the columns, of an arm or of a pendulum, give claims to channels. The best claim to a channel is compared
with the numbers: positions with the joints' ranges, speeds with the slopes of the positions, torques with the motors'
limits. A line that names and numbers leave open says CHECK.
"""

import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from armdyn.errors import InputError
from armdyn.quoting import name_list
from armdyn.recording.channels import channel_kind, is_channel_name
from armdyn.recording.units import si_factor
from pipeline.imports.claims import Claim, best_claims
from pipeline.imports.foreign import ForeignColumn, ForeignRecording
from pipeline.imports.joints import RobotJoints, contains_phrase, match_joints, words_with_numbers_masked
from pipeline.imports.mapping import ColumnEntry, ColumnMap
from pipeline.imports.pendulum import PENDULUM_PARTS, pendulum_claims
from pipeline.imports.units import entries_with_inferred_units, joined_doubts
from pipeline.imports.words import (
    IRRELEVANT_WORDS,
    ColumnHeaderParts,
    is_unit_like,
    name_words,
    split_column_header,
    word_set,
)
from urdf.infer import is_gripper_name

TIME_WORDS = word_set("time t timestamp timestamps stamp clock seconds secs sec zeit duration elapsed utime ts epoch")
LEROBOT_STATE, LEROBOT_COMMAND = "observation.state", "action"
"""LeRobot's names of the measured positions, in degrees, radians or shares of a joint's range, and of the commands."""
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Seconds per unit of time, the most likely unit first."""
SHORTEST_SAMPLE_STEP_SECONDS, LONGEST_SAMPLE_STEP_SECONDS = 5e-5, 0.5
"""Shortest and longest possible time between two samples of a robot's recording [s]."""
MIN_ROW_SHARE_WITH_RISING_TIME = 0.9
"""Smallest share of rows in which a time column must increase; single stamps may be wrong."""
PENDULUM_WORDS = word_set("swing phi pendulum pend pole cart pivot trolley bob alpha gyro gyroscope")


def map_unambiguous_columns(foreign: ForeignRecording, joints: RobotJoints | None = None) -> ColumnMap:
    """Mapping of columns whose names are unambiguous: joint states, and names of armdyn's channels.

    Args:
        foreign: the recording.
        joints: joints of the robot, whose names are used where it is certain which joint is meant; None where the
            robot is unknown.

    Raises:
        InputError: the names define no channel, or it is uncertain whether the joints are the robot's.
    """
    entries = _declared(foreign.columns, joints or RobotJoints())
    if not entries:
        shown = ", ".join(f"'{name}'" for name in list(foreign.columns)[:6])
        raise InputError(
            f"{foreign.name}: no column has the name of a channel (it has {shown}): let armdyn propose a mapping with "
            "--guess, or write one and give it with --map"
        )
    notes: list[str] = []
    if joints is not None:
        missing, own = _missing(entries, joints), dict.fromkeys(entry.joint for entry in entries.values())
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
    return ColumnMap(entries, "time" if foreign.is_table else "", notes=tuple(notes))


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


def guess_map(recordings: Sequence[ForeignRecording], joints: RobotJoints | None = None, rate: str = "") -> ColumnMap:
    """Mapping with the most likely meaning of the columns of recordings in one format.

    Args:
        recordings: one or more; the ranges of values are those of all of them.
        joints: joints of the robot; None where it is unknown.
        rate: rate of the rows of a table without stamps, with its unit.

    Raises:
        InputError: no column looks like a channel.
    """
    known, first = joints or RobotJoints(), recordings[0]
    columns: dict[str, list[ForeignColumn]] = {}
    for foreign in recordings:
        for name, column in foreign.columns.items():
            columns.setdefault(name, []).append(column)
    timing = _time(first) if first.is_table and not rate else ColumnMap({}, rate=rate)
    declared = _declared({name: found[0] for name, found in columns.items() if found[0].unit}, known)
    complete = not _missing(declared, known)
    entries: dict[str, ColumnEntry] = {}
    labels: dict[str, ColumnHeaderParts] = {}
    of_joints: dict[str, ColumnHeaderParts] = {}
    for name, found in columns.items():
        if name == timing.time or _is_repeated(name, columns):
            continue
        if (entry := declared.get(name)) is None:
            labels[name] = split_column_header(name, found[0].unit)
        elif complete or not entry.joint or entry.joint in known.beside:
            entries[name] = entry
        else:
            of_joints[name] = replace(
                split_column_header(entry.joint), quantity=entry.quantity, unit=entry.unit, doubt=""
            )
    of_joints = _of_joints(labels, known) | of_joints
    if known.arm or _is_arm(of_joints):
        claims = _joint_claims(of_joints, known, first.texts)
    else:
        claims, known = pendulum_claims(labels), PENDULUM_PARTS
    if not first.headed:
        claims = _claims_by_order(first, timing.time, known)
    taken = {entry.channel for entry in entries.values()}
    seconds = first.columns[timing.time].value * si_factor(timing.time_unit, "s") if timing.time else None
    best = best_claims(claim for claim in claims if claim.channel not in taken)
    entries |= entries_with_inferred_units(best, columns, known, first, seconds)
    if not entries:
        shown = ", ".join(f"'{name}'" for name in list(columns)[:6])
        places = {"x", "y"} <= {word for label in labels.values() for word in label.words}
        how = (
            "x and y of a load are no channels: let the video's program write its angle, 0 hanging, besides"
            if places
            else "write a mapping, --map"
        )
        raise InputError(f"{first.name}: none of its columns ({shown}) looks like a channel: {how}")
    entries |= _commands(labels, entries, known, first.texts)
    return replace(timing, entries={name: entries[name] for name in columns if name in entries})


def _commands(
    labels: Mapping[str, ColumnHeaderParts],
    entries: Mapping[str, ColumnEntry],
    known: RobotJoints,
    texts: Mapping[str, str],
) -> dict[str, ColumnEntry]:
    """Commands of joints in a recording without torques: there the error of a drive replaces the torque."""
    by_channel = {entry.channel: entry for entry in entries.values()}
    if any(entry.quantity == "tau" for entry in entries.values()):
        return {}
    arm = tuple(entry.joint for entry in by_channel.values() if entry.quantity == "q")
    commands = {}
    for name, label in labels.items():
        if label.commanded:
            is_action = re.split(r"[/.]", name, maxsplit=1)[0] == LEROBOT_COMMAND
            commands[name] = replace(label, measured=True, quantity=label.quantity or "q" * is_action)
    of_joints = _of_joints(commands, replace(known, arm=known.arm or arm))
    found = {}
    for claim in best_claims(_joint_claims(of_joints, replace(known, arm=arm), texts)):
        quantity, _, joint = claim.channel.partition(".")
        position, channel = by_channel.get(f"q.{joint}"), f"{quantity}_cmd.{joint}"
        if quantity not in ("q", "v") or position is None or channel in by_channel:
            continue
        unit = claim.label.unit or position.unit + ("/s" if quantity == "v" else "")
        same = position if quantity == "q" else ColumnEntry("", sign=position.sign, gear_ratio=position.gear_ratio)
        why = "what the joint was told" + (", in its position's unit" if not claim.label.unit else "")
        doubts = [position.check if quantity == "q" and not claim.label.unit else "", *claim.doubts]
        found[claim.column] = replace(same, channel=channel, unit=unit, check=joined_doubts(doubts), why=why)
    return found


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


def _of_joints(labels: Mapping[str, ColumnHeaderParts], known: RobotJoints) -> dict[str, ColumnHeaderParts]:
    """Labels that may be a joint's, with the most likely quantity."""
    found: dict[str, ColumnHeaderParts] = {}
    kinds = Counter(words_with_numbers_masked(label.words) for label in labels.values())
    for name, label in labels.items():
        if is_gripper_name(name) or not label.measured:
            continue
        quantity, doubt = label.quantity, label.doubt
        if LEROBOT_STATE in name.lower() and quantity in ("", "q"):
            quantity, doubt = "q", "degrees, radians or a share of the joint's range?"
        elif label.words[:1] == ("a",) and {("a", "#"), ("q", "#"), ("v", "#")} <= kinds.keys():
            quantity = "a"  # Pinocchio's name of an acceleration, not an axis
        elif not quantity and _names_a_joint(label, kinds[words_with_numbers_masked(label.words)], known):
            quantity, doubt = "q", "taken as positions"
        elif quantity == "force":
            quantity = "tau" if known.arm else ""
        if quantity:
            found[name] = replace(label, quantity=quantity, doubt=doubt)
    # libfranka's q_d is the desired position, beside the speed dq; in other recordings it may be the speed.
    speeds = any(label.quantity == "v" and "d" not in label.rest for label in found.values())
    for name, label in list(found.items()):
        if "d" in label.rest and label.quantity in ("q", "v", "tau"):
            if speeds or label.quantity != "q":
                del found[name]
            else:
                rest = tuple(word for word in label.rest if word != "d")
                found[name] = replace(label, quantity="v", rest=rest, doubt="the speed, or what is desired?")
    return found


def _names_a_joint(label: ColumnHeaderParts, alike: int, known: RobotJoints) -> bool:
    """Whether a label without a quantity is only the name or number of a joint, as `alike` labels are."""
    letters = {word for word in label.words if not word.isdigit()}
    if any(
        contains_phrase(label.words, words) and letters <= {*words, *IRRELEVANT_WORDS}
        for words in map(name_words, known.arm)
    ):
        return True
    if not ((label.words and label.words[-1].isdigit()) or letters & IRRELEVANT_WORDS) or letters - {
        "j",
        "a",
        *IRRELEVANT_WORDS,
    }:
        return False
    return bool({"j", "joint", "a", "axis"} & letters) and (alike == len(known.arm) if known.arm else alike > 1)


def _is_arm(labels: Mapping[str, ColumnHeaderParts]) -> bool:
    """Whether columns are those of an arm: of several joints, or with a joint's torque or current."""
    rests = {label.rest for label in labels.values()}
    numbers = {word for rest in rests for word in rest if word.isdigit()}
    return (
        len(numbers) > 1
        or any(label.quantity in ("tau", "current") for label in labels.values())
        or (len(rests) > 1 and all(rest and not set(rest) & PENDULUM_WORDS for rest in rests))
    )


def _joint_claims(labels: Mapping[str, ColumnHeaderParts], known: RobotJoints, texts: Mapping[str, str]) -> list[Claim]:
    """Claims of the labels of joints, by column; `texts` are those of the recording's columns of text."""
    names = {}
    for column, label in labels.items():
        # A column of text such as ``field.name0`` contains the joint of ``field.position0``.
        field = next((word for word in ("position", "velocity", "effort") if word in label.words), None)
        if field is not None and (text := texts.get(column.replace(field, "name"))) is not None:
            names[column] = text
    claims = []
    for column, (joint, doubt) in match_joints(labels, known, names).items():
        label = labels[column]
        if joint:
            quantity = "tau" if label.quantity == "current" else label.quantity
            doubts = tuple(filter(None, (doubt, label.doubt)))
            claims.append(Claim(column, f"{quantity}.{joint}", joint, label, doubts))
    return claims


def _time(foreign: ForeignRecording) -> ColumnMap:
    """A mapping with the time of a table only."""
    called = [
        n for n in foreign.columns if TIME_WORDS & set(name_words(n)) or split_column_header(n).unit in TIME_UNITS
    ]
    named, rising = (
        {name: count for name in names if (count := _count_stamps(foreign.columns[name].value, share))}
        for names, share in ((called, MIN_ROW_SHARE_WITH_RISING_TIME), (foreign.columns, 1.0))
    )
    if not (named or rising):
        raise InputError(
            f"{foreign.name}: no column rises all the time, so none is the time: give --rate, the rows per second"
        )
    counts = named or rising
    name = max(counts, key=counts.__getitem__)
    column, doubts = foreign.columns[name], []
    if not named:
        doubts.append("no header says that it is the time")
    elif counts[name] < len(column.value):
        doubts.append(f"{len(column.value) - counts[name]} stamps are those of the row before")
    unit, why = column.unit or split_column_header(name).unit, "as written"
    if not is_unit_like(unit, "s"):
        step = float(np.median(np.diff(np.unique(column.value[np.isfinite(column.value)]))))
        likely = [
            u
            for u, factor in TIME_UNITS.items()
            if SHORTEST_SAMPLE_STEP_SECONDS <= step * factor <= LONGEST_SAMPLE_STEP_SECONDS
        ]
        unit, why = (likely or ["s"])[0], f"a sample every {step:.4g}" + (f" {likely[0]}" if likely else "")
        doubts += [] if likely else ["of no unit that a recording has"]
    return ColumnMap({}, name, unit, why=why, check=joined_doubts(doubts))


def _count_stamps(value: np.ndarray, share: float) -> int:
    """Number of different stamps (n,) of a column; 0 where it does not rise in this share of its rows."""
    known = value[np.isfinite(value)]
    if len(known) < max(2, share * len(value)) or np.mean(np.diff(known) >= 0.0) < share or np.ptp(known) == 0.0:
        return 0
    return len(np.unique(known))
