"""Write and read a table's arrays in an npz file with a digest, and check that they can guard an arm.

A well-formed file may still contain any numbers, so they are checked against the path and the robot.
"""

import hashlib
import json
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path as File
from typing import Any

import numpy as np

from armdyn.atomic import replace_file
from armdyn.errors import InputError
from armdyn.read_files import allow_overwrite
from ik.errors import StaleTableError
from ik.path import Path
from urdf import Robot
from urdf.bounds import LARGEST_ARRAY
from urdf.robot import Array

TABLE_FORMAT = 6  # raise it when a change of the code makes other tables out of the same robot
REBUILD = "build it again with 'armdyn ik build'"


def write_arrays(target: File, about: Mapping[str, Any], arrays: Mapping[str, Any]) -> None:
    """Write a file; an interrupted write leaves no broken file behind.

    Raises:
        InputError: the file cannot be written.
    """
    said = json.dumps({"format": TABLE_FORMAT, **about})
    text = json.dumps({"format": TABLE_FORMAT, **about, "digest": digest_of(said, arrays)})
    with replace_file(target) as file:
        np.savez(file, about=np.array(text), **arrays)


def read_arrays(source: File, names: Iterable[str]) -> tuple[dict[str, Any], dict[str, Array]]:
    """Read a file's description and its arrays of these names; call it within `reading`.

    Raises:
        StaleTableError: another version wrote it, or it was changed.
    """
    with zipfile.ZipFile(source) as packed:
        for member in packed.infolist():  # a few kilobytes of zeros expand to as many gigabytes as one likes
            if member.file_size > LARGEST_ARRAY:
                raise StaleTableError(f"{source}: '{member.filename[:60]}' is no array of a table; {REBUILD}")
    with np.load(source, allow_pickle=False) as file:
        about = json.loads(str(file["about"]))
        allow_overwrite(source)  # a table that may be built again
        if about["format"] != TABLE_FORMAT:
            raise StaleTableError(f"{source}: another version of armdyn wrote it; {REBUILD}")
        arrays = {name: file[name] for name in names}
    digest = about.pop("digest")
    if digest != digest_of(json.dumps(about), arrays):
        raise StaleTableError(f"{source}: its numbers were changed; {REBUILD}")
    return about, arrays


def digest_of(said: str, arrays: Mapping[str, Array]) -> str:
    """Digest of a text and of the names, shapes, types and numbers of arrays."""
    digest = hashlib.sha256(said.encode())
    for name, values in sorted(arrays.items()):
        digest.update(f"{name} {values.dtype.str} {values.shape}".encode())
        digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()


@contextmanager
def reading(source: File) -> Iterator[None]:
    """Turn every error of reading a file into one line.

    Raises:
        InputError: there is no such file.
        StaleTableError: the file is damaged, or is no table.
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


SPACING_TOLERANCE = 1e-6
"""Relative difference of the distances between nodes, which a lookup takes as even."""
LIMIT_TOLERANCE = 1e-6
"""Excess over a position limit, rad or m, that rounding explains."""
PATH_TOLERANCE = 1e-6
"""Distance from the path, m, and error of a posture's growth as a share of it: a table is solved to 1e-9."""


def check_shapes(arrays: Mapping[str, Array], shapes: Mapping[str, str], joints: int) -> None:
    """Check the shapes of arrays; each letter of `shapes` is an axis: k nodes, n joints, or a number.

    Raises:
        InputError: it names the array and the fault.
    """
    sizes = {"k": arrays["s"].size, "n": joints, "3": 3, "6": 6}
    for name, axes in shapes.items():
        values, shape = arrays[name], tuple(sizes[axis] for axis in axes)
        if values.dtype != np.float64:
            raise InputError(f"'{name}' holds {values.dtype}, not numbers of 64 bits")
        if values.shape != shape:
            raise InputError(f"'{name}' has the shape {values.shape}, not {shape}")
        if not np.isfinite(values).all():
            raise InputError(f"'{name}' holds a number that is none")
    steps = np.diff(arrays["s"])
    if not steps.size or not np.all(steps > 0.0) or np.ptp(steps) > SPACING_TOLERANCE * np.max(steps):
        raise InputError("'s' does not grow evenly")


def check_motion(arrays: Mapping[str, Array], path: Path) -> None:
    """Check that postures, their derivatives, the Jacobians and the path of a table agree, and keep the joint limits.

    From one node to the next q grows by h (q' + q'_next)/2 + h^2 (q'' - q''_next)/12 + O(h^5 q^(5)), and J q' is the
    path's direction. The arrays, by name, have the shapes that `check_shapes` accepts.

    Raises:
        InputError: it names the arrays that disagree.
    """
    s, q, first, second = (arrays[name] for name in ("s", "q", "dq_ds", "d2q_ds2"))
    if np.any(q < arrays["lower"] - LIMIT_TOLERANCE) or np.any(q > arrays["upper"] + LIMIT_TOLERANCE):
        raise InputError("'q' leaves the range from 'lower' to 'upper'")
    width = s[1] - s[0]
    grown = width * (first[1:] + first[:-1]) / 2 + width**2 * (second[:-1] - second[1:]) / 12
    if np.max(np.abs(np.diff(q, axis=0) - grown)) > 1e-2 * np.max(np.abs(np.diff(q, axis=0)), initial=PATH_TOLERANCE):
        raise InputError("'q', 'dq_ds' and 'd2q_ds2' do not belong together")
    if abs(s[0] - path.s_min) > PATH_TOLERANCE or abs(s[-1] - path.s_max) > PATH_TOLERANCE:
        raise InputError(f"its nodes go from {s[0]:g} to {s[-1]:g} m, its path from {path.s_min:g} to {path.s_max:g} m")
    moved = np.einsum("kij,kj->ki", arrays["jacobian"], first)
    if np.max(np.abs(moved - path.twist(s).T)) > 1e-4:
        raise InputError("'jacobian' and 'dq_ds' do not follow the path")


def check_robot(arrays: Mapping[str, Array], path: Path, robot: Robot) -> None:
    """Check that limits, tool and postures of a table are those of the robot.

    Raises:
        InputError: a limit is not the robot's, or its tool is not on the path.
    """
    for name, values in {"tool_offset": robot.tool_offset, **vars(robot.limits)}.items():
        if not np.array_equal(arrays[name], values):
            raise InputError(f"'{name}' differs from that of '{robot.name}'")
    position = np.array([robot.tool_pose(q).translation for q in arrays["q"]])
    away = float(np.max(np.linalg.norm(position - path.pose(arrays["s"])[1].T, axis=1)))
    if away > PATH_TOLERANCE:
        raise InputError(f"its postures put the tool {away:.3g} m away from the path")
