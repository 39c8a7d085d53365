"""A robot arm simulated by MuJoCo under computed torque: its own damping, friction loss, armature and bodies."""

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree import ElementTree as ET

import mujoco
import numpy as np

import urdf

STEP = 5e-4  # s of the simulation and of its controller
SINES, RAMP = 3, 2.0  # sines of each joint's motion; s from rest and to rest
FARTHEST, SWING, MARGIN = 1.4, (0.2, 0.38), 0.05  # rad from home; share of a joint's range; rad to its limits
SLOWED, FASTEST, BRISKEST = 0.6, 2.0, 8.0  # share of the velocity limits; no more than so many rad/s, rad/s^2
STIFFEST, DAMPED = 150.0, 0.9  # rad/s of a drive on its joint's inertia; damping ratio
LINK_ERROR = (0.05, 0.1)  # of masses, extents and centres of a description that is off; of the link's size


@dataclass(frozen=True)
class Hidden:
    """One effect on one joint, under the catalogue's name."""

    effect: str
    joint: str
    values: Mapping[str, float]  # by the short names of the parameters
    size: float = 0.0  # root mean square of its torque on its joint in training, N m; a load's is the most visible one
    visible: bool = False


@dataclass(frozen=True)
class Log:
    """What MuJoCo did, at the stamps of a log: (n, nj) rad, rad/s, rad/s^2, N m."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    torque: np.ndarray  # of the drives
    friction: np.ndarray  # Coulomb friction
    unknown: np.ndarray  # force that no catalogue has


def bare(xml: str, joints: tuple[str, ...]) -> ET.Element:
    """A description of links alone: without shapes, friction and motors; joints beside the arm's are fixed at zero."""
    root = ET.fromstring(xml)
    for element in [e for e in root if e.tag not in ("link", "joint")]:
        root.remove(element)
    for link in root.findall("link"):
        for element in [e for e in link if e.tag != "inertial"]:
            link.remove(element)
    for joint in root.findall("joint"):
        arm = joint.get("name") in joints
        kept = ("origin", "parent", "child", *(("axis", "limit") if arm else ()))
        for element in [e for e in joint if e.tag not in kept]:
            joint.remove(element)
        if not arm:
            joint.set("type", "fixed")
    return root


def with_links_off(root: ET.Element, rng: np.random.Generator) -> ET.Element:
    """A description with every mass, centre and extent off by `LINK_ERROR`."""
    root = copy.deepcopy(root)
    for inertial in root.iter("inertial"):
        mass, origin, inertia = (inertial.find(tag) for tag in ("mass", "origin", "inertia"))
        assert mass is not None
        assert inertia is not None
        heavier, larger, shift = rng.choice([-1.0, 1.0], 3) * rng.uniform(*LINK_ERROR, 3)
        way = rng.standard_normal(3)
        if origin is None:
            origin = ET.SubElement(inertial, "origin", xyz="0 0 0", rpy="0 0 0")
        kg, centre = float(mass.get("value", 0)), np.array((origin.get("xyz") or "0 0 0").split(), dtype=float)
        if kg <= 0.0:
            continue
        spread = np.sqrt(0.5 * sum(float(inertia.get(k, 0)) for k in ("ixx", "iyy", "izz")) / kg)
        centre += way / np.linalg.norm(way) * shift * max(float(np.linalg.norm(centre)), float(spread))
        mass.set("value", f"{kg * (1 + heavier):.9g}")
        origin.set("xyz", " ".join(f"{x:.9g}" for x in centre))
        for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"):
            inertia.set(key, f"{float(inertia.get(key, 0)) * (1 + heavier) * (1 + larger) ** 2:.9g}")
    return root


def compiled(description: str, joints: tuple[str, ...], hidden: tuple[Hidden, ...] = ()) -> mujoco.MjModel:
    """Rigid bodies of a description in MuJoCo, with what is hidden in it."""
    root = ET.fromstring(description)
    options = {"fusestatic": "false", "balanceinertia": "false", "boundmass": "1e-9", "boundinertia": "1e-12"}
    ET.SubElement(ET.SubElement(root, "mujoco"), "compiler", options)
    spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"))
    spec.option.timestep, spec.option.integrator = STEP, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    last = next(j for j in root.findall("joint") if j.get("name") == joints[-1]).find("child")
    assert last is not None
    for one in hidden:
        if one.effect == "payload":
            place = [one.values[axis] for axis in "xyz"]
            body = spec.body(str(last.get("link"))).add_body(name="load", pos=place, explicitinertial=True)
            body.mass, body.inertia, body.ipos = one.values["mass"], [1e-9] * 3, [0.0, 0.0, 0.0]
    model = spec.compile()
    for one in hidden:
        dof = model.joint(one.joint).dofadr[0]
        if one.effect == "joint_viscous_friction":
            model.dof_damping[dof] = one.values["coefficient"]
        elif one.effect == "joint_coulomb_friction":
            model.dof_frictionloss[dof] = one.values["torque"]
        elif one.effect == "rotor_inertia":
            model.dof_armature[dof] = one.values["inertia"]
    model.dof_solref[:], model.dof_solimp[:] = [2 * STEP, 1.0], [0.99, 0.999, 0.001, 0.5, 2.0]
    return model


