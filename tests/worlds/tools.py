"""Tools behind a force/torque sensor, as MuJoCo's force and torque sensors at a site read them, with hidden faults.

The truth is MuJoCo's inverse dynamics of a robot with a body on its tool's link, along a prescribed motion.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path as FilePath
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

import urdf
from armdyn.arm.model import ArmModel, arm_model
from armdyn.run import Run
from urdf.find import distribution_file

from . import coloured
from .mujoco_plant import Path, bare

LINK, SENSOR = "tool0", "ft"
AXES = ("fx", "fy", "fz", "tx", "ty", "tz")
PLACE, TURNED = (0.01, -0.02, 0.03), (0.2, -0.3, 0.5)  # m, rad: the sensor's frame on the link
ROBOT = "ur_description/urdf/ur5_robot.urdf"
FORCE_NOISE, TORQUE_NOISE, POSITION_NOISE = 0.1, 0.005, 2e-5  # N, N m, rad
JOINT_NOISE = 0.3  # N m
SLOW = (0.08, 0.5)  # frequencies of the motion, Hz


@dataclass(frozen=True)
class Tool:
    """A body on the robot's last link, in the frame of the last joint, and faults of the sensor.

    Attributes:
        mass: kg.
        centre: (3,) m.
        inertia: (3, 3) about its centre, kg m^2.
        faults: values of the catalogue's effects of a sensor, by effect and quantity.
    """

    mass: float = 0.0
    centre: np.ndarray = field(default_factory=lambda: np.zeros(3))
    inertia: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    faults: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


@lru_cache(maxsize=2)
def robot() -> urdf.Robot:
    """The robot that carries the tools."""
    return urdf.load(distribution_file("example-robot-data", ROBOT), meshes=False)


def description(tool: Tool) -> str:
    """URDF of the robot with a tool, a link that is fixed to the last one."""
    root = bare(robot().urdf_xml, robot().joint_names)
    placed = robot().model.frames[robot().model.getFrameId(LINK)].placement
    inertial = ET.SubElement(ET.SubElement(root, "link", name="tool"), "inertial")
    ET.SubElement(inertial, "origin", xyz=" ".join(map(repr, placed.actInv(tool.centre).tolist())))
    ET.SubElement(inertial, "mass", value=repr(tool.mass))
    own = placed.rotation.T @ tool.inertia @ placed.rotation
    names = {"ixx": (0, 0), "iyy": (1, 1), "izz": (2, 2), "ixy": (0, 1), "ixz": (0, 2), "iyz": (1, 2)}
    ET.SubElement(inertial, "inertia", {name: repr(float(own[at])) for name, at in names.items()})
    joint = ET.SubElement(root, "joint", name="tool_joint", type="fixed")
    ET.SubElement(joint, "parent", link=LINK)
    ET.SubElement(joint, "child", link="tool")
    return ET.tostring(root, encoding="unicode")


def sensed_model(urdf_file: FilePath | None = None, **sensor: object) -> ArmModel:
    """The model of the robot, by default without a tool, with its sensor."""
    table = {"link": LINK, "xyz": list(PLACE), "rpy": list(TURNED), **sensor}
    return arm_model(urdf_file or distribution_file("example-robot-data", ROBOT)).with_sensors({SENSOR: table})


def compiled(tool: Tool) -> mujoco.MjModel:
    """The robot with a tool and a sensor, in MuJoCo."""
    root, joints = bare(robot().urdf_xml, robot().joint_names), robot().joint_names
    options = {"fusestatic": "false", "balanceinertia": "false", "boundmass": "1e-9", "boundinertia": "1e-12"}
    ET.SubElement(ET.SubElement(root, "mujoco"), "compiler", options)
    spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"))
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    quaternion = Rotation.from_euler("xyz", TURNED).as_quat(scalar_first=True)
    link = spec.body(LINK)
    link.add_site(name=SENSOR, pos=PLACE, quat=quaternion)
    if tool.mass > 0.0:
        placed = robot().model.frames[robot().model.getFrameId(LINK)].placement
        own = placed.rotation.T @ tool.inertia @ placed.rotation
        moments, axes = np.linalg.eigh(own)
        axes[:, 2] *= np.linalg.det(axes)
        body = link.add_body(name="load", pos=placed.actInv(tool.centre), explicitinertial=True)
        body.mass, body.inertia, body.ipos = tool.mass, np.maximum(moments, 1e-9), [0.0, 0.0, 0.0]
        body.iquat = Rotation.from_matrix(axes).as_quat(scalar_first=True)
    for kind in ("FORCE", "TORQUE"):
        of_site = {"objtype": mujoco.mjtObj.mjOBJ_SITE, "objname": SENSOR}
        spec.add_sensor(name=kind, type=getattr(mujoco.mjtSensor, f"mjSENS_{kind}"), **of_site)
    model = spec.compile()
    assert [model.joint(name).dofadr[0] for name in joints] == list(range(len(joints)))
    return model


def measured(tool: Tool, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(n, nj) torques, N m, (n, 6) wrenches, N and N m, and (n, 3, 3) axes of the sensor, by MuJoCo.

    MuJoCo's sensor reads what the arm does to the tool; a sensor reads what the tool does to the arm.
    """
    model = compiled(tool)
    data, torque, wrench, axes = mujoco.MjData(model), np.empty_like(q), np.empty((len(q), 6)), np.empty((len(q), 3, 3))
    for i in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[i], v[i], a[i]
        mujoco.mj_inverse(model, data)
        torque[i], wrench[i] = data.qfrc_inverse, -data.sensordata
        axes[i] = data.site(SENSOR).xmat.reshape(3, 3)
    return torque, wrench, axes


