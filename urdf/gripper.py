"""Find a robot's gripper joints by what they move and how far, not by their names."""

import math
from copy import deepcopy
from xml.etree import ElementTree as ET

import pinocchio as pin

from urdf.validate import MOVING_JOINT_TYPES, copied

MAX_FINGER_MASS_SHARE = 1 / 15
"""Largest share that fingers have of what the first joint of their chain moves. Over the 69 robots of the package
example-robot-data: jaws and fingers up to 0.058, the calves of quadrupeds, which open as jaws do, from
0.088."""
MAX_JAW_MASS_SHARE = 0.5
"""Largest mass of a lone jaw, of that which carries it: jaws there have up to 0.34, wrists and heads at least 1."""
MAX_JAW_OPENING = {"revolute": math.pi, "prismatic": 0.1}
"""rad or m; a lone jaw opens by less, jaws there by up to 2.2; a wrist that is as light as a jaw rolls further."""


def gripper_joints(root: ET.Element) -> frozenset[str]:
    """Names of joints of grippers and hands in a URDF, with all joints behind them.

    They move little of the arm's mass, and either there are several on one palm, or one copies another, or it is a lone
    jaw: the last joint, which opens less than half a turn and is lighter than what carries it. Empty where all joints
    would be a gripper's, as in the description of a hand alone.
    """
    elements = {str(joint.get("name")): joint for joint in root.findall("joint")}
    followed, model = copied(root), _model(root)
    coupled = {*followed, *followed.values()}
    data, joints = model.createData(), range(1, model.njoints)
    pin.computeSubtreeMasses(model, data)
    light = {j for j in joints if data.mass[j] < MAX_FINGER_MASS_SHARE * data.mass[model.supports[j][1]]}
    found: set[str] = set()
    for j in light:
        palm, beyond = model.parents[j], list(model.subtrees[j])
        several = len(model.children[palm]) > 1 and light.issuperset(model.children[palm])
        lone = len(beyond) == 1 and _opens_as_jaw(elements[model.names[j]])
        is_jaw = lone and data.mass[j] < MAX_JAW_MASS_SHARE * model.inertias[palm].mass
        if several or model.names[j] in coupled or is_jaw:
            found.update(model.names[k] for k in beyond)
    return frozenset(found) if len(found) < len(joints) else frozenset()


def _model(root: ET.Element) -> pin.Model:
    """Masses along the moving joints of a URDF; links that are fixed to each other are one body."""
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
