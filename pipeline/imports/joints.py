"""Which joint of a robot a column belongs to, by name, by number, or by the order of the columns.

A robot's joint and a header are compared without what all joints, or all headers, share: ``panda_joint1`` and
``state.q[0]`` are a 1 and a 0. Numbers are counted from the base to the tool, from 0 or from 1, which is sure where a
quantity has a column for every joint of the arm. Whatever is not sure says why.
"""

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from xml.etree import ElementTree as ET

from pipeline.imports.words import IDLE, Label, words_of
from urdf import Robot
from urdf.infer import gripper_joints
from urdf.validate import MOVING

MESSAGE = ("position", "velocity", "effort")
"""Fields of a JointState, whose arrays are in the order of its names: often the alphabet's."""
AMPERE = frozenset(("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"))
"""Joints of Universal Robots."""
IN_AMPERE = "UR's drivers publish currents as efforts"


@dataclass(frozen=True)
class Range:
    """What a joint may do: slides or turns; positions in rad or m, effort in N m or N."""

    slides: bool
    lower: float
    upper: float
    effort: float

    @property
    def reach(self) -> float:
        """Farthest from zero."""
        return max(abs(self.lower), abs(self.upper))


@dataclass(frozen=True)
class Joints:
    """The joints of a robot.

    Attributes:
        arm: from base to tool; empty where no robot is known.
        others: further joints of its description that move, such as another arm's.
        grippers: joints of grippers.
        ranges: of the arm's joints, where they are known.
    """

    arm: tuple[str, ...] = ()
    others: tuple[str, ...] = ()
    grippers: tuple[str, ...] = ()
    ranges: Mapping[str, Range] = field(default_factory=dict)

    def slides(self, joint: str) -> bool:
        """Whether a joint is known to slide."""
        return joint in self.ranges and self.ranges[joint].slides

    @classmethod
    def of(cls, robot: Robot) -> "Joints":
        """Of a robot, and of everything else in its description."""
        root, limits = ET.fromstring(robot.urdf_xml), robot.limits
        moving = [str(j.get("name")) for j in root.findall("joint") if j.get("type") in MOVING]
        grippers = {name for name in gripper_joints(root) if name not in robot.joint_names}
        mimics = {str(j.get("name")) for j in root.findall("joint") if j.find("mimic") is not None}
        arm = robot.joint_names
        slides = [joint.shortname().startswith("JointModelP") for joint in list(robot.model.joints)[1:]]
        ranges = {
            name: Range(slides[i], float(limits.lower[i]), float(limits.upper[i]), float(limits.effort[i]))
            for i, name in enumerate(arm)
        }
        others = tuple(name for name in moving if name not in {*arm, *grippers, *mimics})
        return cls(arm, others, tuple(grippers), ranges)


@dataclass(frozen=True)
class Match:
    """The joint of a column.

    Attributes:
        joint: its name; empty for a column that is left out.
        doubt: why a person must look; empty where it is sure.
    """

    joint: str
    doubt: str = ""


def match_joints(labels: Mapping[str, Label], joints: Joints, names: Mapping[str, str]) -> dict[str, Match]:
    """The joint of every column.

    Args:
        labels: of the columns that hold a joint's quantity.
        joints: of the robot.
        names: by column: the joint as the file itself says it in a column of text.
    """
    rests = _without_common({column: label.rest for column, label in labels.items()})
    cores = _cores(joints.arm)
    found: dict[str, Match] = {}
    for column, label in labels.items():
        words = words_of(names[column]) if column in names else label.words
        if match := _by_name(words, rests[column] if column not in names else (), cores, joints):
            found[column] = match
    groups: dict[tuple[str, ...], list[str]] = {}
    for column in labels:
        groups.setdefault(skeleton(labels[column].words), []).append(column)
    other: set[str] = set()
    for kind, columns in list(groups.items()):
        # Of joints that only differ in a number all are found by name, or none: files may count from another one.
        counted = [c for c in columns if c in found and "".join(cores.get(found[c].joint, ("a",))).isdigit()]
        if any(column not in found for column in columns):
            for column in counted:
                del found[column]
                other.add(column)
        groups[kind] = [column for column in columns if column not in found]
    groups = {kind: columns for kind, columns in groups.items() if columns}
    complete = {base for columns in groups.values() if (base := _base(columns, labels, rests, joints)) is not None}
    for columns in groups.values():
        numbered = _by_number(columns, labels, rests, joints, complete)
        if other & set(columns):
            numbered = {
                c: Match(m.joint, m.doubt or "the robot's joints count from another number")
                for c, m in numbered.items()
            }
        found |= numbered
    _by_order(found, labels, rests, joints)
    return found


