"""Decode the messages of ROS bags and MCAP files by the definitions that the file contains."""

import json
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from armdyn.errors import InputError
from pipeline.imports.packets import BagConnection

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

DEFINITION_LANGUAGES = {"cdr": ("ros2msg", "ros2idl", ""), "ros1": ("ros1msg", "")}
"""Languages of message definitions that can be read, by encoding of the messages."""


class MessageDecoders:
    """Decoders of the messages of a bag; for types without a definition in the file the common ones of ROS are used.

    Attributes:
        unreadable: reasons why the messages of connections cannot be read.

    Raises:
        InputError: rosbags is not installed.
    """

    def __init__(self) -> None:
        try:
            from rosbags.typesys import Stores, get_typestore
        except ImportError as error:
            raise InputError("ROS bags need rosbags: pip install 'armdyn[ros]'") from error
        common = {"cdr": Stores.ROS2_HUMBLE, "ros1": Stores.ROS1_NOETIC}
        self._common = {encoding: get_typestore(store) for encoding, store in common.items()}
        self._own = {encoding: get_typestore(Stores.EMPTY) for encoding in common}
        self._decoders: dict[BagConnection, Callable[[bytes], Any] | None] = {}
        self.unreadable: dict[BagConnection, str] = {}

    def of(self, connection: BagConnection) -> Callable[[bytes], Any] | None:
        """Function that decodes the bytes of a connection's messages; None where they cannot be read.

        It returns an object with the fields of the message as attributes, or for JSON a dictionary.
        """
        if connection not in self._decoders:
            self._decoders[connection] = self._decoder(connection)
        return self._decoders[connection]

    def _decoder(self, connection: BagConnection) -> Callable[[bytes], Any] | None:
        encoding, kind = connection.encoding, connection.kind
        if encoding == "json":
            return _json
        if connection.language not in DEFINITION_LANGUAGES.get(encoding, ()):
            self.unreadable[connection] = f"messages of another encoding ({encoding or 'none'})"
            return None
        store = self._own[encoding]
        try:
            _register(store, connection)
        except Exception:  # the parser of definitions raises many kinds of exceptions
            store = self._common[encoding]
            if kind not in store.types:
                no = "cannot be read" if connection.definition else "is not in the file"
                self.unreadable[connection] = f"the definition of {kind} {no}"
                return None
        read = store.deserialize_cdr if encoding == "cdr" else store.deserialize_ros1
        return lambda data: read(data, kind)

    def notes(self) -> list[str]:
        """Sentences on topics that are left out because their messages cannot be read, one for each reason."""
        topics: dict[str, dict[str, None]] = {}
        for connection, why in self.unreadable.items():
            topics.setdefault(why, {})[connection.topic] = None
        return [f"{why}: {', '.join(of)} left out" for why, of in topics.items()]


def _register(store: "Typestore", connection: BagConnection) -> None:
    """Add the definitions of a connection to a store."""
    from rosbags.typesys import get_types_from_idl, get_types_from_msg

    found: dict[str, Any] = {}
    if connection.language == "ros2idl":
        for part in connection.definition.split("=" * 80 + "\n"):
            text = part.partition("\n")[2] if part.startswith("IDL: ") else part
            found |= get_types_from_idl(text) if text.strip() else {}
    elif connection.definition:
        found = get_types_from_msg(connection.definition, connection.kind)
    if connection.kind not in found and connection.kind not in store.types:
        raise KeyError(connection.kind)
    store.register({kind: fields for kind, fields in found.items() if kind not in store.types})


def _json(data: bytes) -> dict[str, Any]:
    content = json.loads(data)
    if not isinstance(content, dict):
        raise TypeError("is not an object")
    return content
