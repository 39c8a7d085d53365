"""What a URDF lacks or says in a way that an arm cannot use, added or rewritten without guessing."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from xml.etree import ElementTree as ET

from urdf.robot import Array

TURN = 2 * math.pi


@dataclass(frozen=True)
class Frame:
    """A massless frame to be added, fixed to a link.

    Attributes:
        name: name of the new link.
        parent: link that carries it.
        position: origin in the parent's frame, (3,) [m].
    """

    name: str
    parent: str
    position: Array


def add_frames(root: ET.Element, frames: Iterable[Frame]) -> None:
    """Add massless links with fixed joints to a URDF, in place."""
    for frame in frames:
        ET.SubElement(root, "link", name=frame.name)
        joint = ET.SubElement(root, "joint", name=f"{frame.name}_joint", type="fixed")
        ET.SubElement(joint, "origin", xyz=" ".join(map(repr, map(float, frame.position))), rpy="0 0 0")
        ET.SubElement(joint, "parent", link=frame.parent)
        ET.SubElement(joint, "child", link=frame.name)


def bound_continuous_joints(root: ET.Element, joints: tuple[str, ...]) -> list[str]:
    """Give the arm's endless joints one turn to either side, so that each has one coordinate and a margin.

    Args:
        root: the URDF; changed in place.
        joints: of the arm.

    Returns:
        A sentence per joint.
    """
    sentences = []
    for joint in root.findall("joint"):
        if joint.get("name") not in joints:
            continue
        limit = joint.find("limit")
        # Exporters write joints that turn without end as revolute ones whose limit holds effort and velocity only.
        turns = joint.get("type") == "revolute"
        unlimited = turns and limit is not None and {"lower", "upper"}.isdisjoint(limit.keys())
        if joint.get("type") == "continuous" or unlimited:
            said = "has no position limits" if unlimited else "is continuous"
            sentences.append(f"joint '{joint.get('name')}' {said}; taken as one turn to either side")
            joint.set("type", "revolute")
            limit = ET.SubElement(joint, "limit") if limit is None else limit
            limit.set("lower", repr(-TURN))
            limit.set("upper", repr(TURN))
    return sentences


def leave_out_shapes(root: ET.Element, missing: Iterable[str]) -> list[str]:
    """Remove visual and collision shapes whose mesh is not there.

    Args:
        root: the URDF; changed in place.
        missing: names of meshes as the URDF writes them.

    Returns:
        A sentence per mesh.
    """
    gone = dict.fromkeys(missing)
    for link in root.iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            mesh = shape.find("geometry/mesh")
            if mesh is not None and mesh.get("filename") in gone:
                link.remove(shape)
    return [f"mesh '{uri}' is missing; left out, and no collision is checked against it" for uri in gone]
