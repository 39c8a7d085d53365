"""True motion of gripper and load of the simulated robot, which no product code asks for."""

from dataclasses import dataclass

import mujoco
import numpy as np

from pipeline.robot.protocol import Vector
from pipeline.robot.simulated import SimulatedRobot
from pipeline.robot.truth import swing_angle


@dataclass(frozen=True)
class GripperTruth:
    """The string's upper end."""

    time: float  # [s]
    position: Vector  # in the base frame (3,) [m]
    velocity: Vector  # (3,) [m/s]
    acceleration: Vector  # (3,) [m/s^2]
    s: float  # line coordinate [m]
    s_velocity: float  # along the line [m/s]
    s_acceleration: float  # along the line [m/s^2]


@dataclass(frozen=True)
class LoadTruth:
    """The load and the string."""

    time: float  # [s]
    position: Vector  # of the load's centre in the base frame (3,) [m]
    velocity: Vector  # (3,) [m/s]
    distance: float  # pivot to centre [m]
    swing_angle: float  # 0 hanging, the load is at s - distance sin(angle) [rad]
    swing_rate: float  # [rad/s]
    out_of_plane_angle: float  # of the string across the line [rad]
    tension: float  # pull of the string [N]; 0 when slack


def evaluated(robot: SimulatedRobot) -> mujoco.MjData:
    """MuJoCo at the present state in a copy, so that looking at it changes nothing."""
    model = robot._plant.model
    data = mujoco.MjData(model)
    mujoco.mj_copyData(data, model, robot._data)
    data.ctrl[:] = robot._servo.driven
    mujoco.mj_forward(model, data)
    return data


def velocities(robot: SimulatedRobot, data: mujoco.MjData) -> tuple[Vector, Vector]:
    """Of pivot and load (3,) each [m/s]."""
    model, velocity = robot._plant.model, np.zeros((2, 6))
    pivot, load = model.site("pivot").id, model.body("load").id
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, pivot, velocity[0], 0)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, load, velocity[1], 0)
    return velocity[0, 3:], velocity[1, 3:]


def gripper_truth(robot: SimulatedRobot) -> GripperTruth:
    """Motion of the string's upper end now."""
    plant, data, time = robot._plant, evaluated(robot), robot.time
    site, acceleration, line = plant.model.site("pivot").id, np.zeros(6), plant.line
    v, _ = velocities(robot, data)
    mujoco.mj_rnePostConstraint(plant.model, data)
    mujoco.mj_objectAcceleration(plant.model, data, mujoco.mjtObj.mjOBJ_SITE, site, acceleration, 0)
    # MuJoCo accelerates the world upwards instead of pulling everything down.
    a = acceleration[3:] + plant.model.opt.gravity
    position = data.site_xpos[site].copy()
    return GripperTruth(
        time, position, v, a, line.coordinates(position)[0], float(v @ line.direction), float(a @ line.direction)
    )


def load_truth(robot: SimulatedRobot) -> LoadTruth:
    """Motion of load and string now."""
    plant, data, time = robot._plant, evaluated(robot), robot.time
    at_pivot, at_load = velocities(robot, data)
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
        out_of_plane_angle=float(np.arctan2(reach @ line.axes[:, 1], np.hypot(x, z))),
        tension=robot._string.tension(data),
    )
