r"""Posterior of the unknowns of a linear model: estimate within bounds, covariance, and what freedom costs.

With the information H = X'X and the slope g = X'r of the samples, in units of their noise, and independent normal
priors of mean c and standard deviation w within bounds, the change d of the unknowns is

    d = argmin  d'H d / 2 - g'd + |(d - c) / w|^2 / 2,     covariance  (H + w^-2)^-1.
"""

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Self

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from armdyn.estimation.solve import inverse_positive, log_det, solve_bounded, solve_positive


@dataclass(frozen=True, eq=False)
class NormalPrior:
    """Independent normal priors of P unknowns within bounds.

    Attributes:
        width: (P,) standard deviations, positive.
        centre: (P,) means of the changes.
        lower: (P,) lower bounds of the changes, which may be minus infinity.
        upper: (P,) upper bounds of the changes, which may be infinity.
    """

    width: np.ndarray
    centre: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    def only(self, columns: np.ndarray) -> Self:
        """The priors of some unknowns."""
        return type(self)(*(getattr(self, one.name)[columns] for one in fields(self)))

    def posterior(self, information: np.ndarray, slope: np.ndarray) -> "Posterior":
        """The posterior from the (P, P) information and the (P,) slope of the samples."""
        w = self.width
        A = w[:, None] * information * w
        A.flat[:: len(w) + 1] += 1.0
        found = solve_bounded(A, w * slope + self.centre / w, self.lower / w, self.upper / w)
        # Rounding must not hide a bound.
        change = np.clip(w * found.x, self.lower, self.upper)
        return Posterior(self, information, slope, change, found.on_bound, found.gradient, A)

    def unbounded_change(self, information: np.ndarray, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(..., P) best changes without bounds, and (...) their change of the squared error, negative where it falls.

        Args:
            information: (..., P, P) information of the samples.
            slope: (..., P) their slope.
        """
        d = solve_positive(information + np.diag(self.width**-2.0), slope + self.centre / self.width**2)
        return d, self._squares(information, slope, d)

    def _squares(self, information: np.ndarray, slope: np.ndarray, change: np.ndarray) -> np.ndarray:
        away = (change - self.centre) / self.width
        moved = (information @ change[..., None])[..., 0]
        return np.asarray(np.sum(change * (moved - 2.0 * slope) + away**2, axis=-1))


@dataclass(frozen=True, eq=False)
class Posterior:
    """Posterior of P unknowns.

    Attributes:
        prior: their priors.
        information: (P, P) information of the samples.
        slope: (P,) slope of the samples.
        change: (P,) most probable change within the bounds.
        on_bound: (P,) -1 for an unknown on its lower bound, 1 on its upper bound, 0 between them.
    """

    prior: NormalPrior
    information: np.ndarray
    slope: np.ndarray
    change: np.ndarray
    on_bound: np.ndarray
    _gradient: np.ndarray
    _A: np.ndarray

    @cached_property
    def covariance(self) -> np.ndarray:
        """(P, P) covariance, as if there were no bounds."""
        return inverse_positive(self.information + np.diag(self.prior.width**-2.0))

    @property
    def gain_beyond_bound_nats(self) -> np.ndarray:
        """(P,) gain of log probability, nats, if an unknown on a bound went on beyond it; 0 for all others."""
        return np.where(self.on_bound != 0, 0.5 * self._gradient**2 / np.diag(self._A), 0.0)

    @property
    def squared_error_change(self) -> float:
        """Change of the squared error in units of the noise, with the distance from the prior means."""
        return float(self.prior._squares(self.information, self.slope, self.change))


def posterior_covariance(information: np.ndarray, width: np.ndarray) -> np.ndarray:
    """(P, P) covariance of unknowns without bounds, of which samples and priors together determine every one.

    Args:
        information: (P, P) information of the samples on them.
        width: (P,) standard deviations of their priors; infinite where there is no prior.
    """
    matrix = information + np.diag(width**-2.0)
    scale = 1.0 / np.sqrt(np.diag(matrix))
    factor = cho_factor(matrix * np.outer(scale, scale))
    return np.asarray(cho_solve(factor, np.diag(scale)) * scale[:, None])


def freedom_nats(information: np.ndarray, typical: np.ndarray) -> np.ndarray:
    """(...) nats that the freedom of unknowns costs in evidence (MacKay, Neural Computation 4, 1992).

    Args:
        information: (..., P, P) information of the samples on them.
        typical: (P,) their typical sizes, which are the widths of their priors.
    """
    return np.asarray(0.5 * log_det(typical[:, None] * information * typical + np.eye(len(typical))))


def size_nats(sizes: np.ndarray) -> np.ndarray:
    """(...) nats that (..., P) sizes cost, in typical sizes: a Cauchy prior, under which large ones are rare."""
    return np.asarray(np.sum(np.log1p(sizes**2), axis=-1))


def wald_distance(values: np.ndarray, covariance: np.ndarray) -> float:
    """Distance of values (k,) from nothing in standard deviations, sqrt(x' C^-1 x) with their (k, k) covariance.

    Values without variance, which are on a bound, do not count (Wald, Trans. Am. Math. Soc. 54, 1943).
    """
    own = np.flatnonzero(np.diag(covariance) > 0.0)
    return float(np.sqrt(max(values[own] @ solve_positive(covariance[np.ix_(own, own)], values[own]), 0.0)))
