"""The readable file per robot: what a URDF cannot say."""

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from urdf.mend import Frame
from urdf.robot import Array, Line, Spring, UrdfError, rotation_of


@dataclass(frozen=True)
class Settings:
    """What a robot's TOML file says; see ``robots/baxter.toml`` for an example with comments.

    Attributes:
        text: the file itself, part of the robot's fingerprint.
        name: short name of the robot.
        distribution: Python package that carries the URDF; empty where the files lie beside the settings.
        urdf_file: last parts of the URDF's path in it, or the path from the settings' directory.
        srdf_file: the same of the SRDF, if there is one.
        joints: the arm's joints from base to tool.
        home: a posture, one number per joint [rad or m].
        tool_frame: frame that carries the tool.
        tool_offset: tool point in it, (3,) [m].
        frames: frames that the URDF lacks.
        acceleration: limit per joint [rad/s^2 or m/s^2].
        jerk: limit per joint [rad/s^3 or m/s^3].
        limits_source: where these two come from.
        line: the line, if one is given.
        springs: extra joint torques.
        exclusions: pairs of links that need no collision check.
    """

    text: str
    name: str
    distribution: str
    urdf_file: str
    srdf_file: str | None
    joints: tuple[str, ...]
    home: tuple[float, ...]
    tool_frame: str
    tool_offset: tuple[float, ...]
    frames: tuple[Frame, ...]
    acceleration: tuple[float, ...]
    jerk: tuple[float, ...]
    limits_source: str
    line: Line | None
    springs: tuple[Spring, ...]
    exclusions: tuple[tuple[str, str], ...]


def read_settings(path: Path) -> Settings:
    """Read a robot's settings.

    Raises:
        UrdfError: the file is missing or not TOML, or an entry is missing or has the wrong length.
    """
    try:
        text = path.read_text(encoding="utf-8")
        content = tomllib.loads(text)
    except OSError as error:
        raise UrdfError(f"{path}: cannot be read ({error.strerror}); give the path of a settings file") from error
    except tomllib.TOMLDecodeError as error:
        raise UrdfError(f"{path}: not a TOML file ({error}); correct it") from error
    try:
        settings = _from_content(text, content)
    except KeyError as error:
        raise UrdfError(f"{path}: entry {error} is missing; see urdf/robots/baxter.toml for an example") from error
    except (TypeError, ValueError) as error:
        raise UrdfError(f"{path}: an entry has the wrong form ({error}); see urdf/robots/baxter.toml") from error
    for key in ("home", "acceleration", "jerk"):
        if len(getattr(settings, key)) != len(settings.joints):
            raise UrdfError(
                f"{path}: {key} has {len(getattr(settings, key))} numbers for {len(settings.joints)} joints"
            )
    return settings


def _from_content(text: str, content: dict[str, Any]) -> Settings:
    line = content.get("line")
    return Settings(
        text=text,
        name=str(content["name"]),
        distribution=str(content["urdf"].get("distribution", "")),
        urdf_file=str(content["urdf"]["file"]),
        srdf_file=content.get("collision", {}).get("srdf"),
        joints=tuple(map(str, content["arm"]["joints"])),
        home=tuple(map(float, content["arm"]["home"])),
        tool_frame=str(content["tool"]["frame"]),
        tool_offset=tuple(map(float, content["tool"]["offset"])),
        frames=tuple(
            Frame(str(frame["name"]), str(frame["parent"]), _vector(frame["position"]))
            for frame in content.get("frames", [])
        ),
        acceleration=tuple(map(float, content["limits"]["acceleration"])),
        jerk=tuple(map(float, content["limits"]["jerk"])),
        limits_source=" ".join(str(content["limits"]["source"]).split()),
        line=None if line is None else _line(line),
        springs=tuple(
            Spring(str(s["joint"]), float(s["sine"]), float(s["cosine"]), bool(s["enabled"]), str(s["source"]))
            for s in content.get("springs", [])
        ),
        exclusions=tuple((str(a), str(b)) for a, b in content.get("collision", {}).get("exclude", [])),
    )


def _line(entry: dict[str, Any]) -> Line:
    first, last = map(float, entry["range"])
    low, high = map(float, entry["core"])
    return Line(
        origin=_vector(entry["origin"]),
        direction=_vector(entry["direction"]),
        rotation=rotation_of(*map(float, entry["tool_rpy"])),
        s_min=first,
        s_max=last,
        core=(low, high),
        core_speed=float(entry["core_speed"]),
    )


def _vector(values: list[float]) -> Array:
    vector = np.array([float(value) for value in values])
    if vector.shape != (3,):
        raise ValueError(f"{values} should be three numbers")
    return vector
