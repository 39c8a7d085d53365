"""Inertial parameters of links, in numbers and in symbols; joint torques of rigid bodies with their derivatives.

A link has ten parameters in Pinocchio's order, in the frame of the joint and about its origin: m, m c (3), Ixx, Ixy,
Iyy, Ixz, Iyz, Izz.
"""

import casadi as ca
import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from armdyn.arm.motion import Motion
from armdyn.arm.physics import Expression

SIZE = 10
NO_EXTENT = 0.001
"""m; a described link that is smaller than this in some direction is a point there: no deformation makes it larger."""
MENDED_EXTENT = 0.01
"""m; what such a link is taken to have when it is deformed."""
SMALLEST_MASS = 1e-3
"""Of the heaviest link; a described link that is lighter is taken as so heavy when it is deformed."""


def pseudo_inertia(parameters: np.ndarray) -> np.ndarray:
    """(4, 4) J of (10,) inertial parameters: Sigma = tr(I)/2 - I, m c, m (Wensing, Kim & Slotine 2018, eq. 7)."""
    inertia = inertia_matrix(parameters)
    result = np.empty((4, 4))
    result[:3, :3] = np.trace(inertia) / 2 * np.eye(3) - inertia
    result[:3, 3] = result[3, :3] = parameters[1:4]
    result[3, 3] = parameters[0]
    return result


