"""Find the joints of a robot's gripper from the masses that they move and their ranges, not from their names."""

import math
from copy import deepcopy
from xml.etree import ElementTree as ET

import pinocchio as pin

from urdf.validate import MOVING_JOINT_TYPES, mimicked_joints

MAX_FINGER_SHARE_OF_ARM_MASS = 1 / 15
"""Largest mass that a gripper's joint moves, as a share of the mass that the first joint of its chain moves.

Over the 69 robots of the package example-robot-data, jaws and fingers have at most 0.058 of that mass. The calves of
quadrupeds, which open as jaws do, have at least 0.088.
"""
MAX_JAW_SHARE_OF_PARENT_LINK_MASS = 0.5
"""Largest mass of a single jaw, as a share of the mass of the link that carries it.

In the package example-robot-data, jaws have at most 0.34 of that mass, wrists and heads at least 1.
"""
MAX_JAW_OPENING = {"revolute": math.pi, "prismatic": 0.1}
"""Largest range of a single jaw's joint [rad or m]; jaws in example-robot-data open by at most 2.2, light wrists turn
further."""


def gripper_joints(root: ET.Element) -> frozenset[str]:
    """Names of the joints in a URDF that belong to a gripper or a hand.

    Such a joint moves little of the arm's mass. In addition, one of three holds: it is one of several on the same palm;
    it mimics another joint, or another joint mimics it; or it is a single jaw, the last joint of the chain, which opens
    by less than half a turn and is lighter than the link that carries it. The result is empty where every joint would
    belong to the gripper, as for a hand without an arm.
    """
    elements = {str(joint.get("name")): joint for joint in root.findall("joint")}
    followed, model = mimicked_joints(root), _model(root)
    coupled = {*followed, *followed.values()}
    data, joints = model.createData(), range(1, model.njoints)
    pin.computeSubtreeMasses(model, data)
    light = {j for j in joints if data.mass[j] < MAX_FINGER_SHARE_OF_ARM_MASS * data.mass[model.supports[j][1]]}
    found: set[str] = set()
    for j in light:
        palm, beyond = model.parents[j], list(model.subtrees[j])
        several = len(model.children[palm]) > 1 and light.issuperset(model.children[palm])
        lone = len(beyond) == 1 and _opens_as_jaw(elements[model.names[j]])
        is_jaw = lone and data.mass[j] < MAX_JAW_SHARE_OF_PARENT_LINK_MASS * model.inertias[palm].mass
        if several or model.names[j] in coupled or is_jaw:
            found.update(model.names[k] for k in beyond)
    return frozenset(found) if len(found) < len(joints) else frozenset()


def _model(root: ET.Element) -> pin.Model:
    """Pinocchio model of a URDF with masses and moving joints only."""
    copy = deepcopy(root)
    for joint in copy.findall("joint"):
        if joint.get("type") not in MOVING_JOINT_TYPES:
            joint.set("type", "fixed")
        for element in [part for part in joint if part.tag not in ("origin", "parent", "child", "axis")]:
            joint.remove(element)
        ET.SubElement(joint, "limit", lower="-1", upper="1", velocity="1", effort="1")  # urdfdom asks for some
    return pin.buildModelFromXML(ET.tostring(copy, encoding="unicode"))


def _opens_as_jaw(joint: ET.Element) -> bool:
    limit = joint.find("limit")
    if limit is None:
        return False
    opening = float(limit.get("upper", "0")) - float(limit.get("lower", "0"))
    return 0.0 < opening < MAX_JAW_OPENING.get(str(joint.get("type")), 0.0)
