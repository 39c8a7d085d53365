"""Play of an arm's joints between the drive, which reads its own position, and the link, whose position is recorded.

The link hangs at one end of its play as long as the torque that moves it keeps its sign: q_link = q - b sign(load),
with b half of the whole play and q the drive's position. Gravity acts on the links where they are. The way to the other
end takes no time for the drive; the link is recorded where it falls meanwhile.
"""

from typing import Any

import numpy as np
import pinocchio as pin

from armdyn.arm.model import ArmModel
from armdyn.arm.rigid import inverse_dynamics
from armdyn.arm.slots import PLAY_PARAMETER

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


def play_sides(
    model: ArmModel,
    theta: np.ndarray,
    motion: tuple[np.ndarray, np.ndarray, np.ndarray],
    time: np.ndarray | None = None,
) -> np.ndarray:
    """(n, nj) places of links in their plays, -1 to 1: a link is `play` times this behind its drive.

    A link hangs at the end to which its load pushes it. With times it crosses the play as it falls: the way x behind
    its drive follows M x'' = load between the ends, at which it stays; M is its inertia and load is the torque that
    would move it with its drive.

    Args:
        model: the arm.
        theta: (p,) parameters.
        motion: (n, nj) positions, velocities and accelerations.
        time: (n,) increasing times, s; None means separate moments.
    """
    q, v, a = (np.nan_to_num(part, posinf=0.0, neginf=0.0) for part in motion)
    rigid = model.rigid_body_model_at(theta)
    load = inverse_dynamics(rigid, q, v, a) - rigid.armature * a  # a rotor turns with its drive
    size = SOFT_LOAD_SHARE * np.sqrt(np.mean(load**2, axis=0)) + np.finfo(float).tiny
    found = load / np.hypot(load, size)
    way = np.array(plays(model, theta), dtype=float)
    if time is None or not np.any(way > 0.0):
        return found
    inertia = np.diag(pin.crba(rigid, rigid.createData(), q[len(q) // 2])) - rigid.armature
    for j in np.flatnonzero(way > 0.0):
        found[:, j] = _crossed(load[:, j] / (inertia[j] * way[j]), time, found[0, j])
    return found


def _crossed(pushes: np.ndarray, time: np.ndarray, start: float) -> np.ndarray:
    """(n,) places, -1 to 1, that are accelerated by (n,) `pushes`, 1/s^2, between ends at which they stay."""
    found, at, speed = np.empty(len(time)), start, 0.0
    for k, (push, lasts) in enumerate(zip(pushes.tolist(), np.diff(time, append=time[-1]).tolist(), strict=True)):
        found[k] = at
        speed += lasts * push
        at += lasts * (speed - 0.5 * lasts * push)
        if not -1.0 < at < 1.0:
            at, speed = max(-1.0, min(at, 1.0)), 0.0
    return found
