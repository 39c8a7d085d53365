"""Bytes of a file from outside: never more of them than fit, no device that never ends, no chunk larger than it says.

A chunk of 60 kB of an MCAP file can hold gigabytes of zeros. The file states the size of every chunk; a compressor may
write another. Each chunk is therefore expanded piece by piece up to its stated size, and no further.
"""

import io
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from armdyn.errors import InputError
from urdf.bounds import LARGEST_CHUNK, LARGEST_CONTENT, LARGEST_RECORDING, MIB

if TYPE_CHECKING:
    from mcap.records import Chunk


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


PIECE = 2**20
"""Bytes that are expanded at a time."""


def check_chunk_sizes(data: bytes) -> None:
    """Refuse a file that would expand to more than fits.

    What is cut off or damaged is left to the reader, which has words for it.

    Raises:
        InputError: a chunk, or all of them, are too large, or a chunk holds more than it states.
    """
    total = 0
    for number, chunk in enumerate(_chunks(data), start=1):
        stated = chunk.uncompressed_size
        total += stated if chunk.compression else len(chunk.data)
        if stated > LARGEST_CHUNK or len(chunk.data) > LARGEST_CHUNK:
            raise InputError(
                f"chunk {number} expands to {max(stated, len(chunk.data)) / MIB:.0f} MiB where "
                f"{LARGEST_CHUNK / MIB:.0f} MiB is the most: write it again with smaller chunks"
            )
        if total > LARGEST_CONTENT:
            raise InputError(f"expands to more than {LARGEST_CONTENT / MIB:.0f} MiB: cut the recording")
        if chunk.compression and _expands_beyond(chunk):
            raise InputError(f"chunk {number} holds more than the {stated} bytes that it states: record again")


def _chunks(data: bytes) -> "Iterator[Chunk]":
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader

    with suppress(Exception):  # each way of being damaged is an exception of its own
        for record in StreamReader(io.BytesIO(data), emit_chunks=True, record_size_limit=len(data)).records:
            if isinstance(record, Chunk):
                yield record


def _expands_beyond(chunk: "Chunk") -> bool:
    """Whether there is more in it than is stated; False where it cannot be expanded at all."""
    try:
        if chunk.compression == "lz4":
            import lz4.frame

            opened: Any = lz4.frame.LZ4FrameFile(io.BytesIO(chunk.data))
        elif chunk.compression == "zstd":
            import zstandard

            opened = zstandard.ZstdDecompressor(max_window_size=LARGEST_CHUNK).stream_reader(io.BytesIO(chunk.data))
        else:
            return False
        found = 0
        while piece := opened.read(PIECE):
            found += len(piece)
            if found > chunk.uncompressed_size:
                return True
    except Exception:  # each library has errors of its own; the reader of the file says what is wrong
        return False
    return False
