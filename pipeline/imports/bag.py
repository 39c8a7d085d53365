"""ROS 1 bags, ROS 2 bags (sqlite3, MCAP) and MCAP files, with the message definitions that they carry.

A JointState gives positions, velocities and efforts by joint; of every other message each number is a column, named by
topic and field. Stamps are the header's, else the time at which the message was recorded.
"""

import io
import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from armdyn.bytes_in import check_chunk_sizes, read_bytes
from armdyn.channels import MIN_SAMPLES
from armdyn.errors import InputError
from armdyn.mcap_run import SIDECAR_RECORD
from pipeline.imports.foreign import Column, Foreign, Reader
from pipeline.imports.joints import AMPERE, IN_AMPERE
from urdf.bounds import LARGEST_BAG, MIB, MOST_COLUMNS, MOST_ROWS, shown

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore


JOINT_STATE = "sensor_msgs/msg/JointState"
FIELDS = (("position", "q"), ("velocity", "v"), ("effort", "tau"))
LONGEST_ARRAY = 64
"""Numbers of an array that become columns; longer ones are images and clouds."""
UNITS = {"q": "rad", "v": "rad/s", "tau": "N m"}


@dataclass
class _Samples:
    time: list[float] = field(default_factory=list)
    value: list[float] = field(default_factory=list)
    unit: str = ""
    channel: str = ""


