"""The load of an arm as the controllers of Universal Robots and Franka Emika are told it."""

from typing import Any

import numpy as np
import pinocchio as pin

from armdyn.arm.model import ArmModel

PAYLOAD = ("mass", "x", "y", "z")
"""Quantities of a load: mass [kg] and place in the frame of the last joint [m]."""
SECOND_MOMENTS = ("xx", "yy", "zz", "xy", "xz", "yz")
UR_INERTIA = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Second moments of a load, and their places in a matrix; inertias have the same order in ``set_target_payload``."""
UR_FLANGE, UR_JOINT = "tool0", "wrist_3_joint"
"""Frame of the flange of Universal Robots, and the joint that moves it."""
FRANKA_FLANGES = ("panda_link8", "fr3_link8")
"""Frames of the flange of Franka Emika's arms."""


def load_command(model: ArmModel) -> dict[str, Any] | None:
    """Command of a load that repair has found, and its values; None for another load or another arm.

    Returns:
        ``command``, ``mass`` [kg], ``mass_std``, ``centre`` in the frame of the flange (3,) [m] and ``centre_std``;
        ``inertia`` (3, 3) about the centre in the axes of the flange [kg m^2] where it was found.
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
    inertia = _inertia(model, joint)
    turned_inertia = np.zeros((3, 3)) if inertia is None else turned @ inertia @ turned.T
    if flange == UR_FLANGE and inertia is not None:
        entries = ", ".join(f"{turned_inertia[at]:.5f}" for at in UR_INERTIA)
        command = f"set_target_payload({mass:.3f}, [{point}], [{entries}])"
    elif flange == UR_FLANGE:
        command = f"set_payload({mass:.3f}, [{point}])"
    else:
        entries = ", ".join(f"{x:.5f}" if inertia is not None else "0.0" for x in turned_inertia.ravel(order="F"))
        command = f"robot.setLoad({mass:.3f}, {{{point}}}, {{{entries}}})"
    return {
        "command": command,
        "mass": mass,
        "mass_std": mass_std,
        "centre": centre.tolist(),
        "centre_std": centre_std.tolist(),
        **({} if inertia is None else {"inertia": turned_inertia.tolist()}),
    }


def _inertia(model: ArmModel, joint: str) -> np.ndarray | None:
    """(3, 3) inertia of a load about its centre, in the axes of the last joint, kg m^2; None if it was not found."""
    names = {at: f"payload_inertia.{name}[{joint}]" for name, at in zip(SECOND_MOMENTS, UR_INERTIA, strict=True)}
    if not set(names.values()) <= set(model.names):
        return None
    moments = np.zeros((3, 3))
    for (i, j), name in names.items():
        moments[i, j] = moments[j, i] = model.value(name)
    return np.asarray(np.trace(moments) * np.eye(3) - moments)


def load_sentence(command: dict[str, Any]) -> str:
    """The command with its uncertainties, as a sentence."""
    spread = ", ".join(f"{1e3 * std:.2g}" for std in command["centre_std"])
    point = "" if "inertia" in command else "; a point, its own inertia is not known"
    sure = f"+- {command['mass_std']:.2g} kg; +- {spread} mm{point}"
    return f"load beyond the description: {command['command']} ({sure})"
