"""Read a path of the tool from a TOML file, or from the description that an IK table contains."""

from pathlib import Path as File
from typing import Any

import numpy as np

from armdyn.errors import InputError, UnknownNameError
from ik.path import CORE_SPEED_WITHOUT_REQUIREMENT, MAX_PATH_LENGTH, CirclePath, Path, SplinePath
from urdf import Line, UrdfError
from urdf.robot import Array, rotation_from_rpy
from urdf.toml_tables import TomlFileError, check_keys, read_toml_with_text

PATH_KINDS = ("line", "circle", "spline")
PATH_KEYS = (
    "kind", "origin", "direction", "range", "core", "core_speed", "centre", "radius", "normal", "start", "range_deg",
    "follow", "points", "tool_rpy", "rotation", "rotations",
)  # fmt: skip
MAX_COORDINATE = 100.0
"""Largest coordinate [m]; a larger number is probably in another unit."""
MAX_SPLINE_POINTS = 1000
"""Largest number of points of a spline."""


def read_path(file: str | File) -> Path:
    """Read a path of the tool from a TOML file, in SI units and the robot's base frame.

    The entry ``kind`` selects the other entries. ``"line"``: ``origin``, ``direction``, ``range``. ``"circle"``:
    ``centre``, ``radius``, ``normal``, ``start`` (direction from the centre), ``range_deg``, ``follow`` (whether the
    tool turns with the circle). ``"spline"``: ``points``. Every kind has ``tool_rpy``, the tool's roll, pitch and yaw
    [rad]; a spline may have one triple per point.

    Raises:
        InputError: the file cannot be read, or an entry is missing or has the wrong form.
    """
    source = File(file)
    try:
        _, content = read_toml_with_text(source, finite=True)
        check_keys(content, PATH_KEYS)
        return path_from_description(content)
    except FileNotFoundError as error:
        raise InputError(f"{source}: cannot be read (no such file); give the path of a path file") from error
    except KeyError as error:
        raise InputError(f"{source}: entry {error} is missing; see docs/ik.md for examples") from error
    except (TomlFileError, InputError) as error:
        raise InputError(f"{source}: {error}") from error
    except (TypeError, ValueError, AttributeError, OverflowError, UrdfError) as error:
        raise InputError(f"{source}: an entry has the wrong form ({error}); see docs/ik.md for examples") from error


def path_from_description(content: dict[str, Any]) -> Path:
    """Make a path from the entries of a path file, or from the result of `Path.describe`.

    Raises:
        KeyError: an entry is missing.
        TypeError, ValueError: an entry has the wrong type or length.
        InputError: the entries do not describe a valid path.
    """
    path = _path_of(content)
    if not path.s_max - path.s_min <= MAX_PATH_LENGTH:
        raise InputError(
            f"a path of {path.s_max - path.s_min:g} m is longer than any arm; {MAX_PATH_LENGTH:g} m is the most"
        )
    return path


def _path_of(content: dict[str, Any]) -> Path:
    kind = str(content["kind"])
    if kind not in PATH_KINDS:
        raise UnknownNameError("kind of path", kind, PATH_KINDS)
    if kind == "spline":
        points = np.array(content["points"], dtype=np.float64)
        if len(points) > MAX_SPLINE_POINTS or not np.all(np.abs(points) <= MAX_PATH_LENGTH):
            raise InputError(
                f"spline: give at most {MAX_SPLINE_POINTS} points, none farther than {MAX_PATH_LENGTH:g} m"
            )
        rotations = _rotations(content)
        return SplinePath(points, np.repeat(rotations, len(points), axis=0) if len(rotations) == 1 else rotations)
    (rotation,) = _rotations(content)
    if kind == "circle":
        radius, degrees = float(content["radius"]), content.get("range_deg", [0.0, 360.0])
        first, last = content.get("range", np.deg2rad(np.array(degrees, dtype=np.float64)) * radius)
        normal = _unit(content["normal"])
        start = _vector(content["start"])
        return CirclePath(
            centre=_vector(content["centre"]),
            normal=normal,
            start=_unit(start - normal * (normal @ start)),
            radius=radius,
            rotation=rotation,
            s_min=float(first),
            s_max=float(last),
            follow=bool(content.get("follow", False)),
        )
    first, last = map(float, content["range"])
    low, high = map(float, content.get("core", (first, last)))
    return Line(
        origin=_vector(content["origin"]),
        direction=_unit(content["direction"]),
        rotation=rotation,
        s_min=first,
        s_max=last,
        core=(low, high),
        core_speed=float(content.get("core_speed", CORE_SPEED_WITHOUT_REQUIREMENT)),
    )


def _rotations(content: dict[str, Any]) -> Array:
    """Orientations (m, 3, 3), from matrices or from roll, pitch and yaw."""
    for key in ("rotation", "rotations"):
        if key in content:
            return np.array(content[key], dtype=np.float64).reshape(-1, 3, 3)
    angles = np.array(content["tool_rpy"], dtype=np.float64).reshape(-1, 3)
    return np.array([rotation_from_rpy(*rpy) for rpy in angles])


def _vector(values: Any) -> Array:
    vector = np.array(values, dtype=np.float64)
    if vector.shape != (3,) or not np.all(np.abs(vector) <= MAX_COORDINATE):
        raise ValueError(f"{values} should be three numbers of {MAX_COORDINATE:g} at most")
    return vector


def _unit(values: Any) -> Array:
    vector = _vector(values)
    length = float(np.linalg.norm(vector))
    if not length > 1e-9:
        raise ValueError(f"{vector.tolist()} has no direction")
    # A unit vector stays as it is, to the last digit.
    return vector if abs(length - 1.0) < 1e-15 else vector / length
