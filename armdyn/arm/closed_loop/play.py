"""Play of an arm's joints between the drive, which reads its own position, and the link, whose position is recorded.

The link hangs at one end of its play as long as the torque that moves it keeps its sign, and its way to the other end
takes no time: q_link = q - b sign(load), with b half of the whole play and q the drive's position. Gravity acts on the
links where they are.
"""

from typing import Any

import numpy as np

from armdyn.arm.model import ArmModel
from armdyn.arm.rigid import inverse_dynamics

PLAY_PARAMETER = "backlash.play"
"""Parameter of a joint: its link's way to either side of the drive's position, rad or m."""
SOFT_LOAD_SHARE = 0.02
"""Load, as a share of its root mean square, within which a link is between the ends of its play."""


def has_play(model: ArmModel) -> bool:
    """Whether any joint of the model can have play."""
    return any(name.startswith(f"{PLAY_PARAMETER}[") for name in model.names)


def plays(model: ArmModel, theta: Any) -> list[Any]:
    """Play of each joint, rad or m, at (p,) parameters: numbers or expressions."""
    places = {name: i for i, name in enumerate(model.names)}
    own = [places.get(f"{PLAY_PARAMETER}[{joint}]") for joint in model.arm.joints]
    return [0.0 if i is None else theta[i] for i in own]


def play_sides(model: ArmModel, theta: np.ndarray, motion: tuple[np.ndarray, np.ndarray, np.ndarray]) -> np.ndarray:
    """(n, nj) ends of their plays at which the links hang, -1 to 1: a link is `play` times this behind its drive.

    Args:
        model: the arm.
        theta: (p,) parameters.
        motion: (n, nj) positions, velocities and accelerations.
    """
    q, v, a = (np.nan_to_num(part, posinf=0.0, neginf=0.0) for part in motion)
    load = inverse_dynamics(model.rigid_body_model_at(theta), q, v, a)
    size = SOFT_LOAD_SHARE * np.sqrt(np.mean(load**2, axis=0)) + np.finfo(float).tiny
    return load / np.hypot(load, size)
