"""The messages in ROS bags and MCAP files as bytes, in the order in which they were recorded.

A file is read from its beginning, without its index. A file that ends in the middle, because the recorder was killed or
the disk was full, therefore still gives all messages before its end.
"""

import bz2
import io
import re
import sqlite3
import struct
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from armdyn.errors import InputError
from armdyn.read_files import register_input
from armdyn.recording.bytes_in import read_bytes
from armdyn.recording.mcap_records import decompressed, intact_records
from armdyn.recording.mcap_run import SIDECAR_RECORD
from urdf.bounds import MAX_BAG_BYTES, MAX_CHUNK_BYTES, MIB


class BagConnection(NamedTuple):
    """Connection in a ROS bag: a publisher that sends messages of one type on one topic.

    Attributes:
        topic: name of the topic.
        kind: type of the messages in the notation of ROS 2: ``sensor_msgs/msg/JointState``.
        encoding: ``"cdr"``, ``"ros1"``, ``"json"`` or an encoding that is not read.
        definition: definition of the type; empty where the file contains none.
        language: language of the definition: ``"ros1msg"``, ``"ros2msg"`` or ``"ros2idl"``.
        publisher: name of the publisher; empty where the file does not contain it.
    """

    topic: str
    kind: str
    encoding: str
    definition: str = ""
    language: str = ""
    publisher: str = ""


class BagMessage(NamedTuple):
    """Undecoded message of a bag: its connection, the time at which it was recorded [ns], and its bytes."""

    connection: BagConnection
    received: int
    data: bytes


def bag_messages(path: Path, problems: list[str]) -> Iterator[BagMessage]:
    """Iterate over all readable messages of a bag, undecoded, in the order in which they were recorded.

    Args:
        path: a .bag, .mcap or .db3 file, or the directory of a ROS 2 bag.
        problems: list that gets a reason for each file whose reading ends early.

    Raises:
        InputError: there is no such bag, it is too large, or it is a recording of armdyn, which needs no import.
    """
    for file in _files(path):
        try:
            yield from _READERS[_kind(file)](file)
        except InputError as error:
            raise InputError(str(error) if str(path) in str(error) else f"{path}: {error}") from error
        except Exception as error:  # damaged bytes surface as a dozen exceptions of sqlite, struct, lz4
            problems.append(" ".join(str(error).split()) or type(error).__name__)


def _kind(file: Path) -> str:
    return Path(file.name.removesuffix(ZSTD_ENDING)).suffix.lower()


def _files(path: Path) -> list[Path]:
    if not path.exists():
        raise InputError(f"{path}: no such file or directory")
    files = [path]
    if path.is_dir():
        found = [file for file in path.iterdir() if _kind(file) in (".db3", ".mcap")]
        files = sorted(found, key=lambda file: [int(part) for part in re.findall(r"\d+", file.name)])
        if not files:
            raise InputError(f"{path}: holds no .db3 and no .mcap file: copy the whole bag")
    if sum(file.stat().st_size for file in files) > MAX_BAG_BYTES:
        raise InputError(f"{path}: is larger than {MAX_BAG_BYTES / MIB:g} MiB: cut it with 'rosbag filter'")
    return files


ZSTD_ENDING = ".zstd"
"""Ending of compressed files of a ROS 2 bag."""
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
"""First bytes of compressed data. No message begins so: the first byte of CDR is 0."""
_MAGIC = re.compile(rb"#ROSBAG V2\.0\n")
_CONNECTION, _MESSAGE, _CHUNK = b"\x07", b"\x02", b"\x05"


def _ros1(file: Path) -> Iterator[BagMessage]:
    """Messages of a ROS 1 bag: http://wiki.ros.org/Bags/Format/2.0."""
    connections: dict[bytes, BagConnection] = {}
    with file.open("rb") as source:
        if not _MAGIC.fullmatch(source.readline(20)):
            raise ValueError("it does not begin as a ROS bag of version 2.0 does")
        for header, data in _records(source):
            if header["op"] == _CHUNK:
                for inner, content in _records(io.BytesIO(_chunk(header, data))):
                    yield from _ros1_packet(inner, content, connections)
            else:
                yield from _ros1_packet(header, data, connections)


def _chunk(header: dict[str, bytes], data: bytes) -> bytes:
    (size,) = struct.unpack("<I", header["size"])
    if size > MAX_CHUNK_BYTES:
        raise InputError(f"a chunk expands to {size / MIB:.0f} MiB: cut the bag with 'rosbag filter'")
    match header["compression"]:
        case b"lz4":
            import lz4.frame

            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size))
        case b"bz2":
            return bz2.BZ2Decompressor().decompress(data, max_length=size)
        case _:
            return data


