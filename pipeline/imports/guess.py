"""A mapping proposed from names, units and ranges; a person reads it before it is used.

Degrees look like degrees: positions beyond two turns, or speeds that are 57 times those of the positions. What is
commanded, desired or a set-point is no measurement and is left out.
"""

import re
from collections.abc import Sequence

import numpy as np

from armdyn.channels import FloatArray, channel_kind
from armdyn.errors import InputError
from armdyn.units import si_factor
from pipeline.imports.foreign import Foreign
from pipeline.imports.mapping import ColumnMap, Entry

WORDS = {
    "a": {"acceleration", "accelerations", "acc", "accel", "qdd", "ddq"},
    "v": {"velocity", "vel", "speed", "qd", "dq", "qdot", "velocities", "speeds", "rate"},
    "tau": {"torque", "tau", "effort", "trq", "moment", "torques", "efforts"},
    "current": {"current", "curr", "amps", "currents", "cur", "iq"},
    "q": {"position", "pos", "q", "angle", "theta", "positions", "angles", "encoder", "deg", "rad"},
}
"""Words that name a quantity of a joint."""
PENDULUM_WORDS = (
    ("load_force", {"force", "tension", "loadcell", "load"}),
    ("swing_rate", {"swing_rate", "swingrate"}),
    ("swing_angle", {"swing", "phi", "pendulum"}),
    ("gripper_x", {"gripper", "cart", "pivot"}),
)
TIME_WORDS = {"time", "t", "timestamp", "stamp", "clock", "seconds", "secs", "sec"}
LEROBOT_STATE = "observation.state/"
"""What LeRobot calls the measured positions."""
COMMANDED = {
    "target",
    "cmd",
    "command",
    "commanded",
    "desired",
    "des",
    "ref",
    "reference",
    "setpoint",
    "action",
    "goal",
}
IDLE = {
    "actual", "measured", "meas", "joint", "joints", "observation", "motor", "axis", "the", "data", "value", "link",
    "robot", "arm", "real", "feedback", "act", "state", "states", "pos", "of", "from",
}  # fmt: skip
"""Words that say nothing about which joint it is."""
NUMBERED = re.compile(r"joint_(\d+)")
"""A joint that is only counted."""
TURNS = 7.0
"""rad; positions beyond are degrees, of an arm whose joints turn a little more than once."""
SUFFIXES = {"deg": "deg", "degrees": "deg", "rad": "rad", "nm": "N m", "amp": "A", "amps": "A", "ms": "ms", "us": "us",
            "ns": "ns", "mm": "mm"}  # fmt: skip
STEPS = (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9))
FASTEST, SLOWEST = 5e-5, 0.5
"""s between samples that a robot's recording has."""
AGREES = 0.15
"""Relative difference of speed and differentiated position from which their units are not the same."""


def guessed(foreign: Foreign, joints: Sequence[str] = ()) -> ColumnMap:
    """What the columns seem to be.

    Args:
        foreign: the recording.
        joints: of the robot, from base to tool, where they are known: columns that are numbered get these names.

    Raises:
        InputError: nothing in it looks like a channel.
    """
    time, unit, why = _time(foreign) if foreign.is_table else ("", "", "")
    entries: dict[str, Entry] = {}
    of_joint: dict[str, tuple[str, str]] = {}
    for name, column in foreign.columns.items():
        if name == time:
            continue
        if column.channel or _is_channel(name):
            entries[name] = Entry(column.channel or name, column.unit)
            continue
        words = _words(name)
        if COMMANDED & set(words):
            continue
        for channel, known in PENDULUM_WORDS:
            if known & set(words) and channel not in {entry.channel for entry in entries.values()}:
                entries[name] = _pendulum(channel, column.unit or _suffix(words), column.value)
                break
        else:
            quantity = next((kind for kind, known in WORDS.items() if known & set(words)), None)
            if quantity is None and name.startswith(LEROBOT_STATE):
                quantity = "q"
            if quantity is not None:
                of_joint[name] = quantity, _joint(words)
    seconds = foreign.columns[time].value * si_factor(unit, "s") if time else None
    entries |= _joint_entries(foreign, of_joint, _named(of_joint, joints), seconds)
    if not entries:
        shown = ", ".join(f"'{name}'" for name in list(foreign.columns)[:6])
        raise InputError(f"{foreign.name}: none of its columns ({shown}) looks like a channel: write a mapping, --map")
    ordered = {name: entries[name] for name in foreign.columns if name in entries}
    return ColumnMap(ordered, time, unit, why=why)


def _time(foreign: Foreign) -> tuple[str, str, str]:
    """Column, unit and reason."""
    rising = [
        name
        for name, column in foreign.columns.items()
        if np.all(np.isfinite(column.value)) and np.all(np.diff(column.value) >= 0.0) and np.ptp(column.value) > 0.0
    ]
    named = [name for name in rising if TIME_WORDS & set(_words(name))]
    if not (named or rising):
        raise InputError(f"{foreign.name}: no column rises all the time, so none is the time: is it a recording?")
    name = (named or rising)[0]
    column = foreign.columns[name]
    written = column.unit or _suffix(_words(name))
    if written:
        try:
            si_factor(written, "s")
            return name, written, "as written"
        except InputError:
            pass
    step = float(np.median(np.diff(column.value)))
    for unit, factor in STEPS:
        if FASTEST <= step * factor <= SLOWEST:
            return name, unit, f"a sample every {step:.4g} {unit}"
    return name, "s", f"a sample every {step:.4g}, of no unit that a recording has: CHECK"


