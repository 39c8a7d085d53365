"""The simulated plant (arm, string and load): forces that MuJoCo does not compute, and its state at rest."""

import math
from collections.abc import Mapping

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

import urdf
from armdyn.errors import InputError
from armdyn.pendulum.physics import STANDARD_GRAVITY
from pipeline.robot.hidden import HiddenEffectStage, hidden_effect_terms, pivot_coulomb_friction
from pipeline.robot.own_law import LoadState
from pipeline.robot.protocol import Vector
from pipeline.robot.scene import build_scene, relative_effort_limits
from pipeline.robot.settings import PlantSettings

STRING_DAMPING_RATIO = 0.05
"""Damping ratio of the longitudinal vibration of load and elastic string: typical of cotton and nylon cords."""


class Plant:
    """MuJoCo model and state of arm, string and load, with the random true values and the hidden effects.

    Attributes:
        line: line along which the arm moves the gripper.
        model, data: MuJoCo's model and state.
        dofs: index of each joint in MuJoCo's vectors of positions and velocities (n,).
        pivot, load: positions of the string's upper end and of the load's centre, views of MuJoCo's state (3,) [m].
        mass: true mass of the load [kg].
        bias, latency, link_scale: see `TruePlantParameters`.
    """

    def __init__(
        self, robot: urdf.Robot, settings: PlantSettings, hidden: Mapping[str, float], rng: np.random.Generator
    ) -> None:
        self.robot, self.settings, self.hidden = robot, settings, hidden
        # Values that the settings fix are drawn too and not used, so that the other draws stay the same.
        spread, cell = settings.relative_inertia_std, settings.cell
        self.link_scale = 1.0 + rng.uniform(-spread, spread, len(robot.joint_names))
        self.mass = float(settings.mass * (1.0 + settings.relative_mass_std * rng.standard_normal()))
        bias, latency = cell.bias_std * rng.standard_normal(), rng.uniform(0.0, cell.max_random_latency)
        self.bias = float(bias) if cell.bias is None else cell.bias
        self.latency = float(latency) if cell.latency is None else cell.latency
        self.line = robot.line
        self.model = build_scene(robot, settings, hidden, self.mass, self.link_scale)
        self.data = mujoco.MjData(self.model)
        self.dofs = np.array([self.model.joint(name).dofadr[0] for name in robot.joint_names])
        self._pivot, self._load = self.model.site("pivot").id, self.model.body("load").id
        self.pivot, self.load = self.data.site_xpos[self._pivot], self.data.xpos[self._load]
        self.pull_on_load = self.data.xfrc_applied[self._load][:3]

    def velocities(self) -> tuple[Vector, Vector]:
        """Velocities of pivot and load (3,) each [m/s]."""
        velocity = np.zeros((2, 6))
        mujoco.mj_objectVelocity(self.model, self.data, mujoco.mjtObj.mjOBJ_SITE, self._pivot, velocity[0], 0)
        mujoco.mj_objectVelocity(self.model, self.data, mujoco.mjtObj.mjOBJ_BODY, self._load, velocity[1], 0)
        return velocity[0, 3:], velocity[1, 3:]


