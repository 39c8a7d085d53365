"""How well a MuJoCo model predicts the torques of a run: ``python in_mujoco.py robot.xml run.csv``."""

import sys

import mujoco
import numpy as np
from scipy.signal import savgol_filter

from armdyn.run import read_run

WINDOW, ORDER = 21, 4  # samples and degree of the polynomials that smooth and differentiate the positions
SLOW = 0.05  # rad/s; below it nobody knows the sign of the friction


def predicted(model: mujoco.MjModel, motion: list[np.ndarray]) -> np.ndarray:
    """(n, nj) torques of a motion, N m; positions, velocities and accelerations are (n, nj) each."""
    data, found = mujoco.MjData(model), []
    for state in zip(*motion, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = state
        mujoco.mj_inverse(model, data)
        found.append(data.qfrc_inverse.copy())
    return np.array(found)


def main(xml: str, csv: str) -> None:
    """Print the root mean square error while each joint moves, and the root of their summed squares."""
    model, run = mujoco.MjModel.from_xml_path(xml), read_run(csv)
    joints = [model.joint(i).name for i in range(model.njnt)]
    q, tau = (np.column_stack([run.channels[f"{kind}.{joint}"].value for joint in joints]) for kind in ("q", "tau"))
    interval = float(np.median(np.diff(run.channels[f"q.{joints[0]}"].time)))
    motion = [savgol_filter(q, WINDOW, ORDER, deriv=k, delta=interval, axis=0) for k in range(3)]
    moving = np.abs(motion[1]) > SLOW
    error = np.sqrt(np.mean((tau - predicted(model, motion)) ** 2, axis=0, where=moving))
    for joint, size in zip(joints, error, strict=True):
        print(f"{joint:24} {size:7.3f} N m")
    print(f"{'total':24} {np.hypot.reduce(error):7.3f} N m")


if __name__ == "__main__":
    main(*sys.argv[1:])
