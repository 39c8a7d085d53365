"""What the messages of ROS bags and MCAP files say, by the definitions that the file carries.

A definition or a message that cannot be read is left out and counted; it does not keep the others from being read.
"""

import json
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from armdyn.errors import InputError
from pipeline.imports.packets import Connection, Ending, packets

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

LANGUAGES = {"cdr": ("ros2msg", "ros2idl", ""), "ros1": ("ros1msg", "")}
"""In which definitions are written, by how messages are."""


class Message(NamedTuple):
    """One message.

    Attributes:
        connection: which it came by.
        received: when it was recorded, s.
        content: with the fields of its kind as attributes; of JSON a dictionary.
    """

    connection: Connection
    received: float
    content: Any


@dataclass
class Reading:
    """What was left out while a file was read.

    Attributes:
        unread: by topic, how many messages nothing could be read of.
        notes: sentences on kinds of messages that are left out.
        ending: of the file.
    """

    unread: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)
    ending: Ending = field(default_factory=Ending)


def messages(path: Path, reading: Reading) -> Iterator[Message]:
    """Every message that can be read of a bag.

    Args:
        path: see `packets`.
        reading: told what is left out.

    Raises:
        InputError: rosbags is not installed, or see `packets`.
    """
    decoders = _Decoders()
    skipped: dict[Connection, str] = {}
    for packet in packets(path, reading.ending):
        connection = packet.connection
        if connection in skipped:
            continue
        try:
            decode = decoders.of(connection)
        except _UnreadableError as error:
            skipped[connection] = str(error)
            continue
        try:
            content = decode(packet.data)
        except Exception:  # bytes that do not fit a definition surface as any exception
            reading.unread[connection.topic] += 1
        else:
            yield Message(connection, 1e-9 * packet.received, content)
    for why in dict.fromkeys(skipped.values()):
        topics = dict.fromkeys(connection.topic for connection, said in skipped.items() if said == why)
        reading.notes.append(f"{why}: {', '.join(topics)} left out")


class _UnreadableError(Exception):
    """No message of this kind can be read."""


class _Decoders:
    """Reads messages by their definitions; those without one are taken for the common ones of ROS."""

    def __init__(self) -> None:
        try:
            from rosbags.typesys import Stores, get_typestore
        except ImportError as error:
            raise InputError("ROS bags need rosbags: pip install 'armdyn[ros]'") from error
        common = {"cdr": Stores.ROS2_HUMBLE, "ros1": Stores.ROS1_NOETIC}
        self._common = {encoding: get_typestore(store) for encoding, store in common.items()}
        self._own = {encoding: get_typestore(Stores.EMPTY) for encoding in common}
        self._found: dict[Connection, Callable[[bytes], Any]] = {}

    def of(self, connection: Connection) -> Callable[[bytes], Any]:
        """How the bytes of a connection's messages are read."""
        if connection not in self._found:
            self._found[connection] = self._decoder(connection)
        return self._found[connection]

    def _decoder(self, connection: Connection) -> Callable[[bytes], Any]:
        encoding, kind = connection.encoding, connection.kind
        if encoding == "json":
            return _json
        if connection.language not in LANGUAGES.get(encoding, ()):
            raise _UnreadableError(f"messages of another encoding ({encoding or 'none'})")
        store = self._own[encoding]
        try:
            _register(store, connection)
        except Exception as error:  # a definition that is no definition
            store = self._common[encoding]
            if kind not in store.types:
                no = "cannot be read" if connection.definition else "is not in the file"
                raise _UnreadableError(f"the definition of {kind} {no}") from error
        read = store.deserialize_cdr if encoding == "cdr" else store.deserialize_ros1
        return lambda data: read(data, kind)


def _register(store: "Typestore", connection: Connection) -> None:
    """Add the definitions that a connection brings.

    Raises:
        Exception: they cannot be read, or are not there.
    """
    from rosbags.typesys import get_types_from_idl, get_types_from_msg

    if connection.language == "ros2idl":
        parts = connection.definition.split("=" * 80 + "\n")
        found: dict[str, Any] = {}
        for part in parts:
            text = part.partition("\n")[2] if part.startswith("IDL: ") else part
            found |= get_types_from_idl(text) if text.strip() else {}
    else:
        found = get_types_from_msg(connection.definition, connection.kind) if connection.definition else {}
    if connection.kind not in found and connection.kind not in store.types:
        raise KeyError(connection.kind)
    store.register({kind: fields for kind, fields in found.items() if kind not in store.types})


def _json(data: bytes) -> dict[str, Any]:
    content = json.loads(data)
    if not isinstance(content, dict):
        raise TypeError("is no object")
    return content
