"""The arm as MuJoCo's XML: bodies with their inertias, joints with damping, dry friction and armature, springs, motors.

A spring of zero free length between a point of a link and a point of the previous link gives a torque that is exactly a
sine of the joint's angle (Herder, Energy-free Systems, 2001). So a gravity spring is exported without error, as a
tendon.
"""

from collections.abc import Sequence
from pathlib import Path
from shlex import quote
from xml.etree import ElementTree as ET

import numpy as np
import pinocchio as pin

from armdyn.arm.model import ArmModel
from armdyn.arm.rigid import inertia_about_centre, joint_axes
from armdyn.model_file import ModelFile
from pipeline.exports.format import ExportedModelText, Format, arm_of_model_file
from pipeline.exports.mujoco_drives import add_drives, add_stribeck_frictions, integration, neutral_inertia
from pipeline.exports.mujoco_start import add_start, play_joint
from pipeline.exports.parts import (
    MUJOCO_SLOTS,
    ExportedJointDynamics,
    exported_joint_dynamics,
    held_effects,
    inexpressible_effects,
    require_physical_inertia,
)
from urdf.validate import joint_link
from urdf.write import xml_number_list

DRY_FRICTION_SOLVER = {"solimpfriction": "0.9999 0.9999 0.001 0.5 2"}
"""Solver parameters of the hardest dry friction that is stable. With default values a light link without armature
slides at 2 rad/s, and below 0.03 rad/s friction follows the sign of the acceleration."""
HARD_STOP = {"solimplimit": "0.99 0.999 0.001 0.5 2"}
"""Solver parameters of the ends of a joint's play, which the link neither enters nor leaves by itself."""
SOLVER_TIME_STEPS = 2.0
"""Time constant of both in time steps, the shortest that MuJoCo accepts."""
PLAY_ARMATURE_SHARE = 0.01
"""Armature of a joint's play, as a share of the inertia that it moves; a drive without rotor would weigh nothing."""
GRAVITY_SPRING_LEVER = 0.1
"""Distance from the joint's axis to either end of an exported gravity spring [m]; its stiffness follows from it."""
MIN_MASS_AND_INERTIA = 1e-12
"""Smallest exported mass [kg] and moment of inertia [kg m^2]; MuJoCo refuses less than 1e-15."""
LINK_CAPSULE_RADIUS = 0.02
"""Radius of the visible capsules that represent the links in MuJoCo [m]."""


def mujoco_text(model: ArmModel) -> tuple[str, list[str]]:
    """MuJoCo's XML of an arm with the values of its model, and sentences on effects that it cannot express."""
    arm, parts, gravity = model.arm.model, exported_joint_dynamics(model), model.gravity()
    notes = [
        *inexpressible_effects(
            model, held_effects(model.effects, MUJOCO_SLOTS), "MuJoCo", uneven_drives=model.servo_joints
        ),
        "shapes: capsules stand for the links, nothing collides",
        *(
            f"play of {joint.name}: its link stands at {joint.name} + {play_joint(joint.name)}"
            for joint in parts
            if joint.play
        ),
    ]
    root = ET.Element("mujoco", model=arm.name or "arm")
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    by = integration(model, parts)
    option = {"gravity": xml_number_list(gravity), "integrator": by.integrator, "timestep": repr(by.step)}
    ET.SubElement(root, "option", option)
    world = ET.SubElement(root, "worldbody")
    ET.SubElement(world, "light", pos="0 0 3", directional="true")
    bodies = _add_bodies(world, model, parts, by.step)
    _add_shapes(bodies, model)
    _add_springs(root, bodies, model, parts)
    add_drives(root, model, parts, by)
    add_stribeck_frictions(root, model, parts, by.step)
    add_start(root, model, parts)
    for name, servo in model.drives.items():
        notes += [f"supply of {name}: its gain is that at {servo.supply:g} V"] if servo.supply is not None else []
        notes += [f"rate of {name}: limit its command to {servo.rate:g} per s"] if np.isfinite(servo.rate) else []
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n", notes


