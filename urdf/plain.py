"""What a URDF may hold at all: names and numbers that can be used, before any library sees them.

urdfdom, which Pinocchio reads with, prints what it does not understand and goes on without it: a link whose inertia
has a typing mistake would weigh nothing.
"""

import math
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree as ET

from urdf.robot import UrdfError

LARGEST_FILE = 64 * 2**20
"""Bytes; the largest known description of a robot has 1 MiB."""
DEEPEST = 50
"""Elements in one another; a URDF has 6."""
LARGEST_NUMBER = 1e9
"""In SI units; a number beyond is no property of a robot."""
LONGEST_NAME = 200
KINDS = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
RESERVED = ("universe",)
"""What Pinocchio calls the joint that everything hangs from."""
NUMBERS = {
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "mass": {"value": 1},
    "inertia": dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), 1),
    "box": {"size": 3},
    "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1},
    "sphere": {"radius": 1},
    "mesh": {"scale": 3},
    "limit": dict.fromkeys(("lower", "upper", "effort", "velocity"), 1),
    "dynamics": {"damping": 1, "friction": 1},
    "mimic": {"multiplier": 1, "offset": 1},
    "safety_controller": dict.fromkeys(("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity"), 1),
    "calibration": {"rising": 1, "falling": 1},
}
"""By element: its numbers, and how many each attribute holds."""
NEEDED = {
    "mass": ("value",),
    "inertia": tuple(NUMBERS["inertia"]),
    "box": ("size",),
    "cylinder": ("radius", "length"),
    "sphere": ("radius",),
    "safety_controller": ("k_velocity",),
}
"""Attributes without which a library leaves the element out."""
POSITIVE = ("size", "radius", "length")


def check_depth(root: ET.Element, path: Path) -> None:
    """Refuse elements in one another without end, which no program can write again.

    Raises:
        UrdfError: it is so.
    """
    level = [root]
    for _ in range(DEEPEST):
        level = [child for element in level for child in element]
        if not level:
            return
    raise UrdfError(f"{path}: its elements are nested more than {DEEPEST} deep; give a URDF file")


def check_plain(root: ET.Element, path: Path) -> None:
    """Check every name and number of a URDF.

    Raises:
        UrdfError: names the link or joint, and what it says that cannot be used.
    """
    joints = {joint.get("name") for joint in root.findall("joint")}
    for part in (*root.findall("link"), *root.findall("joint")):
        where = f"{path}: {part.tag} '{_shown(part.get('name', ''))}'"
        _check_name(part, where)
        for element in part.iter():
            _check_numbers(element, where)
        if part.tag == "joint":
            _check_joint(part, where, joints)
        else:
            _check_shapes(part, where)


def _check_name(part: ET.Element, where: str) -> None:
    name = part.get("name", "")
    if not name.strip() or len(name) > LONGEST_NAME or not name.isprintable():
        raise UrdfError(f"{where} has no usable name; give it one of 1 to {LONGEST_NAME} printable characters")
    if part.tag == "joint" and name in RESERVED:
        raise UrdfError(f"{where}: Pinocchio uses this name itself; rename the joint")


def _check_numbers(element: ET.Element, where: str) -> None:
    for key, count in NUMBERS.get(element.tag, {}).items():
        text = element.get(key)
        if text is None:
            if key in NEEDED.get(element.tag, ()):
                raise UrdfError(f"{where}: <{element.tag}> has no {key}; add it")
            continue
        values = list(_floats(text))
        if not all(math.isfinite(value) for value in values):
            raise UrdfError(f'{where}: {element.tag} has {key}="{_shown(text)}"; it must be a finite number')
        if len(values) != count:
            raise UrdfError(f'{where}: {element.tag} has {key}="{_shown(text)}"; it must be {count} numbers')
        if any(abs(value) > LARGEST_NUMBER for value in values):
            raise UrdfError(f'{where}: {element.tag} has {key}="{_shown(text)}"; no robot has it, write SI units')
        if key in POSITIVE and min(values) < 0.0:
            raise UrdfError(f'{where}: {element.tag} has {key}="{_shown(text)}"; it must not be negative')


def _check_joint(joint: ET.Element, where: str, joints: set[str | None]) -> None:
    kind = joint.get("type", "")
    if kind not in KINDS:
        raise UrdfError(f"{where} is of type '{_shown(kind)}'; choose one of {', '.join(KINDS)}")
    axis = joint.find("axis")
    if axis is not None and kind in ("revolute", "continuous", "prismatic", "planar"):
        length = math.hypot(*_floats(axis.get("xyz", "1 0 0")))
        if not length > 1e-9:
            raise UrdfError(f"{where}: its axis has no direction; give one, such as 0 0 1")
    mimic = joint.find("mimic")
    if mimic is not None and (mimic.get("joint") not in joints or mimic.get("joint") == joint.get("name")):
        raise UrdfError(f"{where} mimics '{_shown(mimic.get('joint', ''))}'; name another joint of this robot")


def _check_shapes(link: ET.Element, where: str) -> None:
    inertial = link.find("inertial")
    if inertial is not None:
        for needed in ("mass", "inertia"):
            if inertial.find(needed) is None:
                raise UrdfError(f"{where}: <inertial> has no <{needed}>; add it, or remove <inertial>")
    for shape in (*link.findall("visual"), *link.findall("collision")):
        geometry = shape.find("geometry")
        if geometry is None or len(geometry) == 0:
            raise UrdfError(f"{where}: a <{shape.tag}> has no <geometry>; add it, or remove the <{shape.tag}>")
        mesh = geometry.find("mesh")
        if mesh is not None and not mesh.get("filename"):
            raise UrdfError(f"{where}: a <mesh> has no filename; add it")


def _floats(text: str) -> Iterator[float]:
    for word in text.split():
        try:
            yield float(word) if word.isascii() and "_" not in word else math.nan
        except ValueError:
            yield math.nan


def _shown(text: str) -> str:
    return "".join(c if c.isprintable() else "?" for c in text[:60])
