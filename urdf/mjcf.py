"""A robot in MuJoCo's own XML, an MJCF, written as a URDF: everything else goes on from there.

Pinocchio reads it, includes, defaults and the inertias of shapes. What a URDF needs and an MJCF does not say, speeds
and sometimes torques, is assumed and told; what a URDF of armdyn has no place for is told as well.
"""

from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pinocchio as pin

from urdf.quiet import told
from urdf.robot import Array, UrdfError
from urdf.write import add_joint, inertial_element, numbers_text

SPEED = {"revolute": 1.0, "continuous": 1.0, "prismatic": 0.25}
"""rad/s or m/s that are assumed: an MJCF has no speed limits; 0.25 m/s is the reduced speed of ISO 10218-1."""
EFFORT = 50.0
"""N m or N that are assumed where the file gives none."""
FARTHEST = 2.0
"""m that a sliding joint without a range is given to either side."""
ASSUMED = "of an MJCF: "
"""How sentences begin that say what was assumed or left out."""
GRAVITY = (0.0, 0.0, -9.81)


def as_urdf(path: Path) -> tuple[ET.Element, list[str]]:
    """The URDF of the robot in an MJCF, and a sentence per thing that was assumed or left out.

    Raises:
        UrdfError: Pinocchio cannot read it, or a joint neither turns about an axis nor slides along one.
    """
    with told(f"{path}: Pinocchio cannot read it as an MJCF", "correct it"):
        model = pin.buildModelFromMJCF(str(path))
    document = ET.parse(path).getroot()
    forces = _forces(document)
    root = ET.Element("robot", name=str(document.get("model") or path.stem))
    names = _body_names(model)
    sentences: list[str] = []
    weak, loose = [], []
    axes = _axes(model)
    for link in dict.fromkeys(names.values()):
        ET.SubElement(root, "link", name=link)
    links = {link.get("name"): link for link in root.findall("link")}
    for i in range(1, model.njoints):
        joint, name = model.joints[i], str(model.names[i])
        if joint.nv != 1:
            if joint.nv == 6 and int(model.parents[i]) == 0:
                sentences.append(f"'{name}' floats; taken as fixed to the world")
                _join(root, name, "fixed", names[0], names[i], model.jointPlacements[i])
                _weigh(links[names[i]], model.inertias[i])
                continue
            raise UrdfError(
                f"{path}: joint '{name}' is neither one hinge nor one slide; give every joint a body of its own, and "
                "no ball joints"
            )
        slides = bool(np.abs(axes[i][:3]).max() > 0.5)
        lower, upper = (float(limit[joint.idx_q]) for limit in (model.lowerPositionLimit, model.upperPositionLimit))
        bounded = joint.nq == 1 and np.isfinite(lower) and np.isfinite(upper) and lower < upper
        kind = "prismatic" if slides else "revolute" if bounded else "continuous"
        element = _join(root, name, kind, names[int(model.parents[i])], names[i], model.jointPlacements[i])
        ET.SubElement(element, "axis", xyz=numbers_text(axes[i][:3] if slides else axes[i][3:]))
        effort = float(model.effortLimit[joint.idx_v])
        effort = effort if np.isfinite(effort) and effort > 0 else forces.get(name, 0.0)
        if not effort:
            weak.append(name)
        limit = ET.SubElement(element, "limit", effort=repr(effort or EFFORT), velocity=repr(SPEED[kind]))
        if kind != "continuous":
            limit.set("lower", repr(lower if bounded else -FARTHEST))
            limit.set("upper", repr(upper if bounded else FARTHEST))
        if not slides and not bounded:
            loose.append(name)
        _weigh(links[names[i]], model.inertias[i])
    _add_frames(root, model, names)
    _couple(root, document)
    sentences.append(f"it has no speed limits; {SPEED['revolute']:g} rad/s and {SPEED['prismatic']:g} m/s were assumed")
    if weak:
        sentences.append(f"no limit of force on {', '.join(weak)}; {EFFORT:g} N m or N was assumed")
    dynamics = [
        what for what in ("armature", "damping", "frictionloss") if document.find(f".//joint[@{what}]") is not None
    ]
    if dynamics:
        sentences.append(f"{', '.join(dynamics)} of its joints are left out: add the effects, or let repair find them")
    return root, [f"{ASSUMED}{sentence}" for sentence in (*sentences, *_gravity(document))]


