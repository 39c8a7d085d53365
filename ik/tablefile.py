"""Tables as npz files, with a fingerprint of the robot and a digest of their own numbers."""

import hashlib
import json
import zipfile
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from armdyn.errors import InputError
from ik.errors import StaleTableError
from ik.pathfile import path_of
from ik.table import ARRAYS, LineTable, PathTable
from ik.torque import TorqueRows
from urdf import Robot, UrdfError

if TYPE_CHECKING:
    from collections.abc import Mapping

Array = NDArray[np.float64]
Table = TypeVar("Table", bound=PathTable)

FORMAT = 3  # raise it when a change of the code makes other tables out of the same robot
TORQUES = tuple(item.name for item in fields(TorqueRows))
REBUILD = "build it again with 'armdyn ik build'"


def save(table: PathTable, target: Path) -> None:
    """Write a table; an interrupted write leaves no broken file behind.

    Raises:
        InputError: the file cannot be written.
    """
    arrays = {name: getattr(table, name) for name in ARRAYS}
    arrays |= {name: getattr(table.torque, name) for name in TORQUES}
    about = {
        "format": FORMAT,
        "robot": table.robot_name,
        "joints": table.joint_names,
        "tool_frame": table.tool_frame,
        "path": table.path.describe(),
        "fingerprint": table.fingerprint,
        "digest": _digest(arrays),
    }
    unfinished = target.with_name(f".{target.name}.part")
    try:
        with unfinished.open("wb") as file:
            np.savez(file, about=np.array(json.dumps(about)), **arrays)
        unfinished.replace(target)
    except OSError as error:
        raise InputError(f"{target}: cannot be written ({error.strerror}); choose another file") from error


def load(kind: type[Table], source: Path, robot: Robot | None) -> Table:
    """Read a table, see `ik.PathTable.load`."""
    try:
        with np.load(source, allow_pickle=False) as file:
            about = json.loads(str(file["about"]))
            if about["format"] != FORMAT:
                raise StaleTableError(f"{source}: another version of armdyn wrote it; {REBUILD}")
            arrays = {name: file[name] for name in (*ARRAYS, *TORQUES)}
        if about["digest"] != _digest(arrays):
            raise StaleTableError(f"{source}: its numbers were changed; {REBUILD}")
        path = path_of(about["path"])
        torque = TorqueRows(**{name: arrays.pop(name) for name in TORQUES})
        names = about["robot"], tuple(about["joints"]), about["tool_frame"], about["fingerprint"]
    except FileNotFoundError as error:
        raise InputError(f"{source}: there is no such table; {REBUILD}") from error
    except StaleTableError:
        raise
    except (
        OSError,
        EOFError,
        KeyError,
        ValueError,
        TypeError,
        zipfile.BadZipFile,
        UrdfError,
        InputError,
    ) as error:
        raise StaleTableError(f"{source}: not an IK table, or damaged; {REBUILD}") from error
    if issubclass(kind, LineTable) and about["path"]["kind"] != "line":
        raise StaleTableError(f"{source}: the table of a {about['path']['kind']}, not of a line; {REBUILD}")
    name, joints, tool_frame, fingerprint = names
    if robot is not None and name != robot.name:
        raise StaleTableError(f"{source}: the table is of robot '{name}', not '{robot.name}'; {REBUILD}")
    if robot is not None and fingerprint != robot.fingerprint:
        raise StaleTableError(f"{source}: the URDF or the settings of '{robot.name}' have changed since; {REBUILD}")
    content: dict[str, Any] = {
        "robot_name": name,
        "joint_names": joints,
        "tool_frame": tool_frame,
        "path": path,
        "torque": torque,
        "fingerprint": fingerprint,
        **arrays,
    }
    return kind(**content)


def _digest(arrays: "Mapping[str, Array]") -> str:
    digest = hashlib.sha256()
    for name in (*ARRAYS, *TORQUES):
        digest.update(np.ascontiguousarray(arrays[name]).tobytes())
    return digest.hexdigest()
