"""The plant at time 0: hanging from the stretched string, at rest."""

from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from armdyn.errors import InputError
from pipeline.robot.forces import LoadString
from pipeline.robot.protocol import Vector
from pipeline.robot.settings import PlantSettings


@dataclass(frozen=True)
class Start:
    """What holds the plant at rest.

    Attributes:
        torque: motor torque of each joint (n,) [N m].
        string_length: length of the string without pull [m].
    """

    torque: Vector
    string_length: float


def place_at_rest(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    string: LoadString,
    dofs: npt.NDArray[np.intp],
    q: Vector,
    settings: PlantSettings,
    along: Vector,
    pull: Vector,
    out_of_plane: float,
) -> Start:
    """Put the arm at `q` and the load where it hangs, and make the string as long as that takes.

    The string gives way under the load; its length without pull is found such that the load hangs at
    ``settings.length`` exactly, which is what a ruler measures. A start angle then turns it about the pivot.

    Args:
        model: the plant.
        data: its state, overwritten.
        string: between gripper and load; its length is changed.
        dofs: index of each joint in MuJoCo's velocity, and for hinges in its position (n,).
        q: joint positions (n,) [rad].
        settings: length and start angle.
        along: unit vector of the line (3,).
        pull: weight and wind, what the string carries at rest (3,) [N].
        out_of_plane: start angle across the line [rad].
    """
    data.qpos[dofs] = q
    mujoco.mj_kinematics(model, data)
    pivot = data.site("pivot").xpos.copy()
    weight = float(np.linalg.norm(pull))
    down = pull / weight
    _place_load(model, data, pivot, down, settings.length)
    torque = _holding_torque(model, data, dofs, pull)
    rest = _string_length(model, data, string, dofs, torque, settings.length, weight)
    string.length = rest
    if settings.start_angle or out_of_plane:
        across = np.cross([0.0, 0.0, 1.0], along)
        turn = Rotation.from_rotvec(out_of_plane * along) * Rotation.from_rotvec(settings.start_angle * across)
        turned = turn.apply(down)
        # The pull, and with it the stretch, falls with the cosine of the angle.
        _place_load(model, data, pivot, turned, rest + (settings.length - rest) * float(turned @ down))
    data.qvel[:] = data.qacc[:] = 0.0  # the torque holds the arm, which these evaluations were without
    return Start(torque, rest)


def _place_load(model: mujoco.MjModel, data: mujoco.MjData, pivot: Vector, direction: Vector, distance: float) -> None:
    """Put the load at a distance [m] from the pivot (3,) along a unit vector (3,)."""
    joint = model.body("load").jntadr[0]
    address = model.jnt_qposadr[joint]
    if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
        data.qpos[address : address + 7] = [*(pivot + distance * direction), 1.0, 0.0, 0.0, 0.0]
    else:
        turn = model.joint("turn").qposadr[0]
        wanted = data.site("pivot").xmat.reshape(3, 3).T @ direction
        mujoco.mju_quatZ2Vec(data.qpos[turn : turn + 4], wanted)
        data.qpos[address] = distance - model.body("load").pos[2]
    mujoco.mj_forward(model, data)


def _holding_torque(model: mujoco.MjModel, data: mujoco.MjData, dofs: npt.NDArray[np.intp], pull: Vector) -> Vector:
    """Motor torque (n,) [N m] that balances gravity, springs and the hanging load."""
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jacSite(model, data, jacobian, None, model.site("pivot").id)
    torque: Vector = (data.qfrc_bias - data.qfrc_applied - jacobian.T @ pull)[dofs]
    return torque


def _string_length(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    string: LoadString,
    dofs: npt.NDArray[np.intp],
    torque: Vector,
    distance: float,
    weight: float,
) -> float:
    """Length without pull [m] at which the string carries `weight` [N] over `distance` [m]; linear."""
    trial = mujoco.MjData(model)
    trial.qpos[:] = data.qpos
    trial.qfrc_applied[:] = data.qfrc_applied
    trial.qfrc_applied[dofs] += torque
    trial.xfrc_applied[:] = data.xfrc_applied
    # The motors' own springs are not part of the balance: their reference is set so that they exert `torque`.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    guesses, tensions = [distance - 1e-4, distance - 2e-4], []
    for guess in guesses:
        string.length = guess
        mujoco.mj_forward(model, trial)
        tensions.append(string.pull(trial))
    model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    slope = (tensions[1] - tensions[0]) / (guesses[1] - guesses[0])
    if not slope < 0.0:
        raise InputError(
            f"PlantSettings.mass is too large for the string: it cannot carry {weight:g} N; give a lighter load"
        )
    return float(guesses[0] + (weight - tensions[0]) / slope)
