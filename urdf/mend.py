"""Mend a URDF: add or rewrite entries that an arm needs, and replace impossible inertias."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from urdf.find import locate_mesh
from urdf.library_output import library_errors
from urdf.robot import Array, UrdfError
from urdf.settings import FrameSettings
from urdf.validate import LIMIT_ATTRIBUTES, MOVING_JOINT_TYPES

CONTINUOUS_JOINT_POSITION_LIMIT = 2 * math.pi
"""Position limit to either side of a joint without limits [rad]."""


def add_frames(root: ET.Element, frames: Iterable[FrameSettings]) -> None:
    """Add each frame to a URDF as a massless link with a fixed joint, in place."""
    for frame in frames:
        ET.SubElement(root, "link", name=frame.name)
        joint = ET.SubElement(root, "joint", name=f"{frame.name}_joint", type="fixed")
        ET.SubElement(joint, "origin", xyz=" ".join(map(repr, frame.position)), rpy="0 0 0")
        ET.SubElement(joint, "parent", link=frame.parent)
        ET.SubElement(joint, "child", link=frame.name)


def rename_ambiguous_links(root: ET.Element) -> list[str]:
    """Rename the links of a URDF that have the name of a joint, in place; Pinocchio needs different names.

    Returns:
        A sentence per renamed link.
    """
    joints = {joint.get("name") for joint in root.findall("joint")}
    taken = joints | {link.get("name") for link in root.findall("link")}
    renamed = {}
    for link in root.findall("link"):
        name = link.get("name", "")
        if name in joints:
            renamed[name] = f"{name}_link" if f"{name}_link" not in taken else f"{name}_of_joint"
            link.set("name", renamed[name])
    for end in (*root.iter("parent"), *root.iter("child")):
        if end.get("link") in renamed:
            end.set("link", renamed[str(end.get("link"))])
    return [f"link '{old}' is called as a joint is; renamed to '{new}'" for old, new in renamed.items()]


def complete_limits(root: ET.Element, joints: tuple[str, ...]) -> list[str]:
    """Give every moving joint of a URDF a ``<limit>`` element, in place; the parser urdfdom requires one.

    A limit of zero means that the limit is unknown. Joints of the arm (`joints`) that turn without end get limits of
    one turn to either side, because Pinocchio describes such a joint by two coordinates.

    Returns:
        A sentence per joint of the arm that turns without end.
    """
    sentences = []
    for joint in root.findall("joint"):
        if joint.get("type") not in MOVING_JOINT_TYPES:
            continue
        limit = joint.find("limit")
        # Exporters write joints that turn without end as revolute ones whose limit holds effort and velocity only.
        turns = joint.get("type") == "revolute"
        unlimited = turns and limit is not None and {"lower", "upper"}.isdisjoint(limit.keys())
        limit = ET.SubElement(joint, "limit") if limit is None else limit
        if joint.get("name") in joints and (joint.get("type") == "continuous" or unlimited):
            said = "has no position limits" if unlimited else "is continuous"
            sentences.append(f"joint '{joint.get('name')}' {said}; taken as one turn to either side")
            joint.set("type", "revolute")
            limit.set("lower", repr(-CONTINUOUS_JOINT_POSITION_LIMIT))
            limit.set("upper", repr(CONTINUOUS_JOINT_POSITION_LIMIT))
        for key in LIMIT_ATTRIBUTES:
            limit.set(key, limit.get(key, "0"))
    return sentences


MIN_SHAPE_EXTENT = 0.01
"""Smallest extent of a link's shape that is believed [m]; smaller shapes are placeholders."""
MIN_GYRATION_TO_SHAPE_RATIO = 0.1
"""Smallest credible radius of gyration of a link, divided by that which its shapes suggest; a smaller one is that of a
point mass."""
MIN_LINK_MASS = 1e-3
"""Smallest mass of a real link [kg]; lighter links only mark a place."""
MIN_GYRATION_RADIUS_TO_OPEN_MESH = (
    0.25  # m of gyration from which a mesh is opened to measure it; primitive shapes are always measured
)
"""Radius of gyration from which a link's mesh is opened and measured [m]; primitive shapes are always measured."""
TRIANGLE_INEQUALITY_TOLERANCE = (
    1e-6  # relative slack of the triangle inequality, for numbers that were rounded when written
)
"""Relative tolerance of the triangle inequality of moments of inertia, because numbers are rounded when they are
written."""
MOMENT_NAMES = ("ixx", "iyy", "izz")
PRODUCT_NAMES = ("ixy", "ixz", "iyz")

