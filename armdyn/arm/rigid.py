"""Joint torques of rigid bodies by Pinocchio, and what they owe to each inertial parameter."""

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from armdyn.arm.inertia import SIZE
from armdyn.arm.motion import Motion


def described_parameters(model: pin.Model) -> np.ndarray:
    """(nj, 10) inertial parameters of the links that the joints move, as the URDF has them."""
    return np.array([np.asarray(inertia.toDynamicParameters()) for inertia in model.inertias[1:]])


def inverse_dynamics(model: pin.Model, motion: Motion) -> np.ndarray:
    """(n, nj) torques, N m or N, by the recursive Newton-Euler algorithm: tau = M(q) a + C(q, v) v + g(q)."""
    data = model.createData()
    q, v, a = (np.ascontiguousarray(x) for x in (motion.q, motion.v, motion.a))
    torque = np.empty_like(q)
    for i in range(len(q)):
        torque[i] = pin.rnea(model, data, q[i], v[i], a[i])
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


class BaseParameters(NamedTuple):
    """Which inertial parameters joint torques can tell.

    Attributes:
        independent: (r,) indices of parameters, in the order of (nj x 10), that can be identified given the others.
        combination: (r, nj x 10) K; K pi are the r base parameters, each an independent one plus others.
    """

    independent: np.ndarray
    combination: np.ndarray


def base_parameters(model: pin.Model, samples: int = 0, seed: int = 0) -> BaseParameters:
    """The base parameters of an arm, from torques in random states.

    Those parameters are kept that a QR decomposition with pivoting finds independent (Gautier, J. Robotic Systems 8,
    1991).

    Args:
        model: the arm.
        samples: random states; 20 per joint when 0.
        seed: of the random states.
    """
    from scipy.linalg import qr

    rng = np.random.default_rng(seed)
    shape = (samples or 20 * model.nv, model.nv)
    q, v, a = rng.uniform(-np.pi, np.pi, shape), rng.standard_normal(shape), rng.standard_normal(shape)
    Y = torque_regressor(model, Motion(np.arange(shape[0]), q, v, a, np.sign(v))).reshape(-1, model.nv * SIZE)
    scale = np.linalg.norm(Y, axis=0)
    _, R, order = qr(Y, mode="economic", pivoting=True)
    rank = int(np.sum(np.abs(np.diag(R)) > 1e-9 * scale.max()))
    combination = np.zeros((rank, Y.shape[1]))
    combination[:, order[:rank]] = np.eye(rank)
    combination[:, order[rank:]] = np.linalg.solve(R[:rank, :rank], R[:rank, rank:])
    combination[np.abs(combination) < 1e-9] = 0.0
    return BaseParameters(order[:rank], combination)
