"""MATLAB's files: vectors, matrices and structures of numbers become columns, named as they are in MATLAB."""

from collections import Counter
from collections.abc import Iterator
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from armdyn.errors import InputError
from armdyn.recording.channels import MIN_SAMPLES, FloatArray
from armdyn.user_code import rehearse
from pipeline.imports.foreign import Column, Foreign, Reader
from urdf.bounds import LARGEST_CONTENT, LARGEST_RECORDING, MIB, MOST_COLUMNS

DEEPEST = 8
"""Structures in one another."""


def read_mat(path: Path) -> Foreign:
    """Columns of a MATLAB file; of arrays of several lengths those are taken that most have.

    Raises:
        InputError: it cannot be read, is too large, or holds no array of numbers that is long enough.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    if path.stat().st_size > LARGEST_RECORDING:
        raise InputError(f"{path}: is larger than {LARGEST_RECORDING / MIB:g} MiB: cut it")
    rehearse(path, lambda: _content(path))  # scipy ends the process on some damaged files
    content = _content(path)
    arrays = {
        name: array
        for key, value in content.items()
        if not key.startswith("__")
        for name, array in _arrays(key, value, 0)
    }
    lengths = Counter(n for array in arrays.values() for n in set(array.shape) if n >= MIN_SAMPLES)
    if not lengths:
        raise InputError(f"{path}: holds no array of at least {MIN_SAMPLES} numbers: give a recording")
    rows = max(lengths, key=lambda n: (lengths[n], n))
    columns: dict[str, Column] = {}
    other = []
    for name, array in arrays.items():
        if rows not in array.shape:
            other.append(name)
            continue
        table = array if array.shape[0] == rows else array.T
        columns |= {name: Column(table)} if table.ndim == 1 else {
            f"{name}/{i}": Column(column) for i, column in enumerate(table.T)
        }  # fmt: skip
    if len(columns) > MOST_COLUMNS:
        raise InputError(f"{path}: {len(columns)} columns, where {MOST_COLUMNS} are the most: leave some out")
    notes = [f"not of {rows} rows: {', '.join(other)}: left out"] if other else []
    return Foreign(path.stem, columns, tuple(notes))


def _content(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat, whosmat

    try:
        size = sum(8 * prod(shape) for _, shape, _ in whosmat(path))
        content: dict[str, Any] = loadmat(path, simplify_cells=True) if size <= LARGEST_CONTENT else {}
    except NotImplementedError as error:
        raise InputError(f"{path}: is of MATLAB's version 7.3: save it with save('{path.name}', ..., '-v7')") from error
    except Exception as error:  # damaged bytes surface as a dozen exceptions of scipy
        raise InputError(f"{path}: is no MATLAB file that can be read: {' '.join(str(error).split())}") from error
    if size > LARGEST_CONTENT:
        raise InputError(f"{path}: holds more than {LARGEST_CONTENT / MIB:g} MiB of numbers: cut it")
    return content


def _arrays(name: str, value: Any, depth: int) -> Iterator[tuple[str, FloatArray]]:
    """Vectors and matrices of numbers in a value, named by their way there; a vector may be a row or a column."""
    if isinstance(value, dict) and depth < DEEPEST:
        for part, inner in value.items():
            yield from _arrays(f"{name}.{part}", inner, depth + 1)
    elif isinstance(value, list) and depth < DEEPEST:
        for i, inner in enumerate(value):
            yield from _arrays(f"{name}/{i}", inner, depth + 1)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and value.ndim in (1, 2) and value.size:
        yield name, np.squeeze(value).astype(float) if min(value.shape) == 1 else value.astype(float)


READERS = (Reader(lambda path: [read_mat(path)], (".mat",)),)
