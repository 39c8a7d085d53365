"""What only the simulation knows: the effects that are hidden in it, what was drawn, and the true motion.

Reports and verification see it; the controller never gets it. Hidden effects go by the catalogue's names, and every
value is zero where the effect is absent. How each one acts on MuJoCo's model or state is written in `scene`, `forces`
and `devices`; none of it shares code with the model under test.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import mujoco
import numpy as np

from armdyn.errors import InputError, UnknownNameError
from pipeline.robot.protocol import Vector
from pipeline.robot.scene import LineFrame
from pipeline.robot.settings import PlantSettings


class HiddenEffect(NamedTuple):
    """One effect that the plant can have.

    Attributes:
        unit: unit of its value.
        typical: value that it has when none is given.
        summary: one sentence.
        lower: smallest value that makes sense.
        upper: largest value that the 1 ms integration stays accurate for.
    """

    unit: str
    typical: float
    summary: str
    lower: float = 0.0
    upper: float = math.inf


_BOTH = -math.inf

HIDDEN_EFFECTS: Mapping[str, HiddenEffect] = MappingProxyType({
    # gripper
    "gripper_lag": HiddenEffect(
        "s", 0.02, "The gripper trails what the encoders report, as a first-order lag.", 0.0, 0.2),
    "path_tilt": HiddenEffect(
        "rad", 0.01, "The robot stands tilted: gravity has a component along the line, towards + for > 0.", -0.5, 0.5),
    # string
    "pivot_viscous_friction": HiddenEffect(
        "N m s/rad", 1e-3, "A torque at the string's upper end, proportional to the swing rate.", 0.0, 0.5),
    "pivot_coulomb_friction": HiddenEffect(
        "N m", 1e-3, "A torque of constant size at the string's upper end, against the swing.", 0.0, 0.5),
    "string_elasticity": HiddenEffect(
        "m/N", 2e-3, "The string stretches in proportion to its tension (replaces the nearly rigid one).", 1e-4, 0.05),
    "string_creep": HiddenEffect("m/s", 5e-5, "The string grows longer at a constant rate.", -0.01, 0.01),
    # load
    "linear_drag": HiddenEffect("N s/m", 5e-3, "Air drag proportional to the load's speed.", 0.0, 5.0),
    "quadratic_drag": HiddenEffect(
        "N s^2/m^2", 3e-3, "Air drag growing with the square of the load's speed.", 0.0, 5.0),
    "wind": HiddenEffect("N", 5e-3, "A constant horizontal force on the load, along the line.", -1.0, 1.0),
    "load_inertia": HiddenEffect(
        "kg m^2", 2e-4, "The load turns with the string and has this moment of inertia about its centre.", 0.0, 0.1),
    "out_of_plane_swing": HiddenEffect(
        "rad", 0.05, "The load starts displaced across the line by this angle.", -1.0, 1.0),
    # sensor
    "sensor_bias": HiddenEffect("N", 0.02, "A constant added to the force (on top of the drawn bias).", _BOTH),
    "sensor_gain": HiddenEffect("1", 0.03, "Relative error of the force's scale.", -0.9),
    "sensor_drift": HiddenEffect("N/s", 1e-3, "The force's zero moves at a constant rate.", _BOTH),
    "sensor_lag": HiddenEffect("s", 0.02, "The cell follows the force as a first-order lag.", 0.0, 1.0),
    "sensor_delay": HiddenEffect("s", 0.02, "The force arrives late (on top of the drawn latency).", 0.0, 1.0),
    "vertical_sensing_axis": HiddenEffect(
        "1", 1.0, "The cell measures the vertical part of the string's pull; between 0 and 1 a mixture.", 0.0, 1.0),
    "cross_axis_sensitivity": HiddenEffect(
        "1", 0.02, "The cell also feels this share of the string's pull along the line, T sin(angle).", -1.0, 1.0),
    "sensor_nonlinearity": HiddenEffect(
        "1/N", 0.02, "The reading curves: this times the force squared is added.", _BOTH),
    # joint; the effort limit scales the value, so that Baxter's wrist has 0.3 of the shoulder's
    "joint_viscous_friction": HiddenEffect("N m s/rad", 3.0, "More viscous friction in every joint.", 0.0, 50.0),
    "joint_coulomb_friction": HiddenEffect("N m", 1.0, "More dry friction in every joint.", 0.0, 20.0),
    "joint_asymmetric_friction": HiddenEffect(
        "N m", 1.0, "More dry friction in every joint while it turns positively.", 0.0, 20.0),
    "joint_stribeck_friction": HiddenEffect(
        "N m", 1.0, "More dry friction in every joint near standstill, fading as exp(-(v/0.1 rad/s)^2).", 0.0, 20.0),
    "joint_load_friction": HiddenEffect(
        "1", 0.05, "Dry friction in every joint proportional to the gravity torque that it carries.", 0.0, 1.0),
    "rotor_inertia": HiddenEffect(
        "kg m^2", 0.1, "More rotor inertia in every joint, as seen behind the gears.", 0.0, 10.0),
    "torque_offset": HiddenEffect("N m", 0.5, "A constant added to every measured effort.", _BOTH),
    "torque_gain": HiddenEffect("1", 0.05, "Relative error of the scale of every measured effort.", -0.9),
    "gravity_spring": HiddenEffect(
        "1", 1.0, "Baxter's gravity springs on s1, as a share of the real ones: 8.2 sin q + 35.3 cos q N m.", 0.0, 2.0),
    "payload": HiddenEffect("kg", 0.5, "A mass at the gripper's frame that the arm's model does not know.", 0.0, 5.0),
    "link_inertia": HiddenEffect("1", 0.1, "Mass and inertia of every arm link are larger by this share.", -0.9, 5.0),
})  # fmt: skip


def resolve_hidden(hidden: Mapping[str, float | None]) -> Mapping[str, float]:
    """Value of every effect: typical where ``None`` was given, zero where the effect was not named.

    Args:
        hidden: name to value in the effect's unit, or ``None`` for the typical value.

    Returns:
        All names of `HIDDEN_EFFECTS` with their value, read-only.

    Raises:
        UnknownNameError: a name that the plant does not have.
        InputError: a value that is not finite or outside the effect's range.
    """
    values = dict.fromkeys(HIDDEN_EFFECTS, 0.0)
    for name, value in hidden.items():
        if name not in HIDDEN_EFFECTS:
            raise UnknownNameError("hidden effect", name, HIDDEN_EFFECTS)
        effect = HIDDEN_EFFECTS[name]
        number = effect.typical if value is None else float(value)
        if number != 0.0 and not (math.isfinite(number) and effect.lower <= number <= effect.upper):
            raise InputError(
                f"hidden effect '{name}' is {number:g} {effect.unit}: give 0 or a value from {effect.lower:g} to "
                f"{effect.upper:g} (typical {effect.typical:g})"
            )
        values[name] = number
    return MappingProxyType(values)


@dataclass(frozen=True)
class Drawn:
    """One draw of the plant.

    Attributes:
        mass: true mass of the load [kg].
        bias: zero error of the load cell [N].
        latency: of the load cell [s].
        link_scale: factor on mass and inertia of the link behind each joint (n,).
    """

    mass: float
    bias: float
    latency: float
    link_scale: Vector


def draw(settings: PlantSettings, joints: int, rng: np.random.Generator) -> Drawn:
    """Draw a plant. Values that the settings fix are drawn too and not used, so that the other draws stay the same."""
    spread = settings.inertia_spread
    link_scale = 1.0 + rng.uniform(-spread, spread, joints)
    mass = settings.mass * (1.0 + settings.mass_spread * rng.standard_normal())
    bias = settings.cell.bias_spread * rng.standard_normal()
    latency = rng.uniform(0.0, settings.cell.latency_up_to)
    link_scale.setflags(write=False)
    return Drawn(
        mass=float(mass),
        bias=float(bias) if settings.cell.bias is None else settings.cell.bias,
        latency=float(latency) if settings.cell.latency is None else settings.cell.latency,
        link_scale=link_scale,
    )


@dataclass(frozen=True, kw_only=True)
class PlantTruth(Drawn):
    """What was drawn or hidden.

    Attributes:
        length: from the string's upper end to the load's centre, hanging at rest [m].
        string_length: the same for the string without pull [m].
        hidden: value of every effect that is there.
    """

    length: float
    string_length: float
    hidden: Mapping[str, float]


@dataclass(frozen=True)
class GripperTruth:
    """The string's upper end.

    Attributes:
        time: [s].
        position: in the base frame (3,) [m].
        velocity: (3,) [m/s].
        acceleration: (3,) [m/s^2].
        s: line coordinate [m].
        s_velocity: along the line [m/s].
        s_acceleration: along the line [m/s^2].
    """

    time: float
    position: Vector
    velocity: Vector
    acceleration: Vector
    s: float
    s_velocity: float
    s_acceleration: float


@dataclass(frozen=True)
class LoadTruth:
    """The load and the string.

    Attributes:
        time: [s].
        position: of the load's centre in the base frame (3,) [m].
        velocity: (3,) [m/s].
        distance: pivot to centre [m].
        swing_angle: 0 hanging, the load is at s - distance sin(angle) [rad].
        swing_rate: [rad/s].
        out_of_plane_angle: of the string across the line [rad].
        tension: pull of the string [N]; 0 when slack.
    """

    time: float
    position: Vector
    velocity: Vector
    distance: float
    swing_angle: float
    swing_rate: float
    out_of_plane_angle: float
    tension: float


@dataclass(frozen=True)
class History:
    """The whole motion at a fixed period.

    Attributes:
        time: (k,) [s].
        q: joint positions (k, n) [rad].
        pivot: the string's upper end in the base frame (k, 3) [m].
        load: the load's centre in the base frame (k, 3) [m].
        tension: (k,) [N].
    """

    time: Vector
    q: Vector
    pivot: Vector
    load: Vector
    tension: Vector

    def from_time(self, time: float) -> "History":
        """What happened from `time` [s] on."""
        kept = self.time >= time
        return History(self.time[kept], self.q[kept], self.pivot[kept], self.load[kept], self.tension[kept])


class MotionLog:
    """Collects the history."""

    def __init__(self) -> None:
        self._times: list[float] = []
        self._tensions: list[float] = []
        self._vectors: list[tuple[Vector, Vector, Vector]] = []

    def add(self, time: float, q: Vector, pivot: Vector, load: Vector, tension: float) -> None:
        """Remember one moment; the vectors are kept, not copied."""
        self._times.append(time)
        self._tensions.append(tension)
        self._vectors.append((q, pivot, load))

    def history(self, joints: int) -> History:
        """All that was remembered, for an arm with that many joints."""
        q, pivot, load = (np.array([v[i] for v in self._vectors]).reshape(-1, n) for i, n in enumerate((joints, 3, 3)))
        return History(np.array(self._times), q, pivot, load, np.array(self._tensions))


def swing_angle(string: Vector, along: Vector) -> float:
    """Angle of the string (3,), from pivot to load, from the vertical in the plane of line and vertical [rad]."""
    return float(np.arctan2(-(string @ along), -string[2]))


def gripper_truth(model: mujoco.MjModel, data: mujoco.MjData, line: LineFrame, time: float) -> GripperTruth:
    """Motion of the string's upper end at the state that MuJoCo last evaluated."""
    site = model.site("pivot").id
    velocity, acceleration = np.zeros(6), np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, site, velocity, 0)
    mujoco.mj_rnePostConstraint(model, data)
    mujoco.mj_objectAcceleration(model, data, mujoco.mjtObj.mjOBJ_SITE, site, acceleration, 0)
    # MuJoCo accelerates the world upwards instead of pulling everything down.
    a = acceleration[3:] + model.opt.gravity
    position, v = data.site_xpos[site].copy(), velocity[3:]
    return GripperTruth(time, position, v, a, line.coordinate(position), float(v @ line.along), float(a @ line.along))


def load_truth(model: mujoco.MjModel, data: mujoco.MjData, line: LineFrame, time: float, tension: float) -> LoadTruth:
    """Motion of load and string at the state that MuJoCo last evaluated."""
    site, body = mujoco.mjtObj.mjOBJ_SITE, mujoco.mjtObj.mjOBJ_BODY
    at_pivot, at_load = np.zeros(6), np.zeros(6)
    mujoco.mj_objectVelocity(model, data, site, model.site("pivot").id, at_pivot, 0)
    mujoco.mj_objectVelocity(model, data, body, model.body("load").id, at_load, 0)
    position = data.body("load").xpos.copy()
    string = position - data.site("pivot").xpos
    relative = at_load[3:] - at_pivot[3:]
    x, z = -float(string @ line.along), -float(string[2])
    vx, vz = -float(relative @ line.along), -float(relative[2])
    return LoadTruth(
        time=time,
        position=position,
        velocity=at_load[3:],
        distance=float(np.linalg.norm(string)),
        swing_angle=swing_angle(string, line.along),
        swing_rate=(vx * z - x * vz) / (x * x + z * z),
        out_of_plane_angle=float(np.arctan2(string @ line.across, np.hypot(x, z))),
        tension=tension,
    )
