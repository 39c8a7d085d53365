"""Find the joint of a robot that a column belongs to, by name, by number, or by the order of the columns.

Words that all joints, or all headers, have in common are not compared: of ``panda_joint1`` and ``state.q[0]``, the 1
and the 0 are left. Numbers count from the base to the tool, from 0 or from 1; this is certain where a quantity has a
column for every joint of the arm. An uncertain match has a doubt, a reason for a person to look.
"""

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple
from xml.etree import ElementTree as ET

import numpy as np

from pipeline.imports.words import IRRELEVANT_WORDS, ColumnHeaderParts, name_words
from urdf import Robot
from urdf.gripper import gripper_joints
from urdf.validate import MOVING_JOINT_TYPES

JOINT_STATE_ARRAYS = ("position", "velocity", "effort")
"""Arrays of the ROS message JointState, in the order of its names, which is often alphabetical."""
UR_JOINTS = frozenset(("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"))
"""Names of joints by which arms of Universal Robots are recognised."""
UR_CURRENT_DOUBT = "UR's drivers publish currents as efforts"
"""Doubt about efforts of Universal Robots, which may be currents."""

MIN_MOTION_SHARE = 0.02
"""Least motion of a motor, as a share of the largest one's, below which it only trembles."""


@dataclass(frozen=True)
class JointRange:
    """Range of a joint; infinite where it is unknown.

    Attributes:
        slides: whether the joint is prismatic.
        reach: largest distance from zero [rad or m].
        effort: largest torque or force [N m or N].
    """

    slides: bool
    reach: float
    effort: float


@dataclass(frozen=True)
class RobotJoints:
    """The joints of a robot.

    Attributes:
        arm: joints of the arm, from base to tool; empty where no robot is known.
        others: further moving joints of its description, such as another arm's.
        grippers: joints of grippers.
        ranges: ranges of the arm's joints, where they are known.
        sliding: all prismatic joints.
    """

    arm: tuple[str, ...] = ()
    others: tuple[str, ...] = ()
    grippers: tuple[str, ...] = ()
    ranges: Mapping[str, JointRange] = field(default_factory=dict)
    sliding: frozenset[str] = frozenset()

    @property
    def beside(self) -> tuple[str, ...]:
        """Names of all joints of the robot that do not belong to the arm."""
        return (*self.others, *self.grippers)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all joints of the robot."""
        return (*self.arm, *self.beside)

    def slides(self, joint: str) -> bool:
        """Whether a joint is known to be prismatic."""
        return joint in self.ranges and self.ranges[joint].slides

    @classmethod
    def of(cls, robot: Robot) -> "RobotJoints":
        """Joints of a robot's arm, and all other joints in its description."""
        root, model = ET.fromstring(robot.urdf_xml), robot.model
        joints, arm = {str(j.get("name")): j for j in root.findall("joint")}, robot.joint_names
        grippers = {name for name in gripper_joints(root) if name not in arm}
        slides = [joint.shortname().startswith("JointModelP") for joint in list(model.joints)[1:]]
        reach = np.maximum(np.abs(model.lowerPositionLimit), np.abs(model.upperPositionLimit)).tolist()
        ranges = {
            name: JointRange(*own) for name, *own in zip(arm, slides, reach, model.effortLimit.tolist(), strict=True)
        }
        others = tuple(
            name
            for name, joint in joints.items()
            if joint.get("type") in MOVING_JOINT_TYPES and joint.find("mimic") is None and name not in {*arm, *grippers}
        )
        sliding = frozenset(name for name, joint in joints.items() if joint.get("type") == "prismatic")
        return cls(arm, others, tuple(grippers), ranges, sliding)


class MatchedJointName(NamedTuple):
    """Joint to which a column belongs (empty for a column to leave out), and a doubt (empty for a certain joint)."""

    joint: str
    doubt: str = ""


def match_joints(
    labels: Mapping[str, ColumnHeaderParts],
    joints: RobotJoints,
    names: Mapping[str, str],
    spans: Mapping[str, float] | None = None,
) -> dict[str, MatchedJointName]:
    """Find the joint of every column.

    Args:
        labels: parsed headers of the columns that contain a joint's quantity.
        joints: joints of the robot.
        names: name of the joint where a column of text states it, by column.
        spans: largest less smallest value of columns, where it is known: of more motors than the arm has joints, the
            arm's are those that move.
    """
    groups: dict[tuple[str, ...], list[str]] = {}
    for column in labels:
        groups.setdefault(words_with_numbers_masked(labels[column].words), []).append(column)
    rests = _differing({column: label.rest for column, label in labels.items()})
    headers = _Headers(labels, rests, joints, tuple(groups.values()), spans or {})
    return headers.named_by_robot(names) if joints.arm else headers.named_by_headers()


