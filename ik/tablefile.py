"""Arrays in an npz file, with what they are about and a digest of their numbers; and whether these can guard an arm.

A file is well formed and may still hold anything.
"""

import hashlib
import json
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path as File
from typing import TYPE_CHECKING, Any

import numpy as np

from armdyn.atomic import replacing
from armdyn.errors import InputError
from armdyn.read_files import may_replace
from ik.errors import StaleTableError
from urdf import Robot
from urdf.bounds import LARGEST_ARRAY
from urdf.robot import Array

if TYPE_CHECKING:
    from ik.table import PathTable

FORMAT = 6  # raise it when a change of the code makes other tables out of the same robot
REBUILD = "build it again with 'armdyn ik build'"


def write_arrays(target: File, about: Mapping[str, Any], arrays: Mapping[str, Any]) -> None:
    """Write a file; an interrupted write leaves no broken file behind.

    Raises:
        InputError: the file cannot be written.
    """
    said = json.dumps({"format": FORMAT, **about})
    text = json.dumps({"format": FORMAT, **about, "digest": digest_of(said, arrays)})
    with replacing(target) as file:
        np.savez(file, about=np.array(text), **arrays)


def read_arrays(source: File, names: Iterable[str]) -> tuple[dict[str, Any], dict[str, Array]]:
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
        may_replace(source)  # a table that may be built again
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
    for name, values in sorted(arrays.items()):
        digest.update(f"{name} {values.dtype.str} {values.shape}".encode())
        digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()


@contextmanager
def reading(source: File) -> Iterator[None]:
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


EVEN = 1e-6
"""Share by which a distance between nodes may differ from another; a lookup takes them for even."""
BEYOND = 1e-6
"""rad or m beyond a position limit that rounding explains."""
ASTRAY = 1e-6
"""m and, as a share of the way, how far what belongs together may be apart: a table is solved to 1e-9."""


def check_shapes(arrays: Mapping[str, Array], shapes: Mapping[str, str], joints: int) -> None:
    """Hold arrays against their axes: every letter of `shapes` is one, k nodes, n joints, or a number.

    Raises:
        InputError: names the array and what is wrong.
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
    if not steps.size or not np.all(steps > 0.0) or np.ptp(steps) > EVEN * np.max(steps):
        raise InputError("'s' does not grow evenly")


def check_motion(table: "PathTable") -> None:
    """Hold postures, their derivatives, the Jacobians and the path of a table against each other.

    From one node to the next q grows by h (q' + q'_next)/2 + h^2 (q'' - q''_next)/12 + O(h^5 q^(5)), and J q' is the
    path's direction.

    Raises:
        InputError: says what differs.
    """
    s, q, first, second, path = table.s, table.q, table.dq_ds, table.d2q_ds2, table.path
    if table.joint_margin < -BEYOND:
        raise InputError("'q' leaves the range from 'lower' to 'upper'")
    width = s[1] - s[0]
    grown = width * (first[1:] + first[:-1]) / 2 + width**2 * (second[:-1] - second[1:]) / 12
    if np.max(np.abs(np.diff(q, axis=0) - grown)) > 1e-2 * np.max(np.abs(np.diff(q, axis=0)), initial=ASTRAY):
        raise InputError("'q', 'dq_ds' and 'd2q_ds2' do not belong together")
    if abs(s[0] - path.s_min) > ASTRAY or abs(s[-1] - path.s_max) > ASTRAY:
        raise InputError(f"its nodes go from {s[0]:g} to {s[-1]:g} m, its path from {path.s_min:g} to {path.s_max:g} m")
    moved = np.einsum("kij,kj->ki", table.jacobian, first)
    if np.max(np.abs(moved - path.twist(s).T)) > 1e-4:
        raise InputError("'jacobian' and 'dq_ds' do not follow the path")


def check_robot(table: "PathTable", robot: Robot) -> None:
    """Hold limits, tool and postures of a table against the robot.

    Raises:
        InputError: a limit is not the robot's, or its tool is not on the path.
    """
    own = {"tool_offset": (table.tool_offset, robot.tool_offset)}
    own |= {name: (values, getattr(robot.limits, name)) for name, values in vars(table.limits).items()}
    for name, (values, robots) in own.items():
        if not np.array_equal(values, robots):
            raise InputError(f"'{name}' differs from that of '{robot.name}'")
    position = np.array([robot.tool_pose(q).translation for q in table.q])
    away = float(np.max(np.linalg.norm(position - table.path.pose(table.s)[1].T, axis=1)))
    if away > ASTRAY:
        raise InputError(f"its postures put the tool {away:.3g} m away from the path")
