"""Input of the simulated robot, checked before anything is built on it."""

import numpy as np
import numpy.typing as npt

import urdf
from armdyn.errors import InputError
from pipeline.robot.protocol import Vector
from pipeline.robot.settings import PlantSettings


def checked_vector(values: npt.ArrayLike, joints: int, what: str) -> Vector:
    """A copy of a joint vector (n,).

    Raises:
        InputError: not a vector of that length, or not finite.
    """
    vector = np.array(values, dtype=float)
    if vector.shape != (joints,):
        raise InputError(f"{what} has the shape {vector.shape}: give one value for each of the {joints} joints")
    if not np.isfinite(vector).all():
        raise InputError(f"{what} of joint {int(np.argmin(np.isfinite(vector)))} is not finite: give numbers")
    return vector


def checked_start(robot: urdf.Robot, q_start: npt.ArrayLike, settings: PlantSettings) -> Vector:
    """Start posture (n,) [rad], within the limits of a robot for which the settings have a value per joint.

    Raises:
        InputError: which joint is beyond its limit, or which setting has the wrong number of values.
    """
    joints = len(robot.joint_names)
    servo, readings = settings.servo, settings.readings
    per_joint = {
        "servo.stiffness": servo.stiffness,
        "servo.damping": servo.damping,
        "servo.armature": servo.armature,
        "servo.friction": servo.friction,
        "readings.effort_noise": readings.effort_noise,
    }
    for name, values in per_joint.items():
        if len(values) != joints:
            raise InputError(f"PlantSettings.{name} has {len(values)} values: robot '{robot.name}' has {joints} joints")
    q = checked_vector(q_start, joints, "start posture")
    for name, angle, lower, upper in zip(robot.joint_names, q, robot.limits.lower, robot.limits.upper, strict=True):
        if not lower <= angle <= upper:
            raise InputError(f"start posture: {name} is {angle:.4g} rad, its limits are {lower:.4g} to {upper:.4g} rad")
    return q
