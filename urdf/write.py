"""Write elements of a URDF, with numbers in full precision."""

from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import ArrayLike

INERTIA_INDICES = {"xx": (0, 0), "xy": (0, 1), "xz": (0, 2), "yy": (1, 1), "yz": (1, 2), "zz": (2, 2)}
"""Row and column of each entry of an inertia matrix."""
ZERO_VECTOR = (0.0, 0.0, 0.0)


def xml_number_list(vector: ArrayLike) -> str:
    """Numbers as the text of an XML attribute, separated by spaces, in full precision."""
    return " ".join(repr(float(x)) for x in np.ravel(vector))


def inertial_element(mass: float, centre: ArrayLike, inertia: ArrayLike) -> ET.Element:
    """Make an ``<inertial>`` element from a mass [kg], its centre (3,) [m] and the inertia about it (3, 3) [kg m^2]."""
    moments = np.asarray(inertia)
    element = ET.Element("inertial")
    ET.SubElement(element, "origin", xyz=xml_number_list(centre), rpy="0 0 0")
    ET.SubElement(element, "mass", value=repr(float(mass)))
    ET.SubElement(element, "inertia", {f"i{name}": repr(float(moments[at])) for name, at in INERTIA_INDICES.items()})
    return element


def add_joint(
    root: ET.Element,
    name: str,
    kind: str,
    parent: str,
    child: str,
    xyz: ArrayLike = ZERO_VECTOR,
    rpy: ArrayLike = ZERO_VECTOR,
) -> ET.Element:
    """Add a ``<joint>`` element between two links to a URDF.

    Args:
        root: root element of the URDF.
        name: name of the joint.
        kind: type of the joint, such as ``"revolute"``.
        parent: name of the parent link.
        child: name of the child link.
        xyz: position of the joint in the frame of the parent link, (3,) [m].
        rpy: orientation of the joint in the frame of the parent link as roll, pitch and yaw, (3,) [rad].
    """
    joint = ET.SubElement(root, "joint", name=name, type=kind)
    ET.SubElement(joint, "origin", xyz=xml_number_list(xyz), rpy=xml_number_list(rpy))
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    return joint
