"""A mapping proposed from names, units and ranges; a person reads it before it is used.

What the names say, of an arm or of a pendulum, are claims to channels; the best claim to a channel is held against the
numbers: positions against the joints' ranges, speeds against the slopes of the positions, torques against the motors'
efforts. A line that names or numbers leave open says CHECK.
"""

import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from armdyn.errors import InputError
from armdyn.recording.channels import FloatArray, in_contract
from armdyn.recording.units import si_factor
from pipeline.imports.claims import Claim, best_claims
from pipeline.imports.foreign import Column, Foreign
from pipeline.imports.joints import Joints, contains, match_joints, skeleton
from pipeline.imports.mapping import ColumnMap, Entry
from pipeline.imports.pendulum import PARTS, pendulum_claims
from pipeline.imports.units import in_one, judged_entries
from pipeline.imports.words import IDLE, Label, fits, label_of, words_in, words_of
from urdf.infer import is_gripper

TIME_WORDS = words_in("time t timestamp timestamps stamp clock seconds secs sec zeit duration elapsed utime ts epoch")
LEROBOT_STATE, LEROBOT_TOLD = "observation.state", "action"
"""What LeRobot calls the measured positions: degrees, radians, or shares of a joint's range; and commands."""
STEPS = (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9))
FASTEST, SLOWEST = 5e-5, 0.5
"""s between samples that a robot's recording has."""


def known_columns(foreign: Foreign, joints: Joints | None = None) -> ColumnMap:
    """The mapping that the recording's own names say: joint states, and channels of the contract.

    Args:
        foreign: the recording.
        joints: of the robot, where it is known: its names count, and whatever is sure of others is understood.

    Raises:
        InputError: it says none, or its joints may be the robot's or not.
    """
    entries = _declared(foreign.columns, joints or Joints())
    if not entries:
        shown = ", ".join(f"'{name}'" for name in list(foreign.columns)[:6])
        raise InputError(
            f"{foreign.name}: no column has the name of a channel (it has {shown}): let armdyn propose a mapping with "
            "--guess, or write one and give it with --map"
        )
    notes: list[str] = []
    missing = _missing(entries, joints) if joints is not None else ()
    own = dict.fromkeys(entry.channel.partition(".")[2] for entry in entries.values())
    if joints is not None and missing and not set(own) <= set(joints.names):
        mapping = guess_map([foreign], joints)
        found = {name: mapping.entries[name] for name in entries if name in mapping.entries}
        asked = [name for name, entry in found.items() if entry.check]
        if asked or not set(missing) - set(_missing(found, joints)):
            raise InputError(
                f"{foreign.name}: its joints ({_some(own)}) are not called as the robot's ({_some(joints.arm)}): let "
                "armdyn propose which is which with --guess, or give the right robot"
            )
        renamed = {
            e.channel.partition(".")[2]: found[n].channel.partition(".")[2] for n, e in entries.items() if n in found
        }
        notes += [
            f"joint '{own}' of the recording is '{joint}' of the robot"
            for own, joint in renamed.items()
            if own != joint
        ]
        entries = {name: found.get(name, entry) for name, entry in entries.items()}
    if joints is not None:
        notes += [f"joint '{joint}' of the robot was never sent" for joint in _missing(entries, joints)]
    return ColumnMap(entries, "time" if foreign.is_table else "", "", notes=tuple(notes))


def _some(names: Iterable[str]) -> str:
    names = list(names)
    return ", ".join(names[:SHOWN]) + (f" and {len(names) - SHOWN} more" if len(names) > SHOWN else "")


SHOWN = 4
"""Names that a sentence holds."""


def _declared(columns: Mapping[str, Column], known: Joints) -> dict[str, Entry]:
    """Columns whose channel the file itself says."""
    found = {}
    for name, column in columns.items():
        channel = column.channel or name
        if in_contract(channel) and not _again(name, columns):
            quantity, _, joint = channel.partition(".")
            sliding = SLIDING.get(quantity, "") if column.channel and joint in known.sliding else ""
            found[name] = Entry(channel, sliding or column.unit)
    return found


