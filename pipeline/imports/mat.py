"""MATLAB's files: vectors, matrices and structures of numbers become columns, named as in MATLAB."""

import io
import struct
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping
from functools import partial
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from armdyn.errors import InputError, error_location
from armdyn.recording.bytes_in import read_bytes
from armdyn.recording.channels import MIN_COMPARED_CHANNEL_SAMPLES, FloatArray
from ik.workers import FailedWorkItem, map_in_processes
from pipeline.imports.foreign import ForeignColumn, ForeignReader, ForeignRecording
from urdf.bounds import MAX_TABLE_CELLS, MAX_TABLE_COLUMNS, MIB

if TYPE_CHECKING:
    import h5py

MAX_CONTENT_BYTES = 8 * MAX_TABLE_CELLS
"""Largest size of all numbers of a MATLAB file [bytes]."""
HEADER_BYTES, COMPRESSED_ELEMENT = 128, 15
"""Size of the header of a MATLAB file of version 5 [bytes], and number that marks a compressed element."""
HDF5_OFFSET = 512
"""Place of the HDF5 file in a file of version 7.3 [bytes]; before it is MATLAB's own header."""
HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
OBJECT_REMEDY = "save its columns as vectors: s = table2struct(T, 'ToScalar', true), save(..., '-struct', 's')"
"""What to do with MATLAB's tables and timetables, whose format is not documented."""
MAX_STRUCTURE_DEPTH = 8
"""Largest depth of nested structures in a MATLAB file."""


def read_mat(path: Path) -> ForeignRecording:
    """Read the columns of a MATLAB file; arrays are left out if their number of rows is not that of most arrays.

    Raises:
        InputError: the file cannot be read, is too large, or contains no sufficiently long array of numbers.
    """
    data = read_bytes(path)
    with error_location(path):
        # In a process of its own, because scipy ends the process on some damaged files.
        ((_, content),) = map_in_processes(partial(_content, data), [path.name], 1, "forkserver")
        if isinstance(content, FailedWorkItem):
            raise InputError("is not a MATLAB file that can be read: it is damaged")
        arrays = {
            name: a for key, value in content.items() if not key.startswith("__") for name, a in _arrays(key, value)
        }
        lengths = Counter(n for array in arrays.values() for n in set(array.shape) if n >= MIN_COMPARED_CHANNEL_SAMPLES)
        if not lengths:
            raise InputError(f"holds no array of at least {MIN_COMPARED_CHANNEL_SAMPLES} numbers: give a recording")
        rows = max(lengths, key=lambda n: (lengths[n], n))
        columns: dict[str, ForeignColumn] = {}
        for name, array in arrays.items():
            if array.shape == (rows,):
                columns[name] = ForeignColumn(array)
            elif rows in array.shape:
                table = array if array.shape[0] == rows else array.T
                columns |= {f"{name}/{i}": ForeignColumn(column) for i, column in enumerate(table.T)}
        if len(columns) > MAX_TABLE_COLUMNS:
            raise InputError(f"{len(columns)} columns, where {MAX_TABLE_COLUMNS} are the most: leave some out")
    other = [name for name, array in arrays.items() if rows not in array.shape]
    return ForeignRecording(path.stem, columns, (f"not of {rows} rows: {', '.join(other)}: left out",) if other else ())


def _content(data: bytes, name: str) -> dict[str, Any]:
    from scipy.io import loadmat, whosmat

    if data[HDF5_OFFSET : HDF5_OFFSET + len(HDF5_SIGNATURE)] == HDF5_SIGNATURE:
        return _content_of_hdf5(data, name)
    try:
        variables = whosmat(io.BytesIO(data))
        size = max(sum(8 * prod(shape) for _, shape, _ in variables), _unpacked_bytes(data))
        if size <= MAX_CONTENT_BYTES:
            content = dict(loadmat(io.BytesIO(data), simplify_cells=True))
    except NotImplementedError as error:
        raise InputError("is of MATLAB's version 7.3 by its header, and holds no HDF5 file: it is damaged") from error
    except Exception as error:  # damaged bytes surface as a dozen exceptions of scipy
        raise InputError(f"is not a MATLAB file that can be read: {' '.join(str(error).split())}") from error
    if size > MAX_CONTENT_BYTES:
        raise InputError(f"holds more than {MAX_CONTENT_BYTES / MIB:.0f} MiB of numbers: cut it")
    if variables and all(kind == "opaque" for _, _, kind in variables):
        raise InputError(f"holds a MATLAB table or another object alone: {OBJECT_REMEDY}")
    return content


