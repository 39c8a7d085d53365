"""Messages of any MCAP file: ROS 1, ROS 2 and JSON, with the definitions that stand in it."""

import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from armdyn.bytes_in import read_bytes
from armdyn.errors import InputError
from armdyn.mcap_run import SIDECAR_RECORD
from armdyn.mcap_sizes import check_chunk_sizes

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

LARGEST = 2 * 2**30
"""Bytes of a file."""
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

    data = read_bytes(path, LARGEST)
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