def _add_bodies(
    world: ET.Element, model: ArmModel, parts: Sequence[ExportedJointDynamics], step: float
) -> list[ET.Element]:
    """Add a body for every joint, in the order of the joints, and a site at the tool."""
    arm, names, axes = model.arm.model, _link_names(model), joint_axes(model.arm.model)
    inertias, bodies = np.diag(neutral_inertia(model)).tolist(), list[ET.Element]()
    solver_time = f"{SOLVER_TIME_STEPS * step!r} 1"
    for i, joint in enumerate(parts):
        parent, placement = int(arm.parents[i + 1]) - 1, arm.jointPlacements[i + 1]
        outer = bodies[parent] if parent >= 0 else world
        body = ET.SubElement(outer, "body", {"name": names[i], **_pose(placement, placement.translation)})
        mass, centre, inertia = inertia_about_centre(joint.link)
        inertia = _for_mujoco(names[i], inertia)
        moments = xml_number_list(inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
        mass_text = repr(max(mass, MIN_MASS_AND_INERTIA))
        ET.SubElement(body, "inertial", pos=xml_number_list(centre), mass=mass_text, fullinertia=moments)
        slides = model.arm.slides[i]
        axis = axes[i][:3] if slides else axes[i][3:]
        attributes = {"name": joint.name, "type": "slide" if slides else "hinge", "axis": xml_number_list(axis)}
        dynamics = {"damping": joint.damping, "frictionloss": joint.friction, "armature": joint.armature}
        if joint.stiffness:
            dynamics |= {"stiffness": joint.stiffness, "springref": joint.rest}
        attributes |= {key: repr(value) for key, value in dynamics.items() if value}
        attributes |= {"solreffriction": solver_time, **DRY_FRICTION_SOLVER} if joint.friction else {}
        lower, upper = float(arm.lowerPositionLimit[i]), float(arm.upperPositionLimit[i])
        if np.isfinite(lower) and np.isfinite(upper):
            attributes["range"] = f"{lower!r} {upper!r}"
        ET.SubElement(body, "joint", attributes)
        if joint.play:
            span = {"name": play_joint(joint.name), "range": f"{-joint.play!r} {joint.play!r}"}
            span |= {"solreflimit": solver_time, **HARD_STOP}
            span["armature"] = repr(PLAY_ARMATURE_SHARE * inertias[i])
            ET.SubElement(body, "joint", {key: attributes[key] for key in ("type", "axis")} | span)
        bodies.append(body)
    frame, offset = arm.frames[model.arm.robot.tool_frame_id], np.asarray(model.arm.robot.tool_offset)
    outer = bodies[int(frame.parentJoint) - 1] if frame.parentJoint else world
    pose = _pose(frame.placement, frame.placement.act(offset))
    ET.SubElement(outer, "site", {"name": "tool", **pose, "size": "0.01"})
    return bodies


def _pose(placement: pin.SE3, position: np.ndarray) -> dict[str, str]:
    q = pin.Quaternion(np.asarray(placement.rotation))
    return {"pos": xml_number_list(position), "quat": xml_number_list(np.array([q.w, q.x, q.y, q.z]))}


def _for_mujoco(link: str, inertia: np.ndarray) -> np.ndarray:
    """The inertia (3, 3) [kg m^2] of a link, which may be a point, a rod or a plate, within MuJoCo's bounds."""
    require_physical_inertia(link, inertia)
    moments, axes = np.linalg.eigh(inertia)
    low, middle, high = np.maximum(moments, MIN_MASS_AND_INERTIA)
    bounded = np.array([low, middle, min(high, low + middle)])
    return inertia if np.array_equal(bounded, moments) else (axes * bounded) @ axes.T


def _add_shapes(bodies: list[ET.Element], model: ArmModel) -> None:
    """Add visible capsules from every joint to the next ones, without mass and contacts."""
    arm, look = model.arm.model, {"contype": "0", "conaffinity": "0", "mass": "0", "rgba": "0.4 0.55 0.7 1"}
    look |= {"size": repr(LINK_CAPSULE_RADIUS)}
    for i, body in enumerate(bodies):
        ends = [arm.jointPlacements[k + 1].translation for k in range(len(bodies)) if arm.parents[k + 1] == i + 1]
        ends = [end for end in ends if np.linalg.norm(end) > LINK_CAPSULE_RADIUS]
        shapes = [{"type": "capsule", "fromto": f"0 0 0 {xml_number_list(end)}"} for end in ends] or [
            {"type": "sphere"}
        ]
        for shape in shapes:
            ET.SubElement(body, "geom", shape | look)


def _add_springs(
    root: ET.Element, bodies: list[ET.Element], model: ArmModel, parts: Sequence[ExportedJointDynamics]
) -> None:
    """Add a tendon for every gravity spring.

    Its torque is s sin q + c cos q = A sin(q - q0); the ends of a spring of zero free length meet at q0.
    """
    arm, axes = model.arm.model, joint_axes(model.arm.model)
    sprung = [(i, joint) for i, joint in enumerate(parts) if any(joint.spring)]
    tendons = ET.SubElement(root, "tendon") if sprung else root
    for i, joint in sprung:
        sine, cosine = joint.spring
        axis = np.asarray(axes[i][3:])
        across = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
        on_link = GRAVITY_SPRING_LEVER * across / np.linalg.norm(across)
        turned = pin.AngleAxis(float(np.arctan2(-cosine, sine)), axis).toRotationMatrix() @ on_link
        parent, placement = int(arm.parents[i + 1]) - 1, arm.jointPlacements[i + 1]
        outer = bodies[parent] if parent >= 0 else root.find("worldbody")
        assert outer is not None
        stiffness = repr(float(np.hypot(sine, cosine)) / GRAVITY_SPRING_LEVER**2)
        spring = ET.SubElement(tendons, "spatial", name=f"{joint.name}_spring", stiffness=stiffness, springlength="0")
        for body, end, place in ((bodies[i], "link", on_link), (outer, "frame", placement.act(turned))):
            name = f"{joint.name}_spring_{end}"
            ET.SubElement(body, "site", name=name, pos=xml_number_list(place), size="0.005")
            ET.SubElement(spring, "site", site=name)


def _link_names(model: ArmModel) -> list[str]:
    document = ET.fromstring(model.arm.robot.urdf_xml)
    children = {joint.get("name"): joint_link(joint, "child") for joint in document.findall("joint")}
    return [children.get(name) or f"{name}_link" for name in model.arm.joints]


def _export(file: ModelFile, output: Path, _about: str) -> ExportedModelText:
    model = arm_of_model_file(file, output)
    text, notes = mujoco_text(model)
    usage = f"python -m mujoco.viewer --mjcf={quote(str(output))}"
    return ExportedModelText(text, notes, held_effects(model.effects, MUJOCO_SLOTS), usage)


FORMATS = (Format(".xml", "MuJoCo model", _export),)
