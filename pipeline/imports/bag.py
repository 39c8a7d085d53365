"""ROS 1 bags, ROS 2 bags (sqlite3, MCAP) and MCAP files, with the message definitions that they carry.

A JointState gives positions, velocities and efforts by joint; of every other message each number is a column, named by
topic and field. Stamps are the header's, else the time at which the message was recorded.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from armdyn.errors import InputError
from armdyn.recording.channels import MIN_SAMPLES
from pipeline.imports.foreign import Column, Foreign, Reader
from pipeline.imports.joints import AMPERE, IN_AMPERE
from pipeline.imports.messages import Reading, messages
from pipeline.imports.publishers import FIELDS, JOINT_STATE, TOLD, Publishers
from pipeline.imports.words import COMMANDED, words_of
from urdf.bounds import MOST_COLUMNS

DYNAMIC_JOINT_STATE = "control_msgs/msg/DynamicJointState"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
CONTROLLER_STATE = "control_msgs/msg/JointTrajectoryControllerState"
TOLD_TOPIC = COMMANDED - {"as", "action", "plan", "planned", "nominal", "demand"}
"""Words of topics on which joint states are what joints are told."""
LONGEST_ARRAY = 64
"""Numbers of an array that become columns; longer ones are images and clouds."""


def read_bag(path: Path) -> Foreign:
    """Every number of a bag.

    Args:
        path: a .bag, .mcap or .db3 file, or the directory of a ROS 2 bag.

    Raises:
        InputError: rosbags is not installed, or the bag cannot be read or holds no number.
    """
    reading, publishers, crowded = Reading(), Publishers(), set[str]()
    for connection, received, content in messages(path, reading):
        topic = connection.topic
        try:
            joints, command = _joints(connection.kind, content), _told(connection.kind, content)
            if command is not None:
                beside = [(name, value, "") for name, value in _numbers(topic, content)]
                at = topic, connection.publisher
                publishers.take_joints(*at, *command, _stamp(content), received, told=True, beside=beside)
            elif joints is not None and TOLD_TOPIC & set(words_of(topic)):
                at = topic, connection.publisher
                publishers.take_joints(*at, *joints, _stamp(content), received, told=True)
            elif joints is not None:
                publishers.take_joints(topic, connection.publisher, *joints, _stamp(content), received)
            elif topic not in crowded:
                entries = [(name, value, "") for name, value in _numbers(topic, content)]
                if publishers.count + len(entries) > MOST_COLUMNS:
                    crowded.add(topic)
                publishers.take(topic, connection.publisher, _stamp(content), received, entries[:MOST_COLUMNS])
        except (TypeError, ValueError, AttributeError, OverflowError):  # fields that are not what their names say
            reading.unread[topic] += 1
    notes = list(reading.notes)
    if reading.ending.problem:
        if not publishers.count:
            raise InputError(f"{path}: cannot be read as a bag: {reading.ending.problem}")
        notes.append(f"not all of it can be read: {reading.ending.problem}")
    if crowded:
        notes.append(f"more than {MOST_COLUMNS} numbers in its messages: {', '.join(sorted(crowded))} left out")
    columns, accounts, told = publishers.columns(reading.unread)
    nothing = [f"{topic}: nothing can be read of its {n} messages" for topic, n in reading.unread.items()]
    notes += [said for said, topic in zip(nothing, reading.unread, strict=True) if topic not in accounts]
    columns, more = _chosen(_measured(columns))
    if not columns:
        raise InputError(f"{path}: holds no numbers that were recorded {MIN_SAMPLES} times: give another bag")
    return Foreign(path.stem, columns, (*notes, *told, *more), accounts=accounts)


def _joints(kind: str, content: Any) -> tuple[Sequence[str], Mapping[str, Any]] | None:
    """Names and fields of a message of joints; None of any other."""
    if kind == DYNAMIC_JOINT_STATE:
        every = [
            (f"{joint}/{interface}", value)
            for joint, own in zip(content.joint_names, content.interface_values, strict=True)
            for interface, value in zip(own.interface_names, own.values, strict=True)
        ]
        return [name for name, _ in every], {"position": [value for _, value in every]}
    names = _field(content, "name")
    if kind == JOINT_STATE or (isinstance(content, dict) and isinstance(names, list) and "position" in content):
        return names, {part: _field(content, part) for part, _ in FIELDS}
    return None


def _told(kind: str, content: Any) -> tuple[Sequence[str], Mapping[str, Any]] | None:
    """Names and fields of what a message tells joints to do now; None of any other.

    A controller's state says what it was told, as it interpolates it; a trajectory of one point is a command, one of
    many is a plan, which its controller's state tells.
    """
    parts = {"position": "positions", "velocity": "velocities", "effort": "effort"}
    point: Any = None
    if kind == CONTROLLER_STATE:
        point = _field(content, "reference") or _field(content, "desired")
    elif kind == TRAJECTORY:
        points = _field(content, "points")
        point = points[0] if points is not None and len(points) == 1 else None
    if point is None:
        return None
    return _field(content, "joint_names"), {part: _field(point, name) for part, name in parts.items()}


def _measured(columns: Mapping[str, Column]) -> Mapping[str, Column]:
    """Columns, of which what joints were told counts as measured where nothing says where they went."""
    if any(column.channel.startswith("q.") for column in columns.values()):
        return columns
    back = {told: quantity for quantity, told in TOLD.items()}
    found = {}
    for name, column in columns.items():
        quantity, _, joint = column.channel.partition(".")
        found[name] = replace(column, channel=f"{back[quantity]}.{joint}") if quantity in back else column
    return found


def _field(content: Any, name: str) -> Any:
    return content.get(name) if isinstance(content, dict) else getattr(content, name, None)


def _stamp(content: Any) -> float:
    """s, of a message's header; nan where it has none, or one of 0."""
    stamp = _field(_field(content, "header"), "stamp")
    parts = [next((p for n in names if (p := _field(stamp, n)) is not None), 0) for names in (("sec", "secs"), _NANO)]
    time = float(parts[0]) + 1e-9 * float(parts[1])
    return time if time > 0.0 else np.nan


