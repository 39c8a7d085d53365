"""True motion of gripper and load of the simulated robot, which no product code asks for: m, s, rad, N, base frame."""

from types import SimpleNamespace

import mujoco
import numpy as np

from pipeline.robot.truth import swing_angle


def evaluated(robot):
    """MuJoCo at the present state in a copy, so that looking at it changes nothing."""
    data = mujoco.MjData(robot._plant.model)
    mujoco.mj_copyData(data, robot._plant.model, robot._data)
    data.ctrl[:] = robot._servo.reference_torque
    mujoco.mj_forward(robot._plant.model, data)
    return data


def velocity(robot, data, kind, number):
    found = np.zeros(6)
    mujoco.mj_objectVelocity(robot._plant.model, data, kind, number, found, 0)
    return found[3:]


def gripper_truth(robot):
    """Motion now of the string's upper end, also along the line: s."""
    model, line, data, acceleration = robot._plant.model, robot._plant.line, evaluated(robot), np.zeros(6)
    pivot = mujoco.mjtObj.mjOBJ_SITE, model.site("pivot").id
    mujoco.mj_rnePostConstraint(model, data)
    mujoco.mj_objectAcceleration(model, data, *pivot, acceleration, 0)
    # MuJoCo accelerates the world upwards instead of pulling everything down.
    v, a, position = velocity(robot, data, *pivot), acceleration[3:] + model.opt.gravity, data.site("pivot").xpos.copy()
    return SimpleNamespace(
        position=position, acceleration=a, s=line.coordinates(position)[0],
        s_velocity=float(v @ line.direction), s_acceleration=float(a @ line.direction),
    )  # fmt: skip


def load_truth(robot):
    """Motion now of load and string: angles and their rate as of a pendulum below the pivot; tension 0 when slack."""
    model, line, data = robot._plant.model, robot._plant.line, evaluated(robot)
    at_load = velocity(robot, data, mujoco.mjtObj.mjOBJ_BODY, model.body("load").id)
    relative = at_load - velocity(robot, data, mujoco.mjtObj.mjOBJ_SITE, model.site("pivot").id)
    reach = data.body("load").xpos - data.site("pivot").xpos
    (x, vx), (z, vz) = (-np.array([reach, relative]) @ axis for axis in (line.direction, np.eye(3)[2]))
    return SimpleNamespace(
        position=data.body("load").xpos.copy(), velocity=at_load, distance=float(np.linalg.norm(reach)),
        swing_angle=swing_angle(reach, line.direction), swing_rate=(vx * z - x * vz) / (x * x + z * z),
        out_of_plane_angle=float(np.arctan2(reach @ line.axes[:, 1], np.hypot(x, z))),
        tension=robot._string.tension(data),
    )  # fmt: skip
