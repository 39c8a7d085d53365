"""Export of an arm as URDF: the original file with inertias, friction, payload and tilted base of the model."""

import os
from pathlib import Path
from shlex import quote
from xml.etree import ElementTree as ET

import numpy as np
import pinocchio as pin

from armdyn.arm.model import ArmModel
from armdyn.arm.rigid import inertia_about_centre, is_physical, parameters_about_origin
from armdyn.errors import InputError
from armdyn.model_file import ModelFile
from pipeline.exports.format import ExportedModelText, Format, arm_of_model_file
from pipeline.exports.parts import (
    URDF_SLOTS,
    ExportedJointDynamics,
    exported_joint_dynamics,
    held_effects,
    inexpressible_effects,
    require_physical_inertia,
)
from urdf.robot import URDF_DYNAMICS
from urdf.validate import joint_link
from urdf.write import INERTIA_INDICES, add_joint, inertial_element

MOUNTING_LINK_NAME = "armdyn_world"
"""Name of the root link to which a tilted base is fixed in an exported URDF."""
PAYLOAD_LINK_NAME = "armdyn_payload"
"""Name of the link that represents the payload in an exported URDF."""


def urdf_text(model: ArmModel, folder: Path) -> tuple[str, list[str]]:
    """URDF of an arm with the values of its model.

    Args:
        model: the arm.
        folder: folder of the file to write, to which the paths of meshes are relative.

    Returns:
        Text of the URDF, and sentences on effects that it cannot express.
    """
    robot = model.arm.robot
    root = ET.fromstring(robot.urdf_xml)
    notes = inexpressible_effects(model, held_effects(model.effects, URDF_SLOTS), "a URDF")
    gravity = robot.model.gravity.linear
    if not np.array_equal(gravity, URDF_DYNAMICS.gravity):
        notes.append(f"gravity ({', '.join(f'{x:g}' for x in gravity)}) m/s^2: a URDF has no place for it")
    bare = model.without_effect("payload") if model.joints_having_effect("payload") else model
    for joint in exported_joint_dynamics(bare):
        element = _joint(root, joint.name)
        _set_dynamics(element, joint)
        if not np.array_equal(joint.link, joint.described):
            notes += _set_link(root, joint_link(element, "child"), joint)
    moved = {frame.name for frame in model.arm.model.frames if frame.parentJoint}
    for link in root.findall("link"):
        if link.get("name") in moved:
            require_physical_inertia(str(link.get("name")), inertia_about_centre(_inertial(link))[2])
    if bare is not model:
        _add_payload(root, model)
    if any(effect.reach == "base" for effect in model.effects):
        _mount(root, model)
    _give_shapes(root, ET.parse(robot.urdf_path).getroot())
    _move_meshes(root, robot.urdf_path.parent, folder)
    ET.indent(root)
    return '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n", notes


def _joint(root: ET.Element, name: str) -> ET.Element:
    found = next((joint for joint in root.findall("joint") if joint.get("name") == name), None)
    if found is None:
        raise InputError(f"the URDF has no joint '{name}' any more")
    return found


def _set_dynamics(element: ET.Element, joint: ExportedJointDynamics) -> None:
    """Write the model's friction in place of the URDF's, which armdyn does not use."""
    old = element.find("dynamics")
    if old is None and joint.damping == joint.friction == 0.0:
        return
    dynamics = old if old is not None else ET.SubElement(element, "dynamics")
    dynamics.set("damping", repr(joint.damping))
    dynamics.set("friction", repr(joint.friction))


def _set_link(root: ET.Element, name: str, joint: ExportedJointDynamics) -> list[str]:
    """Write the inertia of the model; links that are fixed to this one keep their own where that is possible."""
    link = next(element for element in root.findall("link") if element.get("name") == name)
    own = _inertial(link) + joint.link - joint.described
    notes = []
    if own[0] <= 0.0 or not is_physical(own):
        fixed = _fixed_to(root, name)
        for other in fixed:
            for inertial in other.findall("inertial"):
                other.remove(inertial)
        own = joint.link
        if fixed:
            names = ", ".join(str(other.get("name")) for other in fixed)
            notes.append(f"link {name} has the inertia of all that is fixed to it ({names}), which have none now")
    _write_inertial(link, own)
    return notes