def _again(name: str, columns: Collection[str]) -> bool:
    """Whether a column is a second one under a header, which nobody knows what it is."""
    return name.rpartition("#")[0] in columns


SLIDING = {"q": "m", "v": "m/s", "a": "m/s^2", "tau": "N", "q_cmd": "m", "v_cmd": "m/s", "tau_ff": "N"}
"""Units of what a message says of a joint that slides."""


def _missing(entries: Mapping[str, Entry], joints: Joints) -> tuple[str, ...]:
    """Joints of the arm of which nothing is said."""
    said = {entry.channel.partition(".")[2] for entry in entries.values()}
    return tuple(joint for joint in joints.arm if joint not in said)


def guess_map(recordings: Sequence[Foreign], joints: Joints | None = None, rate: str = "") -> ColumnMap:
    """What the columns of recordings of one kind seem to be.

    Args:
        recordings: one or more; ranges are those of all.
        joints: of the robot, where it is known.
        rate: of the rows of a table that has no stamps, with its unit.

    Raises:
        InputError: nothing in them looks like a channel.
    """
    known, first = joints or Joints(), recordings[0]
    columns: dict[str, list[Column]] = {}
    for foreign in recordings:
        for name, column in foreign.columns.items():
            columns.setdefault(name, []).append(column)
    time, unit, why, check = _time(first) if first.is_table and not rate else ("", "", "", "")
    declared = _declared({name: found[0] for name, found in columns.items() if found[0].unit}, known)
    whole = not _missing(declared, known)
    entries: dict[str, Entry] = {}
    labels: dict[str, Label] = {}
    of_joints: dict[str, Label] = {}
    for name, found in columns.items():
        if name == time or _again(name, columns):
            continue
        quantity, _, joint = declared[name].channel.partition(".") if name in declared else ("", "", "")
        if name in declared and (whole or not joint or joint in known.beside):
            entries[name] = declared[name]
        elif name in declared:
            of_joints[name] = replace(label_of(joint), quantity=quantity, unit=declared[name].unit, doubt="")
        else:
            labels[name] = label_of(name, found[0].unit)
    arm = _of_joints(labels, known) | of_joints
    if known.arm or _is_arm(arm):
        claims = _joint_claims(arm, known, first.texts)
    else:
        claims, known = pendulum_claims(labels), PARTS
    seconds = first.columns[time].value * si_factor(unit, "s") if time else None
    if not first.headed:
        claims = _by_place(first, time, known)
    free = [claim for claim in claims if claim.channel not in {entry.channel for entry in entries.values()}]
    entries |= judged_entries(best_claims(free), columns, known, first, seconds)
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
    kept = {name: entries[name] for name in columns if name in entries}
    return ColumnMap(kept, time, unit, why=why, check=check, rate=rate)