BoundingBox = tuple[Array, Array]


@dataclass(frozen=True)
class InertiaFault:
    """A fault of a link's inertia in a URDF.

    Attributes:
        link: name of the link.
        sentence: the fault, and how it was repaired.
        replacement_moments: moments of inertia (3,) [kg m^2] from the link's collision shapes, if they replace those of
            the file.
        is_possible: whether a rigid body can have the inertia of the file.
    """

    link: str
    sentence: str
    replacement_moments: Array | None = None
    is_possible: bool = True


def mend_inertias(root: ET.Element, path: Path | None = None, directories: tuple[Path, ...] = ()) -> list[InertiaFault]:
    """Compare every link's inertia with its mass and collision shapes, and replace impossible inertias in place.

    The radius of gyration sqrt(I/m) of a body never exceeds its largest extent. Baxter's fingers violate this:
    0.01 kg m^2 at 20 g is a ring of 0.7 m radius. Such an inertia is replaced by that of a solid with the link's
    collision shapes. An inertia that is far too small does little harm and may stand for a point mass: it is listed and
    kept.

    Args:
        root: root element of the URDF.
        path: file of the URDF, from which meshes are found; without it, meshes are not measured.
        directories: directories that contain the packages of ``package://`` names.

    Returns:
        The faults, at most one per link.

    Raises:
        UrdfError: a mesh cannot be read.
    """
    found = []
    for link in root.iter("link"):
        mass_element, inertia_element = link.find("inertial/mass"), link.find("inertial/inertia")
        if mass_element is None or inertia_element is None:
            continue
        name = str(link.get("name"))
        mass = float(mass_element.get("value", "0"))
        moments, products = (
            [float(inertia_element.get(key, "0")) for key in of] for of in (MOMENT_NAMES, PRODUCT_NAMES)
        )
        boxes = list(_boxes(link, path, directories, mass, max(moments)))
        judged = _judge(name, mass, moments, products, boxes)
        if judged is None:
            continue
        found.append(judged)
        if judged.replacement_moments is not None:
            for key, value in zip(MOMENT_NAMES, judged.replacement_moments, strict=True):
                inertia_element.set(key, repr(float(value)))
            for key in PRODUCT_NAMES:
                inertia_element.set(key, "0")
    return found


def _judge(
    name: str, mass: float, moments: list[float], products: list[float], boxes: list[BoundingBox]
) -> InertiaFault | None:
    """Fault of one link's inertia; None without one."""
    largest, extent = max(moments), max((float(np.linalg.norm(size)) for _, size in boxes), default=0.0)
    solid = _inertia_of_boxes(mass, boxes) if extent >= MIN_SHAPE_EXTENT and mass > 0 else None
    if solid is not None and math.sqrt(max(largest, 0.0) / mass) > extent:
        body = 2 * math.sqrt(largest / mass)
        sentence = (
            f"link '{name}': inertia {largest:g} kg m^2 at {mass:g} kg needs a body of {body:.2g} m; "
            f"replaced by that of its collision shapes, {max(solid):.2g} kg m^2"
        )
        return InertiaFault(name, sentence, solid)
    tensor = np.diag(moments)
    tensor[np.triu_indices(3, 1)] = products
    wrong = impossible_inertia_reason(tensor)
    if wrong:
        return InertiaFault(name, f"link '{name}': {wrong}; left as they are: correct its <inertia>", is_possible=False)
    if solid is not None and mass >= MIN_LINK_MASS and largest < MIN_GYRATION_TO_SHAPE_RATIO**2 * max(solid):
        size = 2e3 * math.sqrt(max(largest, 0.0) / mass)
        sentence = (
            f"link '{name}': inertia {largest:g} kg m^2 at {mass:g} kg is that of a body of {size:.2g} mm, its "
            f"collision shapes suggest {max(solid):.2g} kg m^2; left as it is"
        )
        return InertiaFault(name, sentence)
    return None


