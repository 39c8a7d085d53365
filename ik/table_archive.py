"""Write and read the arrays of an IK table in an npz file with a digest, and check them against path and robot.

The numbers are checked because an arm's motion limits are computed from them.
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
from urdf.bounds import MAX_IK_TABLE_ARRAY_BYTES
from urdf.robot import Array

TABLE_FORMAT_VERSION = 7
"""Version of the file format of IK tables; it is raised when a change of the code changes a robot's table."""
REBUILD_REMEDY = "build it again with 'armdyn ik build'"


def write_arrays(target: File, about: Mapping[str, Any], arrays: Mapping[str, Any]) -> None:
    """Write arrays and their description to an npz file with a digest.

    An interrupted write leaves the old file unchanged.

    Args:
        target: the file.
        about: description of the arrays, of values that JSON can contain.
        arrays: arrays by name.

    Raises:
        InputError: the file cannot be written.
    """
    said = json.dumps({"format": TABLE_FORMAT_VERSION, **about})
    text = json.dumps({"format": TABLE_FORMAT_VERSION, **about, "digest": arrays_digest(said, arrays)})
    with replace_file(target) as file:
        np.savez(file, about=np.array(text), **arrays)


def read_arrays(source: File, names: Iterable[str]) -> tuple[dict[str, Any], dict[str, Array]]:
    """Read the description and the arrays `names` of an npz file; call it in a ``with reading(...)`` block.

    Raises:
        StaleTableError: another version of armdyn wrote the file, or the file was changed afterwards.
    """
    with zipfile.ZipFile(source) as packed:
        for member in packed.infolist():  # a few kilobytes of zeros expand to as many gigabytes as one likes
            if member.file_size > MAX_IK_TABLE_ARRAY_BYTES:
                raise StaleTableError(
                    f"{source}: '{member.filename[:60]}' is not an array of a table; {REBUILD_REMEDY}"
                )
    with np.load(source, allow_pickle=False) as file:
        about = json.loads(str(file["about"]))
        allow_overwrite(source)  # a table that may be built again
        if about["format"] != TABLE_FORMAT_VERSION:
            raise StaleTableError(f"{source}: another version of armdyn wrote it; {REBUILD_REMEDY}")
        arrays = {name: file[name] for name in names}
    digest = about.pop("digest")
    if digest != arrays_digest(json.dumps(about), arrays):
        raise StaleTableError(f"{source}: its numbers were changed; {REBUILD_REMEDY}")
    return about, arrays


def arrays_digest(said: str, arrays: Mapping[str, Array]) -> str:
    """SHA-256 digest of a text and of the names, types, shapes and numbers of arrays."""
    digest = hashlib.sha256(said.encode())
    for name, values in sorted(arrays.items()):
        digest.update(f"{name} {values.dtype.str} {values.shape}".encode())
        digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()


@contextmanager
def table_errors_as_input_errors(source: File) -> Iterator[None]:
    """Convert every exception in the ``with`` block, which reads a table's file, to an error with a clear message.

    Raises:
        InputError: the file does not exist.
        StaleTableError: the file is damaged, or is not an IK table.
    """
    try:
        yield
    except FileNotFoundError as error:
        raise InputError(f"{source}: there is no such table; {REBUILD_REMEDY}") from error
    except StaleTableError:
        raise
    except IsADirectoryError as error:
        raise InputError(f"{source} is a directory: give a table's file") from error
    except Exception as error:  # bytes that are none of a table surface as a dozen exceptions of zipfile, zlib, numpy
        raise StaleTableError(f"{source}: not an IK table, or damaged; {REBUILD_REMEDY}") from error


RELATIVE_NODE_SPACING_TOLERANCE = 1e-6
"""Allowed relative difference of the distances between nodes; the interpolation needs equal distances."""
POSITION_LIMIT_TOLERANCE = 1e-6
"""Allowed distance of a joint beyond its position limit, because of rounding [rad or m]."""
TOOL_TO_PATH_TOLERANCE = 1e-6
"""Allowed distance of the tool from its path [m]; a correct table has 1e-9."""


