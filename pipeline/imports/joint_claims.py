"""Claims of columns to channels of joints, and of force/torque sensors, by the words of their headers."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace

from armdyn.recording.channels import WRENCH_CHANNELS
from pipeline.imports.claims import Claim
from pipeline.imports.joints import RobotJoints, contains_phrase, match_joints, words_with_numbers_masked
from pipeline.imports.mapping import ColumnEntry
from pipeline.imports.units import ANGLE_OR_SHARE_DOUBT
from pipeline.imports.words import (
    COMMAND_WORDS,
    IRRELEVANT_WORDS,
    OF_A_WRENCH,
    WRENCH_AXIS_WORDS,
    ColumnHeaderParts,
    name_words,
    word_set,
)
from urdf.infer import is_gripper_name

LEROBOT_STATE = "observation.state"
"""LeRobot's name of the measured positions, in degrees, radians or shares of a joint's range."""
PENDULUM_WORDS = word_set("swing phi pendulum pend pole cart pivot trolley bob alpha gyro gyroscope")
"""Words of headers of a pendulum's recording."""
UR_NOTE = 'less the payload that the controller knows, in the axes of the base: [wrench.tcp] axes = "base"'
"""What a UR's manual says of actual_TCP_force (RTDE guide, `Generalized forces in the TCP`)."""
AXES = tuple(WRENCH_CHANNELS)


def labels_of_joints(labels: Mapping[str, ColumnHeaderParts], known: RobotJoints) -> dict[str, ColumnHeaderParts]:
    """Labels that may be a joint's, with the most likely quantity."""
    found: dict[str, ColumnHeaderParts] = {}
    kinds = Counter(words_with_numbers_masked(label.words) for label in labels.values())
    for name, label in labels.items():
        if is_gripper_name(name) or not label.measured:
            continue
        quantity, doubt = label.quantity, label.doubt
        if LEROBOT_STATE in name.lower() and quantity in ("", "q"):
            quantity, doubt = "q", ANGLE_OR_SHARE_DOUBT
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


def are_of_arm(labels: Mapping[str, ColumnHeaderParts]) -> bool:
    """Whether columns are those of an arm: of several joints, or with a joint's torque or current."""
    rests = {label.rest for label in labels.values()}
    numbers = {word for rest in rests for word in rest if word.isdigit()}
    return (
        len(numbers) > 1
        or any(label.quantity in ("tau", "current") for label in labels.values())
        or (len(rests) > 1 and all(rest and not set(rest) & PENDULUM_WORDS for rest in rests))
    )


def joint_claims(
    labels: Mapping[str, ColumnHeaderParts],
    known: RobotJoints,
    texts: Mapping[str, str],
    spans: Mapping[str, float] | None = None,
) -> list[Claim]:
    """Claims of the labels of joints, by column; `texts` are those of the recording's columns of text."""
    names = {}
    for column, label in labels.items():
        # A column of text such as ``field.name0`` contains the joint of ``field.position0``.
        field = next((word for word in ("position", "velocity", "effort") if word in label.words), None)
        if field is not None and (text := texts.get(column.replace(field, "name"))) is not None:
            names[column] = text
    claims = []
    for column, (joint, doubt) in match_joints(labels, known, names, spans).items():
        label = labels[column]
        if joint:
            quantity = "tau" if label.quantity == "current" else label.quantity
            doubts = tuple(filter(None, (doubt, label.doubt)))
            claims.append(Claim(column, f"{quantity}.{joint}", joint, label, doubts))
    return claims


def wrench_entries(labels: Mapping[str, ColumnHeaderParts]) -> dict[str, ColumnEntry]:
    """Mapping entries of the columns of whole wrenches, by column; a sensor is called ``ft``, or ``tcp`` as of a UR.

    Args:
        labels: parsed headers by column.
    """
    groups: dict[tuple[str, ...], dict[str, str]] = {}
    for column, label in labels.items():
        if (found := _axis_and_group(label.words)) is not None and not COMMAND_WORDS & set(label.words):
            groups.setdefault(found[1], {}).setdefault(found[0], column)
    entries, count = dict[str, ColumnEntry](), dict[str, int]()
    for group, columns in groups.items():
        numbered = {axis for axis in columns if axis.isdigit()}
        if len(numbered) == len(AXES):
            first = min(map(int, numbered))
            columns = {AXES[int(axis) - first]: columns[axis] for axis in numbered if int(axis) - first < len(AXES)}
        if not set(AXES) <= columns.keys():
            continue
        name = "tcp" if "tcp" in group else "ft"
        count[name] = count.get(name, 0) + 1
        name = name if count[name] == 1 else f"{name}{count[name]}"
        for axis in AXES:
            label = labels[columns[axis]]
            certain = bool(label.unit or {*OF_A_WRENCH, "tcp"} & set(label.words))
            entries[columns[axis]] = ColumnEntry(
                f"{axis}.{name}", label.unit or WRENCH_CHANNELS[axis].units[0],
                check="" if certain else f"in {WRENCH_CHANNELS[axis].units[0]}?",
                why=UR_NOTE if name == "tcp" else "",
            )  # fmt: skip
    return entries


def _axis_and_group(words: tuple[str, ...]) -> tuple[str, tuple[str, ...]] | None:
    """Axis, or its number, and the other words of a header; None for one that is not an axis of a wrench."""
    for i, word in enumerate(words):
        before = words[i - 1] if i else ""
        axis = word if len(word) > 1 else before + word if len(before) == 1 else f"{before} {word}"
        if axis in WRENCH_AXIS_WORDS:
            beside = words[:i] if len(word) > 1 else words[: i - 1]
            return WRENCH_AXIS_WORDS[axis], (*beside, *words[i + 1 :])
    if words and words[-1].isdigit() and (OF_A_WRENCH & set(words) or {"tcp", "force"} <= set(words)):
        return words[-1], words[:-1]
    return None