def _fixed_to(root: ET.Element, name: str) -> list[ET.Element]:
    found, waiting = [], [name]
    links = {element.get("name"): element for element in root.findall("link")}
    while waiting:
        here = waiting.pop()
        for joint in root.findall("joint"):
            if joint.get("type") == "fixed" and joint_link(joint, "parent") == here:
                waiting.append(joint_link(joint, "child"))
                found.append(links[waiting[-1]])
    return found


def _inertial(link: ET.Element) -> np.ndarray:
    """Inertial parameters (10,) of one link in its own frame."""
    element = link.find("inertial")
    if element is None:
        return np.zeros(10)
    origin, mass, inertia = (element.find(tag) for tag in ("origin", "mass", "inertia"))
    xyz, rpy = _numbers(origin, "xyz"), _numbers(origin, "rpy")
    m = float(mass.get("value", "0")) if mass is not None else 0.0
    own = np.zeros((3, 3))
    for name, (row, column) in INERTIA_INDICES.items():
        own[row, column] = own[column, row] = float(inertia.get(f"i{name}", "0")) if inertia is not None else 0.0
    R = pin.rpy.rpyToMatrix(*rpy)
    return parameters_about_origin(m, xyz, R @ own @ R.T)


def _numbers(element: ET.Element | None, key: str) -> np.ndarray:
    text = element.get(key) if element is not None else None
    return np.array([float(x) for x in text.split()]) if text else np.zeros(3)


def _write_inertial(link: ET.Element, parameters: np.ndarray) -> None:
    for old in link.findall("inertial"):
        link.remove(old)
    link.insert(0, inertial_element(*inertia_about_centre(parameters)))


def _add_payload(root: ET.Element, model: ArmModel) -> None:
    """Add the payload, a point mass, as a link that is fixed to the last joint's link."""
    (joint,) = model.joints_having_effect("payload")
    mass, *place = (model.parameters[f"payload.{short}[{joint}]"].value for short in ("mass", "x", "y", "z"))
    link = ET.SubElement(root, "link", name=PAYLOAD_LINK_NAME)
    _write_inertial(link, parameters_about_origin(mass, np.zeros(3), np.zeros((3, 3))))
    add_joint(
        root, f"{PAYLOAD_LINK_NAME}_joint", "fixed", joint_link(_joint(root, joint), "child"), PAYLOAD_LINK_NAME, place
    )


def _mount(root: ET.Element, model: ArmModel) -> None:
    """Add a root link to which the base is fixed at its tilt."""
    children = {joint_link(joint, "child") for joint in root.findall("joint")}
    base = next(str(link.get("name")) for link in root.findall("link") if link.get("name") not in children)
    roll, pitch = (model.parameters[f"base_tilt.{short}"].value for short in ("roll", "pitch"))
    ET.SubElement(root, "link", name=MOUNTING_LINK_NAME)
    add_joint(root, f"{MOUNTING_LINK_NAME}_joint", "fixed", MOUNTING_LINK_NAME, base, rpy=(roll, pitch, 0.0))


def _give_shapes(root: ET.Element, original: ET.Element) -> None:
    """Write the shapes of the original file, also where a mesh is not on this machine."""
    shapes = {
        link.get("name"): [*link.findall("visual"), *link.findall("collision")] for link in original.findall("link")
    }
    for link in root.findall("link"):
        for tag in ("visual", "collision"):
            for shape in link.findall(tag):
                link.remove(shape)
        link.extend(shapes.get(link.get("name"), []))


def _move_meshes(root: ET.Element, old: Path, new: Path) -> None:
    """Make the names of meshes, relative to the old file's folder, relative to the new one."""
    for mesh in root.iter("mesh"):
        name = mesh.get("filename", "")
        if name and "://" not in name and not Path(name).is_absolute():
            mesh.set("filename", os.path.relpath(old / name, new))


def _export(file: ModelFile, output: Path, _about: str) -> ExportedModelText:
    model = arm_of_model_file(file, output)
    text, notes = urdf_text(model, output.resolve().parent)
    usage = f"armdyn new arm M.toml --urdf {quote(str(output))}, or give it to your simulator"
    return ExportedModelText(text, notes, held_effects(model.effects, URDF_SLOTS), usage)


FORMATS = (Format(".urdf", "URDF", _export),)