class LoadString:
    """The string as a MuJoCo tendon: nearly rigid (a limit of its length) or elastic (a spring); it only pulls."""

    def __init__(self, plant: Plant) -> None:
        model = self._model = plant.model
        self._tendon, self._sensor = model.tendon("string").id, model.sensor("tension").adr[0]
        self._elastic = not model.tendon_limited[self._tendon]
        self._stiffness = float(model.tendon_stiffness.reshape(model.ntendon, -1)[self._tendon, 0])
        self._damping = 2.0 * STRING_DAMPING_RATIO * math.sqrt(plant.mass * self._stiffness) if self._elastic else 0.0

    @property
    def length(self) -> float:
        """Length at which the string begins to pull [m]."""
        return float(self._model.tendon_range[self._tendon, 1])

    @length.setter
    def length(self, length: float) -> None:
        self._model.tendon_range[self._tendon, 1] = length
        self._model.tendon_lengthspring[self._tendon, 1] = length

    def pull(self, data: mujoco.MjData) -> float:
        """Force of MuJoCo's tendon, without inner damping, at the state that MuJoCo evaluated last [N]."""
        if not self._elastic:
            return float(data.sensordata[self._sensor])
        return max(0.0, self._stiffness * (float(data.ten_length[self._tendon]) - self.length))

    def damping(self, data: mujoco.MjData) -> float:
        """Contribution of inner damping to the tension of an elastic string [N]; the total is never negative."""
        pull = self.pull(data) if self._elastic else 0.0
        return max(self._damping * float(data.ten_velocity[self._tendon]), -pull) if pull > 0.0 else 0.0

    def tension(self, data: mujoco.MjData) -> float:
        """Tension of the string, with inner damping [N]; 0 for a slack string."""
        return self.pull(data) + self.damping(data)


class HeavyString:
    """The weight and inertia of a string with mass that pull on its upper end: M (g - a) . e along the string, e.

    a is the acceleration of its centre, from the velocities of two steps.
    """

    def __init__(self, plant: Plant) -> None:
        self._plant, self._mass = plant, plant.hidden["string_mass"]
        self._body = plant.model.body("bar").id if self._mass else -1
        self._before: Vector | None = None

    def pull(self) -> float:
        """Part of the pull on the string's upper end that the string itself exerts [N]; called once per step."""
        if not self._mass:
            return 0.0
        plant, velocity = self._plant, np.zeros(6)
        mujoco.mj_objectVelocity(plant.model, plant.data, mujoco.mjtObj.mjOBJ_BODY, self._body, velocity, 0)
        before, self._before = self._before, velocity[3:]
        acceleration = np.zeros(3) if before is None else (velocity[3:] - before) / plant.model.opt.timestep
        along = plant.load - plant.pivot
        return float(self._mass * (plant.model.opt.gravity - acceleration) @ along / np.linalg.norm(along))


class GripperShift:
    """Moves the string's upper end away from where the encoders say it is: by a wrong scale along the line, or an arc.

    MuJoCo's string feels the place of its end and not that it moves on the gripper: with the string's stiffness over
    its damping the pull is 4 ms late for a motion that is a few percent of the gripper's.
    """

    def __init__(self, plant: Plant) -> None:
        self._plant, model = plant, plant.model
        self._site, hidden = model.site("pivot").id, plant.hidden
        self._scale, self._curvature = hidden["gripper_scale"], hidden["gripper_bob"]
        self._home, self._body = model.site_pos[self._site].copy(), int(model.site_bodyid[self._site])

    def apply(self) -> None:
        """Set the place of the string's upper end on the gripper for the arm's present posture."""
        if not (self._scale or self._curvature):
            return
        data, line = self._plant.data, self._plant.line
        turn = data.xmat[self._body].reshape(3, 3)
        along = float((data.xpos[self._body] + turn @ self._home - line.origin) @ line.direction)
        shift = self._scale * along * line.direction + self._curvature * along**2 * line.axes[:, 2]
        self._plant.model.site_pos[self._site] = self._home + turn.T @ shift


