"""The arm as MuJoCo's XML: bodies with their inertias, joints with damping, dry friction and armature, springs, motors.

A spring of zero free length between a point of a link and a point of the one before pulls with exactly a sine of the
joint's angle (Herder, Energy-free Systems, 2001), so that a gravity spring is held to the last digit, as a tendon.
"""

from shlex import quote
from xml.etree import ElementTree as ET

import numpy as np
import pinocchio as pin

from armdyn.arm.drives import Servo
from armdyn.arm.model import ArmModel
from armdyn.arm.rigid import about_centre, joint_axes
from armdyn.arm.symbolic import drive_readings
from pipeline.exports.format import Format, arm_of
from pipeline.exports.parts import HELD, ArmParts, child_link, left_over, need_body, parts_of
from urdf.write import numbers_text

DRY = {"solimpfriction": "0.9999 0.9999 0.001 0.5 2", "solreffriction": "0.004 1"}
"""Dry friction as hard as the solver takes it at its usual step of 2 ms. As MuJoCo has it by default, a light link
without armature slides through it at 2 rad/s, and its sign changes with the acceleration at speeds of 0.03 rad/s."""
LEVER = 0.1
"""m from the joint's axis to either end of a spring; its stiffness follows."""
LEAST = 1e-12
"""kg and kg m^2; MuJoCo refuses bodies that have less than 1e-15, and no torque shows this much."""
USUAL, FINEST, NOTHING = 2e-3, 1e-4, 2.5e-4
"""s; MuJoCo's usual step, than which no delay may be shorter: then the step is; the shortest step at which an actuator
acts no earlier than it should; and a delay that is left out."""
THICKNESS = 0.02
"""m; radius of the capsules that show the links."""


def mujoco_text(model: ArmModel) -> tuple[str, list[str]]:
    """The model as text, and what it cannot hold."""
    arm, parts = model.arm.model, parts_of(model)
    notes = [
        *left_over(model, HELD["mujoco"], "MuJoCo", told=model.servo_joints),
        "shapes: capsules stand for the links, nothing collides",
    ]
    root = ET.Element("mujoco", model=arm.name or "arm")
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    option = ET.SubElement(root, "option", gravity=numbers_text(parts.gravity), integrator="implicitfast")
    step = min(late for joint in parts.joints if (late := _late(model, joint.name) or USUAL))
    if step < USUAL:
        option.set("timestep", repr(step))
    world = ET.SubElement(root, "worldbody")
    ET.SubElement(world, "light", pos="0 0 3", directional="true")
    bodies = _add_bodies(world, model, parts)
    _add_shapes(bodies, model)
    _add_springs(root, bodies, model, parts)
    _add_drives(root, model, parts)
    for name, servo in model.drives.items():
        notes += [f"supply of {name}: its gain is that at {servo.supply:g} V"] if servo.supply is not None else []
        notes += [f"rate of {name}: limit what it is told to {servo.rate:g} per s"] if np.isfinite(servo.rate) else []
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n", notes


def _add_drives(root: ET.Element, model: ArmModel, parts: ArmParts) -> None:
    """A drive for every joint: the torque that its command, or a servo's law, gives is (command - offset) / gain."""
    actuators = ET.SubElement(root, "actuator")
    limits = model.arm.model.effortLimit.tolist()
    for joint, effort, (gain, offset) in zip(parts.joints, limits, drive_readings(model), strict=True):
        told, kind = {"name": joint.name, "joint": joint.name}, "motor"
        servo = model.servo(joint.name)
        if servo is not None and servo.gain is not None:
            # A friction that differs by direction is one that does not, and an offset, also at rest.
            law = _law(servo, servo.gain.value, gain, offset + gain * joint.uneven) | _delayed(_late(model, joint.name))
            ET.SubElement(actuators, "general", told | law)
            continue
        if gain != 1.0 or offset:
            told |= {"gainprm": repr(1.0 / gain), "biastype": "affine", "biasprm": repr(-offset / gain)}
            kind = "general"
        if np.isfinite(effort):
            told["ctrlrange"] = f"{offset - gain * effort!r} {offset + gain * effort!r}"
        ET.SubElement(actuators, kind, told)


