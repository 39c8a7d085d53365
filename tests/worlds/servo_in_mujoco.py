"""How far the motion of an exported servo arm is from a recorded one, simulated by MuJoCo from the file alone.

It is driven as a user does: each command from the first step that begins after its stamp. What the file leaves to
whoever simulates it is done here: a recorded supply scales what its actuators give.
"""

from collections.abc import Sequence

import mujoco
import numpy as np

from armdyn.arm.closed_loop.rollout import SimulationWindow, has_all_position_commands, simulation_windows
from armdyn.arm.model import ArmModel
from armdyn.run import Run
from pipeline.exports.mujoco_start import begin, play_joint

LENGTH = 0.5  # s of the windows of drives that are told no position
ROUNDING = 1e-9  # s; a stamp that is a multiple of the step is not later than it


def stretches(model: ArmModel, run: Run) -> Sequence[SimulationWindow]:
    """The whole recording in closed loop, else windows."""
    return simulation_windows(run, model.arm.joints, np.inf if has_all_position_commands(model, run) else LENGTH)


def errors_in_mujoco(text: str, model: ArmModel, run: Run) -> np.ndarray:
    """(n, nj) simulated less recorded positions, rad or m, by the exported file at its own step."""
    arm = mujoco.MjModel.from_xml_string(text)
    joints = model.arm.joints
    servos, drives = [model.servo(joint) for joint in joints], slice(len(joints))
    whole = (arm.actuator_gainprm, arm.actuator_biasprm, arm.actuator_forcerange)
    gains, biases, limits = (part[drives].copy() for part in whole)
    offsets = biases[:, :1].copy()  # no share of the supply
    names = [arm.joint(i).name for i in range(arm.njnt)]
    places = [names.index(joint) for joint in joints]  # each joint is one coordinate
    arm.jnt_limited[places] = arm.actuator_ctrllimited[:] = False  # generated arms go on where a description ends
    gaps = [(j, names.index(play_joint(n))) for j, n in enumerate(joints) if play_joint(n) in names]
    told = [run.channels[s.command(joint)] for s, joint in zip(servos, joints, strict=True)]
    found = []
    for window in stretches(model, run):
        data = mujoco.MjData(arm)
        count = int(np.ceil((window.end - window.begin) / arm.opt.timestep)) + 1
        time = window.begin + arm.opt.timestep * np.arange(count)
        commands = np.column_stack([channel.zero_order_hold_values(time + ROUNDING) for channel in told])
        q, v, first = (dict(zip(joints, part.tolist(), strict=True)) for part in (*window.start, commands[0]))
        begin(arm, data, q, v, first)
        for i in range(len(joints)):
            if past := int(arm.actuator_history[i, 0]):
                times = arm.opt.timestep * np.arange(-past, 0)
                mujoco.mj_initCtrlHistory(arm, data, i, None, told[i].zero_order_hold_values(window.begin + times))
        shares = np.column_stack([s.torque_share(run, j, time)[0] for s, j in zip(servos, joints, strict=True)])
        positions = np.empty((count, len(told)))
        for k in range(count):
            positions[k] = data.qpos[places]
            for j, gap in gaps:
                positions[k, j] += data.qpos[gap]
            data.ctrl[:] = commands[k]
            share = shares[k][:, None]
            arm.actuator_gainprm[drives], arm.actuator_biasprm[drives] = share * gains, share * biases
            arm.actuator_biasprm[drives, :1] = offsets
            arm.actuator_forcerange[drives] = share * (limits - offsets) + offsets
            mujoco.mj_step(arm, data)
        at = np.column_stack([np.interp(window.time, time, positions[:, j]) for j in range(len(told))])
        found.append(at - window.q)
    return np.vstack(found)