@dataclass(frozen=True)
class _Headers:
    """Headers of joints.

    Attributes:
        labels: labels by column.
        rests: words in which the headers differ, by column.
        joints: joints of the robot.
        groups: columns that differ in numbers only.
        spans: largest less smallest value of columns.
    """

    labels: Mapping[str, ColumnHeaderParts]
    rests: Mapping[str, tuple[str, ...]]
    joints: RobotJoints
    groups: tuple[Sequence[str], ...]
    spans: Mapping[str, float]

    def named_by_headers(self) -> dict[str, MatchedJointName]:
        """Joints with the names in the headers, where no robot is known."""
        found = {}
        for columns in self.groups:
            numbers = self._numbers(columns) or {}
            for column in columns:
                # Several numbers of one thing, such as the coordinates of an elbow, have the name of the thing.
                numbered = column in numbers and not self._names(column)
                joint = f"joint_{numbers[column]}" if numbered else "_".join(self.rests[column]) or "joint_1"
                own = _OWN_NAME.fullmatch(column)
                certain = numbered or self.rests[column]
                found[column] = MatchedJointName(own["name"] if own else joint, "" if certain else "no joint is named")
        return found

    def named_by_robot(self, names: Mapping[str, str]) -> dict[str, MatchedJointName]:
        """Match by the names of the robot's joints, else by their numbers, else by their order."""
        differing = _differing({joint: name_words(joint) for joint in self.joints.arm})
        cores = {
            joint: tuple(word for word in core if word not in IRRELEVANT_WORDS) or core
            for joint, core in differing.items()
        }
        found: dict[str, MatchedJointName] = {}
        for column, label in self.labels.items():
            words, rest = (name_words(names[column]), ()) if column in names else (label.words, self.rests[column])
            if match := _by_name(words, rest, cores, self.joints):
                found[column] = match
        open_groups: list[tuple[list[str], str]] = []
        for columns in self.groups:
            doubt = ""
            if any(column not in found for column in columns):
                # Joints that differ only in a number are all matched by name, or none: files may count differently.
                for column in columns:
                    if column in found and "".join(cores.get(found[column].joint, ("a",))).isdigit():
                        del found[column]
                        doubt = "the robot's joints count from another number"
                open_groups.append(([column for column in columns if column not in found], doubt))
        firsts = {first for columns, _ in open_groups if (first := self._first(columns)) is not None} or {
            first for columns, _ in open_groups if (first := self._first_that_moves(columns)) is not None
        }
        for columns, doubt in open_groups:
            found |= self._by_number(columns, firsts, doubt)
        return found | self._by_order([column for column in self.labels if column not in found], found)

    def _names(self, column: str) -> list[str]:
        """Words of a header that may be a name."""
        return [word for word in self.rests[column] if word.isalpha() and len(word) > 1]

    def _numbers(self, columns: Sequence[str]) -> dict[str, int] | None:
        """The number in which each column differs from the others; None where no or several numbers differ."""
        rows = {column: [int(word) for word in self.labels[column].words if word.isdigit()] for column in columns}
        places = range(len(rows[columns[0]])) if columns else ()
        varying = [k for k in places if len(columns) == 1 or len({row[k] for row in rows.values()}) > 1]
        return {column: row[varying[0]] for column, row in rows.items()} if len(varying) == 1 else None

    def _first(self, columns: Sequence[str]) -> int | None:
        """First number, 0 or 1, of a group with a column for every joint; None for other groups."""
        numbers = self._numbers(columns)
        if numbers is None or any(map(self._names, columns)):
            return None
        first = min(numbers.values())
        complete = set(numbers.values()) == set(range(first, first + len(self.joints.arm)))
        return first if complete and first in (0, 1) else None

    def _first_that_moves(self, columns: Sequence[str]) -> int | None:
        """First number of the positions that move, where they are as many in succession as the arm has joints."""
        numbers = self._numbers(columns)
        if numbers is None or self.labels[columns[0]].quantity != "q" or not set(columns) <= self.spans.keys():
            return None
        least = MIN_MOTION_SHARE * max(self.spans[column] for column in columns)
        moving = sorted(number for column, number in numbers.items() if self.spans[column] > least)
        return moving[0] if moving == list(range(moving[0], moving[0] + len(self.joints.arm))) else None

    def _by_number(self, columns: Sequence[str], firsts: set[int], doubt: str) -> dict[str, MatchedJointName]:
        """Match the columns of one group by their numbers."""
        numbers, arm = self._numbers(columns), self.joints.arm
        if numbers is None:
            return {}
        named = self._names(columns[0])
        if any(set(name_words(joint)) & set(named) for joint in arm):
            return dict.fromkeys(
                columns, MatchedJointName("")
            )  # several numbers of one joint, such as the place of an elbow
        first, certain = self._first(columns), True
        if first is None:
            first = next(iter(firsts)) if len(firsts) == 1 else 0 if 0 in numbers.values() else 1
            certain = len(firsts) == 1 and set(numbers.values()) <= set(range(first, first + len(arm)))
        of_these = f": is number {first} that of {arm[0]}?"
        doubts = {
            f"{len(columns)} numbers for {len(arm)} joints{of_these}": not certain,
            f"or is it of {' '.join(self.joints.others[:1])} and its like?": self.joints.others,
            "numbered as in the message, whose order is often that of the alphabet": self._is_message(columns[0]),
            f"its header also says '{' '.join(named)}'": named,
            doubt: True,
        }
        why = next(doubt for doubt, holds in doubts.items() if holds)
        return {
            column: MatchedJointName(arm[number - first] if 0 <= number - first < len(arm) else "", why)
            for column, number in numbers.items()
        }

    def _is_message(self, column: str) -> bool:
        words = self.labels[column].words
        entry = any(word in JOINT_STATE_ARRAYS and after.isdigit() for word, after in pairwise(words))
        return entry and ("states" in words or any("effort" in label.words for label in self.labels.values()))

    def _by_order(self, columns: Sequence[str], found: Mapping[str, MatchedJointName]) -> dict[str, MatchedJointName]:
        """Match unknown names by the order of the columns where their number fits; else each is a joint of its own."""
        kinds = list(dict.fromkeys(self.rests[column] for column in columns if self.rests[column]))
        free = [joint for joint in self.joints.arm if joint not in {match.joint for match in found.values()}]
        matches = {}
        for column in columns:
            if not (rest := self.rests[column]):
                matches[column] = MatchedJointName(self.joints.arm[0] if len(self.joints.arm) == 1 else "")
            elif len(kinds) == len(free):
                matches[column] = MatchedJointName(free[kinds.index(rest)], "taken in the order of the columns")
            else:
                matches[column] = MatchedJointName("_".join(rest), "no joint of the robot has this name")
        return matches


