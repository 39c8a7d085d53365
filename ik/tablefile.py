"""Arrays in an npz file, with what they are about and a digest of their numbers."""

import hashlib
import json
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from armdyn.atomic import replacing
from armdyn.errors import InputError
from ik.errors import StaleTableError
from urdf.robot import Array

FORMAT = 5  # raise it when a change of the code makes other tables out of the same robot
REBUILD = "build it again with 'armdyn ik build'"
LARGEST_ARRAY = 2**28
"""Bytes of one array; a metre of path at the usual spacing takes 100 kB."""


def write_arrays(target: Path, about: Mapping[str, Any], arrays: Mapping[str, Any]) -> None:
    """Write a file; an interrupted write leaves no broken file behind.

    Raises:
        InputError: the file cannot be written.
    """
    said = json.dumps({"format": FORMAT, **about})
    text = json.dumps({"format": FORMAT, **about, "digest": digest_of(said, arrays)})
    with replacing(target) as file:
        np.savez(file, about=np.array(text), **arrays)


def read_arrays(source: Path, names: Sequence[str]) -> tuple[dict[str, Any], dict[str, Array]]:
    """What a file is about, and its arrays of these names; to be called within `reading`.

    Raises:
        StaleTableError: another version wrote it, or it was changed.
    """
    with zipfile.ZipFile(source) as packed:
        for member in packed.infolist():  # a few kilobytes of zeros expand to as many gigabytes as one likes
            if member.file_size > LARGEST_ARRAY:
                raise StaleTableError(f"{source}: '{member.filename[:60]}' is no array of a table; {REBUILD}")
    with np.load(source, allow_pickle=False) as file:
        about = json.loads(str(file["about"]))
        if about["format"] != FORMAT:
            raise StaleTableError(f"{source}: another version of armdyn wrote it; {REBUILD}")
        arrays = {name: file[name] for name in names}
    digest = about.pop("digest")
    if digest != digest_of(json.dumps(about), arrays):
        raise StaleTableError(f"{source}: its numbers were changed; {REBUILD}")
    return about, arrays


def digest_of(said: str, arrays: Mapping[str, Array]) -> str:
    """A fingerprint of a text and of names, shapes, kinds and numbers of arrays."""
    digest = hashlib.sha256(said.encode())
    for name, values in arrays.items():
        digest.update(f"{name} {values.dtype.str} {values.shape}".encode())
        digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()


@contextmanager
def reading(source: Path) -> Iterator[None]:
    """Say in one line why a file cannot be read.

    Raises:
        InputError: there is no such file.
        StaleTableError: it is damaged, or something else.
    """
    try:
        yield
    except FileNotFoundError as error:
        raise InputError(f"{source}: there is no such table; {REBUILD}") from error
    except StaleTableError:
        raise
    except IsADirectoryError as error:
        raise InputError(f"{source} is a directory: give a table's file") from error
    except Exception as error:  # bytes that are none of a table surface as a dozen exceptions of zipfile, zlib, numpy
        raise StaleTableError(f"{source}: not an IK table, or damaged; {REBUILD}") from error
