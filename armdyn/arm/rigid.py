"""Inertial parameters of links, in numbers and in symbols; joint torques of rigid bodies with their derivatives.

A link has ten parameters in Pinocchio's order, in the frame of the joint and about its origin: m, m c (3), Ixx, Ixy,
Iyy, Ixz, Iyz, Izz.
"""

from collections.abc import Mapping
from functools import cached_property

import casadi as ca
import numpy as np
import pinocchio as pin

from armdyn.arm.physics import Expression

INERTIAL_PARAMETERS_PER_BODY = 10
MIN_LINK_EXTENT_METRES, MENDED_LINK_EXTENT_METRES = 0.001, 0.01
"""Extent of a described link, m, below which it is a point, which no deformation enlarges; then its mended extent."""
MIN_LINK_MASS_SHARE_OF_HEAVIEST = 1e-3
"""Least mass of a link that can be deformed, as a share of the heaviest one; a lighter one gets this mass."""


def pseudo_inertia(parameters: np.ndarray) -> np.ndarray:
    """(4, 4) J of (10,) inertial parameters: Sigma = tr(I)/2 - I, m c, m (Wensing, Kim & Slotine 2018, eq. 7)."""
    inertia = inertia_matrix(parameters)
    result = np.empty((4, 4))
    result[:3, :3] = np.trace(inertia) / 2 * np.eye(3) - inertia
    result[:3, 3] = result[3, :3] = parameters[1:4]
    result[3, 3] = parameters[0]
    return result


def inertial_parameters_of(J: np.ndarray) -> np.ndarray:
    """(10,) inertial parameters of a (4, 4) pseudo-inertia; the inverse of `pseudo_inertia`."""
    return np.array(ca.DM(inertial_parameters(ca.DM(J)))).ravel()


