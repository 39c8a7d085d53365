"""Defects of a URDF that can be mended without guessing, and the frames that it lacks."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from xml.etree import ElementTree as ET

import numpy as np

from urdf.robot import Array

PLACEHOLDER = 0.01  # m


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


def mend_inertias(root: ET.Element) -> list[str]:
    """Give links whose inertia no body of their size could have the inertia of their collision shapes.

    The radius of gyration sqrt(I/m) of a body never exceeds its largest extent. Baxter's fingers break this rule:
    0.01 kg m^2 at 20 g is a ring of 0.7 m radius. Shapes below a centimetre are placeholders and tell nothing.

    Args:
        root: the URDF; changed in place.

    Returns:
        A sentence per link that was mended.
    """
    sentences = []
    for link in root.iter("link"):
        mass_element = link.find("inertial/mass")
        inertia_element = link.find("inertial/inertia")
        boxes = [box for box in (_bounding_box(shape) for shape in link.findall("collision")) if box is not None]
        if mass_element is None or inertia_element is None or not boxes:
            continue
        mass = float(mass_element.get("value", "0"))
        moments = [float(inertia_element.get(key, "0")) for key in ("ixx", "iyy", "izz")]
        extent = max(float(np.linalg.norm(size)) for _, size in boxes)
        if mass <= 0 or extent < PLACEHOLDER or math.sqrt(max(moments) / mass) <= extent:
            continue
        mended = _inertia_of_boxes(mass, boxes)
        for key, value in zip(("ixx", "iyy", "izz"), mended, strict=True):
            inertia_element.set(key, repr(float(value)))
        for key in ("ixy", "ixz", "iyz"):
            inertia_element.set(key, "0")
        sentences.append(
            f"link '{link.get('name')}': inertia {max(moments):g} kg m^2 at {mass:g} kg needs a body of "
            f"{2 * math.sqrt(max(moments) / mass):.2g} m; replaced by that of its collision shapes, "
            f"{max(mended):.2g} kg m^2"
        )
    return sentences


def add_frames(root: ET.Element, frames: Iterable[Frame]) -> None:
    """Add massless links with fixed joints to a URDF, in place."""
    for frame in frames:
        ET.SubElement(root, "link", name=frame.name)
        joint = ET.SubElement(root, "joint", name=f"{frame.name}_joint", type="fixed")
        ET.SubElement(joint, "origin", xyz=" ".join(map(repr, map(float, frame.position))), rpy="0 0 0")
        ET.SubElement(joint, "parent", link=frame.parent)
        ET.SubElement(joint, "child", link=frame.name)


def _bounding_box(collision: ET.Element) -> tuple[Array, Array] | None:
    """Centre (3,) and size (3,) [m] of a primitive shape; its own rotation is ignored (a right angle or none)."""
    origin = collision.find("origin")
    centre = _vector(origin.get("xyz", "0 0 0") if origin is not None else "0 0 0")
    box, cylinder, sphere = (collision.find(f"geometry/{kind}") for kind in ("box", "cylinder", "sphere"))
    if box is not None:
        return centre, _vector(box.get("size", "0 0 0"))
    if cylinder is not None:
        width = 2 * float(cylinder.get("radius", "0"))
        return centre, np.array([width, width, float(cylinder.get("length", "0"))])
    if sphere is not None:
        return centre, np.full(3, 2 * float(sphere.get("radius", "0")))
    return None


def _inertia_of_boxes(mass: float, boxes: list[tuple[Array, Array]]) -> Array:
    """Moments (3,) [kg m^2] of boxes of one density about their common centre of mass."""
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
