"""Makes the recordings beside this file: a simulated UR5 that carries 1.5 kg and has friction that no URDF tells.

Rigid bodies are MuJoCo's, the friction is written here: nothing of armdyn's models takes part. The columns are called
and measured as a lab might: milliseconds, degrees, N m.
"""

from pathlib import Path
from xml.etree import ElementTree as ET

import mujoco
import numpy as np

import urdf

HERE = Path(__file__).parent
PAYLOAD, PLACE = 1.5, "0.02 -0.01 0.08"  # kg and m, in the frame of the last link
VISCOUS = np.array([9.0, 11.0, 6.0, 1.4, 1.2, 0.9])  # N m s/rad
COULOMB = np.array([7.0, 8.5, 4.5, 1.1, 1.0, 0.8])  # N m
CENTRE = np.array([0.0, -1.3, 1.3, -0.9, -1.2, 0.0])  # rad
WIDTH = np.array([1.4, 0.6, 0.8, 0.9, 0.9, 1.5])  # rad
POSITION_NOISE, TORQUE_NOISE = 3e-5, np.array([0.3, 0.3, 0.2, 0.06, 0.06, 0.06])  # rad; N m
DURATION, RATE = 14.0, 100.0  # s; samples per second
RECORDINGS = {"sweep_1": (11, 0.22, 5), "sweep_2": (12, 0.22, 5), "pick_and_place": (13, 0.13, 7)}
"""Seed, basic frequency in Hz and number of harmonics."""


def plant() -> mujoco.MjModel:
    """The UR5 of its URDF, without shapes and without friction, and the payload."""
    root = ET.fromstring(urdf.load("ur5").urdf_xml)
    for link in root.findall("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    carried = ET.SubElement(root, "link", name="carried")
    inertial = ET.SubElement(carried, "inertial")
    ET.SubElement(inertial, "mass", value=str(PAYLOAD))
    ET.SubElement(inertial, "inertia", ixx="1e-4", iyy="1e-4", izz="1e-4", ixy="0", ixz="0", iyz="0")
    fixed = ET.SubElement(root, "joint", name="carried_joint", type="fixed")
    ET.SubElement(fixed, "origin", xyz=PLACE)
    ET.SubElement(fixed, "parent", link="wrist_3_link")
    ET.SubElement(fixed, "child", link="carried")
    model = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    model.dof_damping[:] = model.dof_frictionloss[:] = 0.0
    model.jnt_limited[:] = False
    return model


def motion(seed: int, frequency: float, harmonics: int, time: np.ndarray) -> list[np.ndarray]:
    """(n, 6) positions, velocities and accelerations: a Fourier series that begins at rest."""
    rng = np.random.default_rng(seed)
    n = np.arange(1, harmonics + 1)
    waves = rng.normal(0.0, 1.0, (2, 6, harmonics)) / n
    waves *= (WIDTH / np.sum(np.abs(waves), axis=(0, 2)))[:, None]
    w = 2 * np.pi * frequency * n
    angle = time[:, None] * w
    q = CENTRE + np.cos(angle) @ waves[0].T + np.sin(angle) @ waves[1].T
    v = (np.cos(angle) * w) @ waves[1].T - (np.sin(angle) * w) @ waves[0].T
    a = -(np.cos(angle) * w**2) @ waves[0].T - (np.sin(angle) * w**2) @ waves[1].T
    return [q, v, a]


def torques(model: mujoco.MjModel, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """(n, 6) of the drives, N m."""
    data, found = mujoco.MjData(model), []
    for state in zip(q, v, a, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = state
        mujoco.mj_inverse(model, data)
        found.append(data.qfrc_inverse.copy())
    return np.array(found) + VISCOUS * v + COULOMB * np.sign(v)


def main() -> None:
    """Write all recordings."""
    model, time = plant(), np.arange(round(DURATION * RATE)) / RATE
    joints = range(1, 7)
    header = ["timestamp_ms", *(f"joint{i}_pos" for i in joints), *(f"joint{i}_torque" for i in joints)]
    for name, (seed, frequency, harmonics) in RECORDINGS.items():
        rng = np.random.default_rng([seed, 1])
        q, v, a = motion(seed, frequency, harmonics, time)
        tau = torques(model, q, v, a) + TORQUE_NOISE * rng.standard_normal(q.shape)
        q = q + POSITION_NOISE * rng.standard_normal(q.shape)
        table = np.column_stack([1e3 * time, np.rad2deg(q), tau])
        formats = ["%.0f", *["%.3f"] * 6, *["%.2f"] * 6]
        np.savetxt(HERE / f"{name}.csv", table, formats, delimiter=",", header=",".join(header), comments="")


if __name__ == "__main__":
    main()
