"""Joint torques of rigid bodies by Pinocchio, and their derivatives by the inertial parameters."""

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from armdyn.arm.inertia import SIZE
from armdyn.arm.motion import Motion


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
    data = model.createData()
    pin.computeJointJacobians(model, data, np.zeros(nj))
    own = [pin.getJointJacobian(model, data, i + 1, pin.LOCAL).reshape(6, nj)[:, i] for i in range(nj)]
    parents = [int(parent) - 1 for parent in list(model.parents)[1:]]
    rotations, origins = np.empty((nj, n, 3, 3)), np.empty((nj, n, 3))
    linear, angular = np.empty((nj, n, 3)), np.empty((nj, n, 3))
    regressor = np.zeros((n, nj, nj, 3, 4))
    for i, placement in enumerate(list(model.jointPlacements)[1:]):
        R, p = np.eye(3)[None], np.zeros((1, 3))
        if parents[i] >= 0:
            R, p = rotations[parents[i]], origins[parents[i]]
        R, p = R @ placement.rotation, p + R @ placement.translation
        origins[i] = p + (R @ own[i][:3]) * q[:, [i]]
        rotations[i] = R @ Rotation.from_rotvec(q[:, [i]] * own[i][3:]).as_matrix()
        angular[i] = R @ own[i][3:]
        linear[i] = R @ own[i][:3] - np.cross(angular[i], origins[i])
        j = i
        while j >= 0:
            regressor[:, j, i, :, 0] = -linear[j] - np.cross(angular[j], origins[i])
            regressor[:, j, i, :, 1:] = -np.cross(angular[j][:, :, None], rotations[i], axis=1)
            j = parents[j]
    return regressor
