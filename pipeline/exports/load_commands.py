"""The load of an arm as the controllers of Universal Robots and Franka Emika are told it."""

from typing import Any

import numpy as np
import pinocchio as pin

from armdyn.arm.model import ArmModel

PAYLOAD = ("mass", "x", "y", "z")
"""Quantities of a load: mass [kg] and place in the frame of the last joint [m]."""
UR_FLANGE, UR_JOINT = "tool0", "wrist_3_joint"
"""Frame of the flange of Universal Robots, and the joint that moves it."""
FRANKA_FLANGES = ("panda_link8", "fr3_link8")
"""Frames of the flange of Franka Emika's arms."""


def load_command(model: ArmModel) -> dict[str, Any] | None:
    """Command of a load that repair has found, and its values; None for another load or another arm.

    Returns:
        ``command``, ``mass`` [kg], ``mass_std``, ``centre`` in the frame of the flange (3,) [m] and ``centre_std``.
    """
    frames, joint = model.arm.model, model.arm.joints[-1]
    found = [parameters for key in PAYLOAD if (parameters := model.parameters.get(f"payload.{key}[{joint}]"))]
    flange = next((name for name in (UR_FLANGE, *FRANKA_FLANGES) if frames.existFrame(name)), None)
    if len(found) < len(PAYLOAD) or any(p.std is None for p in found) or flange is None:
        return None
    if flange == UR_FLANGE and joint != UR_JOINT:
        return None
    frame = frames.frames[frames.getFrameId(flange)]
    if frame.parentJoint != len(model.arm.joints):
        return None
    (mass, *place), (mass_std, *place_std) = [p.value for p in found], [float(p.std or 0.0) for p in found]
    turned = np.asarray(frame.placement.rotation).T
    centre = np.asarray(pin.SE3(frame.placement).actInv(np.array(place)))
    centre_std = np.sqrt(turned**2 @ np.square(place_std))
    point = ", ".join(f"{x:.4f}" for x in centre)
    if flange == UR_FLANGE:
        command = f"set_payload({mass:.3f}, [{point}])"
    else:
        command = f"robot.setLoad({mass:.3f}, {{{point}}}, {{{', '.join(['0.0'] * 9)}}})"
    return {
        "command": command,
        "mass": mass,
        "mass_std": mass_std,
        "centre": centre.tolist(),
        "centre_std": centre_std.tolist(),
    }


def load_sentence(command: dict[str, Any]) -> str:
    """The command with its uncertainties, as a sentence."""
    spread = ", ".join(f"{1e3 * std:.2g}" for std in command["centre_std"])
    return (
        f"load beyond the description: {command['command']} (+- {command['mass_std']:.2g} kg; +- {spread} mm; a point, "
        "its own inertia is not known)"
    )
