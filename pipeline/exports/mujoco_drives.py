"""The drives of an arm in MuJoCo's XML: actuators with a servo's law and delay, and the integration that they need.

A delayed actuator reads the last commands, one a step, with linear interpolation: at a time s that is the mean of the
command over the step of length h that begins at s. What acts at t - d is thus read at t - (d + h/2), which is the delay
in the file. Only a velocity loop in an implicit step needs d itself: its new velocity is that of the step's middle.
So MuJoCo's Runge-Kutta method moves an arm as `armdyn.arm.closed_loop.simulator` does, to rounding if nothing sticks.
Its implicit method, for loops that are too stiff for the other, takes all damping half a step late.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree as ET

import numpy as np
import pinocchio as pin
from scipy.linalg import eigh

from armdyn.arm.closed_loop.rollout import MAX_ROLLOUT_STEP_SECONDS
from armdyn.arm.drives import Servo
from armdyn.arm.model import ArmModel
from armdyn.arm.symbolic import drive_reading_gains_and_offsets
from pipeline.exports.parts import ExportedJointDynamics
from urdf.write import xml_number_list

DEFAULT_TIME_STEP = 2e-3
"""Time step [s] of an arm without servos, MuJoCo's usual one."""
MIN_TIME_STEP = 1e-4
"""Shortest time step [s] at which MuJoCo applies an actuator's delay correctly: its buffer is long enough for that."""
RUNGE_KUTTA, IMPLICIT = "RK4", "implicitfast"
"""MuJoCo's names of its integrators."""
MIN_EXPORTED_DELAY_SECONDS = 2.5e-4
"""Shortest delay that is exported [s]."""
DELAYS_PER_STEP = 1.5
"""Least ratio of delay and step: a Runge-Kutta step of length h reads the command at t + h - (d + h/2), before t."""
MAX_RATE_STEPS = 1.0
"""Largest product of step and rate, of damping or of vibration, for the Runge-Kutta method, which is unstable above
2.8; the rates are those of the neutral posture, and larger in some others."""
PRESLIDING = 1e-4
"""Way [rad or m] by which a joint gives before its Stribeck friction slides; a longer one is seen at each reversal, a
shorter one makes a SO-101's wrists stick elsewhere (held out 1.00 times the model's own error, half of it: 1.03)."""
STRIBECK_REMAINDER = 1e-3
"""Share of a Stribeck friction that remains at high speed, which MuJoCo's friction must not lose entirely."""
MAX_PRESLIDING_RATE_STEPS = 0.5
"""Largest product of step and rate of a vibration on the stiffness before sliding."""
IMPLICIT_STEP_SHARE = 0.5
"""Step of the implicit method, which is of first order, as a share of that of the Runge-Kutta method."""


@dataclass(frozen=True)
class Integration:
    """How MuJoCo integrates an exported arm.

    Attributes:
        step: time step [s].
        integrator: MuJoCo's name of the method.
    """

    step: float
    integrator: str


def integration(model: ArmModel, parts: Sequence[ExportedJointDynamics]) -> Integration:
    """The integration with which MuJoCo moves an arm as the model's own roll-out does.

    The step is that of the roll-out, or shorter where a delay or a stiff servo needs it. An arm without servos has
    MuJoCo's usual step.
    """
    if not model.servo_joints:
        return Integration(DEFAULT_TIME_STEP, IMPLICIT)
    delays = [late / DELAYS_PER_STEP for joint in parts if (late := drive_delay(model, joint.name))]
    longest = min([MAX_ROLLOUT_STEP_SECONDS, *delays])
    explicit = min(longest, MAX_RATE_STEPS / max(_largest_rate(model, parts), np.finfo(float).tiny))
    fades = any(joint.stribeck[0] > 0.0 for joint in parts)  # only the implicit method integrates that exactly
    if not fades and explicit >= IMPLICIT_STEP_SHARE * longest:
        return Integration(_even_step(explicit), RUNGE_KUTTA)
    return Integration(_even_step(IMPLICIT_STEP_SHARE * longest), IMPLICIT)


def _even_step(longest: float) -> float:
    """Longest step [s] of which one or more make a millisecond: commands of usual rates then begin with a step."""
    count = np.ceil(1e-3 / max(longest, MIN_TIME_STEP) - 1e-9)
    return 1e-3 / max(float(count), 1.0)


def _largest_rate(model: ArmModel, parts: Sequence[ExportedJointDynamics]) -> float:
    """Largest rate [1/s] at which a motion is damped, or vibrates, in the arm's neutral posture."""
    servos = [model.servo(joint.name) for joint in parts]
    gain, damping = np.zeros(len(parts)), np.array([joint.damping for joint in parts])
    for j, servo in enumerate(servos):
        if servo is not None and servo.gain is not None:
            gain[j], damped = servo.feedback
            damping[j] += damped
    inertia = neutral_inertia(model) + np.diag([joint.armature for joint in parts])
    damped, squared = (float(eigh(np.diag(part), inertia, eigvals_only=True)[-1]) for part in (damping, gain))
    return max(damped, float(np.sqrt(squared)))


