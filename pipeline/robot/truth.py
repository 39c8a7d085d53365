"""What only the simulation knows: what was drawn, and the true motion.

Reports and verification see it; the controller never gets it.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from pipeline.robot.protocol import Vector
from pipeline.robot.scene import LineFrame
from pipeline.robot.settings import PlantSettings


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
