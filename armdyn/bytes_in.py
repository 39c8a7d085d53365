"""Bytes of a file from outside: never more of them than fit, no device that never ends, no chunk larger than it says.

A chunk of 60 kB of an MCAP file can hold gigabytes of zeros. The file states the size of every chunk; a compressor may
write another. Each chunk is therefore expanded piece by piece up to its stated size, and no further.
"""

import io
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from armdyn.errors import InputError
from urdf.bounds import LARGEST_CHUNK, LARGEST_CONTENT, LARGEST_RECORDING


def read_bytes(path: Path, largest: int = LARGEST_RECORDING) -> bytes:
    """The content of a file or pipe.

    Args:
        path: of the file.
        largest: number of bytes beyond which it is refused, before more of it is read.

    Raises:
        InputError: it is absent, a directory, unreadable or too large.
    """
    try:
        with path.open("rb") as file:
            data = file.read(largest + 1)
    except IsADirectoryError as error:
        raise InputError(f"{path} is a directory: give the recording's file") from error
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file") from error
    except (OSError, ValueError) as error:  # a name with a null character is a ValueError
        raise InputError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    if len(data) > largest:
        raise InputError(f"{path}: is larger than {largest / 2**20:g} MiB: cut it, or record at a lower rate")
    return data


_CHUNK = 0x06
_HEAD = struct.Struct("<BQ")
_CHUNK_HEAD = struct.Struct("<QQQII")
_PIECE = 2**20


class _Chunk(NamedTuple):
    stated: int
    compression: bytes
    data: memoryview


def check_chunk_sizes(data: bytes) -> None:
    """Refuse a file that would expand to more than fits.

    What is cut off or damaged is left to the reader, which has words for it.

    Raises:
        InputError: a chunk, or all of them, are too large, or a chunk holds more than it states.
    """
    total = 0
    for number, chunk in enumerate(_chunks(data), start=1):
        total += chunk.stated if chunk.compression else len(chunk.data)
        if chunk.stated > LARGEST_CHUNK or len(chunk.data) > LARGEST_CHUNK:
            raise InputError(
                f"chunk {number} expands to {max(chunk.stated, len(chunk.data)) / 2**20:.0f} MiB where "
                f"{LARGEST_CHUNK / 2**20:.0f} MiB is the most: write it again with smaller chunks"
            )
        if total > LARGEST_CONTENT:
            raise InputError(f"expands to more than {LARGEST_CONTENT / 2**20:.0f} MiB: cut the recording")
        if chunk.compression and _expands_beyond(chunk):
            raise InputError(f"chunk {number} holds more than the {chunk.stated} bytes that it states: record again")


def _chunks(data: bytes) -> Iterator[_Chunk]:
    view, at = memoryview(data), 8
    while at + _HEAD.size <= len(data):
        kind, length = _HEAD.unpack_from(data, at)
        at += _HEAD.size
        if length > len(data) - at:
            return
        body = view[at : at + length]
        at += length
        if kind != _CHUNK or length < _CHUNK_HEAD.size:
            continue
        *_, stated, _, name = _CHUNK_HEAD.unpack_from(body)
        start = _CHUNK_HEAD.size + name
        if start + 8 > length:
            continue
        (size,) = struct.unpack_from("<Q", body, start)
        yield _Chunk(stated, bytes(body[_CHUNK_HEAD.size : start]), body[start + 8 : start + 8 + size])


def _expands_beyond(chunk: _Chunk) -> bool:
    """Whether there is more in it than is stated; False where it cannot be expanded at all."""
    try:
        if chunk.compression == b"lz4":
            import lz4.frame

            opened: Any = lz4.frame.LZ4FrameFile(io.BytesIO(chunk.data))
        elif chunk.compression == b"zstd":
            import zstandard

            opened = zstandard.ZstdDecompressor(max_window_size=LARGEST_CHUNK).stream_reader(io.BytesIO(chunk.data))
        else:
            return False
        found = 0
        while piece := opened.read(_PIECE):
            found += len(piece)
            if found > chunk.stated:
                return True
    except Exception:  # each library has errors of its own; the reader of the file says what is wrong
        return False
    return False