def read_bag(path: Path) -> Foreign:
    """Every number of a bag.

    Args:
        path: a .bag, .mcap or .db3 file, or the directory of a ROS 2 bag.

    Raises:
        InputError: rosbags is not installed, or the bag cannot be read or holds no number.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise InputError("ROS bags need rosbags: pip install 'armdyn[ros]'") from error
    if not path.exists():
        raise InputError(f"{path}: no such file or directory")
    size = sum(file.stat().st_size for file in (path.iterdir() if path.is_dir() else [path]))
    if size > LARGEST_BAG:
        raise InputError(f"{path}: is larger than {LARGEST_BAG / MIB:g} MiB: cut it with 'rosbag filter'")
    samples: dict[str, _Samples] = {}
    notes: list[str] = []
    # Bags of ROS 2 before Iron carry no definitions; common messages are then those of Humble.
    try:
        if path.suffix.lower() == ".mcap" and path.is_file():
            store = get_typestore(Stores.ROS2_HUMBLE)
            for topic, kind, stamp, message in messages(path, store, notes):
                _take(topic, kind, stamp, message, samples)
            return _foreign(path, samples, notes)
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as bag:
            known = [c for c in bag.connections if c.msgtype in bag.typestore.types]
            unknown = sorted({c.msgtype for c in bag.connections} - {c.msgtype for c in known})
            if unknown:
                notes.append(f"no definition of {', '.join(unknown)} in the bag: left out")
            for connection, stamp, raw in bag.messages(known):
                _take(connection.topic, connection.msgtype, stamp, bag.deserialize(raw, connection.msgtype), samples)
    except InputError as error:
        raise InputError(str(error) if str(path) in str(error) else f"{path}: {error}") from error
    except Exception as error:  # damaged bytes surface as a dozen exceptions of sqlite, struct, lz4
        raise InputError(
            f"{path}: cannot be read as a bag: {' '.join(str(error).split()) or type(error).__name__}"
        ) from error
    return _foreign(path, samples, notes)


def _foreign(path: Path, samples: dict[str, _Samples], notes: list[str]) -> Foreign:
    columns, more = _columns(samples)
    if not columns:
        raise InputError(f"{path}: holds no numbers that were recorded {MIN_SAMPLES} times: give another bag")
    return Foreign(path.stem, columns, (*notes, *more))


def _take(topic: str, kind: str, stamp: int, message: Any, samples: dict[str, _Samples]) -> None:
    header = getattr(message, "header", None)
    written = getattr(header, "stamp", None)
    time = written.sec + 1e-9 * written.nanosec if written is not None else 0.0
    time = time if time > 0.0 else 1e-9 * stamp
    if kind == JOINT_STATE:
        entries = _joint_entries(topic, message)
    else:
        entries = ((name, value, "") for name, value in _numbers(topic, message))
    for name, value, channel in entries:
        if name not in samples and len(samples) >= MOST_COLUMNS:
            raise InputError(f"more than {MOST_COLUMNS} numbers in its messages: cut the bag to the topics that matter")
        column = samples.setdefault(name, _Samples(channel=channel, unit=UNITS.get(channel.partition(".")[0], "")))
        if column.time and time <= column.time[-1]:
            continue  # published twice, or after the clock was set back
        if len(column.time) >= MOST_ROWS:
            raise InputError(f"more than {MOST_ROWS} messages of {shown(name)}: cut the bag")
        column.time.append(time)
        column.value.append(value)


def _joint_entries(topic: str, message: Any) -> Iterator[tuple[str, float, str]]:
    for part, quantity in FIELDS:
        values = getattr(message, part)
        if len(values) == len(message.name):
            for joint, value in zip(message.name, values, strict=True):
                yield f"{topic}/{part}/{joint}", float(value), f"{quantity}.{joint}"


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
            yield from _numbers(f"{name}/{part}", entry)
    elif hasattr(value, "__dataclass_fields__"):
        for part in value.__dataclass_fields__:
            if part not in ("header", "__msgtype__") and not part.isupper():  # constants of the definition
                yield from _numbers(f"{name}/{part}", getattr(value, part))


def _columns(samples: dict[str, _Samples]) -> tuple[dict[str, Column], list[str]]:
    """What was recorded often enough and says something; of several topics with the same joint the longest."""
    columns: dict[str, Column] = {}
    notes, few, zero = [], [], []
    best: dict[str, str] = {}
    for name, s in samples.items():
        if len(s.time) < MIN_SAMPLES:
            few.append(name)
        elif s.channel.startswith(("v.", "tau.")) and not np.any(s.value):
            zero.append(name)
        else:
            columns[name] = Column(np.array(s.value), s.unit, np.array(s.time), s.channel)
            if s.channel and len(s.time) > len(samples[best.get(s.channel, "")].time if s.channel in best else ()):
                best[s.channel] = name
    for name, column in columns.items():
        if column.channel and best[column.channel] != name:
            columns[name] = Column(column.value, column.unit, column.time)
            notes.append(f"{name}: {best[column.channel]} has more samples of {column.channel}, and is used")
    efforts = {c.channel.removeprefix("tau.") for c in columns.values() if c.channel.startswith("tau.")}
    if efforts >= AMPERE:
        notes.append(f"efforts were taken as N m: {IN_AMPERE}; then give --map with a torque_constant")
    for names, why in ((few, f"fewer than {MIN_SAMPLES} samples"), (zero, "nothing but zeros")):
        if names:
            shown = ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
            notes.append(f"{why}: {shown}: left out")
    return columns, notes


KNOWN = {"cdr": "ros2msg", "ros1": "ros1msg"}
"""How definitions are written, by how messages are."""


def messages(path: Path, store: "Typestore", notes: list[str]) -> Iterator[tuple[str, str, int, Any]]:
    """Topic, type, time in ns and content of every message that can be read; what cannot is told in `notes`.

    Args:
        path: of the file.
        store: gets the definitions of the file.
        notes: a sentence is added for each kind of message that is left out.

    Raises:
        InputError: it is a recording of armdyn, which needs no import.
    """
    from mcap.reader import make_reader
    from rosbags.typesys import get_types_from_msg

    data = read_bytes(path, LARGEST_BAG)
    check_chunk_sizes(data)
    unread: set[str] = set()
    defined: dict[int, str] = {}
    reader = make_reader(io.BytesIO(data))
    if any(record.name == SIDECAR_RECORD for record in reader.iter_metadata()):
        raise InputError(f"{path}: is a recording of armdyn, which is a run already: give it to armdyn compare")
    for schema, channel, message in reader.iter_messages():
        if channel.message_encoding == "json":
            yield channel.topic, "json", message.log_time, json.loads(message.data)
            continue
        if schema is None or KNOWN.get(channel.message_encoding) != schema.encoding:
            unread.add(f"{channel.topic} ({channel.message_encoding})")
            continue
        if schema.id not in defined:
            package, _, kind = schema.name.rpartition("/")
            defined[schema.id] = name = f"{package.removesuffix('/msg')}/msg/{kind}"
            found = get_types_from_msg(schema.data.decode(), name)
            store.register({key: value for key, value in found.items() if key not in store.types})
        name = defined[schema.id]
        read = store.deserialize_cdr if channel.message_encoding == "cdr" else store.deserialize_ros1
        yield channel.topic, name, message.log_time, read(message.data, name)
    if unread:
        notes.append(f"messages of another encoding left out: {', '.join(sorted(unread))}")


READERS = (Reader(lambda path: [read_bag(path)], (".bag", ".mcap", ".db3"), "ROS 2 bag", "metadata.yaml"),)
