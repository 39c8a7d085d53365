"""Inertial parameters of a link and its pseudo-inertia, in numbers and in symbols.

Ten parameters in Pinocchio's order, in the frame of the joint and about its origin: m, m c (3), Ixx, Ixy, Iyy, Ixz,
Iyz, Izz.
"""

import casadi as ca
import numpy as np

from armdyn.arm.physics import Expression

SIZE = 10
SMALLEST_EXTENT = 0.01
"""m; a described link that is smaller than this in some direction is taken as so large when it is deformed."""
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
    spread = (vectors * np.maximum(values, mass * SMALLEST_EXTENT**2)) @ vectors.T
    U = np.zeros((4, 4))
    U[:3, :3] = np.linalg.cholesky(spread[::-1, ::-1])[::-1, ::-1]
    U[:3, 3] = np.sqrt(mass) * centre
    U[3, 3] = np.sqrt(mass)
    return U


def is_physical(parameters: np.ndarray) -> bool:
    """Whether some body has the (10,) parameters: J is positive definite."""
    return bool(np.linalg.eigvalsh(pseudo_inertia(parameters))[0] > 0)
