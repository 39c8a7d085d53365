"""ROS 1 bags, ROS 2 bags (sqlite3, MCAP) and MCAP files, with the message definitions that they contain.

A JointState gives positions, velocities and efforts by joint. Of every other message each number becomes a column,
named by topic and field. The time of a sample is the header's stamp, or else the time at which it was recorded.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from armdyn.errors import InputError
from armdyn.quoting import name_list
from armdyn.recording.channels import MIN_COMPARED_CHANNEL_SAMPLES
from pipeline.imports.foreign import ForeignColumn, ForeignReader, ForeignRecording
from pipeline.imports.joints import UR_CURRENT_DOUBT, UR_JOINTS
from pipeline.imports.messages import MessageDecoders
from pipeline.imports.packets import bag_messages
from pipeline.imports.publishers import COMMAND_QUANTITIES, JOINT_STATE, JOINT_STATE_QUANTITIES, Publishers
from pipeline.imports.words import COMMAND_WORDS, name_words
from urdf.bounds import MAX_TABLE_COLUMNS

DYNAMIC_JOINT_STATE_TYPE = "control_msgs/msg/DynamicJointState"
JOINT_TRAJECTORY_TYPE = "trajectory_msgs/msg/JointTrajectory"
CONTROLLER_STATE_TYPE = "control_msgs/msg/JointTrajectoryControllerState"
COMMAND_TOPIC_WORDS = COMMAND_WORDS - {"as", "action", "plan", "planned", "nominal", "demand"}
"""Words in the name of a topic that mark its joint states as commands."""
MAX_ARRAY_ELEMENTS_AS_COLUMNS = 64
"""Largest length of an array in a message whose numbers become columns; longer ones are images and point clouds."""


def read_bag(path: Path) -> ForeignRecording:
    """Read every number in the messages of a ROS bag or MCAP file as columns.

    Args:
        path: a .bag, .mcap or .db3 file, or the directory of a ROS 2 bag.

    Raises:
        InputError: rosbags is not installed, or the bag cannot be read or contains no number.
    """
    decoders, publishers, problems = MessageDecoders(), Publishers(), list[str]()
    unread: dict[str, int] = {}
    for connection, received, data in bag_messages(path, problems):
        topic = connection.topic
        if (decode := decoders.of(connection)) is None:
            continue
        try:
            content = decode(data)
        except Exception:  # bytes that do not fit a definition surface as any exception
            unread[topic] = unread.get(topic, 0) + 1
            continue
        try:
            _take(publishers, topic, connection.kind, connection.publisher, 1e-9 * received, content)
        except (TypeError, ValueError, AttributeError, OverflowError):  # fields that are not what their names say
            unread[topic] = unread.get(topic, 0) + 1
    notes = decoders.notes()
    columns, accounts, changes = publishers.columns(unread)
    if problems and not columns:
        raise InputError(f"{path}: cannot be read as a bag: {problems[-1]}")
    if problems:
        notes.append(f"not all of it can be read: {problems[-1]}")
    if publishers.crowded:
        notes.append(
            f"more than {MAX_TABLE_COLUMNS} numbers in its messages: {name_list(sorted(publishers.crowded))} left out"
        )
    notes += [
        f"{topic}: nothing can be read of its {n} messages" for topic, n in unread.items() if topic not in accounts
    ]
    columns, choices = _chosen(_measured(columns))
    if not columns:
        raise InputError(
            f"{path}: holds no numbers that were recorded {MIN_COMPARED_CHANNEL_SAMPLES} times: give another bag"
        )
    return ForeignRecording(path.stem, columns, (*notes, *changes, *choices), accounts=accounts)


def _take(publishers: Publishers, topic: str, kind: str, publisher: str, received: float, content: Any) -> None:
    """Add the numbers of one message: as measurements or commands of joints, else as they are."""
    stamp = _stamp(content)
    numbers = ((name, value, "") for name, value in _numbers(topic, content))
    if (command := _command(kind, content)) is not None:
        publishers.add_joint_message(topic, publisher, *command, stamp, received, commanded=True, beside=list(numbers))
    elif (state := _joint_state(kind, content)) is not None:
        commanded = not COMMAND_TOPIC_WORDS.isdisjoint(name_words(topic))
        publishers.add_joint_message(topic, publisher, *state, stamp, received, commanded=commanded)
    else:
        publishers.take(topic, publisher, stamp, received, list(numbers))


def _joint_state(kind: str, content: Any) -> tuple[Sequence[str], Mapping[str, Any]] | None:
    """Names and fields of a message about the state of joints; None for any other message."""
    if kind == DYNAMIC_JOINT_STATE_TYPE:
        found = {
            f"{joint}/{interface}": value
            for joint, own in zip(content.joint_names, content.interface_values, strict=True)
            for interface, value in zip(own.interface_names, own.values, strict=True)
        }
        return list(found), {"position": list(found.values())}
    names = _field(content, "name")
    if kind == JOINT_STATE or (isinstance(content, dict) and isinstance(names, list) and "position" in content):
        return names, {part: _field(content, part) for part, _ in JOINT_STATE_QUANTITIES}
    return None


def _command(kind: str, content: Any) -> tuple[Sequence[str], Mapping[str, Any]] | None:
    """Names and fields of a message that contains the present command of joints; None for any other message.

    The state of a controller contains the interpolated command. A trajectory of one point is a command; one of many
    points is a plan, whose present point is in the controller's state.
    """
    point: Any = None
    if kind == CONTROLLER_STATE_TYPE:
        point = _field(content, "reference") or _field(content, "desired")
    elif kind == JOINT_TRAJECTORY_TYPE:
        points = _field(content, "points")
        point = points[0] if points is not None and len(points) == 1 else None
    if point is None:
        return None
    parts = {"position": "positions", "velocity": "velocities", "effort": "effort"}
    return _field(content, "joint_names"), {part: _field(point, name) for part, name in parts.items()}


def _measured(columns: Mapping[str, ForeignColumn]) -> Mapping[str, ForeignColumn]:
    """The columns; where no position was measured, commands count as measurements."""
    if any(column.channel.startswith("q.") for column in columns.values()):
        return columns
    back = {command: quantity for quantity, command in COMMAND_QUANTITIES.items()}
    found = {}
    for name, column in columns.items():
        quantity, _, joint = column.channel.partition(".")
        found[name] = replace(column, channel=f"{back[quantity]}.{joint}") if quantity in back else column
    return found


def _field(content: Any, name: str) -> Any:
    return content.get(name) if isinstance(content, dict) else getattr(content, name, None)


def _stamp(content: Any) -> float:
    """Stamp of a message's header [s]; nan where there is none, or it is 0."""
    stamp = _field(_field(content, "header"), "stamp")
    seconds, nanoseconds = (
        next((value for name in names if (value := _field(stamp, name)) is not None), 0)
        for names in (("sec", "secs"), ("nanosec", "nsecs", "nsec"))
    )
    time = float(seconds) + 1e-9 * float(nanoseconds)
    return time if time > 0.0 else np.nan