def rigid_torques(model: mujoco.MjModel, joints: tuple[str, ...], log: Log | tuple[np.ndarray, ...]) -> np.ndarray:
    """(n, nj) N m by MuJoCo's inverse dynamics of a model that has no friction."""
    q, v, a = (log.q, log.v, log.a) if isinstance(log, Log) else log
    dof, data, torque = _dofs(model, joints), mujoco.MjData(model), np.empty_like(q)
    for i in range(len(q)):
        data.qpos[dof], data.qvel[dof], data.qacc[dof] = q[i], v[i], a[i]
        mujoco.mj_inverse(model, data)
        torque[i] = data.qfrc_inverse[dof]
    return torque


def _dofs(model: mujoco.MjModel, joints: tuple[str, ...]) -> list[int]:
    return [int(model.joint(name).dofadr[0]) for name in joints]  # positions have the same places: no body floats


@dataclass(frozen=True)
class Path:
    """Sums of sines of every joint, from rest to rest; (nj, k) rad, Hz and rad."""

    centre: np.ndarray
    amplitude: np.ndarray
    frequency: np.ndarray
    phase: np.ndarray
    seconds: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, robot: urdf.Robot, hz: tuple[float, float], seconds: float) -> "Path":
        """A path within the limits of a robot's joints."""
        limits, count = robot.limits, len(robot.joint_names)
        lower = np.maximum(limits.lower + MARGIN, robot.home - FARTHEST)
        upper = np.minimum(limits.upper - MARGIN, robot.home + FARTHEST)
        swing = rng.uniform(*SWING, count) * (upper - lower)
        centre = rng.uniform(lower + swing, upper - swing)
        amplitude = rng.uniform(0.3, 1.0, (count, SINES))
        frequency, phase = rng.uniform(*hz, (count, SINES)), rng.uniform(0, 2 * np.pi, (count, SINES))
        q, v, a = cls(centre, amplitude, frequency, phase, seconds).at(np.arange(0.0, seconds, 0.01))
        speed = np.minimum(SLOWED * limits.velocity, FASTEST)
        room = [swing / abs(q - centre).max(axis=0), speed / abs(v).max(axis=0), BRISKEST / abs(a).max(axis=0)]
        return cls(centre, amplitude * np.min(room, axis=0)[:, None], frequency, phase, seconds)

    def at(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(n, nj) rad, rad/s and rad/s^2 at (n,) s."""
        w = 2 * np.pi * self.frequency
        angle = time[:, None, None] * w + self.phase
        sine, cosine = self.amplitude * np.sin(angle), self.amplitude * np.cos(angle)
        s, s1, s2 = sine.sum(axis=2), (w * cosine).sum(axis=2), -(w**2 * sine).sum(axis=2)
        left = np.minimum(time, self.seconds - time)
        x = np.clip(left / RAMP, 0.0, 1.0)
        way = np.where(time < self.seconds / 2, 1.0, -1.0) / RAMP
        r = (x**3 * (10 - 15 * x + 6 * x**2))[:, None]
        r1 = (30 * x**2 * (1 - x) ** 2 * way)[:, None]
        r2 = (60 * x * (1 - x) * (1 - 2 * x) / RAMP**2)[:, None]
        return self.centre + r * s, r1 * s + r * s1, r2 * s + 2 * r1 * s1 + r * s2


@dataclass(frozen=True)
class Unknown:
    """A force on one joint that no catalogue has: a cogging, or a torque a (q_j - c) v_i of another joint's speed."""

    joint: int
    other: int  # the joint of the speed; its own for a cogging
    size: float  # N m, or N m s/rad^2
    cogs: float  # periods of a cogging per 2 pi
    centre: float  # rad

    def torque(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(..., nj) N m that the drives need besides, at (..., nj) rad and rad/s."""
        torque = np.zeros_like(q)
        own = q[..., self.joint]
        along = np.sin(self.cogs * own) if self.other == self.joint else (own - self.centre) * v[..., self.other]
        torque[..., self.joint] = self.size * along
        return torque


def simulated(
    model: mujoco.MjModel, joints: tuple[str, ...], path: Path, every: int, drive: np.ndarray, unknown: Unknown | None
) -> Log:
    """A run under computed torque with PD gains: (nj,) `drive` N m/rad; a log has every so many steps."""
    steps = round(path.seconds / STEP)
    wanted, fast, brisk = path.at(STEP * np.arange(steps))
    data, dof, mass = mujoco.MjData(model), _dofs(model, joints), np.zeros((model.nv, model.nv))
    data.qpos[dof] = wanted[0]
    rows: list[np.ndarray] = []
    zero = np.zeros(len(joints))
    for k in range(steps):
        mujoco.mj_step1(model, data)
        mujoco.mj_fullM(model, data, mass)
        own = mass[np.ix_(dof, dof)]
        inertia = np.diag(own)
        stiffness = np.minimum(drive, STIFFEST**2 * inertia)
        q, v = data.qpos[dof], data.qvel[dof]
        torque = own @ brisk[k] + data.qfrc_bias[dof] + stiffness * (wanted[k] - q)
        torque += 2 * DAMPED * np.sqrt(stiffness * inertia) * (fast[k] - v)
        further = zero if unknown is None else unknown.torque(q, v)
        data.qfrc_applied[dof] = torque - further
        mujoco.mj_step2(model, data)
        if k % every == 0:
            # A step's force is that of the second difference of the positions around it (leapfrog).
            after, friction = data.qvel[dof], -data.qfrc_constraint[dof]
            rows.append(np.array([q, 0.5 * (v + after), (after - v) / STEP, torque, friction, further]))
    return Log(*np.array(rows).transpose(1, 0, 2))
