"""Arrays in an npz file, with what they are about and a digest of their numbers."""

import hashlib
import json
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from armdyn.errors import InputError
from ik.errors import StaleTableError
from urdf import UrdfError
from urdf.robot import Array

FORMAT = 4  # raise it when a change of the code makes other tables out of the same robot
REBUILD = "build it again with 'armdyn ik build'"


def write_arrays(target: Path, about: Mapping[str, Any], arrays: Mapping[str, Any]) -> None:
    """Write a file; an interrupted write leaves no broken file behind.

    Raises:
        InputError: the file cannot be written.
    """
    text = json.dumps({"format": FORMAT, **about, "digest": _digest(arrays)})
    unfinished = target.with_name(f".{target.name}.part")
    try:
        with unfinished.open("wb") as file:
            np.savez(file, about=np.array(text), **arrays)
        unfinished.replace(target)
    except OSError as error:
        raise InputError(f"{target}: cannot be written ({error.strerror}); choose another file") from error


def read_arrays(source: Path, names: Sequence[str]) -> tuple[dict[str, Any], dict[str, Array]]:
    """What a file is about, and its arrays of these names; to be called within `reading`.

    Raises:
        StaleTableError: another version wrote it, or its numbers were changed.
    """
    with np.load(source, allow_pickle=False) as file:
        about = json.loads(str(file["about"]))
        if about["format"] != FORMAT:
            raise StaleTableError(f"{source}: another version of armdyn wrote it; {REBUILD}")
        arrays = {name: file[name] for name in names}
    if about["digest"] != _digest(arrays):
        raise StaleTableError(f"{source}: its numbers were changed; {REBUILD}")
    return about, arrays


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
    except (OSError, EOFError, KeyError, ValueError, TypeError, zipfile.BadZipFile, UrdfError, InputError) as error:
        raise StaleTableError(f"{source}: not an IK table, or damaged; {REBUILD}") from error


def _digest(arrays: Mapping[str, Array]) -> str:
    digest = hashlib.sha256()
    for values in arrays.values():
        digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()
