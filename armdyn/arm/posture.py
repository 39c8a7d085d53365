r"""The dynamics of an arm at one posture, and the speeds and forces that its tool can reach.

All terms are those of the equation of motion

    M(q) \ddot q + C(q, \dot q) \dot q + g(q) + d \dot q = \tau,

with the viscous damping d of the joints, which Pinocchio's own algorithms omit.
"""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.optimize import linprog

from armdyn.errors import InputError
from urdf import Robot
from urdf.robot import Array, read_only_copy

MAX_PLAUSIBLE_RADIANS = 2 * np.pi
"""Largest plausible position of a joint, rad; a larger value outside the limits is probably in degrees."""
LINK_PARAMETER_NAMES = (
    "m",
    "mx",
    "my",
    "mz",
    "Ixx",
    "Ixy",
    "Iyy",
    "Ixz",
    "Iyz",
    "Izz",
)  # kg, kg m, kg m^2 about the joint


@dataclass(frozen=True)
class ManipulabilityEllipsoid:
    """Largest speeds or forces of the tool, for joint values within an ellipsoid of their limits.

    Attributes:
        axes: unit vectors in the base frame, the columns of (3, 3).
        lengths: semi-axes, (3,) [m/s or N], the largest first.
        along: largest value along the base's x, y and z, with each joint within its own limit, (3,) [m/s or N].
    """

    axes: Array
    lengths: Array
    along: Array


@dataclass(frozen=True)
class ArmPosture:
    """The dynamics of an arm at one posture; n joints.

    Attributes:
        q: positions, (n,) [rad or m].
        v: velocities, (n,) [rad/s or m/s].
        tool_position: tool point in the base frame, (3,) [m].
        tool_rotation: rotation matrix of the tool frame in the base frame, (3, 3).
        margin: distance of each joint to its nearer position limit, (n,) [rad or m].
        gravity: torque that holds the arm, (n,) [N m or N].
        springs: torque of the robot's known springs, (n,) [N m].
        inertia: M, (n, n) [kg m^2, kg m or kg].
        coriolis: C, (n, n) [N m s]; C v is the torque that the velocities take.
        damping: d, (n,) [N m s/rad or N s/m].
        kinetic_energy: kinetic energy of the arm [J].
        potential_energy: potential energy of gravity, 0 with every centre of mass at the base's height [J].
        regressor: Y with tau - d v = Y p at these q, v and zero acceleration, (n, 10 n).
        parameters: p, ten values per link as in `LINK_PARAMETER_NAMES`, (10 n,) [kg, kg m, kg m^2].
        jacobian: Jacobian of the tool point in base axes, linear rows first, (6, n) [m/rad or 1, 1 or 0].
        manipulability: Yoshikawa's measure for translations of the tool; 0 at a singularity.
        speed: speeds of the tool point within the joints' velocity limits, with any rotation. None without limits.
        force: forces of the tool point at rest, within the torque limits minus gravity. None without limits.
    """

    q: Array
    v: Array
    tool_position: Array
    tool_rotation: Array
    margin: Array
    gravity: Array
    springs: Array
    inertia: Array
    coriolis: Array
    damping: Array
    kinetic_energy: float
    potential_energy: float
    regressor: Array
    parameters: Array
    jacobian: Array
    manipulability: float
    speed: ManipulabilityEllipsoid | None
    force: ManipulabilityEllipsoid | None


def arm_posture(robot: Robot, q: ArrayLike | None = None, v: ArrayLike | None = None) -> ArmPosture:
    """Evaluate an arm at one posture.

    Args:
        robot: the arm.
        q: positions, (n,) [rad or m]; None means home.
        v: velocities, (n,) [rad/s or m/s]; None means rest.

    Raises:
        InputError: a value is missing, not finite, or outside the position limits.
    """
    model, data = robot.model, robot.model.createData()
    at = np.array(robot.home) if q is None else _checked(robot, q, "position")
    rate = np.zeros(model.nv) if v is None else _checked(robot, v, "velocity")
    _check_limits(robot, at)
    still = np.zeros(model.nv)
    pose = robot.tool_pose(at)
    gravity = pin.computeGeneralizedGravity(model, data, at).copy()
    upper = np.triu(pin.crba(model, data, at).reshape(model.nv, model.nv))  # for a single joint it is flat
    jacobian = _tool_jacobian(robot, data, at)
    linear = jacobian[:3]
    volume = float(np.linalg.det(linear @ linear.T)) if model.nv >= 3 else 0.0
    return ArmPosture(
        q=read_only_copy(at),
        v=read_only_copy(rate),
        tool_position=read_only_copy(pose.translation),
        tool_rotation=read_only_copy(pose.rotation),
        margin=read_only_copy(_margin(robot, at)),
        gravity=read_only_copy(gravity),
        springs=read_only_copy(robot.spring_torque(at)),
        inertia=read_only_copy(upper + np.triu(upper, 1).T),
        coriolis=read_only_copy(pin.computeCoriolisMatrix(model, data, at, rate).reshape(model.nv, model.nv)),
        damping=read_only_copy(model.damping),
        kinetic_energy=float(pin.computeKineticEnergy(model, data, at, rate)),
        potential_energy=float(pin.computePotentialEnergy(model, data, at)),
        regressor=read_only_copy(pin.computeJointTorqueRegressor(model, data, at, rate, still).reshape(model.nv, -1)),
        parameters=read_only_copy(
            np.concatenate([inertia.toDynamicParameters() for inertia in list(model.inertias)[1:]])
        ),
        jacobian=read_only_copy(jacobian),
        manipulability=float(np.sqrt(max(0.0, volume))),
        speed=_speed(linear, model.velocityLimit) if np.isfinite(model.velocityLimit).all() else None,
        force=_force(linear, model.effortLimit, gravity) if np.isfinite(model.effortLimit).all() else None,
    )