def _by_name(
    words: Sequence[str], rest: Sequence[str], cores: Mapping[str, tuple[str, ...]], joints: Joints
) -> Match | None:
    """The joint whose whole name is in a header, else the one that differs from all others as the header does."""
    everything = (*joints.arm, *joints.others, *joints.grippers)
    inside = [j for j in everything if any(w.isalpha() for w in words_of(j)) and contains(words, words_of(j))]
    inside = [j for j in inside if not any(contains(words_of(k), words_of(j)) for k in inside if k != j)]
    if len(inside) == 1:
        joint = inside[0]
        if joint in joints.grippers:
            return Match("")
        extra = list((Counter(rest) - Counter(words_of(joint))).elements())
        return Match(joint, f"its header also says '{' '.join(extra)}'" if extra else "")
    if not any(word.isalpha() for word in rest):
        return None
    same = [joint for joint, core in cores.items() if "".join(core) == "".join(rest)]
    if len(same) == 1:
        return Match(same[0])
    letters = {word for word in rest if word.isalpha() and len(word) > 1}
    numbers = {word for word in rest if word.isdigit()}
    near = [
        joint
        for joint, core in cores.items()
        if letters & set(core) and numbers == {word for word in core if word.isdigit()}
    ]
    return Match(near[0], "a name like it") if len(near) == 1 else None


def _base(
    columns: Sequence[str], labels: Mapping[str, Label], rests: Mapping[str, tuple[str, ...]], joints: Joints
) -> int | None:
    """From which number a group counts that has a column for every joint; None where it has not."""
    numbers = _numbers(columns, labels)
    if numbers is None or len(joints.arm) < 1 or any(w.isalpha() for c in columns for w in rests[c] if len(w) > 1):
        return None
    first = min(numbers.values())
    whole = set(numbers.values()) == set(range(first, first + len(joints.arm)))
    return first if whole and first in (0, 1) else None


def _by_number(
    columns: Sequence[str],
    labels: Mapping[str, Label],
    rests: Mapping[str, tuple[str, ...]],
    joints: Joints,
    complete: set[int],
) -> dict[str, Match]:
    """Columns that differ in a number only."""
    numbers = _numbers(columns, labels)
    if numbers is None:
        return {}
    named = [w for w in rests[columns[0]] if w.isalpha() and len(w) > 1]
    if not joints.arm:
        if named:  # several numbers of one thing, such as the coordinates of an elbow
            return {column: Match(_own_name(column, _joined(rests[column]))) for column in columns}
        return {column: Match(_own_name(column, f"joint_{number}")) for column, number in numbers.items()}
    base, doubt = _base(columns, labels, rests, joints), ""
    if base is None:
        base = next(iter(complete)) if len(complete) == 1 else 0 if 0 in numbers.values() else 1
        if len(complete) != 1 or not set(numbers.values()) <= set(range(base, base + len(joints.arm))):
            doubt = f"{len(columns)} numbers for {len(joints.arm)} joints"
    if joints.others:
        doubt = doubt or f"or is it of {joints.others[0]} and its like?"
    if _is_message(labels[columns[0]].words, labels):
        doubt = doubt or "numbered as in the message, whose order is often that of the alphabet"
    if named:
        mixed = [joint for joint in joints.arm if set(words_of(joint)) & set(named)]
        if mixed:  # several numbers of one joint, such as the place of an elbow
            return {column: Match("") for column in columns}
        doubt = doubt or f"its header also says '{' '.join(named)}'"
    places = {column: number - base for column, number in numbers.items()}
    return {
        column: Match(joints.arm[place] if 0 <= place < len(joints.arm) else "", doubt)
        for column, place in places.items()
    }


