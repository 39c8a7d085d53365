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

import numpy as np

from pipeline.imports.words import IDLE, Label, words_of
from urdf import Robot
from urdf.gripper import gripper_joints
from urdf.validate import MOVING_JOINT_TYPES

MESSAGE = ("position", "velocity", "effort")
"""Fields of a JointState, whose arrays are in the order of its names: often the alphabet's."""
AMPERE = frozenset(("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"))
"""Joints of Universal Robots."""
IN_AMPERE = "UR's drivers publish currents as efforts"


@dataclass(frozen=True)
class Range:
    """What a joint may do: slides or turns; distance from zero, rad or m; effort, N m or N; infinite if unknown."""

    slides: bool
    reach: float
    effort: float


@dataclass(frozen=True)
class Joints:
    """The joints of a robot.

    Attributes:
        arm: from base to tool; empty where no robot is known.
        others: further joints of its description that move, such as another arm's.
        grippers: joints of grippers.
        ranges: of the arm's joints, where they are known.
        sliding: of all joints those that slide.
    """

    arm: tuple[str, ...] = ()
    others: tuple[str, ...] = ()
    grippers: tuple[str, ...] = ()
    ranges: Mapping[str, Range] = field(default_factory=dict)
    sliding: frozenset[str] = frozenset()

    @property
    def names(self) -> tuple[str, ...]:
        """All of them."""
        return (*self.arm, *self.others, *self.grippers)

    @property
    def beside(self) -> tuple[str, ...]:
        """Those that are none of the arm's."""
        return (*self.others, *self.grippers)

    def slides(self, joint: str) -> bool:
        """Whether a joint is known to slide."""
        return joint in self.ranges and self.ranges[joint].slides

    @classmethod
    def of(cls, robot: Robot) -> "Joints":
        """Of a robot, and of everything else in its description."""
        root, model = ET.fromstring(robot.urdf_xml), robot.model
        moving = [str(j.get("name")) for j in root.findall("joint") if j.get("type") in MOVING_JOINT_TYPES]
        grippers = {name for name in gripper_joints(root) if name not in robot.joint_names}
        mimics = {str(j.get("name")) for j in root.findall("joint") if j.find("mimic") is not None}
        arm = robot.joint_names
        slides = [joint.shortname().startswith("JointModelP") for joint in list(model.joints)[1:]]
        reach = np.maximum(np.abs(model.lowerPositionLimit), np.abs(model.upperPositionLimit)).tolist()
        effort = model.effortLimit.tolist()
        ranges = {name: Range(*own) for name, *own in zip(arm, slides, reach, effort, strict=True)}
        others = tuple(name for name in moving if name not in {*arm, *grippers, *mimics})
        sliding = frozenset(str(j.get("name")) for j in root.findall("joint") if j.get("type") == "prismatic")
        return cls(arm, others, tuple(grippers), ranges, sliding)


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
    rests = _differing({column: label.rest for column, label in labels.items()})
    groups: dict[tuple[str, ...], list[str]] = {}
    for column in labels:
        groups.setdefault(skeleton(labels[column].words), []).append(column)
    headers = _Headers(labels, rests, joints, tuple(groups.values()))
    return headers.named_by_robot(names) if joints.arm else headers.named_by_themselves()