def inertia_matrix(parameters: np.ndarray) -> np.ndarray:
    """(3, 3) inertia about the origin of (10,) inertial parameters, kg m^2."""
    xx, xy, yy, xz, yz, zz = parameters[4:]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def inertia_about_centre(parameters: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, kg, centre (3,), m, and inertia (3, 3) about it, kg m^2, of (10,) inertial parameters.

    A link without mass has its centre at the origin.
    """
    mass = float(parameters[0])
    centre = parameters[1:4] / mass if mass else np.zeros(3)
    return mass, centre, inertia_matrix(parameters) - _steiner(mass, centre)


def parameters_about_origin(mass: float, centre: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """(10,) inertial parameters of a body; the inverse of `inertia_about_centre`."""
    full = inertia + _steiner(mass, centre)
    return np.array([mass, *(mass * centre), full[0, 0], full[0, 1], full[1, 1], full[0, 2], full[1, 2], full[2, 2]])


def _steiner(mass: float, centre: np.ndarray) -> np.ndarray:
    return mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))


def inertial_parameters(J: Expression) -> Expression:
    """(10,) inertial parameters of a (4, 4) pseudo-inertia, symbolic."""
    xx, yy, zz = J[0, 0], J[1, 1], J[2, 2]
    return ca.vertcat(J[3, 3], J[0:3, 3], yy + zz, -J[0, 1], xx + zz, -J[0, 2], -J[1, 2], xx + yy)


def pseudo_inertia_factor(parameters: np.ndarray, heaviest: float) -> np.ndarray:
    """(4, 4) upper triangular U with U U' = J of a link with (10,) parameters, so that it can be deformed.

    A link without extent or mass, or with an inertia that no body has, is mended first, without a change of its weight
    in the model; `heaviest` is the mass of the arm's heaviest link, kg.
    """
    J = pseudo_inertia(parameters)
    mass = max(J[3, 3], MIN_LINK_MASS_SHARE_OF_HEAVIEST * heaviest, np.finfo(float).tiny)
    centre = J[:3, 3] / J[3, 3] if J[3, 3] > 0 else np.zeros(3)
    spread = J[:3, :3] - J[3, 3] * np.outer(centre, centre)
    values, vectors = np.linalg.eigh((spread + spread.T) / 2)
    mended = np.where(values < mass * MIN_LINK_EXTENT_METRES**2, mass * MENDED_LINK_EXTENT_METRES**2, values)
    spread = (vectors * mended) @ vectors.T
    U = np.zeros((4, 4))
    U[:3, :3] = np.linalg.cholesky(spread[::-1, ::-1])[::-1, ::-1]
    U[:3, 3] = np.sqrt(mass) * centre
    U[3, 3] = np.sqrt(mass)
    return U


def is_physical(parameters: np.ndarray) -> bool:
    """Whether a body with these (10,) parameters can exist: J is positive definite."""
    return bool(np.linalg.eigvalsh(pseudo_inertia(parameters))[0] > 0)


def described_parameters(model: pin.Model) -> np.ndarray:
    """(nj, 10) inertial parameters of the moved links in the URDF."""
    return np.array([np.asarray(inertia.toDynamicParameters()) for inertia in model.inertias[1:]])


def inverse_dynamics(model: pin.Model, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """(n, nj) torques, N m or N, by the recursive Newton-Euler algorithm: tau = M(q) a + C(q, v) v + g(q)."""
    data, torque = model.createData(), np.empty(q.shape)
    for i, row in enumerate(zip(*map(np.ascontiguousarray, (q, v, a)), strict=True)):
        torque[i] = pin.rnea(model, data, *row)
    return torque


def torque_regressor(model: pin.Model, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """(n, nj, nj, 10) Y with tau_j = sum_l Y[., j, l] pi_l, pi_l the inertial parameters of the l-th moved link."""
    data, (n, nj) = model.createData(), q.shape
    regressor = np.empty((n, nj, nj * INERTIAL_PARAMETERS_PER_BODY))
    for i, row in enumerate(zip(*map(np.ascontiguousarray, (q, v, a)), strict=True)):
        regressor[i] = pin.computeJointTorqueRegressor(model, data, *row)
    return regressor.reshape(n, nj, nj, INERTIAL_PARAMETERS_PER_BODY)


class GravityTorques:
    """Torques that hold an arm at rest, per component of gravity, from the positions of its links.

    A body of mass m with its centre at x needs the torque -m g' dx/dq_j on joint j (virtual work), with dx/dq_j = v_j +
    w_j x (x - p_j) for a joint at p_j with linear and angular axes v_j and w_j.

    Args:
        model: the arm; each joint turns or slides.
        q: (n, nj) positions of the joints.
    """

    def __init__(self, model: pin.Model, q: np.ndarray) -> None:
        n, nj = q.shape
        self._rotation, self._place = np.empty((nj, n, 3, 3)), np.empty((nj, n, 3))
        self._linear, self._angular = np.empty((nj, n, 3)), np.empty((nj, n, 3))
        self._model, self._parents = model, parent_joints(model)
        for i, (axis, parent, placement) in enumerate(
            zip(joint_axes(model), self._parents, list(model.jointPlacements)[1:], strict=True)
        ):
            cross, angle = pin.skew(axis[3:]), q[:, i, None, None]
            rotation = placement.rotation @ (np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)
            place = placement.translation + q[:, i, None] * (placement.rotation @ axis[:3])
            if parent >= 0:
                place = (self._rotation[parent] @ place[..., None])[..., 0] + self._place[parent]
                rotation = self._rotation[parent] @ rotation
            self._rotation[i], self._place[i] = rotation, place
            self._linear[i], self._angular[i] = rotation @ axis[:3], rotation @ axis[3:]

    def gravity_torque_of_link(self, joint: int, link: int) -> np.ndarray:
        """(n, 3, 4) matrices G of a joint: tau = g' G (m, m c), with mass m and centre c of a link that it carries."""
        return np.stack([self.under(gravity, joint, link) for gravity in np.eye(3)], axis=1)

    def under(self, gravity: np.ndarray, joint: int, link: int) -> np.ndarray:
        """(n, 4) rows g' G of a joint, see `gravity_torque_of_link`, for a gravity g (3,), m/s^2."""
        across = self._angular[joint] @ pin.skew(gravity).T  # g x w
        columns = np.empty((len(across), 4))
        arm = self._place[link] - self._place[joint]
        columns[:, 0] = -(self._linear[joint] @ gravity + np.einsum("nk,nk->n", across, arm))
        columns[:, 1:] = -np.einsum("nk,nkc->nc", across, self._rotation[link])
        return columns

    @cached_property
    def described(self) -> np.ndarray:
        """(nj, n, 3) torques, by each component of gravity, for the links as the model describes them."""
        inertias = list(self._model.inertias)[1:]
        return self.of_bodies({i: inertia.mass * np.append(1.0, inertia.lever) for i, inertia in enumerate(inertias)})

    def of_bodies(self, bodies: Mapping[int, np.ndarray]) -> np.ndarray:
        """(nj, n, 3) torques for bodies on links, each given by its mass and first moment (4,) in the link's frame."""
        mass, moment = np.zeros(len(self._parents)), np.zeros(self._place.shape)
        for i in reversed(range(len(self._parents))):
            if i in bodies:
                own, *first = bodies[i]
                mass[i] += own
                # One product instead of n small ones.
                moment[i] += own * self._place[i] + (self._rotation[i].reshape(-1, 3) @ first).reshape(-1, 3)
            if (parent := self._parents[i]) >= 0:
                mass[parent] += mass[i]
                moment[parent] += moment[i]
        mass = mass[:, None, None]
        return -(mass * self._linear + np.cross(self._angular, moment - mass * self._place))


def parent_joints(model: pin.Model) -> tuple[int, ...]:
    """(nj,) index of the next joint towards the base, for each joint; -1 if there is none."""
    return tuple(int(parent) - 1 for parent in list(model.parents)[1:])


def joint_axes(model: pin.Model) -> list[np.ndarray]:
    """(6,) linear and angular velocity of each joint's link for a joint velocity of 1, in the link's axes."""
    data, n = model.createData(), model.nv
    pin.computeJointJacobians(model, data, np.zeros(n))
    return [np.array(pin.getJointJacobian(model, data, i + 1, pin.LOCAL).reshape(6, n)[:, i]) for i in range(n)]