def impossible_inertia_reason(inertia: Array) -> str:
    """Explain why no rigid body can have an inertia; empty where a body can have it.

    Every principal moment of inertia must be positive, and at most the sum of the two others.

    Args:
        inertia: inertia about the centre of mass, (3, 3) [kg m^2]; only the upper triangle is read.
    """
    principal = np.linalg.eigvalsh(inertia, UPLO="U")
    slack = TRIANGLE_INEQUALITY_TOLERANCE * max(principal[2], 0.0)
    if principal[0] >= -slack and principal[2] <= principal[0] + principal[1] + slack:
        return ""
    values = ", ".join(f"{value:.3g}" for value in principal)
    why = "as each must be positive and at most the sum of the others"
    return f"principal moments {values} kg m^2 belong to no body, {why}"


def _boxes(
    link: ET.Element, path: Path | None, directories: tuple[Path, ...], mass: float, largest: float
) -> Iterator[BoundingBox]:
    """Boxes around the collision shapes of a link: centre (3,) and size (3,) [m], in the link's axes."""
    for collision in link.findall("collision"):
        origin = collision.find("origin")
        centre = _vector(origin.get("xyz", "0 0 0") if origin is not None else "0 0 0")
        box, cylinder, sphere, mesh = (
            collision.find(f"geometry/{kind}") for kind in ("box", "cylinder", "sphere", "mesh")
        )
        if box is not None:
            yield centre, _vector(box.get("size", "0 0 0"))
        elif cylinder is not None:
            width = 2 * float(cylinder.get("radius", "0"))
            yield centre, np.array([width, width, float(cylinder.get("length", "0"))])
        elif sphere is not None:
            yield centre, np.full(3, 2 * float(sphere.get("radius", "0")))
        elif (
            mesh is not None and path is not None and mass > 0 and largest > mass * MIN_GYRATION_RADIUS_TO_OPEN_MESH**2
        ):
            found = locate_mesh(mesh.get("filename", ""), path, directories)
            if found is not None:
                low, high = _mesh_bounds(found, _vector(mesh.get("scale", "1 1 1")))
                yield centre + (low + high) / 2, high - low


def _mesh_bounds(path: Path, scale: Array) -> tuple[Array, Array]:
    """Lowest and highest corner (3,) [m] of a mesh."""
    import coal

    with library_errors(f"mesh {path} cannot be read", "correct or replace it"):
        mesh = coal.MeshLoader().load(str(path), scale)
        mesh.computeLocalAABB()
    if not np.isfinite(mesh.vertices()).all():
        raise UrdfError(f"mesh {path} holds a corner that is not a number; correct or replace it")
    return np.array(mesh.aabb_local.min_), np.array(mesh.aabb_local.max_)


def _inertia_of_boxes(mass: float, boxes: list[BoundingBox]) -> Array:
    """Moments of inertia (3,) [kg m^2] of boxes of equal density about their common centre of mass."""
    volumes = np.array([np.prod(size) for _, size in boxes])
    shares = mass * volumes / volumes.sum()
    centre = sum((share * c for share, (c, _) in zip(shares, boxes, strict=True)), np.zeros(3)) / mass
    total = np.zeros(3)
    for share, (c, size) in zip(shares, boxes, strict=True):
        squares, offsets = size**2 / 12, (c - centre) ** 2
        total += share * (squares.sum() - squares + offsets.sum() - offsets)
    return total


def _vector(text: str) -> Array:
    return np.array([float(value) for value in text.split()])