def _ros1_packet(
    header: dict[str, bytes], data: bytes, connections: dict[bytes, BagConnection]
) -> Iterator[BagMessage]:
    if header["op"] == _CONNECTION:
        about = _fields(data)
        package, _, kind = about["type"].decode().rpartition("/")
        definition = about["message_definition"].decode(errors="replace")
        publisher = about.get("callerid", b"").decode(errors="replace")
        topic = re.sub("/+", "/", header["topic"].decode())
        connections[header["conn"]] = BagConnection(
            topic, f"{package}/msg/{kind}", "ros1", definition, "ros1msg", publisher
        )
    elif header["op"] == _MESSAGE:
        seconds, nanoseconds = struct.unpack("<II", header["time"])
        yield BagMessage(connections[header["conn"]], seconds * 10**9 + nanoseconds, data)


def _records(source: io.BufferedIOBase) -> Iterator[tuple[dict[str, bytes], bytes]]:
    """Headers and data of successive records; a chunk that is cut off is returned as far as it goes.

    Raises:
        EOFError: the last record is incomplete.
    """
    while size := source.read(4):
        data, whole = _read(source, size)
        header = _fields(data) if whole else {}
        data, whole = _read(source, source.read(4))
        if whole or header.get("op") == _CHUNK:
            yield header, data
        if not whole:
            raise EOFError("it is cut off, its recording did not end properly")


def _read(source: io.BufferedIOBase, size: bytes) -> tuple[bytes, bool]:
    """Read as many bytes as `size` states, and tell whether all of them were there."""
    wanted = struct.unpack("<I", size)[0] if len(size) == 4 else 0
    data = source.read(wanted)
    return data, len(size) == 4 and len(data) == wanted


def _fields(data: bytes) -> dict[str, bytes]:
    found, at = {}, 0
    while at < len(data):
        (size,) = struct.unpack_from("<I", data, at)
        name, _, value = data[at + 4 : at + 4 + size].partition(b"=")
        found[name.decode(errors="replace")] = value
        at += 4 + size
    return found


def _sqlite(file: Path) -> Iterator[BagMessage]:
    with suppress(OSError):
        if file.stat().st_size == 0:
            raise ValueError("it is empty")
    if file.name.endswith(ZSTD_ENDING):
        database = sqlite3.connect(":memory:")
        database.deserialize(decompressed(read_bytes(file, MAX_BAG_BYTES)))
    else:
        register_input(file)
        database = sqlite3.connect(f"{file.absolute().as_uri()}?immutable=1", uri=True)
    try:
        database.execute("PRAGMA trusted_schema = OFF")
        database.execute("PRAGMA writable_schema = ON")  # else nothing is read of a file that is too short
        definitions = {}
        with suppress(sqlite3.DatabaseError):  # bags before ROS 2 Iron have none
            rows = database.execute("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions")
            definitions = {kind: (str(definition), str(language)) for kind, language, definition in rows}
        connections = {
            number: BagConnection(topic, kind, encoding, *definitions.get(kind, ("", "")))
            for number, topic, kind, encoding in database.execute(
                "SELECT id, name, type, serialization_format FROM topics"
            )
        }
        for number, received, data in database.execute("SELECT topic_id, timestamp, data FROM messages"):
            if number in connections:
                yield BagMessage(connections[number], received, _message(data))
    finally:
        database.close()


def _message(data: bytes) -> bytes:
    return decompressed(data) if data.startswith(_ZSTD_MAGIC) else data


def _mcap(file: Path) -> Iterator[BagMessage]:
    from mcap.records import Channel, Message, Metadata, Schema

    data = read_bytes(file, MAX_BAG_BYTES)
    if file.name.endswith(ZSTD_ENDING):
        data = decompressed(data)
    schemas: dict[int, Schema] = {}
    connections: dict[int, BagConnection] = {}
    problems: list[str] = []
    for record in intact_records(data, problems):
        if isinstance(record, Metadata) and record.name == SIDECAR_RECORD:
            raise InputError(f"{file}: is a recording of armdyn, which is a run already: give it to armdyn compare")
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            connections[record.id] = _mcap_connection(record, schemas.get(record.schema_id))
        elif isinstance(record, Message) and record.channel_id in connections:
            yield BagMessage(connections[record.channel_id], record.log_time, _message(record.data))
    if problems:
        raise EOFError(f"it {', and '.join(dict.fromkeys(problems))}")


def _mcap_connection(channel: Any, schema: Any) -> BagConnection:
    publisher = channel.metadata.get("callerid", "")
    if schema is None:
        return BagConnection(channel.topic, "", channel.message_encoding, publisher=publisher)
    package, _, kind = schema.name.rpartition("/")
    return BagConnection(
        channel.topic, f"{package.removesuffix('/msg')}/msg/{kind}", channel.message_encoding,
        schema.data.decode(errors="replace"), schema.encoding, publisher,
    )  # fmt: skip


_READERS: dict[str, Callable[[Path], Iterator[BagMessage]]] = {".bag": _ros1, ".db3": _sqlite, ".mcap": _mcap}