def _content_of_hdf5(data: bytes, name: str) -> dict[str, Any]:
    """Variables of a file of version 7.3, which is an HDF5 file; MATLAB's matrices are stored transposed in it."""
    try:
        import h5py
    except ImportError as error:
        raise InputError(
            f"is of MATLAB's version 7.3, which needs h5py: pip install 'armdyn[import]', or save('{name}', ..., '-v7')"
        ) from error
    room = MAX_CONTENT_BYTES
    objects: list[str] = []

    def read(part: "h5py.Group", depth: int = 0) -> dict[str, Any]:
        nonlocal room
        found: dict[str, Any] = {}
        for key in part:
            # Neither links nor external or virtual data, which would read other files.
            if key.startswith("#") or not isinstance(part.get(key, getlink=True), h5py.HardLink):
                continue
            inner = part[key]
            if "MATLAB_object_decode" in inner.attrs:
                objects.append(key)
            elif isinstance(inner, h5py.Group) and depth < MAX_STRUCTURE_DEPTH:
                found[key] = read(inner, depth + 1)
            elif isinstance(inner, h5py.Dataset) and inner.dtype.kind in "biuf":
                if inner.external or inner.is_virtual or "MATLAB_empty" in inner.attrs:
                    continue
                room -= 8 * inner.size
                if room < 0:
                    raise InputError(f"holds more than {MAX_CONTENT_BYTES / MIB:.0f} MiB of numbers: cut it")
                found[key] = np.asarray(inner[()]).T
        return found

    try:
        with h5py.File(io.BytesIO(data), "r") as file:
            found = read(file)
    except (OSError, RuntimeError, ValueError, KeyError) as error:
        raise InputError(f"is not a MATLAB file that can be read: {' '.join(str(error).split())}") from error
    if objects and not found:
        raise InputError(f"holds a MATLAB table or another object alone: {OBJECT_REMEDY}")
    return found


def _unpacked_bytes(data: bytes) -> int:
    """Size of all compressed elements of a file of version 5, counted up to a little more than `MAX_CONTENT_BYTES`.

    The size that a structure or cell states for itself is the number of its cells, whatever they hold.
    """
    total, at, order = 0, HEADER_BYTES, "<" if data[126:128] == b"IM" else ">"
    while at + 8 <= len(data) and total <= MAX_CONTENT_BYTES:
        kind, size = struct.unpack_from(f"{order}II", data, at)
        if kind == COMPRESSED_ELEMENT:
            unpacker, left = zlib.decompressobj(), data[at + 8 : at + 8 + size]
            while left and not unpacker.eof and total <= MAX_CONTENT_BYTES:
                total += len(unpacker.decompress(left, MIB))
                left = unpacker.unconsumed_tail
        at += 8 + size
    return total


def _arrays(name: str, value: Any, depth: int = 0) -> Iterator[tuple[str, FloatArray]]:
    """Vectors and matrices of numbers in a value, named by their path; a vector may be a row or a column."""
    if isinstance(value, np.ndarray):
        if value.dtype.kind in "biuf" and value.ndim in (1, 2) and value.size:
            yield name, (np.squeeze(value) if min(value.shape) == 1 else value).astype(float)
        return
    parts: Mapping[str, Any] = {}
    if isinstance(value, dict):
        parts = {f"{name}.{part}": inner for part, inner in value.items()}
    elif isinstance(value, list):
        parts = {f"{name}/{i}": inner for i, inner in enumerate(value)}
    if depth < MAX_STRUCTURE_DEPTH:
        for path, inner in parts.items():
            yield from _arrays(path, inner, depth + 1)


READERS = (ForeignReader(lambda path: [read_mat(path)], (".mat",)),)