def _speed(linear: Array, limits: Array) -> ManipulabilityEllipsoid:
    """Image of the ball |q' / limit| <= 1, and the largest speeds along x, y and z within the box of limits."""
    axes, lengths, _ = np.linalg.svd(linear * limits)
    along = np.empty(3)
    for axis in range(3):
        # Largest t with J q' = t e and |q'| <= limits: a linear program in (q', t).
        direction = np.zeros((3, 1))
        direction[axis] = -1.0
        solution = linprog(
            np.append(np.zeros(len(limits)), -1.0),
            A_eq=np.hstack((linear, direction)),
            b_eq=np.zeros(3),
            bounds=[*((-limit, limit) for limit in limits), (0.0, None)],
        )
        along[axis] = -solution.fun if solution.success else 0.0
    full = np.zeros(3)
    full[: len(lengths)] = lengths
    return ManipulabilityEllipsoid(read_only_copy(axes), read_only_copy(full), read_only_copy(along))


def _force(linear: Array, limits: Array, gravity: Array) -> ManipulabilityEllipsoid:
    """Forces f with |J^T f / (limit - |gravity|)| <= 1, and the largest along +x, +y and +z joint by joint.

    Semi-axes are infinite in directions in which the structure carries the force without torque.
    """
    left = np.maximum(limits - np.abs(gravity), 0.0)
    scaled = linear.T / np.maximum(left, 1e-12)[:, None]
    _, values, axes = np.linalg.svd(scaled)
    full = np.zeros(3)
    full[: len(values)] = values
    with np.errstate(divide="ignore"):
        lengths = np.where(full > 1e-12, 1.0 / full, np.inf)
        # Torque J^T f + g within the limits: each joint bounds t from its own side.
        per_force = linear.T
        room = np.where(per_force > 0, limits[:, None] - gravity[:, None], limits[:, None] + gravity[:, None])
        along = np.where(
            np.abs(per_force) > 1e-12, np.maximum(room, 0.0) / np.maximum(np.abs(per_force), 1e-300), np.inf
        )
    order = np.argsort(lengths)[::-1]
    return ManipulabilityEllipsoid(
        read_only_copy(axes.T[:, order]), read_only_copy(lengths[order]), read_only_copy(along.min(axis=0))
    )


def _tool_jacobian(robot: Robot, data: pin.Data, q: Array) -> Array:
    jacobian = pin.computeFrameJacobian(
        robot.model, data, q, robot.tool_frame_id, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    ).reshape(6, robot.model.nv)
    lever = robot.tool_pose(q).rotation @ robot.tool_offset
    jacobian[:3] += np.cross(jacobian[3:].T, lever).T
    return np.asarray(jacobian, dtype=np.float64)


def _checked(robot: Robot, values: ArrayLike, kind: str) -> Array:
    array = np.atleast_1d(np.asarray(values, dtype=np.float64))
    if array.shape != (len(robot.joint_names),):
        raise InputError(
            f"robot '{robot.name}': {array.size} numbers for the {kind} of its {len(robot.joint_names)} joints; "
            f"give one for each of {', '.join(robot.joint_names)}"
        )
    if not np.isfinite(array).all():
        name = robot.joint_names[int(np.argmin(np.isfinite(array)))]
        raise InputError(f"robot '{robot.name}': the {kind} of joint '{name}' is not a finite number; correct it")
    return array


def _margin(robot: Robot, q: Array) -> Array:
    """Distance (n,) of each joint to its nearer position limit, infinite where it has none."""
    return np.asarray(np.minimum(q - robot.model.lowerPositionLimit, robot.model.upperPositionLimit - q))


def _check_limits(robot: Robot, q: Array) -> None:
    margin = _margin(robot, q)
    if margin.min() >= -1e-9:
        return
    joint = int(margin.argmin())
    message = (
        f"robot '{robot.name}': joint '{robot.joint_names[joint]}' at {q[joint]:g} is outside its limits "
        f"{robot.model.lowerPositionLimit[joint]:g} to {robot.model.upperPositionLimit[joint]:g}"
    )
    inside = _margin(robot, np.deg2rad(q)).min() >= 0
    if inside and np.abs(q).max() > MAX_PLAUSIBLE_RADIANS:
        raise InputError(f"{message}; these look like degrees: give radians")
    raise InputError(f"{message}; choose a posture within them")