def _axes(model: pin.Model) -> dict[int, Array]:
    """By joint with one degree of freedom: (6,) linear and angular motion in its own frame, per unit."""
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    found = {}
    for i in range(1, model.njoints):
        columns = pin.getJointJacobian(model, data, i, pin.LOCAL).reshape(6, model.nv)
        if model.joints[i].nv == 1:
            found[i] = np.asarray(columns[:, model.joints[i].idx_v])
    return found


def _body_names(model: pin.Model) -> dict[int, str]:
    """By joint the name of the body that it moves; of the world ``world``, or that of its first body."""
    names = {0: "world"}
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY and int(frame.parentJoint) and int(frame.parentJoint) not in names:
            names[int(frame.parentJoint)] = str(frame.name)
    taken: set[str] = set()
    for i in range(model.njoints):
        name = names.get(i) or f"{model.names[i]}_link"
        names[i] = name if name not in taken else f"{name}_{i}"
        taken.add(names[i])
    return names


def _add_frames(root: ET.Element, model: pin.Model, names: dict[int, str]) -> None:
    """Sites and further bodies as massless links, so that one can be the tool."""
    taken = set(names.values())
    for frame in model.frames:
        name = str(frame.name)
        if frame.type in (pin.FrameType.BODY, pin.FrameType.OP_FRAME) and name not in taken and name != "universe":
            taken.add(name)
            ET.SubElement(root, "link", name=name)
            _join(root, f"{name}_fixed", "fixed", names[int(frame.parentJoint)], name, frame.placement)


def _join(root: ET.Element, name: str, kind: str, parent: str, child: str, placement: pin.SE3) -> ET.Element:
    rpy = pin.rpy.matrixToRpy(np.asarray(placement.rotation))
    return add_joint(root, name, kind, parent, child, placement.translation, rpy)


def _weigh(link: ET.Element, inertia: pin.Inertia) -> None:
    if inertia.mass > 0.0:
        link.append(inertial_element(inertia.mass, inertia.lever, inertia.inertia))


def _forces(document: ET.Element) -> dict[str, float]:
    """By joint: the largest force of the actuators that name it, where they say one themselves."""
    found: dict[str, float] = {}
    for actuator in document.findall("./actuator/*"):
        text, gear = actuator.get("forcerange"), abs(float((actuator.get("gear") or "1").split()[0]))
        if text is None and actuator.tag == "motor":
            text = actuator.get("ctrlrange")
        joint = actuator.get("joint")
        if joint and text:
            found[joint] = max(abs(float(word)) for word in text.split()) * gear
    return found


def _couple(root: ET.Element, document: ET.Element) -> None:
    """Joints that follow others, as the fingers of a gripper do."""
    joints = {joint.get("name"): joint for joint in root.findall("joint")}
    for equality in document.findall("./equality/joint"):
        first, second = equality.get("joint1"), equality.get("joint2")
        if first in joints and second in joints:
            ET.SubElement(joints[first], "mimic", joint=str(second))


def _gravity(document: ET.Element) -> list[str]:
    option = document.find("./option[@gravity]")
    given = GRAVITY if option is None else tuple(float(word) for word in str(option.get("gravity")).split())
    if len(given) == 3 and np.abs(np.subtract(given, GRAVITY)).max() > 0.05:
        shown = " ".join(f"{value:g}" for value in given)
        return [f"its gravity {shown} is left out; the base is taken to stand upright"]
    return []
