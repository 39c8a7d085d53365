"""A LeRobot data set of a hobby arm with position servos, as its user has it: degrees, 30 frames a second, no torque.

MuJoCo moves the arm, as armdyn exports it. It hides the servos' gain and delay, their frictions and rotors. The
encoders read in steps of 1/4096 turn.
"""

import json
from pathlib import Path

import mujoco
import numpy as np
import pyarrow
from pyarrow import parquet

from armdyn.arm.model import ArmModel, arm_model
from armdyn.effects.catalogue import find
from pipeline.exports.mujoco_file import mujoco_text
from pipeline.exports.mujoco_start import begin

JOINTS = {  # axis, where it is in the joint before, mass of its link, kg, and how far that reaches, m
    "shoulder_pan": ("0 0 1", "0 0 0.06", 0.12, "0 0 0.05"),
    "shoulder_lift": ("0 1 0", "0 0 0.055", 0.13, "0 0 0.116"),
    "elbow_flex": ("0 1 0", "0 0 0.116", 0.12, "0 0 0.135"),
    "wrist_flex": ("0 1 0", "0 0 0.135", 0.11, "0 0 0.06"),
    "wrist_roll": ("0 0 1", "0 0 0.06", 0.13, "0.02 0 0.08"),
}
GAIN, DELAY, FPS, SECONDS = 8.3, 0.018, 30, 40.0
HIDDEN = {
    "joint_viscous_friction.coefficient": 0.25, "joint_coulomb_friction.torque": 0.12, "rotor_inertia.inertia": 0.012,
}  # fmt: skip
CENTRE = np.array([0.0, 0.5, 0.7, -0.4, 0.0])
WIDTH = np.array([0.9, 0.5, 0.6, 0.7, 1.0])


def urdf_text() -> str:
    """The arm as its description has it."""
    parts, parent = ['<robot name="hobby_arm"><link name="base"/>'], "base"
    for name, (axis, origin, mass, reach) in JOINTS.items():
        middle = " ".join(f"{0.5 * float(part):g}" for part in reach.split())
        size = mass * 0.12**2 / 12.0
        parts.append(
            f'<link name="{name}_link"><inertial><origin xyz="{middle}"/><mass value="{mass}"/>'
            f'<inertia ixx="{size:.3g}" iyy="{size:.3g}" izz="{0.4 * size:.3g}" ixy="0" ixz="0" iyz="0"/></inertial>'
            "</link>"
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{name}_link"/>'
            f'<origin xyz="{origin}"/><axis xyz="{axis}"/>'
            '<limit lower="-2" upper="2" effort="3.35" velocity="6"/></joint>'
        )
        parent = f"{name}_link"
    return "\n".join([*parts, "</robot>"]) + "\n"


def true_arm(urdf: Path) -> ArmModel:
    """With its drives and all that is hidden."""
    table = {"joints": list(JOINTS), "gain": f"{GAIN} N m/rad", "limit": "3.35 N m", "delay": f"{DELAY} s"}
    model = arm_model(urdf).with_drives({"servo": table})
    for name, value in HIDDEN.items():
        model = model.with_effect(find(name.partition(".")[0]))
        model = model.with_values({f"{name}[{joint}]": value for joint in JOINTS})
    return model


def recorded(urdf: Path, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """(n, 5) positions and commands, rad: a motion of a few sines, and rests."""
    random, time = np.random.default_rng(seed), np.arange(0.0, SECONDS, 1.0 / FPS)
    rate, phase = random.uniform(0.05, 0.45, (3, 5)), random.uniform(0.0, 6.3, (3, 5))
    waves = np.sin(2.0 * np.pi * rate * time[:, None, None] + phase).mean(axis=1)
    told = CENTRE + 1.4 * WIDTH * waves * np.clip(1.6 * np.sin(0.3 * time + seed) + 1.4, 0.0, 1.0)[:, None]
    arm = mujoco.MjModel.from_xml_string(mujoco_text(true_arm(urdf))[0])
    data, found, step = mujoco.MjData(arm), [], arm.opt.timestep
    begin(arm, data, dict(zip(JOINTS, told[0].tolist(), strict=True)))
    settling = round(2.0 / step)
    for k in range(settling + round(SECONDS / step)):
        frame = int(max(k - settling, 0) * step * FPS + 1e-6)
        if k >= settling and len(found) == frame:
            found.append(data.qpos.copy())
        data.ctrl[:] = told[min(frame, len(told) - 1)]
        mujoco.mj_step(arm, data)
    turn = 2.0 * np.pi / 4096
    return np.round(np.array(found[: len(told)]) / turn) * turn, told


def write(folder: Path, episodes: int = 3) -> None:
    """The description ``arm.urdf``, and a data set of version 3, ``dataset``."""
    urdf, data = folder / "arm.urdf", folder / "dataset"
    urdf.write_text(urdf_text())
    (data / "meta").mkdir(parents=True)
    (data / "data/chunk-000").mkdir(parents=True)
    about = {"dtype": "float32", "shape": [len(JOINTS)], "names": [f"{joint}.pos" for joint in JOINTS]}
    info = {"codebase_version": "v3.0", "fps": FPS, "features": {"observation.state": about, "action": about}}
    (data / "meta/info.json").write_text(json.dumps(info))
    rows: dict[str, list] = {name: [] for name in ("observation.state", "action", "frame_index", "episode_index")}
    for episode in range(episodes):
        q, told = recorded(urdf, episode)
        rows["observation.state"] += np.rad2deg(q).round(5).tolist()
        rows["action"] += np.rad2deg(told).round(5).tolist()
        rows["frame_index"] += range(len(q))
        rows["episode_index"] += [episode] * len(q)
    rows["timestamp"] = [frame / FPS for frame in rows["frame_index"]]
    parquet.write_table(pyarrow.table(rows), data / "data/chunk-000/file-000.parquet")
