"""How far the motion of an exported servo arm is from a recorded one, simulated by MuJoCo from the file alone.

What the file leaves to whoever simulates it is done here: a recorded supply scales what its actuators give.
"""

from collections.abc import Sequence

import mujoco
import numpy as np

from armdyn.arm.closed_loop.rollout import SimulationWindow, has_all_position_commands, simulation_windows
from armdyn.arm.model import ArmModel
from armdyn.run import Run
from pipeline.exports.mujoco_file import play_joint

LENGTH = 0.5  # s of the windows of drives that are told no position


def stretches(model: ArmModel, run: Run) -> Sequence[SimulationWindow]:
    """The whole recording in closed loop, else windows."""
    return simulation_windows(run, model.arm.joints, np.inf if has_all_position_commands(model, run) else LENGTH)


def errors_in_mujoco(text: str, model: ArmModel, run: Run, step: float | None = None) -> np.ndarray:
    """(n, nj) simulated less recorded positions, rad or m, by the exported file, in steps of s or MuJoCo's own."""
    arm = mujoco.MjModel.from_xml_string(text)
    arm.opt.timestep = step or arm.opt.timestep
    gains, biases, limits = (a.copy() for a in (arm.actuator_gainprm, arm.actuator_biasprm, arm.actuator_forcerange))
    offsets = biases[:, :1].copy()  # no share of the supply
    servos = [model.servo(joint) for joint in model.arm.joints]
    names = [arm.joint(i).name for i in range(arm.njnt)]
    drives = [names.index(joint) for joint in model.arm.joints]  # each joint is one coordinate
    arm.jnt_limited[drives] = False  # generated arms go on where a description ends
    gaps = [(j, names.index(play_joint(n))) for j, n in enumerate(model.arm.joints) if play_joint(n) in names]
    told = [run.channels[s.command(joint)] for s, joint in zip(servos, model.arm.joints, strict=True)]
    found = []
    for window in stretches(model, run):
        data = mujoco.MjData(arm)
        data.qpos[drives], data.qvel[drives], data.time = *window.start, window.begin
        for i, channel in enumerate(told):
            count = int(arm.actuator_history[i, 0])
            if count:
                times = window.begin - arm.opt.timestep * np.arange(count, 0, -1)
                mujoco.mj_initCtrlHistory(arm, data, i, times, channel.zero_order_hold_values(times))
        count = int(np.ceil((window.end - window.begin) / arm.opt.timestep)) + 1
        time = window.begin + arm.opt.timestep * np.arange(count)
        # A step's force stands for half a step before and after it (leapfrog): so does what it is told.
        edges = np.append(time, time[-1] + arm.opt.timestep) - 0.5 * arm.opt.timestep
        commands = np.column_stack([channel.mean_zero_order_hold_values(edges) for channel in told])
        shares = np.column_stack(
            [s.torque_share(run, j, time)[0] for s, j in zip(servos, model.arm.joints, strict=True)]
        )
        positions = np.empty((count, len(told)))
        for k in range(count):
            positions[k] = data.qpos[drives]
            for j, gap in gaps:
                positions[k, j] += data.qpos[gap]
            data.ctrl[:] = commands[k]
            share = shares[k][:, None]
            arm.actuator_gainprm[:], arm.actuator_biasprm[:] = share * gains, share * biases
            arm.actuator_biasprm[:, :1], arm.actuator_forcerange[:] = offsets, share * (limits - offsets) + offsets
            mujoco.mj_step(arm, data)
        at = np.column_stack([np.interp(window.time, time, positions[:, j]) for j in range(len(told))])
        found.append(at - window.q)
    return np.vstack(found)