def inertia_matrix(parameters: np.ndarray) -> np.ndarray:
    """(3, 3) inertia about the origin of (10,) inertial parameters, kg m^2."""
    xx, xy, yy, xz, yz, zz = parameters[4:]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def about_centre(parameters: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, kg, centre (3,), m, and inertia (3, 3) about it, kg m^2, of (10,) inertial parameters.

    A link without mass has its centre at the origin.
    """
    mass = float(parameters[0])
    centre = parameters[1:4] / mass if mass else np.zeros(3)
    return mass, centre, inertia_matrix(parameters) - _steiner(mass, centre)


def about_origin(mass: float, centre: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """(10,) inertial parameters of a body; the inverse of `about_centre`."""
    full = inertia + _steiner(mass, centre)
    return np.array([mass, *(mass * centre), full[0, 0], full[0, 1], full[1, 1], full[0, 2], full[1, 2], full[2, 2]])


def _steiner(mass: float, centre: np.ndarray) -> np.ndarray:
    return mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))


def inertial_parameters(J: Expression) -> Expression:
    """(10,) inertial parameters of a (4, 4) pseudo-inertia, symbolic."""
    xx, yy, zz = J[0, 0], J[1, 1], J[2, 2]
    return ca.vertcat(J[3, 3], J[0:3, 3], yy + zz, -J[0, 1], xx + zz, -J[0, 2], -J[1, 2], xx + yy)


def shape(parameters: np.ndarray, heaviest: float) -> np.ndarray:
    """(4, 4) upper triangular U with U U' = J of a link that can be deformed.

    A link without extent or mass, or with an inertia that no body has, is mended first; what it weighs in the model
    does not change by that.

    Args:
        parameters: (10,) as described.
        heaviest: mass of the heaviest link of the arm, kg.
    """
    J = pseudo_inertia(parameters)
    mass = max(J[3, 3], SMALLEST_MASS * heaviest, np.finfo(float).tiny)
    centre = J[:3, 3] / J[3, 3] if J[3, 3] > 0 else np.zeros(3)
    spread = J[:3, :3] - J[3, 3] * np.outer(centre, centre)
    values, vectors = np.linalg.eigh((spread + spread.T) / 2)
    mended = np.where(values < mass * NO_EXTENT**2, mass * MENDED_EXTENT**2, values)
    spread = (vectors * mended) @ vectors.T
    U = np.zeros((4, 4))
    U[:3, :3] = np.linalg.cholesky(spread[::-1, ::-1])[::-1, ::-1]
    U[:3, 3] = np.sqrt(mass) * centre
    U[3, 3] = np.sqrt(mass)
    return U


def is_physical(parameters: np.ndarray) -> bool:
    """Whether some body has the (10,) parameters: J is positive definite."""
    return bool(np.linalg.eigvalsh(pseudo_inertia(parameters))[0] > 0)


def described_parameters(model: pin.Model) -> np.ndarray:
    """(nj, 10) inertial parameters of the links that the joints move, as the URDF has them."""
    return np.array([np.asarray(inertia.toDynamicParameters()) for inertia in model.inertias[1:]])


def inverse_dynamics(model: pin.Model, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """(n, nj) torques, N m or N, by the recursive Newton-Euler algorithm: tau = M(q) a + C(q, v) v + g(q)."""
    data, torque = model.createData(), np.empty(q.shape)
    for i, row in enumerate(zip(*map(np.ascontiguousarray, (q, v, a)), strict=True)):
        torque[i] = pin.rnea(model, data, *row)
    return torque


def torque_regressor(model: pin.Model, motion: Motion) -> np.ndarray:
    """(n, nj, nj, 10) Y with tau_j = sum_l Y[., j, l] pi_l, pi_l the inertial parameters of the l-th moved link."""
    data = model.createData()
    q, v, a = (np.ascontiguousarray(x) for x in (motion.q, motion.v, motion.a))
    n, nj = q.shape
    regressor = np.empty((n, nj, nj * SIZE))
    for i in range(n):
        regressor[i] = pin.computeJointTorqueRegressor(model, data, q[i], v[i], a[i])
    return regressor.reshape(n, nj, nj, SIZE)


def parents(model: pin.Model) -> tuple[int, ...]:
    """(nj,) index of each joint's neighbour towards the base, -1 for none."""
    return tuple(int(parent) - 1 for parent in list(model.parents)[1:])


def joint_axes(model: pin.Model) -> list[np.ndarray]:
    """By joint (6,): linear and angular velocity of its link per unit of its own, in the link's axes."""
    data, n = model.createData(), model.nv
    pin.computeJointJacobians(model, data, np.zeros(n))
    return [np.array(pin.getJointJacobian(model, data, i + 1, pin.LOCAL).reshape(6, n)[:, i]) for i in range(n)]


def gravity_regressor(model: pin.Model, q: np.ndarray) -> np.ndarray:
    """(n, nj, nj, 3, 4) G with tau_j = sum_l g' G[., j, l] (m_l, m_l c_l) for gravity g (3,), m/s^2, at rest.

    Gravity acts on a link with the force m g and, about the origin of the base, the moment (m p + R m c) x g, p and R
    being where the link's joint is. A joint with the velocities u and w, linear at that origin and angular, per unit
    of its own holds it with -(m u + w x (m p + R m c)) . g.

    Args:
        model: joints with one degree of freedom each.
        q: (n, nj) rad or m.
    """
    n, nj = q.shape
    own = joint_axes(model)
    before = parents(model)
    rotations, origins = np.empty((nj, n, 3, 3)), np.empty((nj, n, 3))
    linear, angular = np.empty((nj, n, 3)), np.empty((nj, n, 3))
    regressor = np.zeros((n, nj, nj, 3, 4))
    for i, placement in enumerate(list(model.jointPlacements)[1:]):
        R, p = np.eye(3)[None], np.zeros((1, 3))
        if before[i] >= 0:
            R, p = rotations[before[i]], origins[before[i]]
        R, p = R @ placement.rotation, p + R @ placement.translation
        origins[i] = p + (R @ own[i][:3]) * q[:, [i]]
        rotations[i] = R @ Rotation.from_rotvec(q[:, [i]] * own[i][3:]).as_matrix()
        angular[i] = R @ own[i][3:]
        linear[i] = R @ own[i][:3] - np.cross(angular[i], origins[i])
        j = i
        while j >= 0:
            regressor[:, j, i, :, 0] = -linear[j] - np.cross(angular[j], origins[i])
            regressor[:, j, i, :, 1:] = -np.cross(angular[j][:, :, None], rotations[i], axis=1)
            j = before[j]
    return regressor
