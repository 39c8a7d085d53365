"""Read the settings file of a robot (TOML), which contains properties that a URDF cannot contain."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from urdf.bounds import MAX_NAME_CHARACTERS
from urdf.robot import MAX_JOINT_LIMITS, Line, Spring, UrdfError, rotation_from_rpy
from urdf.toml_tables import TomlFileError, read_toml_with_text, table_to_dataclass

Vector3 = tuple[float, float, float]
Interval = tuple[float, float]

MAX_DISTANCE_FROM_ROBOT_METRES = 100.0
"""Largest distance of a tool, frame or line from the robot [m]; a larger number is probably in another unit."""
MAX_SPRING_TORQUE = 1e5
"""Largest torque of a joint's spring [N m]."""


@dataclass(frozen=True)
class UrdfSettings:
    """Table ``[urdf]`` of the settings: where the URDF file is.

    Attributes:
        file: path from the directory of the settings; in a Python package, the last parts of the path.
        distribution: name of the Python package that contains the file; empty if it is in none.
    """

    file: str
    distribution: str = ""


@dataclass(frozen=True)
class ArmSettings:
    """Table ``[arm]`` of the settings: the arm's joints from base to tool, and its home posture [rad or m]."""

    joints: tuple[str, ...]
    home: tuple[float, ...]


@dataclass(frozen=True)
class ToolSettings:
    """Table ``[tool]`` of the settings: the frame that carries the tool, and the tool point in this frame [m]."""

    frame: str
    offset: Vector3


@dataclass(frozen=True)
class FrameSettings:
    """Table ``[[frames]]`` of the settings: a massless frame that is fixed to a link and that the URDF lacks.

    Attributes:
        name: name of the frame.
        parent: name of the link.
        position: origin of the frame in the link's frame [m]; the axes are parallel.
    """

    name: str
    parent: str
    position: Vector3


@dataclass(frozen=True)
class LimitSettings:
    """Table ``[limits]`` of the settings: joint limits that a URDF cannot contain.

    Attributes:
        acceleration: largest acceleration of each joint [rad/s^2 or m/s^2].
        jerk: largest jerk of each joint [rad/s^3 or m/s^3].
        source: where the values come from.
    """

    acceleration: tuple[float, ...]
    jerk: tuple[float, ...]
    source: str


@dataclass(frozen=True)
class LineSettings:
    """Table ``[line]`` of the settings: a `urdf.Line` with the tool's orientation as roll, pitch and yaw [rad]."""

    origin: Vector3
    direction: Vector3
    tool_rpy: Vector3
    range: Interval
    core: Interval
    core_speed: float

    def to_line(self) -> Line:
        """Convert the entries of the settings to a `urdf.Line`.

        Raises:
            UrdfError: the range is empty, or the direction is not a unit vector.
        """
        origin, direction = np.array(self.origin), np.array(self.direction)
        rotation = rotation_from_rpy(*self.tool_rpy)
        return Line(origin, direction, rotation, *self.range, self.core, self.core_speed)


@dataclass(frozen=True)
class CollisionSettings:
    """Table ``[collision]`` of the settings: pairs of links that need no collision check.

    Attributes:
        srdf: path of an SRDF file that lists such pairs, given like the path of the URDF.
        exclude: further pairs of link names.
    """

    srdf: str | None = None
    exclude: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class RobotSettings:
    """Content of a robot's settings file, one field per entry; ``urdf/robots/baxter.toml`` explains every entry."""

    name: str
    urdf: UrdfSettings
    arm: ArmSettings
    tool: ToolSettings
    limits: LimitSettings
    frames: tuple[FrameSettings, ...] = ()
    line: LineSettings | None = None
    collision: CollisionSettings = CollisionSettings()
    springs: tuple[Spring, ...] = ()
    ros: dict[str, Any] | None = None  # read by pipeline.ros.topics


def read_robot_settings(path: Path) -> tuple[str, RobotSettings]:
    """Read a robot's settings file.

    Returns:
        The text of the file, and its content.

    Raises:
        UrdfError: the file is missing or not TOML, or an entry is missing, unknown, of the wrong kind or length, or
            has a value that no robot has.
    """
    try:
        text, content = read_toml_with_text(path, finite=True)
        settings = table_to_dataclass(RobotSettings, content)
        _check(settings)
    except FileNotFoundError as error:
        raise UrdfError(f"{path}: cannot be read (no such file); give the path of a settings file") from error
    except TomlFileError as error:
        raise UrdfError(f"{path}: {error}; see urdf/robots/baxter.toml for an example") from error
    except UrdfError as error:
        raise UrdfError(f"{path}: {error}") from error
    return text, settings


def _check(settings: RobotSettings) -> None:
    """Refuse numbers that no arm can have, since these numbers protect it.

    Raises:
        UrdfError: names the entry.
    """
    joints, limits = settings.arm.joints, settings.limits
    if not joints:
        raise UrdfError("[arm] joints: it names none; list the arm's joints from base to tool")
    twice = next((name for name in joints if joints.count(name) > 1), None)
    if twice is not None:
        raise UrdfError(f"[arm] joints: '{twice}' is listed twice; list every joint once")
    for key, values in (("home", settings.arm.home), ("acceleration", limits.acceleration), ("jerk", limits.jerk)):
        if len(values) != len(joints):
            raise UrdfError(f"{key} has {len(values)} numbers for {len(joints)} joints")
        for joint, value in zip(joints, values, strict=True):
            if key in MAX_JOINT_LIMITS and not 0.0 < value <= MAX_JOINT_LIMITS[key]:
                raise UrdfError(
                    f"[limits] {key} of '{joint}' is {value:g}; "
                    f"give a number above 0 and at most {MAX_JOINT_LIMITS[key]:g}, in rad or m and s"
                )
    for table, file in (("[urdf] file", settings.urdf.file), ("[collision] srdf", settings.collision.srdf)):
        if file is not None and not 0 < len(file.strip()) <= MAX_NAME_CHARACTERS:
            raise UrdfError(f"{table} = '{file:.60}' is not a name: give one of 1 to {MAX_NAME_CHARACTERS} characters")
    places: dict[str, tuple[float, ...]] = {f"[[frames]] {frame.name}": frame.position for frame in settings.frames}
    places["[tool] offset"] = settings.tool.offset
    if settings.line is not None:
        line = settings.line
        places |= {"[line] origin": line.origin, "[line] range": line.range}
        low, high = line.core
        if not line.range[0] <= low < high <= line.range[1]:
            raise UrdfError(f"[line] core: {low:g} to {high:g} m does not lie within range; give two numbers inside it")
        if not 0.0 < line.core_speed <= MAX_JOINT_LIMITS["velocity"]:
            raise UrdfError(f"[line] core_speed is {line.core_speed:g} m/s; give a number above 0")
        line.to_line()
    for where, place in places.items():
        if max(map(abs, place)) > MAX_DISTANCE_FROM_ROBOT_METRES:
            raise UrdfError(f"{where}: {list(place)} m is too far away; write it in metres")
    for spring in settings.springs:
        if spring.joint not in joints:
            raise UrdfError(f"[[springs]]: the arm has no joint '{spring.joint}'; choose among {', '.join(joints)}")
        if max(abs(spring.sine), abs(spring.cosine)) > MAX_SPRING_TORQUE:
            raise UrdfError(f"[[springs]] {spring.joint}: stronger than {MAX_SPRING_TORQUE:g} N m; write it in N m")