_NANO = ("nanosec", "nsecs", "nsec")


def _numbers(name: str, value: Any) -> Iterator[tuple[str, float]]:
    """Every number in a message, named by its way there."""
    if isinstance(value, bool | int | float | np.bool_ | np.integer | np.floating):
        yield name, float(value)
    elif isinstance(value, list | np.ndarray):
        if 0 < len(value) <= LONGEST_ARRAY:
            for i, entry in enumerate(value):
                yield from _numbers(f"{name}/{i}", entry)
    elif isinstance(value, dict):  # of JSON
        for part, entry in value.items():
            if part != "header":
                yield from _numbers(f"{name}/{part}", entry)
    elif hasattr(value, "__dataclass_fields__"):
        for part in value.__dataclass_fields__:
            if part not in ("header", "__msgtype__") and not part.isupper():  # constants of the definition
                yield from _numbers(f"{name}/{part}", getattr(value, part))


def _chosen(columns: Mapping[str, Column]) -> tuple[dict[str, Column], list[str]]:
    """What was recorded often enough; of several topics with the same joint that which changes, else the longest."""
    kept = {name: column for name, column in columns.items() if np.isfinite(column.value).sum() >= MIN_SAMPLES}
    best: dict[str, str] = {}
    for name, column in kept.items():
        if column.channel and (column.channel not in best or _said(column) > _said(kept[best[column.channel]])):
            best[column.channel] = name
    notes = []
    for name, column in kept.items():
        if column.channel and best[column.channel] != name:
            kept[name] = Column(column.value, column.unit, column.time, source=column.source)
            notes.append(f"{name}: {best[column.channel]} has more samples of {column.channel}, and is used")
    efforts = {c.channel.removeprefix("tau.") for c in kept.values() if c.channel.startswith("tau.")}
    if efforts >= AMPERE:
        notes.append(f"efforts were taken as N m: {IN_AMPERE}; then give --map with a torque_constant")
    few = [name for name in columns if name not in kept]
    if few:
        some = ", ".join(few[:4]) + (f" and {len(few) - 4} more" if len(few) > 4 else "")
        notes.append(f"fewer than {MIN_SAMPLES} numbers: {some}: left out")
    return kept, notes


def _said(column: Column) -> tuple[bool, int]:
    """How much a column says."""
    return bool(np.ptp(column.value[np.isfinite(column.value)]) > 0.0), len(column.value)


PARTS = tuple(f"{{name}}{number}.{kind}" for number in ("", "_[0-9]*") for kind in ("db3", "db3.zstd", "mcap"))
"""How recorders of ROS 2 call the files of a bag: as its directory."""
READERS = (Reader(lambda path: [read_bag(path)], (".bag", ".mcap", ".db3"), "ROS 2 bag", "metadata.yaml", PARTS),)