def _commands(
    labels: Mapping[str, Label], entries: Mapping[str, Entry], known: Joints, texts: Mapping[str, str]
) -> dict[str, Entry]:
    """What joints were told, of recordings that hold no torque: there a drive's error stands for one.

    Args:
        labels: of the columns that nothing has claimed.
        entries: of those that are measured.
        known: joints of the robot.
        texts: of the recording's columns of text.
    """
    by_channel = {entry.channel: entry for entry in entries.values()}
    if any(channel.startswith("tau.") for channel in by_channel):
        return {}
    arm = tuple(channel.removeprefix("q.") for channel in by_channel if channel.startswith("q."))
    lerobot = {name for name in labels if re.split(r"[/.]", name, maxsplit=1)[0] == LEROBOT_TOLD}
    told = {
        name: replace(label, measured=True, quantity=label.quantity or ("q" if name in lerobot else ""))
        for name, label in labels.items()
        if label.told
    }
    claims = _joint_claims(_of_joints(told, replace(known, arm=known.arm or arm)), replace(known, arm=arm), texts)
    found = {}
    for claim in best_claims(claims):
        quantity, _, joint = claim.channel.partition(".")
        at = by_channel.get(f"q.{joint}")
        if quantity not in ("q", "v") or at is None or f"{quantity}_cmd.{joint}" in by_channel:
            continue
        unit = claim.label.unit or at.unit + ("/s" if quantity == "v" else "")
        same = replace(at, unit=unit) if quantity == "q" else Entry("", unit, at.sign, gear_ratio=at.gear_ratio)
        why = "what the joint was told, in its position's unit" if not claim.label.unit else "what the joint was told"
        doubts = [at.check if quantity == "q" and not claim.label.unit else "", *claim.doubts]
        found[claim.column] = replace(same, channel=f"{quantity}_cmd.{joint}", check=in_one(doubts), why=why)
    return found


