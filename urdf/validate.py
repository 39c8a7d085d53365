"""Whether a URDF describes one robot that can be used; a sentence per defect."""

import math
from pathlib import Path
from xml.etree import ElementTree as ET

from urdf.find import locate_mesh, package_dirs
from urdf.plain import LARGEST_FILE, check_depth
from urdf.robot import UrdfError

MOST_LINKS = 2000
"""And joints; a humanoid with its hands has 100."""


def parse(path: Path) -> ET.Element:
    """Read a URDF file.

    Raises:
        UrdfError: there is no such file, it is not XML, or it is not a URDF.
    """
    try:
        with path.open("rb") as file:
            data = file.read(LARGEST_FILE + 1)
    except (OSError, ValueError) as error:  # a name with a null character is a ValueError
        why = getattr(error, "strerror", None) or error
        raise UrdfError(f"{path}: cannot be read ({why}); give the path of a URDF file") from error
    if len(data) > LARGEST_FILE:
        raise UrdfError(f"{path}: is larger than {LARGEST_FILE / 2**20:g} MiB; give a URDF file")
    try:
        root = ET.fromstring(data)
    except (ET.ParseError, ValueError, LookupError) as error:  # also an encoding that nobody knows
        raise UrdfError(f"{path}: not an XML file ({error}); expand xacro files first, with 'xacro'") from error
    if root.tag != "robot":
        raise UrdfError(f"{path}: the root element is <{root.tag[:60]}>, not <robot>; give a URDF file")
    check_depth(root, path)
    return root


def check_tree(root: ET.Element, path: Path) -> None:
    """Check that links and joints form one tree.

    Raises:
        UrdfError: no links, no moving joints, an unknown link, two parents, several roots or a cycle.
    """
    links = [link.get("name", "") for link in root.findall("link")]
    joints = root.findall("joint")
    if not links:
        raise UrdfError(f"{path}: it has no links; give a URDF that describes a robot")
    if max(len(links), len(joints)) > MOST_LINKS:
        raise UrdfError(
            f"{path}: it has {len(links)} links and {len(joints)} joints; give a robot of {MOST_LINKS} at most"
        )
    if not any(joint.get("type") in ("revolute", "continuous", "prismatic") for joint in joints):
        raise UrdfError(f"{path}: it has no moving joint; give a URDF with revolute or prismatic joints")
    for kind, names in (("link", links), ("joint", [joint.get("name", "") for joint in joints])):
        twice = {name for name in names if names.count(name) > 1}
        if twice:
            raise UrdfError(f"{path}: {kind} '{min(twice)}' is defined twice; rename one of them")
    parent_of: dict[str, tuple[str, str]] = {}
    for joint in joints:
        name = joint.get("name", "")
        ends = [
            element.get("link", "") if (element := joint.find(end)) is not None else "" for end in ("parent", "child")
        ]
        for end in ends:
            if end not in links:
                raise UrdfError(f"{path}: joint '{name}' refers to link '{end}', which is not defined; add it")
        if ends[1] in parent_of:
            other = parent_of[ends[1]][0]
            raise UrdfError(f"{path}: link '{ends[1]}' hangs from two joints, '{other}' and '{name}'; keep one")
        parent_of[ends[1]] = (name, ends[0])
    for link in links:
        seen = [link]
        while seen[-1] in parent_of:
            seen.append(parent_of[seen[-1]][1])
            if seen[-1] == link:
                raise UrdfError(f"{path}: the links form a cycle, {' <- '.join(seen)}; a URDF must be a tree")
            if len(seen) > len(links):
                break
    roots = [link for link in links if link not in parent_of]
    if len(roots) != 1:
        raise UrdfError(f"{path}: {len(roots)} links have no parent ({', '.join(roots)}); join them by fixed joints")


def check_schema(path: Path) -> list[str]:
    """What yourdfpy finds wrong with the file: a sentence per defect, none of which stops the robot from being used."""
    import yourdfpy  # half a second, most of it for meshes that are not needed here

    # Whatever it stumbles over, it is an opinion: what is needed of the file has been checked by ourselves.
    try:
        robot = yourdfpy.URDF.load(str(path), load_meshes=False, build_scene_graph=False)
        robot.validate()
    except Exception as error:
        return [f"yourdfpy cannot read it ({' '.join(repr(error).split())[:200]}); left as it is"]
    return [f"yourdfpy: {error}; left as it is" for error in robot.errors]


def check_limits(root: ET.Element, path: Path, joints: tuple[str, ...]) -> None:
    """Check that every joint of the arm says how far, how fast and how strongly it moves.

    Raises:
        UrdfError: an unknown joint, or one without usable limits.
    """
    by_name = {joint.get("name"): joint for joint in root.findall("joint")}
    for name in joints:
        joint = by_name.get(name)
        if joint is None:
            raise UrdfError(f"{path}: there is no joint '{name}'; choose among {', '.join(map(str, by_name))}")
        limit = joint.find("limit")
        needed = (
            ("effort", "velocity") if joint.get("type") == "continuous" else ("lower", "upper", "effort", "velocity")
        )
        missing = [key for key in needed if limit is None or limit.get(key) is None]
        if missing:
            raise UrdfError(f"{path}: joint '{name}' has no limit {', '.join(missing)}; add it to its <limit>")
        values = {} if limit is None else {key: finite_number(limit, key, f"{path}: joint '{name}'") for key in needed}
        for key in ("effort", "velocity"):
            if not values[key] > 0:
                raise UrdfError(f"{path}: joint '{name}' has {key} limit {values[key]:g}; it must be positive")
        if "lower" in values and not values["lower"] < values["upper"]:
            raise UrdfError(
                f"{path}: joint '{name}' has limits {values['lower']:g} to {values['upper']:g}; "
                "the lower one must be the smaller"
            )


def finite_number(element: ET.Element, key: str, where: str, default: str = "") -> float:
    """An attribute of a URDF's element.

    Raises:
        UrdfError: it is no finite number; `where` begins the message.
    """
    text = element.get(key, default)
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UrdfError(f'{where} has {key}="{text}"; it must be a finite number')
    return value


def find_meshes(root: ET.Element, path: Path) -> tuple[tuple[Path, ...], tuple[str, ...]]:
    """The package directories of a URDF, and the names of meshes that are not there."""
    uris = dict.fromkeys(str(mesh.get("filename")) for mesh in root.iter("mesh") if mesh.get("filename"))
    names = {uri.removeprefix("package://").split("/")[0] for uri in uris if uri.startswith("package://")}
    directories = package_dirs(path, names)
    return directories, tuple(uri for uri in uris if locate_mesh(uri, path, directories) is None)


def make_absolute(root: ET.Element, path: Path) -> None:
    """Write relative mesh names of a URDF in full, in place, so that its text can be read from anywhere."""
    for mesh in root.iter("mesh"):
        uri = str(mesh.get("filename", ""))
        if uri and "://" not in uri:
            mesh.set("filename", str((path.parent / uri).resolve()))