def _law(servo: Servo, k: float, gain: float, offset: float) -> dict[str, str]:
    """A drive as an affine actuator: force = (k (told - is) - damping v - offset) / gain, within its limit."""
    own = {"position": (-k, -servo.damping), "velocity": (0.0, -k)}.get(servo.law, (0.0, 0.0))
    law = {"gainprm": repr(k / gain), "biastype": "affine", "biasprm": numbers_text(np.array([-offset, *own]) / gain)}
    if np.isfinite(servo.largest):
        law["forcerange"] = f"{(-servo.largest - offset) / gain!r} {(servo.largest - offset) / gain!r}"
    return law


def _delayed(late: float) -> dict[str, str]:
    """What an actuator is told acts late by so many s; its buffer holds that at steps of `FINEST`."""
    if not late:
        return {}
    return {"delay": repr(late), "nsample": str(int(np.ceil(late / FINEST)) + 2), "interp": "linear"}


def _late(model: ArmModel, joint: str) -> float:
    """How late the drive of a joint acts, s; 0 where that is next to nothing."""
    servo, own = model.servo(joint), model.parameters.get(f"command_delay.time[{joint}]")
    late = (servo.delay or 0.0 if servo is not None else 0.0) + (own.value if own is not None else 0.0)
    return late if late > NOTHING else 0.0


def _add_bodies(world: ET.Element, model: ArmModel, parts: ArmParts) -> list[ET.Element]:
    """A body for every joint, in their order, and the tool's place."""
    arm = model.arm.model
    names = _link_names(model)
    bodies: list[ET.Element] = []
    axes = joint_axes(arm)
    for i, joint in enumerate(parts.joints):
        parent, placement = int(arm.parents[i + 1]) - 1, arm.jointPlacements[i + 1]
        body = ET.SubElement(
            bodies[parent] if parent >= 0 else world,
            "body",
            name=names[i],
            pos=numbers_text(placement.translation),
            quat=_quaternion(np.asarray(placement.rotation)),
        )
        mass, centre, inertia = about_centre(joint.link)
        inertia = _for_mujoco(names[i], inertia)
        moments = (inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2])
        ET.SubElement(
            body,
            "inertial",
            pos=numbers_text(centre),
            mass=repr(max(mass, LEAST)),
            fullinertia=numbers_text(np.array(moments)),
        )
        slides = model.arm.slides[i]
        axis = axes[i][:3] if slides else axes[i][3:]
        dynamics = {"damping": joint.damping, "frictionloss": joint.friction, "armature": joint.armature}
        if joint.stiffness:
            dynamics |= {"stiffness": joint.stiffness, "springref": joint.rest}
        attributes = {key: repr(value) for key, value in dynamics.items() if value}
        if joint.friction:
            attributes |= DRY
        lower, upper = float(arm.lowerPositionLimit[i]), float(arm.upperPositionLimit[i])
        if np.isfinite(lower) and np.isfinite(upper):
            attributes["range"] = f"{lower!r} {upper!r}"
        ET.SubElement(
            body,
            "joint",
            {"name": joint.name, "type": "slide" if slides else "hinge", "axis": numbers_text(axis), **attributes},
        )
        bodies.append(body)
    frame = arm.frames[model.arm.robot.tool_frame_id]
    ET.SubElement(
        bodies[int(frame.parentJoint) - 1] if frame.parentJoint else world,
        "site",
        name="tool",
        pos=numbers_text(frame.placement.act(np.asarray(model.arm.robot.tool_offset))),
        quat=_quaternion(np.asarray(frame.placement.rotation)),
        size="0.01",
    )
    return bodies


