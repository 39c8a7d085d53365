"""Arrays in an npz file, with what they are about and a digest of their numbers; and whether these can guard an arm.

A file is well formed and may still hold anything.
"""

import hashlib
import json
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path as File
from typing import Any

import numpy as np

from armdyn.atomic import replacing
from armdyn.errors import InputError
from ik.errors import StaleTableError
from ik.path import Path
from urdf import Limits, Robot
from urdf.bounds import LARGEST_ARRAY
from urdf.robot import LARGEST, Array

FORMAT = 5  # raise it when a change of the code makes other tables out of the same robot
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


def read_arrays(source: File, names: Sequence[str]) -> tuple[dict[str, Any], dict[str, Array]]:
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


FEWEST = 2
"""Nodes."""
EVEN = 1e-6
"""Share by which a distance between nodes may differ from another; a lookup takes them for even."""
BEYOND = 1e-6
"""rad or m beyond a position limit that rounding explains."""
ASTRAY = 1e-6
"""m and, as a share of the way, how far what belongs together may be apart: a table is solved to 1e-9."""


def check_arrays(arrays: Mapping[str, Array], joints: int) -> None:
    """Hold shapes, kinds and ranges against what a table of so many joints is.

    Args:
        arrays: of the table, by name.
        joints: n.

    Raises:
        InputError: names the array and what is wrong.
    """
    nodes = arrays["s"].size
    per_node = {"q", "dq_ds", "d2q_ds2", "inertial", "centrifugal", "damping", "gravity", "springs"}
    for name, values in arrays.items():
        if values.dtype != np.float64:
            raise InputError(f"'{name}' holds {values.dtype}, not numbers of 64 bits")
        shape: tuple[int, ...] = (nodes,) if name == "s" else (3,) if name == "tool_offset" else (joints,)
        shape = (nodes, joints) if name in per_node else (nodes, 6, joints) if name == "jacobian" else shape
        if values.shape != shape:
            raise InputError(f"'{name}' has the shape {values.shape}, not {shape}")
        if not np.isfinite(values).all():
            raise InputError(f"'{name}' holds a number that is none")
    steps = np.diff(arrays["s"])
    if nodes < FEWEST or not np.all(steps > 0.0) or np.ptp(steps) > EVEN * np.max(steps):
        raise InputError("'s' does not grow evenly")
    for name in ("velocity", "acceleration", "effort"):
        values = arrays[f"{name}_limits"]
        if not np.all((values > 0.0) & (values <= LARGEST[name])):
            raise InputError(f"'{name}_limits' are not all above 0 and at most {LARGEST[name]:g}")
    if not np.all(arrays["lower"] < arrays["upper"]):
        raise InputError("'lower' is not below 'upper'")
    q, bounds = arrays["q"], np.array([arrays["lower"] - BEYOND, arrays["upper"] + BEYOND])
    if not np.all((q >= bounds[0]) & (q <= bounds[1])):
        raise InputError("'q' leaves the range from 'lower' to 'upper'")
    _check_derivatives(arrays, float(steps[0]))


def _check_derivatives(arrays: Mapping[str, Array], width: float) -> None:
    """Postures, their derivatives and the Jacobian belong together: limits of speed follow from derivatives.

    From one node to the next q grows by h (q' + q'_next)/2 + h^2 (q'' - q''_next)/12 + O(h^5 q^(5)).
    """
    q, first, second = (arrays[name] for name in ("q", "dq_ds", "d2q_ds2"))
    grown = width * (first[1:] + first[:-1]) / 2 + width**2 * (second[:-1] - second[1:]) / 12
    if np.max(np.abs(np.diff(q, axis=0) - grown)) > 1e-2 * np.max(np.abs(np.diff(q, axis=0)), initial=ASTRAY):
        raise InputError("'q', 'dq_ds' and 'd2q_ds2' do not belong together")


def check_path(arrays: Mapping[str, Array], path: Path) -> None:
    """Hold the motion of the tool at the nodes against its path: J q' is the path's direction.

    Raises:
        InputError: they differ.
    """
    s = arrays["s"]
    if abs(s[0] - path.s_min) > ASTRAY or abs(s[-1] - path.s_max) > ASTRAY:
        raise InputError(f"its nodes go from {s[0]:g} to {s[-1]:g} m, its path from {path.s_min:g} to {path.s_max:g} m")
    moved = np.einsum("kij,kj->ki", arrays["jacobian"], arrays["dq_ds"])
    if np.max(np.abs(moved - path.twist(s).T)) > 1e-4:
        raise InputError("'jacobian' and 'dq_ds' do not follow the path")


def check_robot(arrays: Mapping[str, Array], path: Path, robot: Robot) -> None:
    """Hold limits and postures against the robot.

    Raises:
        InputError: a limit is not the robot's, or its tool is not on the path.
    """
    own: Limits = robot.limits
    limits = {
        "lower": own.lower,
        "upper": own.upper,
        "velocity_limits": own.velocity,
        "acceleration_limits": own.acceleration,
        "effort_limits": own.effort,
        "tool_offset": robot.tool_offset,
    }
    for name, values in limits.items():
        if values.shape != arrays[name].shape or not np.array_equal(arrays[name], values):
            raise InputError(f"'{name}' differs from that of '{robot.name}'")
    position = np.array([robot.tool_pose(q).translation for q in arrays["q"]])
    away = float(np.max(np.linalg.norm(position - path.pose(arrays["s"])[1].T, axis=1)))
    if away > ASTRAY:
        raise InputError(f"its postures put the tool {away:.3g} m away from the path")
