"""Read the records of an MCAP file from its beginning, as far as they are intact: https://mcap.dev/spec.

The index is at the end of the file, where a killed recorder has not written it, and each chunk is compressed as a
whole. So chunks are expanded here, block by block: the beginning of a chunk that is cut off is read. A damaged chunk is
left out, because a wrong byte may be a digit. A chunk of 60 kB can contain gigabytes of zeros: none is expanded beyond
its stated size or the limit.
"""

import io
import itertools
import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

from armdyn.errors import InputError
from urdf.bounds import MAX_CHUNK_BYTES, MAX_DECOMPRESSED_FILE_BYTES, MAX_RECORDING_ROWS, MIB

CUT_OFF_MESSAGE = "is cut off, its recording did not end properly"
BLOCK_BYTES = 2**17
"""Number of bytes that zstd compresses at a time."""
CHUNK_HEAD_BYTES = 1 + 8 + 28
"""Number of bytes of a chunk before the name of its compression: opcode, length, times, size and checksum."""


def intact_records(data: bytes, problems: list[str]) -> Iterator[Any]:
    """Read every intact record of an MCAP file, including those in chunks.

    Args:
        data: bytes of the file.
        problems: list to which a text is appended for each fault of the file.

    Raises:
        InputError: the chunks are too large, one or together, or a chunk contains more than it states.
    """
    from mcap.exceptions import EndOfFile, RecordLengthLimitExceeded
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader

    source, whole, number, total, counter = io.BytesIO(data), 0, 0, 0, itertools.count(1)
    reader = StreamReader(source, emit_chunks=True, validate_crcs=True, record_size_limit=len(data))
    # Damaged bytes raise a dozen exceptions of struct, zstd, lz4 and mcap, with the same remedy for a user.
    try:
        for record in reader.records:
            if isinstance(record, Chunk):
                number, total = number + 1, total + max(record.uncompressed_size, len(record.data))
                _check_size(record, number, total)
                content = _expanded(record.data, record.compression, record.uncompressed_size)
                if len(content) > record.uncompressed_size:
                    stated = record.uncompressed_size
                    raise InputError(f"chunk {number} holds more than the {stated} bytes that it states: record again")
                if len(content) == record.uncompressed_size and record.uncompressed_crc in (0, zlib.crc32(content)):
                    yield from _records(content, counter)
                else:  # unknown which of its messages are intact
                    problems.append("has a chunk that is damaged, which is left out")
            else:
                yield record
            whole = source.tell()
    except (EndOfFile, RecordLengthLimitExceeded, struct.error):
        problems.append(CUT_OFF_MESSAGE)
        yield from _of_cut_chunk(data[whole:], counter)
    except InputError:
        raise
    except Exception as error:
        problems.append(f"is damaged ({type(error).__name__})")


def _check_size(chunk: Any, number: int, total: int) -> None:
    size = max(chunk.uncompressed_size, len(chunk.data))
    if size > MAX_CHUNK_BYTES:
        raise InputError(
            f"chunk {number} expands to {size / MIB:.0f} MiB where {MAX_CHUNK_BYTES / MIB:.0f} MiB is the most: "
            "write it again with smaller chunks"
        )
    if total > MAX_DECOMPRESSED_FILE_BYTES:
        raise InputError(f"expands to more than {MAX_DECOMPRESSED_FILE_BYTES / MIB:.0f} MiB: cut the recording")


def decompressed(data: bytes) -> bytes:
    """Expand bytes that zstd compressed, as far as they go.

    Raises:
        InputError: the content is too large.
    """
    found = _expanded(data, "zstd", MAX_DECOMPRESSED_FILE_BYTES)
    if len(found) > MAX_DECOMPRESSED_FILE_BYTES:
        raise InputError(f"expands to more than {MAX_DECOMPRESSED_FILE_BYTES / MIB:.0f} MiB: cut the recording")
    return found


def _expanded(data: bytes, compression: str, most: int) -> bytes:
    """Expand bytes as far as they go, to little more than `most` bytes."""
    found = bytearray()
    with suppress(Exception):  # each library has its own errors
        if compression == "zstd":
            import zstandard

            opened = zstandard.ZstdDecompressor(max_window_size=MAX_CHUNK_BYTES).stream_reader(data)
            while len(found) <= most and (piece := opened.read(BLOCK_BYTES)):
                found += piece
        elif compression == "lz4":
            import lz4.frame

            found += lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=most + 1)
    return bytes(found) if compression else data


def _of_cut_chunk(data: bytes, counter: Iterator[int]) -> Iterator[Any]:
    """The complete records at the beginning of a chunk that was cut off."""
    from mcap.opcode import Opcode

    if len(data) < CHUNK_HEAD_BYTES + 4 or data[0] != Opcode.CHUNK:
        return
    size = int.from_bytes(data[CHUNK_HEAD_BYTES : CHUNK_HEAD_BYTES + 4], "little")
    start = CHUNK_HEAD_BYTES + 4 + size
    compression = data[CHUNK_HEAD_BYTES + 4 : start].decode(errors="replace")
    yield from _records(_expanded(data[start + 8 :], compression, MAX_CHUNK_BYTES), counter)


def _records(content: bytes, counter: Iterator[int]) -> Iterator[Any]:
    """Records in a chunk, the last of which may be cut off; `counter` counts those of the whole file.

    Raises:
        InputError: there are more than `MAX_RECORDING_ROWS`.
    """
    from mcap.data_stream import ReadDataStream
    from mcap.opcode import Opcode
    from mcap.records import Channel, Message, Schema

    at = 0
    while at + 9 <= len(content):
        length = int.from_bytes(content[at + 1 : at + 9], "little")
        if at + 9 + length > len(content):
            return
        if next(counter) > MAX_RECORDING_ROWS:
            raise InputError(f"holds more than {MAX_RECORDING_ROWS} records: cut the recording")
        stream = ReadDataStream(io.BytesIO(content[at + 9 : at + 9 + length]))
        match content[at]:
            case Opcode.SCHEMA:
                yield Schema.read(stream)
            case Opcode.CHANNEL:
                yield Channel.read(stream)
            case Opcode.MESSAGE:
                yield Message.read(stream, length)
        at += 9 + length