def _numbers(name: str, value: Any) -> Iterator[tuple[str, float]]:
    """Every number in a message, named by its path."""
    if isinstance(value, bool | int | float | np.bool_ | np.integer | np.floating):
        yield name, float(value)
        return
    parts: Mapping[str, Any] = {}
    if isinstance(value, list | np.ndarray):
        parts = {str(i): entry for i, entry in enumerate(value)} if len(value) <= MAX_ARRAY_ELEMENTS_AS_COLUMNS else {}
    elif isinstance(value, dict):  # of JSON
        parts = value
    elif hasattr(value, "__dataclass_fields__"):
        fields = value.__dataclass_fields__
        # Names in capitals are constants of the definition.
        parts = {part: getattr(value, part) for part in fields if part != "__msgtype__" and not part.isupper()}
    yield from chain.from_iterable(_numbers(f"{name}/{part}", own) for part, own in parts.items() if part != "header")


def _chosen(columns: Mapping[str, ForeignColumn]) -> tuple[dict[str, ForeignColumn], list[str]]:
    """Columns with enough samples, and sentences; of several topics with one channel, the most informative is used."""
    kept = {
        name: column
        for name, column in columns.items()
        if np.isfinite(column.value).sum() >= MIN_COMPARED_CHANNEL_SAMPLES
    }
    best: dict[str, str] = {}
    for name, column in kept.items():
        if column.channel and (best.setdefault(column.channel, name) != name):
            best[column.channel] = max(best[column.channel], name, key=lambda of: _information(kept[of]))
    notes = []
    for name, column in kept.items():
        if column.channel and best[column.channel] != name:
            kept[name] = replace(column, channel="")
            notes.append(f"{name}: {best[column.channel]} has more samples of {column.channel}, and is used")
    if {f"tau.{joint}" for joint in UR_JOINTS} <= {column.channel for column in kept.values()}:
        notes.append(f"efforts were taken as N m: {UR_CURRENT_DOUBT}; then give --map with a torque_constant")
    if few := [name for name in columns if name not in kept]:
        notes.append(f"fewer than {MIN_COMPARED_CHANNEL_SAMPLES} numbers: {name_list(few)}: left out")
    return kept, notes


def _information(column: ForeignColumn) -> tuple[bool, int]:
    """Sort key of columns of one channel: whether the values change, number of samples."""
    return bool(np.ptp(column.value[np.isfinite(column.value)]) > 0.0), len(column.value)


BAG_FILE_PATTERNS = tuple(
    f"{{name}}{number}.{kind}" for number in ("", "_[0-9]*") for kind in ("db3", "db3.zstd", "mcap")
)
"""Patterns of the names of files in the directory of a ROS 2 bag; ``{name}`` is the name of the directory."""
READERS = (
    ForeignReader(
        lambda path: [read_bag(path)], (".bag", ".mcap", ".db3"), "ROS 2 bag", "metadata.yaml", BAG_FILE_PATTERNS
    ),
)