def faulty(tool: Tool, time: np.ndarray, wrench: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """(n, 6) readings of a sensor with the faults of a tool, for (n, 6) true wrenches and (n, 3, 3) axes."""
    force, torque = wrench[:, :3].copy(), wrench[:, 3:].copy()
    for effect, values in tool.faults.items():
        own = np.array(list(values.values()))
        if effect == "cable_pull":
            pull = np.einsum("nji,j->ni", axes, own[:3])
            force, torque = force + pull, torque + np.cross(own[3:], pull)
        elif effect == "wrench_rotation":
            turned = Rotation.from_euler("xyz", own)
            force, torque = turned.inv().apply(force), turned.inv().apply(torque)
        elif effect == "wrench_crosstalk":
            share = {name: x for name, x in values.items() if x}
            both, true = np.hstack([force, torque]), force.copy()
            for name, x in share.items():
                to, of = (AXES.index(axis) for axis in name.split("_"))
                both[:, to] += x * true[:, of]
            force, torque = both[:, :3], both[:, 3:]
        elif effect == "wrench_gain":
            force, torque = force * (1 + own[:3]), torque * (1 + own[3:])
        elif effect == "wrench_offset":
            force, torque = force + own[:3], torque + own[3:]
        elif effect == "wrench_drift":
            force, torque = force + np.outer(time, own[:3]), torque + np.outer(time, own[3:])
        else:
            raise ValueError(effect)
    return np.hstack([force, torque])


def recorded(tool: Tool, seed: int, seconds: float = 20.0, rate: float = 125.0, *, torques: bool = False) -> Run:
    """A recording of positions and a wrench, and of joint torques if asked, with noise."""
    rng = np.random.default_rng([seed, 41])
    time = np.arange(0.0, seconds, 1.0 / rate)
    q, v, a = Path.drawn(rng, robot(), SLOW, seconds).at(time)
    torque, wrench, axes = measured(tool, q, v, a)
    noise = np.repeat([FORCE_NOISE, TORQUE_NOISE], 3) * rng.standard_normal(wrench.shape)
    read = faulty(tool, time, wrench, axes) + noise
    values = {"q": q + POSITION_NOISE * rng.standard_normal(q.shape)}
    if torques:
        values["tau"] = torque + JOINT_NOISE * rng.standard_normal(q.shape)
    values |= {f"{axis}.{SENSOR}": read[:, i] for i, axis in enumerate(AXES)}
    return Run.from_arrays(time, values, joints=robot().joint_names, name=f"run {seed}")


def drawn(seed: int) -> Tool:
    """A tool with one or two faults of its sensor, of sizes that sensors in use have."""
    rng = np.random.default_rng([seed, 42])
    mass, extent = float(rng.uniform(0.4, 3.0)), rng.uniform(0.02, 0.08, 3)
    turned = Rotation.random(random_state=seed).as_matrix()
    inertia = turned @ np.diag(mass * (np.sum(extent**2) - extent**2)) @ turned.T
    each = {
        "wrench_offset": dict(
            zip(AXES, rng.choice([-1, 1], 6) * rng.uniform(1, 2, 6) * np.repeat([2, 0.1], 3), strict=True)
        ),
        "wrench_drift": dict(
            zip(AXES, rng.choice([-1, 1], 6) * rng.uniform(1, 2, 6) * np.repeat([0.05, 0.003], 3), strict=True)
        ),
        "wrench_rotation": dict(
            zip(("roll", "pitch", "yaw"), rng.choice([-1, 1], 3) * rng.uniform(0.03, 0.3, 3), strict=True)
        ),
        "wrench_gain": dict(zip(AXES, rng.choice([-1, 1], 6) * rng.uniform(0.02, 0.08, 6), strict=True)),
        "wrench_crosstalk": {"fx_fz": float(rng.uniform(0.02, 0.06)), "ty_fz": float(rng.uniform(0.002, 0.006))},
        "cable_pull": dict(
            zip(
                ("x", "y", "z", "at_x", "at_y", "at_z"),
                [*rng.uniform(2, 5, 3), *rng.uniform(-0.1, 0.1, 3)],
                strict=True,
            )
        ),
    }
    chosen = rng.permutation(list(each))[: 1 + seed % 2]
    faults = {name: each[name] for name in each if name in chosen}
    order = ("cable_pull", "wrench_rotation", "wrench_crosstalk", "wrench_gain", "wrench_offset", "wrench_drift")
    return Tool(
        mass,
        rng.uniform((-0.05, -0.05, 0.07), (0.05, 0.05, 0.17)),
        inertia,
        {n: faults[n] for n in order if n in faults},
    )


FRICTION, JOINT_ERROR, WRENCH_ERROR = 2.0, 0.15, 0.01
"""Dry friction, N m; error of a model of the joints, N m, new every half a second; and of a wrench, a share of it."""


def worked(
    tool: Tool,
    seed: int,
    seconds: float = 60.0,
    rate: float = 125.0,
    *,
    begin: float = np.inf,
    end: float = np.inf,
    push: np.ndarray | None = None,
    load: float = 0.0,
    zeroed: bool = False,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(n,) stamps, (n, nj) positions, and (n, nj + 6) torques and a wrench, of an arm at work.

    From `begin` [s] on a force (3,) N, along the axes of the base, pushes the sensor's origin until `end`, there are
    `load` kg more at the tool's centre, or the sensor is zeroed.
    """
    rng = np.random.default_rng([seed, 43])
    time = np.arange(0.0, seconds, 1.0 / rate)
    q, v, a = Path.drawn(rng, robot(), SLOW, seconds).at(time)
    torque, wrench, axes = measured(tool, q, v, a)
    after = time >= begin
    if load:
        heavier = measured(replace(tool, mass=tool.mass + load), q[after], v[after], a[after])
        torque[after], wrench[after] = heavier[:2]
    wrench = wrench * (1.0 + WRENCH_ERROR * np.random.default_rng(44).standard_normal(wrench.shape[1]))
    if push is not None:
        model = compiled(tool)
        data, J = mujoco.MjData(model), np.zeros((3, model.nv))
        for i in np.flatnonzero(after & (time < end)):
            data.qpos[:] = q[i]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_jacSite(model, data, J, None, data.site(SENSOR).id)
            torque[i] -= J.T @ push
            wrench[i, :3] += axes[i].T @ push
    if zeroed:
        wrench[after] -= wrench[after][0]
    slow = coloured(rng.standard_normal(torque.shape), np.exp(-1.0 / (0.5 * rate)))
    torque = torque + FRICTION * np.sign(v) + JOINT_ERROR * slow + 0.05 * rng.standard_normal(torque.shape)
    wrench = wrench + np.repeat([FORCE_NOISE, TORQUE_NOISE], 3) * rng.standard_normal(wrench.shape)
    return time, q + POSITION_NOISE * rng.standard_normal(q.shape), np.hstack([torque, wrench])
