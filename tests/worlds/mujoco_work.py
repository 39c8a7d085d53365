"""Arms at work in MuJoCo for as long as one likes, and what happens to them: touches, loads, joints that wear.

The truth is MuJoCo's: rigid bodies, rotors, damping and friction loss with its stiction, under a stiff computed-torque
controller that knows nothing of friction, loads and touches. A user's description is off by `LINK_ERROR` everywhere,
and has no rotors and no friction. `SensedWorker` carries a tool behind a force/torque sensor, read by MuJoCo's.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from xml.etree import ElementTree as ET

import mujoco
import numpy as np

import urdf

from .motions import Motion, Room, random_fourier, random_moves
from .mujoco_arm import robot_of
from .mujoco_plant import DAMPED, FARTHEST, MARGIN, Hidden, bare, compiled, with_links_off

STEP = 1e-3  # s
DRY: Mapping[str, tuple[float, ...]] = {
    "panda": (1.0, 1.5, 1.0, 1.5, 0.8, 0.8, 0.8), "ur10": (12.0, 14.0, 13.0, 3.0, 3.0, 2.5),
    "xarm7": (4.0, 4.0, 3.0, 3.0, 1.5, 1.5, 1.0),
}  # fmt: skip
"""Dry friction of each joint, N m; there is viscous friction of `VISCOUS` times as much per rad/s."""
VISCOUS, ROTOR = 0.5, 0.05  # s/rad; kg m^2 per N m of dry friction
BANDWIDTH = 60.0  # rad/s of the controller
SPEED, ACCELERATION = 0.8, 3.0  # rad/s, rad/s^2: largest of work
TORQUE_NOISE, POSITION_NOISE = 0.05, 2e-5  # N m and rad, white
WRENCH_NOISE = np.repeat([0.1, 0.005], 3)  # N and N m, white
TOOL, TOOL_LINK, TOOL_MASS, TOOL_CENTRE = "tool", "tool0", 1.2, (0.02, -0.01, 0.08)  # kg; m in the frame of its link


@dataclass(frozen=True)
class Happening:
    """What happens to an arm from `begin` [s] on: at most one of a touch, a load, wear, and a fault of its sensor.

    Attributes:
        touch: (nj,) N m, acting on the joints until `end`.
        load: kg at `place` (3,) m in the last joint's frame.
        worn: (nj,) share by which dry friction grows, over `ramp` s.
        push: (3,) N along the axes of the base, at the last joint's origin or at the tool, until `end`.
        zeroed: whether the sensor is zeroed.
        drift: (6,) rates of its readings, N/s and N m/s.
    """

    begin: float = np.inf
    end: float = np.inf
    touch: np.ndarray | None = None
    load: float = 0.0
    place: tuple[float, float, float] = (0.0, 0.0, 0.0)
    worn: np.ndarray | None = None
    ramp: float = 5.0
    push: np.ndarray | None = None
    zeroed: bool = False
    drift: np.ndarray | None = None


class Worker:
    """One arm at work."""

    def __init__(self, name: str, seed: int) -> None:
        rng = np.random.default_rng([seed, list(DRY).index(name), 77])
        self.robot: urdf.Robot = robot_of(name)
        self.joints = self.robot.joint_names
        plain = bare(self.robot.urdf_xml, self.joints)
        self.exact = ET.tostring(plain, encoding="unicode")
        self.description = ET.tostring(with_links_off(plain, rng), encoding="unicode")
        self.dry = np.array(DRY[name])

    @cached_property
    def _model(self) -> mujoco.MjModel:
        model = self._compiled()
        model.opt.timestep = STEP
        model.dof_solref[:] = [2 * STEP, 1.0]
        for joint, dry in zip(self.joints, self.dry, strict=True):
            dof = model.joint(joint).dofadr[0]
            model.dof_armature[dof], model.dof_damping[dof] = ROTOR * dry, VISCOUS * dry
        # The load may lie anywhere, and how stiff a joint sticks follows from its inertia, with the rotor.
        model.body_sameframe[model.body("load").id] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return model

    def _compiled(self) -> mujoco.MjModel:
        nothing = {"mass": 1e-6, "x": 0.0, "y": 0.0, "z": 0.0}
        return compiled(self.exact, self.joints, (Hidden("payload", self.joints[-1], nothing),))

    @cached_property
    def _dofs(self) -> np.ndarray:
        return np.array([int(self._model.joint(name).dofadr[0]) for name in self.joints])

    def motion(self, rng: np.random.Generator, seconds: float) -> Motion:
        """Moves from posture to posture, or swings, somewhere in the joints' range."""
        limits, home, n = self.robot.limits, self.robot.home, len(self.joints)
        lower, upper = (
            np.maximum(limits.lower + MARGIN, home - FARTHEST),
            np.minimum(limits.upper - MARGIN, home + FARTHEST),
        )
        swing = rng.uniform(0.15, 0.4, n) * (upper - lower)
        centre = rng.uniform(lower + swing, upper - swing)
        speed = np.minimum(SPEED, 0.5 * limits.velocity)
        if rng.random() < 0.5:
            return random_moves(rng, Room(centre, swing, speed, np.full(n, ACCELERATION)), seconds)
        return random_fourier(rng, centre, swing, speed, float(rng.uniform(10.0, 16.0)), 5)

    def jacobian_torques(self, rng: np.random.Generator, q: np.ndarray, largest: float) -> np.ndarray:
        """(nj,) torques of a force on a random link, in a random direction, the largest of them so large."""
        model, data, dof = self._model, mujoco.MjData(self._model), self._dofs
        data.qpos[dof] = q
        mujoco.mj_forward(model, data)
        moved = [int(model.joint(name).bodyid[0]) for name in self.joints]
        body, J = moved[int(rng.integers(len(moved)))], np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, J, None, data.xpos[body] + rng.uniform(-0.15, 0.15, 3), body)
        torque = (J.T @ rng.standard_normal(3))[dof]
        return torque * (largest / np.abs(torque).max())

    def work(
        self, rng: np.random.Generator, motion: Motion, seconds: float, rate: float, what: Happening = Happening()
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(n,) stamps, (n, nj) positions and (n, nj) torques of the drives as they are read, then axes of a sensor."""
        model, dof, every = self._model, self._dofs, round(1.0 / rate / STEP)
        data, mass, n = mujoco.MjData(model), np.zeros((model.nv, model.nv)), len(self.joints)
        load = model.body("load").id
        model.body_mass[load], model.body_ipos[load] = 1e-6, 0.0
        steps = round(seconds / STEP)
        wanted, fast, brisk = motion.at(STEP * np.arange(steps))
        data.qpos[dof], data.qvel[dof] = wanted[0], fast[0]
        rows = np.empty((len(range(0, steps, every)), 2 * n + model.nsensordata))
        for k in range(steps):
            time = k * STEP
            touched = what.touch is not None and what.begin <= time < what.end
            if k % every == 0:
                worn = 1.0
                if what.worn is not None:
                    worn = 1.0 + what.worn * np.clip((time - what.begin) / what.ramp, 0.0, 1.0)
                model.dof_frictionloss[dof] = self.dry * worn
                if what.load and time >= what.begin and model.body_mass[load] < what.load:
                    model.body_mass[load], model.body_ipos[load] = what.load, what.place
            mujoco.mj_step1(model, data)
            mujoco.mj_fullM(model, data, mass)
            own = mass[np.ix_(dof, dof)]
            q, v = data.qpos[dof], data.qvel[dof]
            pull = BANDWIDTH * (BANDWIDTH * (wanted[k] - q) + 2 * DAMPED * (fast[k] - v))
            torque = own @ (brisk[k] + pull) + data.qfrc_bias[dof]
            if k % every == 0:
                rows[k // every, : 2 * n] = *q, *torque
            data.qfrc_applied[dof] = torque + what.touch if touched else torque
            pushed = what.push is not None and what.begin <= time < what.end
            data.xfrc_applied[load, :3] = what.push if pushed else 0.0
            mujoco.mj_step2(model, data)
            if k % every == 0:
                rows[k // every, 2 * n :] = -data.sensordata  # what the tool does to the sensor
        noise = rng.standard_normal((2, len(rows), n))
        stamps, (q, torque, wrench) = STEP * every * np.arange(len(rows)), np.split(rows, [n, 2 * n], axis=1)
        wrench = wrench + WRENCH_NOISE[: wrench.shape[1]] * rng.standard_normal(wrench.shape)
        after = stamps >= what.begin
        if what.zeroed:
            wrench[after] -= wrench[after][0]
        if what.drift is not None:
            wrench[after] += np.outer(stamps[after] - what.begin, what.drift)
        torque = np.hstack([torque + TORQUE_NOISE * noise[1], wrench])
        return stamps, q + POSITION_NOISE * noise[0], torque


class SensedWorker(Worker):
    """An arm with a force/torque sensor on `TOOL_LINK` that carries a tool, in which loads lie and which is pushed.

    The description has no tool.
    """

    def __init__(self, name: str, seed: int) -> None:
        super().__init__(name, seed)
        plain = bare(self.robot.urdf_xml, self.joints)
        link = ET.SubElement(plain, "link", name=TOOL)
        inertial = ET.SubElement(link, "inertial")
        ET.SubElement(inertial, "origin", xyz=" ".join(map(str, TOOL_CENTRE)))
        ET.SubElement(inertial, "mass", value=str(TOOL_MASS))
        ET.SubElement(inertial, "inertia", ixx="2e-3", iyy="2e-3", izz="1e-3", ixy="0", ixz="0", iyz="0")
        joint = ET.SubElement(plain, "joint", name="tool_joint", type="fixed")
        ET.SubElement(joint, "parent", link=TOOL_LINK)
        ET.SubElement(joint, "child", link=TOOL)
        self.exact = ET.tostring(plain, encoding="unicode")

    def _compiled(self) -> mujoco.MjModel:
        root = ET.fromstring(self.exact)
        options = {"fusestatic": "false", "balanceinertia": "false", "boundmass": "1e-9", "boundinertia": "1e-12"}
        ET.SubElement(ET.SubElement(root, "mujoco"), "compiler", options)
        spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"))
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
        spec.body(TOOL).add_site(name="ft")
        body = spec.body(TOOL).add_body(name="load", explicitinertial=True)
        body.mass, body.inertia = 1e-6, [1e-9] * 3
        for kind in ("FORCE", "TORQUE"):
            of_site = {"objtype": mujoco.mjtObj.mjOBJ_SITE, "objname": "ft"}
            spec.add_sensor(name=kind, type=getattr(mujoco.mjtSensor, f"mjSENS_{kind}"), **of_site)
        model = spec.compile()
        model.dof_solimp[:] = [0.99, 0.999, 0.001, 0.5, 2.0]
        return model