class LoadForces:
    """Forces on the load: drag, wind, magnet, friction at the pivot, a user's laws, inner damping of an elastic string.

    Their direct reaction on the arm, some millinewtons, is neglected.
    """

    def __init__(self, plant: Plant, string: LoadString) -> None:
        self._plant, self._string = plant, string
        self._wind = plant.hidden["wind"] * plant.line.direction
        plant.pull_on_load[:] = self._wind
        self._on_load, self._at_pivot = (
            hidden_effect_terms(plant.hidden, HiddenEffectStage.LOAD),
            hidden_effect_terms(plant.hidden, HiddenEffectStage.PIVOT),
        )
        self._at_place, self._own = (
            hidden_effect_terms(plant.hidden, HiddenEffectStage.POSITION),
            hidden_effect_terms(plant.hidden, HiddenEffectStage.OWN),
        )
        added = self._on_load or self._at_pivot or self._at_place or self._own
        self._active = bool(added or plant.hidden["string_elasticity"])
        self._reversal = plant.model.opt.timestep / (plant.mass * plant.settings.length**2)
        self._hand = 0.0

    def hold(self, *, held: bool) -> None:
        """Whether a hand brakes the load, as strongly as it settles soonest: 2 m sqrt(g / l) [N s/m]."""
        plant = self._plant
        critical = 2.0 * plant.mass * math.sqrt(STANDARD_GRAVITY / plant.settings.length)
        self._hand, plant.pull_on_load[:] = critical if held else 0.0, self._wind

    def apply(self) -> None:
        """Set the external force on the load in MuJoCo for the present state."""
        if not (self._active or self._hand):
            return
        pivot, load = self._plant.velocities()
        force = self._wind - self._hand * load + sum(term(load) for term in self._on_load)
        if self._at_place:
            line = self._plant.line
            along = float((self._plant.load - line.origin) @ line.direction)
            force = force + sum(term(along) for term in self._at_place) * line.direction
        taut = self._string.pull(self._plant.data) > 0.0
        if self._own:
            force = force + self._by_own_laws(pivot, load, taut=taut)
        if taut:
            force = force + self._along_string(load - pivot)
        self._plant.pull_on_load[:] = force

    def _along_string(self, relative: Vector) -> Vector:
        """Friction at the pivot and inner damping (3,) [N] at the load's velocity relative to the pivot (3,) [m/s]."""
        string = self._plant.pivot - self._plant.load
        length = math.sqrt(string @ string)
        string = string / length
        across = relative - (relative @ string) * string
        rate = math.sqrt(across @ across) / length
        resistance = sum(term(rate, self._reversal) for term in self._at_pivot)
        force: Vector = self._string.damping(self._plant.data) * string - resistance / length**2 * across
        return force

    def _by_own_laws(self, pivot: Vector, load: Vector, *, taut: bool) -> Vector:
        """Forces of a user's laws, and their torques about the pivot, as forces on the load (3,) [N]."""
        plant, line = self._plant, self._plant.line
        frame = line.axes.T
        string, relative = frame @ (plant.load - plant.pivot), frame @ (load - pivot)
        length, angle = math.sqrt(string @ string), math.atan2(-string[0], -string[2])
        along = np.array([-math.cos(angle), 0.0, math.sin(angle)])  # direction of the load's motion as the angle grows
        rate = float(along @ relative) / math.hypot(string[0], string[2])
        place = frame @ (plant.load - line.origin)
        swing = LoadState(float(plant.data.time), plant.mass, length, angle, rate, place, frame @ load)
        force = np.zeros(3)
        for law in self._own:
            added = law(swing)
            torque = added.torque - pivot_coulomb_friction(added.dry, abs(rate), self._reversal) * rate
            force += added.force + (torque / length * along if taut else 0.0)
        return np.asarray(force @ frame)