def neutral_inertia(model: ArmModel) -> np.ndarray:
    """(nj, nj) inertia [kg m^2 or kg] of the joints in the arm's neutral posture, without rotors."""
    rigid = model.rigid_body_model_at(model.theta())
    upper = np.triu(pin.crba(rigid, rigid.createData(), pin.neutral(rigid)))
    return np.asarray(upper + np.triu(upper, 1).T)


def drive_delay(model: ArmModel, joint: str) -> float:
    """Delay of a joint's drive [s]; 0 where it is shorter than `MIN_EXPORTED_DELAY_SECONDS`."""
    servo, own = model.servo(joint), model.parameters.get(f"command_delay.time[{joint}]")
    late = (servo.delay or 0.0 if servo is not None else 0.0) + (own.value if own is not None else 0.0)
    return late if late > MIN_EXPORTED_DELAY_SECONDS else 0.0


def add_drives(root: ET.Element, model: ArmModel, parts: Sequence[ExportedJointDynamics], by: Integration) -> None:
    """Add an actuator for every joint, which gives the torque (command - offset) / gain, or that of a servo's law.

    Args:
        root: MuJoCo's XML.
        model: the arm.
        parts: its joints.
        by: how the file is integrated.
    """
    actuators = ET.SubElement(root, "actuator")
    limits = model.arm.model.effortLimit.tolist()
    for joint, effort, (gain, offset) in zip(parts, limits, drive_reading_gains_and_offsets(model), strict=True):
        attributes, kind = {"name": joint.name, "joint": joint.name}, "motor"
        servo = model.servo(joint.name)
        if servo is not None and servo.gain is not None:
            # A friction that differs by direction is exported as a symmetric one and an offset, also at rest.
            law = _law(servo, servo.gain.value, gain, offset + gain * joint.uneven)
            if late := drive_delay(model, joint.name):
                late += 0.0 if by.integrator == IMPLICIT and servo.control.senses == "velocity" else by.step / 2
                count = int(np.ceil(late / MIN_TIME_STEP)) + 2
                law |= {"delay": repr(late), "nsample": str(count), "interp": "linear"}
            ET.SubElement(actuators, "general", attributes | law)
            continue
        if gain != 1.0 or offset:
            attributes |= {"gainprm": repr(1.0 / gain), "biastype": "affine", "biasprm": repr(-offset / gain)}
            kind = "general"
        if np.isfinite(effort):
            attributes["ctrlrange"] = f"{offset - gain * effort!r} {offset + gain * effort!r}"
        ET.SubElement(actuators, kind, attributes)


def _law(servo: Servo, k: float, gain: float, offset: float) -> dict[str, str]:
    """A drive as an affine actuator: force = (k (q_cmd - q) - damping v - offset) / gain, within its limit."""
    own = 0.0 - np.array(servo.feedback)
    law = {
        "gainprm": repr(k / gain),
        "biastype": "affine",
        "biasprm": xml_number_list(np.array([-offset, *own]) / gain),
    }
    if np.isfinite(servo.largest):
        law["forcerange"] = f"{(-servo.largest - offset) / gain!r} {(servo.largest - offset) / gain!r}"
    return law


def add_stribeck_frictions(
    root: ET.Element, model: ArmModel, parts: Sequence[ExportedJointDynamics], step: float
) -> None:
    """Add a passive motor for every joint with Stribeck friction, which has no control and acts by its friction alone.

    MuJoCo's motors have the friction of Canudas de Wit et al. (A New Model for Control of Systems with Friction, IEEE
    Trans. Automatic Control 40, 1995), whose steady part is that of the effect: f exp(-(v/v_s)^2).

    Args:
        root: MuJoCo's XML, with its actuators.
        model: the arm.
        parts: its joints.
        step: time step [s].
    """
    actuators = root.find("actuator")
    assert actuators is not None
    held_back = np.diag([joint.armature + step * joint.damping for joint in parts])
    felt = 1.0 / np.diag(np.linalg.inv(neutral_inertia(model) + held_back))  # while the other joints may move
    for joint, moved in zip(parts, felt.tolist(), strict=True):
        torque, speed = joint.stribeck
        if torque <= 0.0:
            continue
        stiffness = min(torque / PRESLIDING, moved * (MAX_PRESLIDING_RATE_STEPS / step) ** 2)
        friction = np.array([stiffness, 0.0, STRIBECK_REMAINDER * torque, torque, speed])
        passive = {"input": "none", "motorconst": "0 0", "resistance": "1", "lugre": xml_number_list(friction)}
        ET.SubElement(actuators, "dcmotor", {"name": f"{joint.name}_stribeck", "joint": joint.name, **passive})
