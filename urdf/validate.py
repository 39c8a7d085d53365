"""Check that a URDF describes one usable robot, and report each fault in one sentence.

Names and numbers are checked before any library reads the file: Pinocchio's parser urdfdom skips an element that it
does not understand, so that a link whose inertia contains a typing mistake would have no mass.
"""

import math
from collections import Counter
from collections.abc import Sequence
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from shlex import quote
from xml.etree import ElementTree as ET

from urdf.bounds import (
    MAX_NAME_CHARACTERS,
    MAX_ROBOT_LINKS,
    MAX_XML_BYTES,
    MAX_XML_DEPTH,
    has_plausible_magnitude,
    parse_number,
    printable_excerpt,
)
from urdf.robot import UrdfError

MAX_URDF_NUMBER = 1e9
"""Largest number in a URDF, in SI units; no property of a robot is larger."""
MOVING_JOINT_TYPES = ("revolute", "continuous", "prismatic")
JOINT_TYPES = (*MOVING_JOINT_TYPES, "fixed", "floating", "planar")
MAX_URDF_ANGLE = 2.0 * math.pi + 1e-3
"""Largest angle that is plausible in a URDF [rad]: one turn, and a tolerance for rounding."""
RESERVED_JOINT_NAMES = ("universe",)
"""Names that Pinocchio gives to its own joints: "universe" is the fixed joint at the root."""
NUMERIC_ATTRIBUTES = {
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
"""For each element of a URDF, its attributes that contain numbers, and how many numbers each contains."""
LIMIT_ATTRIBUTES = tuple(NUMERIC_ATTRIBUTES["limit"])
REQUIRED_ATTRIBUTES = {
    "mass": ("value",),
    "inertia": tuple(NUMERIC_ATTRIBUTES["inertia"]),
    "box": ("size",),
    "cylinder": ("radius", "length"),
    "sphere": ("radius",),
    "safety_controller": ("k_velocity",),
}
"""For each element of a URDF, the attributes without which libraries ignore the element."""
NON_NEGATIVE_ELEMENTS = ("box", "cylinder", "capsule", "sphere", "mass")


def check_names_and_numbers(root: ET.Element, path: Path) -> None:
    """Check every name and number of a URDF.

    Raises:
        UrdfError: a name or number cannot be used; the message names the link or joint.
    """
    joints = {joint.get("name") for joint in root.findall("joint")}
    for part in (*root.findall("link"), *root.findall("joint")):
        where = f"{path}: {part.tag} '{printable_excerpt(part.get('name', ''))}'"
        _check_name(part, where)
        for element in part.iter():
            _check_numbers(element, where)
        if part.tag == "joint":
            _check_joint(part, where, joints)
        else:
            _check_shapes(part, where)


def suspicious_entries(root: ET.Element) -> tuple[str, ...]:
    """One sentence per entry that is probably a mistake: an angle above one turn, a planar or floating joint."""
    said = []
    for part in (*root.findall("joint"), *root.findall("link")):
        where = f"{part.tag} '{part.get('name')}'"
        if part.get("type") in ("planar", "floating"):
            said.append(f"{where} is {part.get('type')}, which no joint of an arm is: it is held where it stands")
        for origin in part.iter("origin"):
            if max(abs(float(word)) for word in origin.get("rpy", "0 0 0").split()) > MAX_URDF_ANGLE:
                said.append(f'{where} is turned by rpy="{origin.get("rpy")}" in rad: if that is in degrees, correct it')
    return tuple(said)


def _check_name(part: ET.Element, where: str) -> None:
    name = part.get("name", "")
    if not name.strip() or len(name) > MAX_NAME_CHARACTERS or not name.isprintable():
        raise UrdfError(f"{where} has no usable name; give it one of 1 to {MAX_NAME_CHARACTERS} printable characters")
    if part.tag == "joint" and name in RESERVED_JOINT_NAMES:
        raise UrdfError(f"{where}: Pinocchio uses this name itself; rename the joint")


def _check_numbers(element: ET.Element, where: str) -> None:
    for key, count in NUMERIC_ATTRIBUTES.get(element.tag, {}).items():
        text = element.get(key)
        if text is None:
            if key in REQUIRED_ATTRIBUTES.get(element.tag, ()):
                raise UrdfError(f"{where}: <{element.tag}> has no {key}; add it")
            continue
        try:
            values = [parse_number(word) for word in text.split()]
        except ValueError:
            values = [math.nan]
        wrong = None
        if not all(map(math.isfinite, values)):
            wrong = "it must be a finite number"
        elif len(values) != count:
            wrong = f"it must be {count} numbers"
        elif max(map(abs, values)) > MAX_URDF_NUMBER:
            wrong = "no robot has it, write SI units"
        elif element.tag in ("limit", "mass") and not all(map(has_plausible_magnitude, values)):
            wrong = "it is too small, write SI units"
        elif element.tag in NON_NEGATIVE_ELEMENTS and min(values) < 0.0:
            wrong = "it must not be negative"
        if wrong:
            raise UrdfError(f'{where}: {element.tag} has {key}="{printable_excerpt(text)}"; {wrong}')


def _check_joint(joint: ET.Element, where: str, joints: set[str | None]) -> None:
    kind = joint.get("type", "")
    if kind not in JOINT_TYPES:
        raise UrdfError(f"{where} is of type '{printable_excerpt(kind)}'; choose one of {', '.join(JOINT_TYPES)}")
    axis = joint.find("axis")
    if axis is not None and kind in (*MOVING_JOINT_TYPES, "planar"):
        length = math.hypot(*map(float, axis.get("xyz", "1 0 0").split()))
        if not length > 1e-9:
            raise UrdfError(f"{where}: its axis has no direction; give one, such as 0 0 1")
    mimic = joint.find("mimic")
    if mimic is not None and (mimic.get("joint") not in joints or mimic.get("joint") == joint.get("name")):
        raise UrdfError(
            f"{where} mimics '{printable_excerpt(mimic.get('joint', ''))}'; name another joint of this robot"
        )


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


MJCF_ROOT_TAG = "mujoco"
"""Name of the root element of an MJCF, MuJoCo's XML format."""


def parse_description(path: Path, roots: Sequence[str] = ("robot", MJCF_ROOT_TAG)) -> ET.Element:
    """Read the root element of a URDF or MJCF file, or of a part of one, whose root is one of `roots`.

    Raises:
        UrdfError: the file is missing, is not XML, or has another root.
    """
    try:
        with path.open("rb") as file:
            data = file.read(MAX_XML_BYTES + 1)
    except (OSError, ValueError) as error:  # a file name with a null character raises ValueError
        why = getattr(error, "strerror", None) or error
        raise UrdfError(f"{path}: cannot be read ({why}); give the path of a URDF file") from error
    if len(data) > MAX_XML_BYTES:
        raise UrdfError(f"{path}: is larger than {MAX_XML_BYTES / 2**20:g} MiB; give a URDF file")
    try:
        root = ET.fromstring(data)
    except (ET.ParseError, ValueError, LookupError) as error:  # raised for an unknown encoding too
        if b"<xacro:" in data:
            raise _is_xacro(path, "<xacro: ...>") from error
        raise UrdfError(f"{path}: not an XML file ({error}); correct it") from error
    _refuse_xacro(root, path)
    if root.tag not in roots:
        raise UrdfError(f"{path}: the root element is <{root.tag[:60]}>, not <robot>; give a URDF file")
    level = [root]
    for _ in range(MAX_XML_DEPTH):
        level = [child for element in level for child in element]
    if level:  # elements are nested too deeply for any program to write again
        raise UrdfError(f"{path}: its elements are nested more than {MAX_XML_DEPTH} deep; give a URDF file")
    return root


def _refuse_xacro(root: ET.Element, path: Path) -> None:
    """Refuse xacro macros, which URDF parsers ignore silently; a declared xacro namespace alone is allowed."""
    for element in root.iter():
        space, _, tag = str(element.tag).rpartition("}")
        if space.endswith("xacro"):
            raise _is_xacro(path, f"<xacro:{printable_excerpt(tag)}>")
    for part in (*root.findall("link"), *root.findall("joint")):
        for element in part.iter():
            for key in NUMERIC_ATTRIBUTES.get(element.tag, ()):
                if "$" in element.get(key, ""):
                    raise _is_xacro(path, f'{key}="{printable_excerpt(element.get(key, ""))}"')


def _is_xacro(path: Path, found: str) -> UrdfError:
    file = quote(str(path))
    return UrdfError(
        f"{path}: is a xacro file, as it holds {found}: expand it with 'xacro {file} > robot.urdf' (xacro is a part of "
        "ROS, or: pip install xacro), and give robot.urdf"
    )


def check_tree(root: ET.Element, path: Path) -> None:
    """Check that the links and joints of a URDF form one tree.

    Raises:
        UrdfError: there is no link or no moving joint, a joint's link is not defined, a link has two parents, several
            links have no parent, or the links form a cycle.
    """
    links = [link.get("name", "") for link in root.findall("link")]
    joints = root.findall("joint")
    if not links:
        raise UrdfError(f"{path}: it has no links; give a URDF that describes a robot")
    if max(len(links), len(joints)) > MAX_ROBOT_LINKS:
        raise UrdfError(
            f"{path}: it has {len(links)} links and {len(joints)} joints; give a robot of {MAX_ROBOT_LINKS} at most"
        )
    if not any(joint.get("type") in MOVING_JOINT_TYPES for joint in joints):
        raise UrdfError(f"{path}: it has no moving joint; give a URDF with revolute or prismatic joints")
    for kind, names in (("link", links), ("joint", [joint.get("name", "") for joint in joints])):
        twice = [name for name, count in Counter(names).items() if count > 1]
        if twice:
            raise UrdfError(f"{path}: {kind} '{min(twice)}' is defined twice; rename one of them")
    known, carrier, parents = set(links), dict[str, str](), dict[str, list[str]]()
    for joint in joints:
        name = joint.get("name", "")
        parent, child = (joint_link(joint, end) for end in ("parent", "child"))
        for link in (parent, child):
            if link not in known:
                raise UrdfError(f"{path}: joint '{name}' refers to link '{link}', which is not defined; add it")
        if child in carrier:
            both = f"'{carrier[child]}' and '{name}'"
            raise UrdfError(f"{path}: link '{child}' hangs from two joints, {both}; keep one")
        carrier[child], parents[child] = name, [parent]
    try:
        TopologicalSorter(parents).prepare()
    except CycleError as error:
        cycle = " -> ".join(error.args[1])
        raise UrdfError(f"{path}: the links form a cycle, {cycle}; a URDF must be a tree") from error
    roots = [link for link in links if link not in carrier]
    if len(roots) != 1:
        raise UrdfError(f"{path}: {len(roots)} links have no parent ({', '.join(roots)}); join them by fixed joints")


def joint_link(joint: ET.Element, end: str) -> str:
    """Name of a joint's parent or child link; `end` is ``"parent"`` or ``"child"``. Empty if the joint has none."""
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def mimicked_joints(root: ET.Element) -> dict[str, str]:
    """For each joint of a URDF that mimics another joint, as a gripper's fingers do, the name of the other joint."""
    return {
        str(joint.get("name")): str(mimic.get("joint"))
        for joint in root.findall("joint")
        for mimic in joint.findall("mimic")
    }


def check_schema(path: Path) -> list[str]:
    """Faults that the library yourdfpy finds in a URDF file, one sentence each; none prevents the use of the robot."""
    import yourdfpy  # the import takes half a second, mostly for meshes, which are not needed here

    # An error of yourdfpy is an opinion only: all needed parts of the file have been checked before.
    try:
        robot = yourdfpy.URDF.load(str(path), load_meshes=False, build_scene_graph=False)
        robot.validate()
    except Exception as error:
        return [f"yourdfpy cannot read it ({' '.join(repr(error).split())[:200]}); left as it is"]
    return [f"yourdfpy: {error}; left as it is" for error in robot.errors]


def check_limits(root: ET.Element, path: Path, joints: tuple[str, ...]) -> None:
    """Check the limits of position, velocity and effort of an arm's joints in a URDF; limits may be absent.

    Raises:
        UrdfError: a joint does not exist, a limit is negative, or a lower position limit is above the upper one.
    """
    by_name = {joint.get("name"): joint for joint in root.findall("joint")}
    for name in joints:
        joint = by_name.get(name)
        if joint is None:
            raise UrdfError(f"{path}: there is no joint '{name}'; choose among {', '.join(map(str, by_name))}")
        limit = joint.find("limit")
        values = {
            key: float(text) for key, text in ({} if limit is None else limit.attrib).items() if key in LIMIT_ATTRIBUTES
        }
        for key in ("effort", "velocity"):
            if values.get(key, 0.0) < 0.0:
                raise UrdfError(f"{path}: joint '{name}' has {key} limit {values[key]:g}; it must be positive")
        if values.get("lower", 0.0) > values.get("upper", 0.0):
            raise UrdfError(
                f"{path}: joint '{name}' has limits {values['lower']:g} to {values['upper']:g}; "
                "the lower one must be the smaller"
            )
