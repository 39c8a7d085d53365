"""Bags as ROS 1, ROS 2 and Foxglove write them."""

import json

import numpy as np
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

START = 1_700_000_000
"""s since 1970, of the first message."""


def store_of(ros):
    return get_typestore(Stores.ROS2_HUMBLE if ros == 2 else Stores.ROS1_NOETIC)


def header(store, time, seq=0):
    """Header with a stamp, s; only the headers of ROS 1 have a number."""
    kind = store.types["std_msgs/msg/Header"]
    number = {"seq": seq} if "seq" in kind.__dataclass_fields__ else {}
    nanoseconds = round(1e9 * (time % 1.0))
    stamp = store.types["builtin_interfaces/msg/Time"](sec=int(time), nanosec=nanoseconds)
    return kind(stamp=stamp, frame_id="", **number)


def joint_state(store, time, names, position, velocity=(), effort=()):
    values = {"position": position, "velocity": velocity, "effort": effort}
    arrays = {field: np.array(value, dtype=float) for field, value in values.items()}
    return store.types["sensor_msgs/msg/JointState"](header=header(store, time), name=list(names), **arrays)


def write_bag(path, store, messages, plugin=None):
    """A bag of ROS 2 with a kind of storage, else one of ROS 1; messages are (topic, s of the recording, content)."""
    serialize = store.serialize_cdr if plugin else store.serialize_ros1
    with Writer2(path, version=9, storage_plugin=plugin) if plugin else Writer1(path) as writer:
        connections = {}
        for topic, received, message in messages:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], round(1e9 * received), serialize(message, kind))
    return path


def write_mcap(path, messages, schemas=(), **options):
    """An MCAP file without a profile of ROS; messages are (topic, s of the recording, bytes or content of JSON).

    `schemas` are name, language and text of a topic's definition, and the encoding, where it is not JSON.
    """
    schemas = dict(schemas)
    with path.open("wb") as file:
        writer = McapWriter(file, **options)
        writer.start(profile="", library="a test")
        channels = {}
        for topic, received, content in messages:
            if topic not in channels:
                *schema, of = schemas.get(topic, ("", "", "", "json"))
                number = writer.register_schema(schema[0], schema[1], schema[2].encode()) if schema[0] else 0
                channels[topic] = writer.register_channel(topic, of, number)
            data = content if isinstance(content, bytes) else json.dumps(content).encode()
            writer.add_message(channels[topic], round(1e9 * received), data, round(1e9 * received))
        writer.finish()
    return path