@dataclass(frozen=True)
class _Headers:
    """Headers of joints.

    Attributes:
        labels: by column.
        rests: by column: the words in which they differ.
        joints: of the robot.
        groups: columns that differ in numbers only.
    """

    labels: Mapping[str, Label]
    rests: Mapping[str, tuple[str, ...]]
    joints: Joints
    groups: tuple[Sequence[str], ...]

    def named_by_themselves(self) -> dict[str, Match]:
        """Joints as the headers call them, where no robot is known."""
        found = {}
        for columns in self.groups:
            numbers = self._numbers(columns) or {}
            for column in columns:
                # Of several numbers of one thing, such as the coordinates of an elbow, the thing is told.
                numbered = column in numbers and not self._names(column)
                joint = f"joint_{numbers[column]}" if numbered else "_".join(self.rests[column]) or "joint_1"
                sure = numbered or self.rests[column]
                found[column] = Match(_own_name(column, joint), "" if sure else "no joint is named")
        return found

    def named_by_robot(self, names: Mapping[str, str]) -> dict[str, Match]:
        """By the names of the robot's joints, else by their numbers, else in their order."""
        differing = _differing({joint: words_of(joint) for joint in self.joints.arm})
        cores = {joint: tuple(word for word in core if word not in IDLE) or core for joint, core in differing.items()}
        found: dict[str, Match] = {}
        for column, label in self.labels.items():
            words, rest = (words_of(names[column]), ()) if column in names else (label.words, self.rests[column])
            if match := _by_name(words, rest, cores, self.joints):
                found[column] = match
        left: list[tuple[list[str], str]] = []
        for columns in self.groups:
            doubt = ""
            if any(column not in found for column in columns):
                # Of joints that only differ in a number all are found by name, or none: files may count otherwise.
                for column in columns:
                    if column in found and "".join(cores.get(found[column].joint, ("a",))).isdigit():
                        del found[column]
                        doubt = "the robot's joints count from another number"
                left.append(([column for column in columns if column not in found], doubt))
        whole = {first for columns, _ in left if (first := self._first(columns)) is not None}
        for columns, doubt in left:
            found |= self._by_number(columns, whole, doubt)
        return found | self._by_order([column for column in self.labels if column not in found], found)

    def _names(self, column: str) -> list[str]:
        """Words of a header that may name a thing."""
        return [word for word in self.rests[column] if word.isalpha() and len(word) > 1]

    def _numbers(self, columns: Sequence[str]) -> dict[str, int] | None:
        """By column the number in which it differs from the others; None where there is no such, or several."""
        rows = {column: [int(word) for word in self.labels[column].words if word.isdigit()] for column in columns}
        width = len(rows[columns[0]])
        varying = [k for k in range(width) if len(columns) == 1 or len({row[k] for row in rows.values()}) > 1]
        return {column: row[varying[0]] for column, row in rows.items()} if len(varying) == 1 else None

    def _first(self, columns: Sequence[str]) -> int | None:
        """From which number a group counts that has a column for every joint; None where it has not."""
        numbers = self._numbers(columns)
        if numbers is None or any(self._names(column) for column in columns):
            return None
        first = min(numbers.values())
        whole = set(numbers.values()) == set(range(first, first + len(self.joints.arm)))
        return first if whole and first in (0, 1) else None

    def _by_number(self, columns: Sequence[str], whole: set[int], doubt: str) -> dict[str, Match]:
        """Columns that differ in a number only.

        Args:
            columns: of one group.
            whole: from which numbers groups count that have a column for every joint.
            doubt: where nothing else is doubtful.
        """
        numbers, arm, named = self._numbers(columns), self.joints.arm, self._names(columns[0])
        if numbers is None:
            return {}
        if any(set(words_of(joint)) & set(named) for joint in arm):
            return dict.fromkeys(columns, Match(""))  # several numbers of one joint, such as the place of an elbow
        first, sure = self._first(columns), True
        if first is None:
            first = next(iter(whole)) if len(whole) == 1 else 0 if 0 in numbers.values() else 1
            sure = len(whole) == 1 and set(numbers.values()) <= set(range(first, first + len(arm)))
        doubts = (
            not sure and f"{len(columns)} numbers for {len(arm)} joints",
            self.joints.others and f"or is it of {self.joints.others[0]} and its like?",
            self._is_message(columns[0]) and "numbered as in the message, whose order is often that of the alphabet",
            named and f"its header also says '{' '.join(named)}'",
            doubt,
        )
        why = next(filter(None, doubts), "")
        return {
            column: Match(arm[number - first] if 0 <= number - first < len(arm) else "", str(why))
            for column, number in numbers.items()
        }

    def _is_message(self, column: str) -> bool:
        """Whether a header is an entry of a JointState's arrays."""
        words = self.labels[column].words
        entry = any(word in MESSAGE and after.isdigit() for word, after in pairwise(words))
        return entry and ("states" in words or any("effort" in label.words for label in self.labels.values()))

    def _by_order(self, columns: Sequence[str], found: Mapping[str, Match]) -> dict[str, Match]:
        """Names that no joint has: in the order of the columns where as many joints are left, else as they are."""
        kinds = list(dict.fromkeys(self.rests[column] for column in columns if self.rests[column]))
        free = [joint for joint in self.joints.arm if joint not in {match.joint for match in found.values()}]
        matches = {}
        for column in columns:
            if not (rest := self.rests[column]):
                matches[column] = Match(self.joints.arm[0] if len(self.joints.arm) == 1 else "")
            elif len(kinds) == len(free):
                matches[column] = Match(free[kinds.index(rest)], "taken in the order of the columns")
            else:
                matches[column] = Match("_".join(rest), "no joint of the robot has this name")
        return matches


def _by_name(
    words: Sequence[str], rest: Sequence[str], cores: Mapping[str, tuple[str, ...]], joints: Joints
) -> Match | None:
    """The joint whose whole name is in a header, else the one that differs from all others as the header does."""
    inside = [j for j in (*joints.arm, *joints.others, *joints.grippers) if contains(words, words_of(j))]
    inside = [j for j in inside if any(word.isalpha() for word in words_of(j))]
    inside = [j for j in inside if not any(contains(words_of(k), words_of(j)) for k in inside if k != j)]
    if len(inside) == 1:
        extra = list((Counter(rest) - Counter(words_of(inside[0]))).elements())
        if inside[0] in joints.grippers:
            return Match("")
        return Match(inside[0], f"its header also says '{' '.join(extra)}'" if extra else "")
    if not any(word.isalpha() for word in rest):
        return None
    same = [joint for joint, core in cores.items() if "".join(core) == "".join(rest)]
    if len(same) == 1:
        return Match(same[0])
    letters = {word for word in rest if word.isalpha() and len(word) > 1}
    numbers = {word for word in rest if word.isdigit()}
    near = [j for j, core in cores.items() if letters & set(core) and numbers == set(filter(str.isdigit, core))]
    return Match(near[0], "a name like it") if len(near) == 1 else None


_OWN_NAME = re.compile(
    r"(?:.*[/.])?(?P<name>\w*joint(?:_?\d+)?)[_/.](?:pos|position|vel|velocity|speed|eff|effort|torque|tau)",
    re.IGNORECASE,
)


def _own_name(column: str, otherwise: str) -> str:
    """The joint's name as a header writes it, ``panda_joint1`` of ``panda_joint1_position``, where it does."""
    found = _OWN_NAME.fullmatch(column)
    return found["name"] if found is not None else otherwise


def _differing(names: Mapping[str, tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
    """Without the words that all names share, such as a namespace, where something is left of each."""
    common = {w for w in set.intersection(*map(set, names.values())) if w.isalpha()} if names else set()
    if any(set(words) <= common for words in names.values()):
        return dict(names)
    return {name: tuple(word for word in words if word not in common) for name, words in names.items()}


def skeleton(words: Iterable[str]) -> tuple[str, ...]:
    """Words with a sign in the place of every number."""
    return tuple("#" if word.isdigit() else word for word in words)


def contains(words: Sequence[str], part: Sequence[str]) -> bool:
    """Whether words stand in a row within others."""
    n = len(part)
    return any(tuple(words[i : i + n]) == tuple(part) for i in range(len(words) - n + 1))