def _joint_entries(
    foreign: Foreign, found: dict[str, tuple[str, str]], names: dict[str, str], time: FloatArray | None
) -> dict[str, Entry]:
    angle, angle_why = _angle_unit(foreign, [name for name, (quantity, _) in found.items() if quantity == "q"])
    entries: dict[str, Entry] = {}
    taken: set[str] = set()
    for name, (quantity, joint) in found.items():
        column = foreign.columns[name]
        written = column.unit or _suffix(_words(name))
        channel = f"{'tau' if quantity == 'current' else quantity}.{names.get(joint, joint)}"
        if channel in taken:
            continue
        if quantity == "current":
            entry = Entry(
                channel,
                written or "A",
                torque_constant="1 N m/A",
                why="a current: CHECK the torque constant and the gear",
            )
        elif written:
            entry = Entry(channel, written, why="unit as written")
        elif quantity == "q":
            entry = Entry(channel, angle, why=angle_why)
        elif quantity == "tau":
            entry = Entry(channel, "N m", why="unit assumed")
        else:
            unit, why = _rate_unit(foreign, name, quantity, joint, found, angle, time)
            entry = Entry(channel, unit, why=why)
        taken.add(channel)
        entries[name] = entry
    return entries


def _angle_unit(foreign: Foreign, positions: Sequence[str]) -> tuple[str, str]:
    """Of all positions together: one joint beyond two turns tells for all."""
    largest = max((float(np.nanmax(np.abs(foreign.columns[name].value))) for name in positions), default=0.0)
    return ("deg", f"up to {largest:.4g}") if largest > TURNS else ("rad", f"up to {largest:.4g}")


def _rate_unit(
    foreign: Foreign,
    name: str,
    quantity: str,
    joint: str,
    found: dict[str, tuple[str, str]],
    angle: str,
    time: FloatArray | None,
) -> tuple[str, str]:
    """Unit of a speed or acceleration: that of the position, where differentiating it gives the same numbers."""
    suffix = "/s" if quantity == "v" else "/s^2"
    position = next((n for n, (kind, j) in found.items() if kind == "q" and j == joint), None)
    if quantity == "v" and position is not None and time is not None and len(time) > 2:
        with np.errstate(all="ignore"):
            slope = np.gradient(foreign.columns[position].value, time)
        speed = foreign.columns[name].value
        fine = np.isfinite(slope) & np.isfinite(speed)
        size = float(np.sum(slope[fine] ** 2))
        if size > 0.0:
            ratio = float(slope[fine] @ speed[fine]) / size
            for unit, expected in ((angle, 1.0), ("rad", np.pi / 180), ("deg", 180 / np.pi)):
                if abs(ratio / expected - 1.0) < AGREES:
                    return f"{unit}{suffix}", f"{ratio:.3g} times the position's slope"
    return f"{angle}{suffix}", "as the position"


def _named(found: dict[str, tuple[str, str]], joints: Sequence[str]) -> dict[str, str]:
    """The robot's name of each joint: the same letters, else by number where there are as many."""
    ids = list(dict.fromkeys(joint for _, joint in found.values()))
    names: dict[str, str] = {}
    for joint in ids:
        same = [known for known in joints if _letters(known) == _letters(joint)]
        if not NUMBERED.fullmatch(joint):  # the 1 of joint_1 is not that of wrist_1
            same = same or [known for known in joints if _letters(joint) and _letters(joint) in _letters(known)]
        if len(same) == 1:
            names[joint] = same[0]
    left = [joint for joint in ids if joint not in names]
    free = [joint for joint in joints if joint not in names.values()]
    numbers = {joint: int(match[1]) for joint in left if (match := NUMBERED.fullmatch(joint))}
    if left and len(left) == len(free) == len(numbers):
        ordered = sorted(left, key=lambda joint: numbers[joint])
        names |= dict(zip(ordered, free, strict=True))
    return names


def _pendulum(channel: str, written: str, value: FloatArray) -> Entry:
    si = channel_kind(channel).units[0]
    if written:
        return Entry(channel, written, why="unit as written")
    largest = float(np.nanmax(np.abs(value)))
    if si == "rad" and largest > TURNS:
        return Entry(channel, "deg", why=f"up to {largest:.4g}")
    if si == "m" and largest > 10.0:
        return Entry(channel, "mm", why=f"up to {largest:.4g}")
    return Entry(channel, si, why=f"unit assumed, up to {largest:.4g}: CHECK")


def _is_channel(name: str) -> bool:
    try:
        channel_kind(name)
    except InputError:
        return False
    return True


def _words(name: str) -> list[str]:
    """Lower-case words of a name: ``actualQd_3`` as actual, qd, 3."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
    spaced = re.sub(r"(?<=[A-Za-z])(?=\d+\b)", " ", spaced.replace("_", " ").replace("/", " ").replace(".", " "))
    return re.sub(r"[^A-Za-z0-9 ]", " ", spaced).lower().split()


def _suffix(words: Sequence[str]) -> str:
    return next((SUFFIXES[word] for word in reversed(words) if word in SUFFIXES), "")


def _joint(words: Sequence[str]) -> str:
    """What is left of a name without the words of the quantity: the joint, or ``joint_<number>``."""
    quantity_words = set.union(*WORDS.values(), COMMANDED, IDLE, set(SUFFIXES))
    left = [word for word in words if word not in quantity_words]
    if len(left) == 2 and left[0] in ("j", "joint") and left[1].isdigit():
        left = left[1:]
    if not left:
        return "joint_1"
    return f"joint_{left[-1]}" if left[-1].isdigit() and len(left) == 1 else "_".join(left)


def _letters(name: str) -> str:
    return "".join(part for part in re.sub(r"[^a-z0-9]", " ", name.lower()).split() if part != "joint")