class HiddenJointEffects:
    """Hidden effects on the joints: dry friction and gravity springs, set in MuJoCo at every step.

    Dry friction is a constraint of MuJoCo's solver, which holds a joint exactly at rest; only its bound is changed.

    Raises:
        InputError: a gravity spring is requested, and none is known for this robot.
    """

    def __init__(self, plant: Plant) -> None:
        robot, self._plant = plant.robot, plant
        self._share = relative_effort_limits(robot)
        self._base = plant.model.dof_frictionloss[plant.dofs].copy()
        self._friction = hidden_effect_terms(plant.hidden, HiddenEffectStage.JOINTS)
        strength = plant.hidden["gravity_spring"]
        if strength and not robot.springs:
            raise InputError(
                f"hidden effect 'gravity_spring': no spring is known for robot '{robot.name}'; leave it out"
            )
        # The robot's springs are defined by the effort that they add to a measurement; their torque has the other sign.
        self._springs = [
            (int(plant.dofs[robot.joint_names.index(s.joint)]), -strength * s.sine, -strength * s.cosine)
            for s in robot.springs
            if strength
        ]

    def apply(self) -> None:
        """Set friction bounds and spring torques for the present state, whose bias force MuJoCo has computed."""
        model, data, dofs = self._plant.model, self._plant.data, self._plant.dofs
        for dof, sine, cosine in self._springs:
            angle = data.qpos[model.jnt_qposadr[model.dof_jntid[dof]]]
            data.qfrc_applied[dof] = sine * np.sin(angle) + cosine * np.cos(angle)
        if self._friction:
            v, gravity = data.qvel[dofs], data.qfrc_bias[dofs]
            model.dof_frictionloss[dofs] = self._base + sum(term(self._share, v, gravity) for term in self._friction)


def place_at_rest(plant: Plant, string: LoadString, shift: GripperShift, q: Vector) -> Vector:
    """Put the arm at the posture `q` (n,) [rad] with the load at rest, and set the string's unstretched length.

    The unstretched length is such that the load hangs exactly at ``settings.length``, which a ruler measures. Then the
    string is turned about the pivot to its start angle.

    Returns:
        Motor torque of each joint that holds the arm (n,) [N m].
    """
    model, data, settings, along = plant.model, plant.data, plant.settings, plant.line.direction
    data.qpos[plant.dofs] = q
    mujoco.mj_kinematics(model, data)
    if plant.hidden["gripper_compliance"]:
        giving = model.joint("giving")
        model.jnt_axis[giving.id] = data.xmat[model.jnt_bodyid[giving.id]].reshape(3, 3).T @ along
    shift.apply()
    mujoco.mj_kinematics(model, data)
    pivot = plant.pivot.copy()
    pull = plant.mass * model.opt.gravity + plant.hidden["wind"] * along
    weight = float(np.linalg.norm(pull))
    down = pull / weight
    _place_load(plant, pivot, down, settings.length)
    # The motors balance gravity, springs and the hanging load.
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jacSite(model, data, jacobian, None, model.site("pivot").id)
    torque: Vector = (data.qfrc_bias - data.qfrc_applied - jacobian.T @ pull)[plant.dofs]
    rest = string.length = _string_length(plant, string, torque, weight)
    out_of_plane = plant.hidden["out_of_plane_swing"]
    if settings.start_angle or out_of_plane:
        across = plant.line.axes[:, 1]
        turn = Rotation.from_rotvec(out_of_plane * along) * Rotation.from_rotvec(settings.start_angle * across)
        turned = turn.apply(down)
        # The pull, and with it the stretch, falls with the cosine of the angle.
        _place_load(plant, pivot, turned, rest + (settings.length - rest) * float(turned @ down))
    data.qvel[:] = data.qacc[:] = 0.0  # these evaluations were made without the torque that holds the arm
    return torque


def _place_load(plant: Plant, pivot: Vector, direction: Vector, distance: float) -> None:
    """Put the load at a distance [m] from the pivot (3,) along a unit vector (3,)."""
    model, data = plant.model, plant.data
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


def _string_length(plant: Plant, string: LoadString, torque: Vector, weight: float) -> float:
    """Unstretched length [m] with which the string has the wanted length under `weight` [N]; linear."""
    model, data, distance = plant.model, plant.data, plant.settings.length
    trial = mujoco.MjData(model)
    trial.qpos[:] = data.qpos
    trial.qfrc_applied[:] = data.qfrc_applied
    trial.qfrc_applied[plant.dofs] += torque
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