def check_shapes(arrays: Mapping[str, Array], shapes: Mapping[str, str], joints: int) -> None:
    """Check the types and shapes of a table's arrays, and that all numbers are finite and the nodes evenly spaced.

    Args:
        arrays: arrays by name.
        shapes: axes of each array, such as ``"k6n"``: k nodes, n joints, or a number.
        joints: number of joints n.

    Raises:
        InputError: an array is wrong; the message names it and the fault.
    """
    sizes = {"k": arrays["s"].size, "n": joints, "3": 3, "6": 6}
    for name, axes in shapes.items():
        values, shape = arrays[name], tuple(sizes[axis] for axis in axes)
        if values.dtype != np.float64:
            raise InputError(f"'{name}' holds {values.dtype}, not numbers of 64 bits")
        if values.shape != shape:
            raise InputError(f"'{name}' has the shape {values.shape}, not {shape}")
        if not np.isfinite(values).all():
            raise InputError(f"'{name}' holds a number that is not finite")
    steps = np.diff(arrays["s"])
    if not steps.size or not np.all(steps > 0.0) or np.ptp(steps) > RELATIVE_NODE_SPACING_TOLERANCE * np.max(steps):
        raise InputError("'s' does not grow evenly")


def check_consistency(arrays: Mapping[str, Array], path: Path) -> None:
    """Check that a table's postures keep the joint limits and agree with their derivatives, the Jacobians and the path.

    From one node to the next, h apart, q grows by h (q' + q'_next)/2 + h^2 (q'' - q''_next)/12 + O(h^5 q^(5)), and J q'
    is the twist of the path. The arrays have been checked by `check_shapes`.

    Raises:
        InputError: arrays disagree; the message names them.
    """
    s, q, first, second = (arrays[name] for name in ("s", "q", "dq_ds", "d2q_ds2"))
    if np.any(q < arrays["lower"] - POSITION_LIMIT_TOLERANCE) or np.any(q > arrays["upper"] + POSITION_LIMIT_TOLERANCE):
        raise InputError("'q' leaves the range from 'lower' to 'upper'")
    width = s[1] - s[0]
    grown = width * (first[1:] + first[:-1]) / 2 + width**2 * (second[:-1] - second[1:]) / 12
    if np.max(np.abs(np.diff(q, axis=0) - grown)) > 1e-2 * np.max(
        np.abs(np.diff(q, axis=0)), initial=TOOL_TO_PATH_TOLERANCE
    ):
        raise InputError("'q', 'dq_ds' and 'd2q_ds2' do not belong together")
    if abs(s[0] - path.s_min) > TOOL_TO_PATH_TOLERANCE or abs(s[-1] - path.s_max) > TOOL_TO_PATH_TOLERANCE:
        raise InputError(f"its nodes go from {s[0]:g} to {s[-1]:g} m, its path from {path.s_min:g} to {path.s_max:g} m")
    moved = np.einsum("kij,kj->ki", arrays["jacobian"], first)
    if np.max(np.abs(moved - path.twist(s).T)) > 1e-4:
        raise InputError("'jacobian' and 'dq_ds' do not follow the path")


def check_robot(arrays: Mapping[str, Array], path: Path, robot: Robot) -> None:
    """Check that a table has the joint limits and tool of a robot, and that its postures put the tool on the path.

    Raises:
        InputError: a limit or the tool offset differs from the robot's, or the tool is away from the path.
    """
    for name, values in {"tool_offset": robot.tool_offset, **vars(robot.limits)}.items():
        if not np.array_equal(arrays[name], values):
            raise InputError(f"its '{name}' is not that of robot '{robot.name}'")
    position = np.array([robot.tool_pose(q).translation for q in arrays["q"]])
    away = float(np.max(np.linalg.norm(position - path.pose(arrays["s"])[1].T, axis=1)))
    if away > TOOL_TO_PATH_TOLERANCE:
        raise InputError(f"the tool is {away:.3g} m away from the path at its postures")
