"""The readable file per robot: what a URDF cannot say."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from urdf.bounds import LONGEST_NAME
from urdf.mend import Frame
from urdf.robot import LARGEST, Line, Spring, UrdfError, rotation_of
from urdf.table_file import TableFileError, check_keys, read_table


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


KEYS: Mapping[str, tuple[str, ...]] = {
    "": ("name", "urdf", "arm", "tool", "frames", "limits", "line", "collision", "springs", "ros"),
    "urdf": ("distribution", "file"),
    "arm": ("joints", "home"),
    "tool": ("frame", "offset"),
    "frames": ("name", "parent", "position"),
    "limits": ("acceleration", "jerk", "source"),
    "line": ("origin", "direction", "tool_rpy", "range", "core", "core_speed"),
    "collision": ("srdf", "exclude"),
    "springs": ("joint", "sine", "cosine", "enabled", "source"),
    "ros": (  # read by pipeline.ros.topics
        "joint_states",
        "command",
        "type",
        "mode",
        "feed_forward",
        "timeout",
        "command_timeout",
        "speed_ratio",
        "enabling",
        "horizon",
    ),
}
"""By table: what it may hold."""
FARTHEST = 100.0
"""m; a tool, frame or line that is farther from its robot is in another unit."""
STRONGEST = 1e5
"""N m; no spring of an arm gives more."""


def read_settings(path: Path) -> Settings:
    """Read a robot's settings.

    Raises:
        UrdfError: the file is missing or not TOML, or an entry is missing, unknown, of the wrong kind or length, or
            has a value that no robot has.
    """
    try:
        text, content = read_table(path, finite=True)
    except FileNotFoundError as error:
        raise UrdfError(f"{path}: cannot be read (no such file); give the path of a settings file") from error
    except TableFileError as error:
        raise UrdfError(f"{path}: {error}") from error
    try:
        _check_content(content)
        settings = _from_content(text, content)
        _check(settings)
    except KeyError as error:
        raise UrdfError(f"{path}: entry {error} is missing; see urdf/robots/baxter.toml for an example") from error
    except (TableFileError, UrdfError) as error:
        raise UrdfError(f"{path}: {error}") from error
    except (TypeError, ValueError, AttributeError, OverflowError) as error:
        raise UrdfError(f"{path}: an entry has the wrong form ({error}); see urdf/robots/baxter.toml") from error
    return settings


def _check_content(content: Mapping[str, Any]) -> None:
    """Refuse keys that are not read, and tables that are none."""
    check_keys(content, KEYS[""])
    for name, value in content.items():
        tables = value if name in ("frames", "springs") else [value]
        if name == "name":
            continue
        if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
            form = f"[[{name}]]" if name in ("frames", "springs") else f"[{name}]"
            raise TableFileError(f"'{name}' is not a table: write '{form}' on a line of its own")
        for table in tables if name in KEYS else ():  # [ros] is read, and its keys are checked, by pipeline/ros
            check_keys(table, KEYS[name], f"[{name}]")


def _check(settings: Settings) -> None:
    """Refuse numbers that no arm has: they guard it.

    Raises:
        UrdfError: names the entry.
    """
    count = len(settings.joints)
    if count == 0:
        raise UrdfError("[arm] joints: it names none; list the arm's joints from base to tool")
    if len(set(settings.joints)) < count:
        twice = next(name for name in settings.joints if settings.joints.count(name) > 1)
        raise UrdfError(f"[arm] joints: '{twice}' is listed twice; list every joint once")
    for key in ("home", "acceleration", "jerk"):
        values = getattr(settings, key)
        if len(values) != count:
            raise UrdfError(f"{key} has {len(values)} numbers for {count} joints")
    for key, largest in (("acceleration", LARGEST["acceleration"]), ("jerk", LARGEST["jerk"])):
        for joint, value in zip(settings.joints, getattr(settings, key), strict=True):
            if not 0.0 < value <= largest:
                raise UrdfError(
                    f"[limits] {key} of '{joint}' is {value:g}; give a number above 0 and at most {largest:g}, in rad "
                    "or m and s"
                )
    places: dict[str, ArrayLike] = {f"[[frames]] {frame.name}": frame.position for frame in settings.frames}
    places["[tool] offset"] = settings.tool_offset
    if settings.line is not None:
        line = settings.line
        places |= {"[line] origin": line.origin, "[line] range": (line.s_min, line.s_max)}
        low, high = line.core
        if not line.s_min <= low < high <= line.s_max:
            raise UrdfError(f"[line] core: {low:g} to {high:g} m does not lie within range; give two numbers inside it")
        if not 0.0 < line.core_speed <= LARGEST["velocity"]:
            raise UrdfError(f"[line] core_speed is {line.core_speed:g} m/s; give a number above 0")
    for where, place in places.items():
        if not np.all(np.abs(place) <= FARTHEST):
            raise UrdfError(f"{where}: {np.asarray(place).tolist()} m is too far away; write it in metres")
    for spring in settings.springs:
        if spring.joint not in settings.joints:
            raise UrdfError(
                f"[[springs]]: the arm has no joint '{spring.joint}'; choose among {', '.join(settings.joints)}"
            )
        if not max(abs(spring.sine), abs(spring.cosine)) <= STRONGEST:
            raise UrdfError(f"[[springs]] {spring.joint}: stronger than {STRONGEST:g} N m; write it in N m")


def _from_content(text: str, content: dict[str, Any]) -> Settings:
    line = content.get("line")
    collision = content.get("collision", {})
    return Settings(
        text=text,
        name=_text(content, "name"),
        distribution=_text(content["urdf"], "distribution", ""),
        urdf_file=_named(content["urdf"], "file"),
        srdf_file=_named(collision, "srdf") if "srdf" in collision else None,
        joints=_texts(content["arm"], "joints"),
        home=_numbers(content["arm"], "home"),
        tool_frame=_text(content["tool"], "frame"),
        tool_offset=_three(content["tool"], "offset"),
        frames=tuple(
            Frame(_text(frame, "name"), _text(frame, "parent"), np.array(_three(frame, "position")))
            for frame in content.get("frames", [])
        ),
        acceleration=_numbers(content["limits"], "acceleration"),
        jerk=_numbers(content["limits"], "jerk"),
        limits_source=" ".join(_text(content["limits"], "source").split()),
        line=None if line is None else _line(line),
        springs=tuple(
            Spring(_text(s, "joint"), _number(s, "sine"), _number(s, "cosine"), _flag(s, "enabled"), _text(s, "source"))
            for s in content.get("springs", [])
        ),
        exclusions=tuple(_pair(pair) for pair in collision.get("exclude", [])),
    )


def _line(entry: dict[str, Any]) -> Line:
    first, last = _numbers(entry, "range", 2)
    low, high = _numbers(entry, "core", 2)
    return Line(
        origin=np.array(_three(entry, "origin")),
        direction=np.array(_three(entry, "direction")),
        rotation=rotation_of(*_three(entry, "tool_rpy")),
        s_min=first,
        s_max=last,
        core=(low, high),
        core_speed=_number(entry, "core_speed"),
    )


def _text(table: Mapping[str, Any], key: str, default: str | None = None) -> str:
    value = table[key] if default is None else table.get(key, default)
    if not isinstance(value, str) or "\0" in value:
        raise ValueError(f"{key} = {value!r:.60} is not a text: put it in quotes")
    return value


def _named(table: Mapping[str, Any], key: str) -> str:
    value = _text(table, key)
    if not value.strip() or len(value) > LONGEST_NAME:
        raise ValueError(f"{key} = '{value:.60}' is no name: give one of 1 to {LONGEST_NAME} characters")
    return value


def _texts(table: Mapping[str, Any], key: str) -> tuple[str, ...]:
    values = table[key]
    if not isinstance(values, list) or not all(isinstance(value, str) for value in values):
        raise ValueError(f'{key} = {values!r:.60} is not a list of names: write ["first", "second"]')
    return tuple(values)


def _number(table: Mapping[str, Any], key: str) -> float:
    value = table[key]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{key} = {value!r:.60} is not a number")
    return float(value)


def _numbers(table: Mapping[str, Any], key: str, count: int | None = None) -> tuple[float, ...]:
    values = table[key]
    if not isinstance(values, list):
        raise ValueError(f"{key} = {values!r:.60} is not a list of numbers")
    found = tuple(_number({key: value}, key) for value in values)
    if count is not None and len(found) != count:
        raise ValueError(f"{key} = {values!r:.60} should be {count} numbers")
    return found


def _three(table: Mapping[str, Any], key: str) -> tuple[float, ...]:
    return _numbers(table, key, 3)


def _flag(table: Mapping[str, Any], key: str) -> bool:
    value = table[key]
    if not isinstance(value, bool):
        raise ValueError(f"{key} = {value!r:.60} is neither true nor false")
    return value


def _pair(names: Any) -> tuple[str, str]:
    first, second = _texts({"exclude": names}, "exclude")
    return first, second
