"""Joint torques of rigid bodies by Pinocchio, and what they owe to each inertial parameter."""

from typing import NamedTuple

import numpy as np
import pinocchio as pin

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
