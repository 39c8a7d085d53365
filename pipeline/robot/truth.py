"""The true motion of gripper, load and arm, which only the simulation knows: for reports and verification."""

from dataclasses import dataclass

import mujoco
import numpy as np

from pipeline.robot.plant import LoadString, Plant
from pipeline.robot.protocol import Vector


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


def swing_angle(string: Vector, along: Vector) -> float:
    """Angle of the string (3,), from pivot to load, from the vertical in the plane of line and vertical [rad]."""
    return float(np.arctan2(-(string @ along), -string[2]))


def gripper_truth(plant: Plant, data: mujoco.MjData, time: float) -> GripperTruth:
    """Motion of the string's upper end at a state that MuJoCo has evaluated."""
    site, acceleration, line = plant.model.site("pivot").id, np.zeros(6), plant.line
    v, _ = plant.velocities(data)
    mujoco.mj_rnePostConstraint(plant.model, data)
    mujoco.mj_objectAcceleration(plant.model, data, mujoco.mjtObj.mjOBJ_SITE, site, acceleration, 0)
    # MuJoCo accelerates the world upwards instead of pulling everything down.
    a = acceleration[3:] + plant.model.opt.gravity
    position = data.site_xpos[site].copy()
    return GripperTruth(
        time, position, v, a, line.coordinates(position)[0], float(v @ line.direction), float(a @ line.direction)
    )


def load_truth(plant: Plant, data: mujoco.MjData, string: LoadString, time: float) -> LoadTruth:
    """Motion of load and string at a state that MuJoCo has evaluated."""
    at_pivot, at_load = plant.velocities(data)
    position, line = data.body("load").xpos.copy(), plant.line
    reach, relative = position - data.site("pivot").xpos, at_load - at_pivot
    x, z = -float(reach @ line.direction), -float(reach[2])
    vx, vz = -float(relative @ line.direction), -float(relative[2])
    return LoadTruth(
        time=time,
        position=position,
        velocity=at_load,
        distance=float(np.linalg.norm(reach)),
        swing_angle=swing_angle(reach, line.direction),
        swing_rate=(vx * z - x * vz) / (x * x + z * z),
        out_of_plane_angle=float(np.arctan2(reach @ line.across, np.hypot(x, z))),
        tension=string.tension(data),
    )
