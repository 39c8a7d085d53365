"""Servo arms with a tool behind a force/torque sensor, which MuJoCo moves by its position actuators.

The robots are described but for their tool, and recorded are positions, their commands, and what MuJoCo's sensors at a
site read, with noise, and with one or two faults of `tools`; no torque. Drives have a gain that is roughly known, a
delay, and hidden friction. They are told steps, so that the sensor averages over a sample as real ones do: else their
vibrations would be aliased.
"""

from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import Any
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from armdyn.arm.model import ArmModel, arm_model
from armdyn.run import Run

from . import tools
from .mujoco_arm import robot_of
from .mujoco_plant import STEP, Path, bare, rigid_torques

ROBOTS = ("z1", "ur5", "xarm7", "panda")  # the seeds take them in turn
LINK, AWAY = "flange", 0.04  # a link of the description on the last one, m
RATES, SECONDS = (50.0, 100.0, 125.0, 200.0), (12.0, 12.0, 12.0)  # Hz, divisors of 1 / STEP; the last is held out
DROOP, DAMPED, DRY, LATE = (0.02, 0.06), (0.3, 0.8), (0.03, 0.12), (0.0, 0.02)  # rad; ratio; of the largest load; s
TURN, GAIN_STD, SETTLED = 65536, 0.05, 2.0  # steps of a turn; share; s at rest before a recording
LEAST = 0.02  # of the largest load: a joint with a vertical axis carries none
HEAVIEST = {"z1": 1.5}  # kg


@dataclass(frozen=True)
class ServoTool:
    """One arm with what is hidden in it: friction by joint, N m s/rad and N m, and a tool."""

    joints: tuple[str, ...]
    description: str
    drives: dict[str, dict[str, Any]]
    viscous: np.ndarray
    dry: np.ndarray
    gain: np.ndarray  # N m/rad
    tool: tools.Tool
    runs: tuple[Run, ...]

    def model(self, folder: FilePath) -> ArmModel:
        """The arm as its user describes it."""
        file = folder / "arm.urdf"
        file.write_text(self.description, encoding="utf-8")
        sensor = {tools.SENSOR: {"link": LINK, "xyz": list(tools.PLACE), "rpy": list(tools.TURNED)}}
        return arm_model(file, joints=self.joints).with_drives(self.drives).with_sensors(sensor)


def generate(
    seed: int, *, clean: bool = False, tool: tools.Tool | None = None, count: int | None = None,
    seconds: tuple[float, ...] = SECONDS,
) -> ServoTool:  # fmt: skip
    """The arm of a seed; a clean one is described with its tool, and its sensor has no faults.

    It has `count` joints, None for all, and carries a `tool`, by default one that is drawn.
    """
    rng = np.random.default_rng([seed, 45])
    name = ROBOTS[seed % len(ROBOTS)]
    robot = robot_of(name)
    if tool is None:
        tool = tools.drawn(seed)
        lighter = min(1.0, HEAVIEST.get(name, np.inf) / tool.mass)
        tool = replace(tool, mass=lighter * tool.mass, inertia=lighter * tool.inertia)
    tool = replace(tool, faults={}) if clean else tool
    joints = tuple(robot.joint_names)[:count]
    plain, with_tool = (_described(robot.urdf_xml, joints, held) for held in (None, tool))
    spec = _spec(with_tool)
    rigid = spec.compile()
    paths = [Path.drawn(rng, robot, tools.SLOW, lasts) for lasts in seconds]
    way = [
        np.vstack(parts)[:, : len(joints)]
        for parts in zip(*(p.at(np.arange(0, p.seconds, 0.1)) for p in paths), strict=True)
    ]
    load = np.abs(rigid_torques(rigid, joints, (way[0], 0 * way[1], 0 * way[2]))).max(axis=0)
    at, still = np.tile(way[0].mean(axis=0), (len(joints), 1)), np.zeros((len(joints),) * 2)
    pushed, held = (rigid_torques(rigid, joints, (at, still, a)) for a in (np.eye(len(joints)), still))
    inertia, strong = np.diag(pushed - held), load > 0.3 * load.max()
    gain, drives = np.zeros(len(joints)), dict[str, dict[str, Any]]()
    late, every = round(rng.uniform(*LATE) / STEP), round(1.0 / float(rng.choice(RATES)) / STEP)
    for kind, members in (("shoulder", strong), ("wrist", ~strong)):
        own = [joint for joint, is_in in zip(joints, members, strict=True) if is_in]
        gain[members] = max(load[members].max(), LEAST * load.max()) / rng.uniform(*DROOP)
        told = f"{gain[members][0] * rng.normal(1.0, GAIN_STD):.6g} N m/rad +/- {100 * GAIN_STD:g} %"
        drives[kind] = {"joints": own, "law": "position", "gain": told}
    viscous = 2.0 * rng.uniform(*DAMPED, len(joints)) * np.sqrt(gain * inertia)
    dry = rng.uniform(*DRY, len(joints)) * np.maximum(load, 0.15 * load.max()) * (rng.random() < 0.7)
    for joint, k, d, f in zip(joints, gain, viscous, dry, strict=True):
        moved = spec.joint(joint)
        moved.damping, moved.frictionloss = np.array([d, 0, 0]), f
        moved.solref_friction, moved.solimp_friction = [2 * STEP, 1.0], [0.99, 0.999, 0.001, 0.5, 2.0]
        drive = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        drive.gainprm[0], drive.biastype, drive.biasprm[1] = k, mujoco.mjtBias.mjBIAS_AFFINE, -k
    plant = spec.compile()
    runs = tuple(_recorded(rng, plant, joints, p, (late, every), tool, k) for k, p in enumerate(paths))
    return ServoTool(joints, with_tool if clean else plain, drives, viscous, dry, gain, tool, runs)