def _for_mujoco(link: str, inertia: np.ndarray) -> np.ndarray:
    """The inertia (3, 3), kg m^2, of a link that may be a point, a rod or a plate, within MuJoCo's bounds.

    Raises:
        InputError: no body has it.
    """
    need_body(link, inertia)
    moments, axes = np.linalg.eigh(inertia)
    low, middle, high = np.maximum(moments, LEAST)
    bounded = np.array([low, middle, min(high, low + middle)])
    return inertia if np.array_equal(bounded, moments) else (axes * bounded) @ axes.T


def _add_shapes(bodies: list[ET.Element], model: ArmModel) -> None:
    """A capsule from every joint to the next one, to be seen; it weighs nothing and touches nothing."""
    arm, look = model.arm.model, {"contype": "0", "conaffinity": "0", "mass": "0", "rgba": "0.4 0.55 0.7 1"}
    for i, body in enumerate(bodies):
        ends = [arm.jointPlacements[k + 1].translation for k in range(len(bodies)) if arm.parents[k + 1] == i + 1]
        ends = [end for end in ends if np.linalg.norm(end) > THICKNESS]
        for end in ends:
            ET.SubElement(
                body,
                "geom",
                {"type": "capsule", "fromto": f"0 0 0 {numbers_text(end)}", "size": repr(THICKNESS), **look},
            )
        if not ends:
            ET.SubElement(body, "geom", {"type": "sphere", "size": repr(THICKNESS), **look})


def _add_springs(root: ET.Element, bodies: list[ET.Element], model: ArmModel, parts: ArmParts) -> None:
    """A s sin q + c cos q = A sin(q - q0): the ends of a spring of zero free length meet at q0."""
    arm, axes, tendons = model.arm.model, joint_axes(model.arm.model), None
    for i, joint in enumerate(parts.joints):
        sine, cosine = joint.spring
        size = float(np.hypot(sine, cosine))
        if size == 0.0:
            continue
        meet = float(np.arctan2(-cosine, sine))
        across = _perpendicular(axes[i][3:])
        placement = arm.jointPlacements[i + 1]
        on_link = LEVER * across
        turned = pin.AngleAxis(meet, np.asarray(axes[i][3:])).toRotationMatrix() @ on_link
        parent = int(arm.parents[i + 1]) - 1
        outer = bodies[parent] if parent >= 0 else root.find("worldbody")
        assert outer is not None
        ends = f"{joint.name}_spring_link", f"{joint.name}_spring_frame"
        ET.SubElement(bodies[i], "site", name=ends[0], pos=numbers_text(on_link), size="0.005")
        ET.SubElement(outer, "site", name=ends[1], pos=numbers_text(placement.act(turned)), size="0.005")
        tendons = tendons if tendons is not None else ET.SubElement(root, "tendon")
        spring = ET.SubElement(
            tendons, "spatial", name=f"{joint.name}_spring", stiffness=repr(size / LEVER**2), springlength="0"
        )
        for end in ends:
            ET.SubElement(spring, "site", site=end)


def _link_names(model: ArmModel) -> list[str]:
    """The URDF's name of the link that each joint moves."""
    document = ET.fromstring(model.arm.robot.urdf_xml)
    children = {joint.get("name"): child_link(joint) for joint in document.findall("joint")}
    return [children.get(name) or f"{name}_link" for name in model.arm.joints]


def _perpendicular(axis: np.ndarray) -> np.ndarray:
    """A unit vector across an axis."""
    aside = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    return np.asarray(aside / np.linalg.norm(aside))


def _quaternion(rotation: np.ndarray) -> str:
    q = pin.Quaternion(rotation)
    return numbers_text(np.array([q.w, q.x, q.y, q.z]))


FORMATS = (
    Format(
        ".xml",
        "MuJoCo model",
        lambda file, output, _: mujoco_text(arm_of(file, output)),
        lambda _: HELD["mujoco"],
        lambda _, output: f"python -m mujoco.viewer --mjcf={quote(str(output))}",
    ),
)
