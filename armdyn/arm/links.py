"""Links in kg, m and kg m^2: described and fitted values, and which of them the runs determine."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np

from armdyn.arm.arm import Arm
from armdyn.arm.rigid import INERTIAL_PARAMETERS_PER_BODY, is_physical

MAX_LINK_VALUE_STD_SHARE = 0.25
"""Largest standard deviation, without any prior, of a value that the runs determine: as a share of the link's mass,
radius of gyration, their product, or mean moment of inertia. Beyond it a value is hardly more than positive."""
MAX_LINK_MASS_RATIO_TO_URDF = 5.0
"""Largest ratio of a link's mass to that in the URDF, or its inverse, for a wrong description: beyond it the mass
represents something else, or is not identifiable."""
LINK_QUANTITIES = (
    ("mass", "kg"),
    *((f"centre_{axis}", "m") for axis in "xyz"),
    *((f"inertia_{axes}", "kg m^2") for axes in ("xx", "xy", "yy", "xz", "yz", "zz")),
    *((f"moment_{axis}", "kg m") for axis in "xyz"),
)
"""Names and units of the values of a link in the frame of its joint; inertias are about the centre of mass. Moments are
mass times centre: torques determine those of a last link, but not its mass alone."""


@dataclass(frozen=True)
class LinkQuantity:
    """One value of a link.

    Attributes:
        name: a name of `LINK_QUANTITIES`.
        unit: its SI unit.
        described: value in the URDF.
        value: value in the model.
        std: standard deviation of `value`, with priors.
        determined: whether these runs determine it without any prior.
    """

    name: str
    unit: str
    described: float
    value: float
    std: float
    determined: bool


@dataclass(frozen=True)
class LinkInertiaChange:
    """A link that a fit changed, with the bodies that are fixed to it.

    Attributes:
        joint: joint that moves it.
        quantities: its values, in the order of `LINK_QUANTITIES`.
        physical: whether a body with these inertial parameters can exist.
        loaded: whether a load that an effect names is counted in.
    """

    joint: str
    quantities: tuple[LinkQuantity, ...]
    physical: bool
    loaded: bool = False

    @property
    def mass(self) -> LinkQuantity:
        """The mass, kg."""
        return self.quantities[0]

    @property
    def warning(self) -> str:
        """A warning for users of these values; empty without one."""
        if not self.physical:
            return f"the link of {self.joint} has an inertia that no body has"
        mass = self.mass
        if (
            not self.loaded
            and mass.described > 0
            and not 1 / MAX_LINK_MASS_RATIO_TO_URDF <= mass.value / mass.described <= MAX_LINK_MASS_RATIO_TO_URDF
        ):
            text = f"the link of {self.joint} weighs {mass.value:.3g} kg in the model (URDF: {mass.described:.3g} kg)"
            return text + ("" if mass.determined else ", which these runs do not determine")
        return ""


def link_inertia_changes(
    arm: Arm,
    changes: Mapping[int, tuple[np.ndarray, np.ndarray]],
    covariance: np.ndarray,
    of_runs_alone: np.ndarray,
    free: np.ndarray,
) -> tuple[LinkInertiaChange, ...]:
    """Every link that effects change, in the order of the joints, with standard deviations by the delta method.

    Args:
        arm: the arm as described.
        changes: (10,) change of each link's inertial parameters and its (10, p) derivatives by p fitted parameters, by
            its joint's index.
        covariance: (p, p) covariance of the parameters.
        of_runs_alone: (p, p) covariance nearly without priors.
        free: (p,) bool, fitted parameters.
    """
    found = []
    for i, (change, derivatives) in changes.items():
        concerned = np.any(derivatives != 0.0, axis=0)
        if not (change.any() or np.any(concerned & free)):
            continue
        described = arm.described[i]
        inertial = described + change
        value, jacobian = _described_by(inertial)
        by_theta = jacobian @ (derivatives * free)
        std, alone = (_deviations(by_theta, c) for c in (covariance, of_runs_alone))
        sizes = _sizes(value)
        moves = np.any(by_theta != 0.0, axis=1)
        quantities = tuple(
            LinkQuantity(name, unit, float(d), float(v), float(s), bool(m and a < MAX_LINK_VALUE_STD_SHARE * size))
            for (name, unit), d, v, s, a, size, m in zip(
                LINK_QUANTITIES, _described_by(described)[0], value, std, alone, sizes, moves, strict=True
            )
        )
        found.append(LinkInertiaChange(arm.joints[i], quantities, is_physical(inertial)))
    return tuple(found)


def _deviations(jacobian: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """(k,) standard deviations by the delta method, none below the rounding error of the sum."""
    variance = np.einsum("ij,jk,ik->i", jacobian, covariance, jacobian)
    terms = np.einsum("ij,jk,ik->i", np.abs(jacobian), np.abs(covariance), np.abs(jacobian))
    return np.sqrt(np.maximum(variance, len(covariance) * np.finfo(float).eps * terms))


def _sizes(value: np.ndarray) -> np.ndarray:
    """(13,) sizes for comparison with a standard deviation: mass, radius of gyration, mean inertia, moment."""
    mass, moment = abs(value[0]), float(np.mean(np.abs(value[[4, 6, 9]])))
    # A sphere's moments are 2/3 of its mass times the square of its radius of gyration about the centre.
    radius = float(np.sqrt(1.5 * moment / mass)) if mass > 0 else 0.0
    return np.array([mass, *[radius] * 3, *[moment] * 6, *[mass * radius] * 3])


def _described_by(inertial: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(13,) `LINK_QUANTITIES` of (10,) inertial parameters, and (13, 10) the derivatives.

    c = h / m, I_c = I - m (|c|^2 1 - c c'); a link without mass has its centre at the origin.
    """
    if inertial[0] == 0.0:
        values = np.concatenate([np.zeros(4), inertial[4:], inertial[1:4]])
        return values, np.vstack([np.eye(INERTIAL_PARAMETERS_PER_BODY), np.eye(INERTIAL_PARAMETERS_PER_BODY)[1:4]])
    found, derivatives = _function()(inertial)
    return np.asarray(found)[:, 0], np.asarray(derivatives)


@cache
def _function() -> ca.Function:
    inertial = ca.SX.sym("pi", INERTIAL_PARAMETERS_PER_BODY)
    mass, centre = inertial[0], inertial[1:4] / inertial[0]
    steiner = mass * (ca.dot(centre, centre) * ca.SX.eye(3) - centre @ centre.T)
    about = ca.vertcat(steiner[0, 0], steiner[0, 1], steiner[1, 1], steiner[0, 2], steiner[1, 2], steiner[2, 2])
    values = ca.vertcat(mass, centre, inertial[4:] - about, inertial[1:4])
    return ca.Function("link", [inertial], [ca.densify(values), ca.densify(ca.jacobian(values, inertial))])