def _by_name(
    words: Sequence[str], rest: Sequence[str], cores: Mapping[str, tuple[str, ...]], joints: RobotJoints
) -> MatchedJointName | None:
    """The joint whose whole name is in a header, else the one whose distinctive words are those of the header."""
    inside = [j for j in joints.names if contains_phrase(words, name_words(j)) and any(map(str.isalpha, name_words(j)))]
    inside = [j for j in inside if not any(contains_phrase(name_words(k), name_words(j)) for k in inside if k != j)]
    if len(inside) == 1:
        extra = " ".join((Counter(rest) - Counter(name_words(inside[0]))).elements())
        if inside[0] in joints.grippers:
            return MatchedJointName("")
        return MatchedJointName(inside[0], f"its header also says '{extra}'" if extra else "")
    if not any(word.isalpha() for word in rest):
        return None
    same = [joint for joint, core in cores.items() if "".join(core) == "".join(rest)]
    if len(same) == 1:
        return MatchedJointName(same[0])
    letters = {word for word in rest if word.isalpha() and len(word) > 1}
    numbers = set(filter(str.isdigit, rest))
    near = [j for j, core in cores.items() if letters & set(core) and numbers == set(filter(str.isdigit, core))]
    return MatchedJointName(near[0], "a name like it") if len(near) == 1 else None


_OWN_NAME = re.compile(
    r"(?:.*[/.])?(?P<name>\w*joint(?:_?\d+)?)[_/.](?:pos|position|vel|velocity|speed|eff|effort|torque|tau)",
    re.IGNORECASE,
)
"""Header with the joint's own name: ``panda_joint1`` of ``panda_joint1_position``."""


def _differing(names: Mapping[str, tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
    """Remove the words that all names have in common, such as a namespace, unless that leaves nothing of one."""
    common = {w for w in set.intersection(*map(set, names.values())) if w.isalpha()} if names else set()
    if any(set(words) <= common for words in names.values()):
        return dict(names)
    return {name: tuple(word for word in words if word not in common) for name, words in names.items()}


def words_with_numbers_masked(words: Iterable[str]) -> tuple[str, ...]:
    """Words of a name with ``#`` in place of every number, so that names that differ in a number become equal."""
    return tuple("#" if word.isdigit() else word for word in words)


def contains_phrase(words: Sequence[str], part: Sequence[str]) -> bool:
    """Whether `words` contain the words of `part` in succession."""
    n = len(part)
    return any(tuple(words[i : i + n]) == tuple(part) for i in range(len(words) - n + 1))