def _by_place(foreign: Foreign, time: str, known: Joints) -> list[Claim]:
    """What columns without a header may be: positions, speeds and torques of all joints, in this order.

    Raises:
        InputError: they are not so many.
    """
    names, arm = [name for name in foreign.columns if name != time], known.arm
    quantities = {1: ("q",), 2: ("q", "tau"), 3: ("q", "v", "tau")}.get(len(names) // len(arm) if arm else 0, ())
    if len(names) != len(quantities) * len(arm) or not names:
        raise InputError(
            f"{foreign.name}: has no header: say which column is what with a mapping, --map, whose columns are "
            f"{_some(map(repr, foreign.columns))}"
        )
    doubt = f"no header says so: taken in the order {', '.join(quantities)}"
    places = [(quantity, joint) for quantity in quantities for joint in arm]
    return [
        Claim(name, f"{quantity}.{joint}", joint, Label((), quantity, "", True, ()), (doubt,))
        for name, (quantity, joint) in zip(names, places, strict=True)
    ]


def _of_joints(labels: Mapping[str, Label], known: Joints) -> dict[str, Label]:
    """Headers that may be a joint's, with the quantity that they most likely are of."""
    found: dict[str, Label] = {}
    kinds = Counter(skeleton(label.words) for label in labels.values())
    for name, label in labels.items():
        if is_gripper(name) or not label.measured:
            continue
        quantity, doubt = label.quantity, label.doubt
        if LEROBOT_STATE in name.lower() and quantity in ("", "q"):
            quantity, doubt = "q", "degrees, radians or a share of the joint's range?"
        elif label.words[:1] == ("a",) and {("a", "#"), ("q", "#"), ("v", "#")} <= kinds.keys():
            quantity = "a"  # as Pinocchio calls it, and no axis
        elif not quantity and _names_a_joint(label, kinds[skeleton(label.words)], known):
            quantity, doubt = "q", "taken as positions"
        elif quantity == "force":
            quantity = "tau" if known.arm else ""
        if quantity:
            found[name] = replace(label, quantity=quantity, doubt=doubt)
    # libfranka's q_d is what is desired, as it has dq besides; elsewhere it may be the speed.
    speeds = any(label.quantity == "v" and "d" not in label.rest for label in found.values())
    for name, label in list(found.items()):
        if "d" in label.rest and label.quantity in ("q", "v", "tau"):
            if speeds or label.quantity != "q":
                del found[name]
            else:
                rest = tuple(word for word in label.rest if word != "d")
                found[name] = replace(label, quantity="v", rest=rest, doubt="the speed, or what is desired?")
    return found


def _names_a_joint(label: Label, alike: int, known: Joints) -> bool:
    """Whether a header without a quantity is just the name or the number of a joint, as so many others are."""
    letters = {word for word in label.words if not word.isdigit()}
    if any(contains(label.words, words) and letters <= {*words, *IDLE} for words in map(words_of, known.arm)):
        return True
    if not ((label.words and label.words[-1].isdigit()) or letters & IDLE) or letters - {"j", "a", *IDLE}:
        return False
    if not {"j", "joint", "a", "axis"} & letters:
        return False
    return alike == len(known.arm) or (not known.arm and alike > 1)


def _is_arm(labels: Mapping[str, Label]) -> bool:
    """Whether columns are those of an arm: of several joints, or with a joint's torque or current."""
    rests = {label.rest for label in labels.values()}
    numbers = {word for rest in rests for word in rest if word.isdigit()}
    return (
        len(numbers) > 1
        or any(label.quantity in ("tau", "current") for label in labels.values())
        or (len(rests) > 1 and all(rest and not set(rest) & _PENDULUM for rest in rests))
    )


_PENDULUM = {
    "swing",
    "phi",
    "pendulum",
    "pend",
    "pole",
    "cart",
    "pivot",
    "trolley",
    "bob",
    "alpha",
    "gyro",
    "gyroscope",
}


def _name_column(name: str, label: Label) -> str:
    """The column of text that holds the joint's name, such as ``field.name0`` of ``field.position0``."""
    for word in ("position", "velocity", "effort"):
        if word in label.words:
            return name.replace(word, "name")
    return ""


def _joint_claims(labels: Mapping[str, Label], known: Joints, texts: Mapping[str, str]) -> list[Claim]:
    """What headers of joints claim.

    Args:
        labels: by column, with their quantities.
        known: joints of the robot.
        texts: of the recording's columns of text.
    """
    names = {column: texts[f] for column, label in labels.items() if (f := _name_column(column, label)) in texts}
    claims = []
    for column, match in match_joints(labels, known, names).items():
        label = labels[column]
        if match.joint:
            quantity = "tau" if label.quantity == "current" else label.quantity
            doubts = tuple(filter(None, (match.doubt, label.doubt)))
            claims.append(Claim(column, f"{quantity}.{match.joint}", match.joint, label, doubts))
    return claims


RISES = 0.9
"""Share of the rows from which a column that is called the time goes on: single stamps may be wrong."""


def _stamps(value: FloatArray, share: float) -> int:
    """How many different stamps a column holds; 0 where it does not rise in such a share of its rows."""
    known = value[np.isfinite(value)]
    if len(known) < max(2, share * len(value)) or np.mean(np.diff(known) >= 0.0) < share or np.ptp(known) == 0.0:
        return 0
    return len(np.unique(known))


def _time(foreign: Foreign) -> tuple[str, str, str, str]:
    """Column, unit, reason and what is open of it."""
    called = [n for n in foreign.columns if TIME_WORDS & set(words_of(n)) or label_of(n).unit in dict(STEPS)]
    named, rising = (
        {name: n for name in names if (n := _stamps(foreign.columns[name].value, share))}
        for names, share in ((called, RISES), (foreign.columns, 1.0))
    )
    if not (named or rising):
        raise InputError(
            f"{foreign.name}: no column rises all the time, so none is the time: give --rate, the rows per second"
        )
    choice = named or rising
    name = max(choice, key=choice.__getitem__)
    column, doubts = foreign.columns[name], []
    if not named:
        doubts.append("no header says that it is the time")
    elif choice[name] < len(column.value):
        doubts.append(f"{len(column.value) - choice[name]} stamps are those of the row before")
    written = column.unit or label_of(name).unit
    step = float(np.median(np.diff(np.unique(column.value[np.isfinite(column.value)]))))
    if fits(written, "s"):
        return name, written, "as written", in_one(doubts)
    for unit, factor in STEPS:
        if FASTEST <= step * factor <= SLOWEST:
            return name, unit, f"a sample every {step:.4g} {unit}", in_one(doubts)
    return name, "s", f"a sample every {step:.4g}", in_one([*doubts, "of no unit that a recording has"])