def _described(xml: str, joints: tuple[str, ...], tool: tools.Tool | None) -> str:
    """URDF of a robot with a flange, and with a tool on it, if any."""
    root = bare(xml, joints)
    last = next(j for j in root.findall("joint") if j.get("name") == joints[-1]).find("child")
    assert last is not None
    for parent, link, place in ((last.get("link"), LINK, AWAY), *(((LINK, "tool", -AWAY),) if tool else ())):
        joint = ET.SubElement(root, "joint", name=f"{link}_joint", type="fixed")
        ET.SubElement(joint, "origin", xyz=f"0 0 {place}")
        ET.SubElement(joint, "parent", link=str(parent))
        ET.SubElement(joint, "child", link=link)
        body = ET.SubElement(root, "link", name=link)
        if link == "tool" and tool is not None:
            inertial = ET.SubElement(body, "inertial")
            ET.SubElement(inertial, "origin", xyz=" ".join(map(repr, tool.centre.tolist())))
            ET.SubElement(inertial, "mass", value=repr(tool.mass))
            names = {"ixx": (0, 0), "iyy": (1, 1), "izz": (2, 2), "ixy": (0, 1), "ixz": (0, 2), "iyz": (1, 2)}
            ET.SubElement(inertial, "inertia", {name: repr(float(tool.inertia[at])) for name, at in names.items()})
    return ET.tostring(root, encoding="unicode")


def _spec(description: str) -> mujoco.MjSpec:
    """The arm in MuJoCo, with its sensor and without limits."""
    root = ET.fromstring(description)
    options = {"fusestatic": "false", "balanceinertia": "false", "boundmass": "1e-9", "boundinertia": "1e-12"}
    ET.SubElement(ET.SubElement(root, "mujoco"), "compiler", options)
    spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"))
    spec.option.timestep, spec.option.integrator = STEP, mujoco.mjtIntegrator.mjINT_RK4
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    quaternion = Rotation.from_euler("xyz", tools.TURNED).as_quat(scalar_first=True)
    spec.body(LINK).add_site(name=tools.SENSOR, pos=tools.PLACE, quat=quaternion)
    for kind in ("FORCE", "TORQUE"):
        of_site = {"objtype": mujoco.mjtObj.mjOBJ_SITE, "objname": tools.SENSOR}
        spec.add_sensor(name=kind, type=getattr(mujoco.mjtSensor, f"mjSENS_{kind}"), **of_site)
    for joint in spec.joints:
        joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
    return spec


def _recorded(
    rng: np.random.Generator, plant: mujoco.MjModel, joints: tuple[str, ...], path: Path, steps: tuple[int, int],
    tool: tools.Tool, index: int,
) -> Run:  # fmt: skip
    """A recording of a path that the drives are told; `steps` of their delay and of one sample."""
    (late, every), data = steps, mujoco.MjData(plant)
    time = STEP * every * np.arange(round(path.seconds / STEP / every))
    told = path.at(time)[0][:, : len(joints)]
    data.qpos[:], data.ctrl[:] = told[0], told[0]
    mujoco.mj_step(plant, data, round(SETTLED / STEP))
    q, wrenches, axes = np.empty_like(told), [], np.empty((len(time), 3, 3))
    for k in range(len(time)):
        mujoco.mj_kinematics(plant, data)
        q[k], axes[k] = data.qpos, data.site(tools.SENSOR).xmat.reshape(3, 3)
        for step in range(every):
            data.ctrl[:] = told[max((k * every + step - late) // every, 0)]
            mujoco.mj_step(plant, data)
            begun = data.sensordata.copy()  # of the state before the step
            mujoco.mj_forward(plant, data)
            wrenches.append(-(begun + data.sensordata) / 2.0)
    wrench = uniform_filter1d(np.array(wrenches), every, axis=0, mode="nearest")[::every]
    noise = np.repeat([tools.FORCE_NOISE, tools.TORQUE_NOISE], 3) * rng.standard_normal(wrench.shape)
    read, encoder = tools.faulty(tool, time, wrench, axes) + noise, 2.0 * np.pi / TURN
    values = {f"{axis}.{tools.SENSOR}": read[:, i] for i, axis in enumerate(tools.AXES)}
    values |= {"q": np.round(q / encoder) * encoder, "q_cmd": told}
    values = {
        **{n: x for n, x in values.items() if x.ndim == 1},
        **{f"{kind}.{j}": values[kind][:, i] for kind in ("q", "q_cmd") for i, j in enumerate(joints)},
    }
    return Run.from_arrays(time, values, name=f"run {index}", joints=None)