def _is_message(words: Sequence[str], labels: Mapping[str, Label]) -> bool:
    """Whether a header is an entry of a JointState's arrays."""
    entry = any(word in MESSAGE and after.isdigit() for word, after in pairwise(words))
    return entry and ("states" in words or any("effort" in label.words for label in labels.values()))


def _by_order(
    found: dict[str, Match], labels: Mapping[str, Label], rests: Mapping[str, tuple[str, ...]], joints: Joints
) -> None:
    """Names that no joint has: in the order of the columns where as many joints are left, else as they are."""
    left = {column: rests[column] for column in labels if column not in found}
    kinds = list(dict.fromkeys(rest for rest in left.values() if rest))
    free = [joint for joint in joints.arm if joint not in {match.joint for match in found.values()}]
    for column, rest in left.items():
        if not joints.arm:
            found[column] = Match(_own_name(column, _joined(rest)), "" if rest else "no joint is named")
        elif not rest:
            only = len(joints.arm) == 1
            found[column] = Match(joints.arm[0] if only else "", "" if only else "no joint is named")
        elif len(kinds) == len(free):
            found[column] = Match(free[kinds.index(rest)], "taken in the order of the columns")
        else:
            found[column] = Match(_joined(rest), "no joint of the robot has this name")


_OWN_NAME = re.compile(
    r"(?:.*[/.])?(?P<name>\w*joint(?:_?\d+)?)[_/.](?:pos|position|vel|velocity|speed|eff|effort|torque|tau)",
    re.IGNORECASE,
)


def _own_name(column: str, otherwise: str) -> str:
    """The joint's name as a header writes it, ``panda_joint1`` of ``panda_joint1_position``, where it does."""
    found = _OWN_NAME.fullmatch(column)
    return found["name"] if found is not None else otherwise


def _joined(rest: Sequence[str]) -> str:
    return "_".join(rest) or "joint_1"


def _without_common(rests: Mapping[str, tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
    """Without the words that all headers share, such as a namespace, where something is left of each."""
    common = {w for w in set.intersection(*map(set, rests.values())) if w.isalpha()} if rests else set()
    if any(set(rest) <= common for rest in rests.values()):
        return dict(rests)
    return {column: tuple(word for word in rest if word not in common) for column, rest in rests.items()}


def _cores(joints: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """By joint: the words in which it differs from the others."""
    words = {joint: words_of(joint) for joint in joints}
    if len(joints) < 2:
        return words
    start, end = (_shared([w[::step] for w in words.values()]) for step in (1, -1))
    return {
        joint: tuple(word for word in w[start : len(w) - end] if word not in IDLE) or w for joint, w in words.items()
    }


def _shared(rows: Sequence[Sequence[str]]) -> int:
    """How many first words all rows share, none of them whole."""
    shortest = min(map(len, rows))
    return next((k for k in range(shortest) if len({row[k] for row in rows}) > 1), shortest - 1)


def skeleton(words: Iterable[str]) -> tuple[str, ...]:
    """Words with a sign in the place of every number."""
    return tuple("#" if word.isdigit() else word for word in words)


def _numbers(columns: Sequence[str], labels: Mapping[str, Label]) -> dict[str, int] | None:
    """By column the number in which it differs from the others; None where there is no such number, or several."""
    rows = {column: [int(word) for word in labels[column].words if word.isdigit()] for column in columns}
    width = len(rows[columns[0]])
    if len(columns) == 1:
        return {column: row[0] for column, row in rows.items()} if width == 1 else None
    varying = [k for k in range(width) if len({row[k] for row in rows.values()}) > 1]
    if len(varying) != 1:
        return None
    return {column: row[varying[0]] for column, row in rows.items()}


def contains(words: Sequence[str], part: Sequence[str]) -> bool:
    """Whether words stand in a row within others."""
    n = len(part)
    return any(tuple(words[i : i + n]) == tuple(part) for i in range(len(words) - n + 1))
