r"""Criteria of optimal experiments: functions of a motion's information matrix, with the exact gradient.

Unknowns are in their typical sizes. F (P, P) is the Fisher information of the motion and \Lambda the inverse of the
prior variances. K = (F + \Lambda)^{-1} is the covariance of all unknowns after the motion; a block of K is the
covariance of some unknowns with the others as nuisance: the inverse of a Schur complement of F + \Lambda.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from armdyn.estimation.posterior import posterior_covariance
from armdyn.estimation.solve import marginal_information

ValueAndGradient: TypeAlias = tuple[float, np.ndarray]
"""Value of a criterion, and its symmetric (P, P) derivative by the information matrix."""
InformationCriterion: TypeAlias = Callable[[np.ndarray], ValueAndGradient]
"""A function of a (P, P) information matrix that is to be minimised."""
NEGLIGIBLE_CHI2_RISE = 1e-4
"""Rise of chi2 that counts as zero; it keeps the criterion finite for effects that a motion does not distinguish."""


def d_optimality(information: np.ndarray, prior: np.ndarray, wanted: np.ndarray) -> ValueAndGradient:
    r"""Mean logarithm of the standard deviations of the wanted unknowns, over all directions: D-optimality.

    For (P, P) information F, (P,) prior standard deviations and indices W it is log det K_{WW} / (2 |W|), a constant
    less twice the expected gain of information (Chaloner & Verdinelli, Statistical Science 10(3), 1995).
    """
    K = posterior_covariance(information, prior)
    block, columns = K[np.ix_(wanted, wanted)], K[:, wanted]
    size = 2.0 * len(wanted)
    return float(np.linalg.slogdet(block)[1]) / size, -columns @ np.linalg.solve(block, columns.T) / size


@dataclass(frozen=True, eq=False)
class RivalSeparation:
    """An effect on one joint that may be present, and the unknowns of a rival effect that is fitted in its place.

    Attributes:
        effect: name of the effect.
        joint: joint on which it acts; ``""`` for the base.
        rival: name of the effect that is fitted in its place.
        own: indices of the effect's unknowns.
        fitted: indices of the rival's unknowns on all joints, and of the nuisance unknowns.
        directions: (len(own), k) orthonormal changes of the effect's unknowns that some motion distinguishes from the
            fitted ones.
    """

    effect: str
    joint: str
    rival: str
    own: np.ndarray
    fitted: np.ndarray
    directions: np.ndarray

    def information_after_refit(self, information: np.ndarray, prior: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Information that remains after the rival's refit: (k, k) matrix L, and the changes of all unknowns.

        For (P, P) information F and (P,) prior standard deviations, L is the Schur complement
        F_AA - F_AB (F_BB + Lambda_B)^-1 F_BA: after the refit, chi2 rises by d' L d for a change d along `directions`,
        in typical sizes. The changes are (len(own) + len(fitted), k).
        """
        nuisance = np.isin(np.arange(len(prior)), self.fitted)
        L, follow = marginal_information(information + np.diag(nuisance * prior**-2.0), self.own, self.fitted)
        changes = np.vstack([np.eye(len(self.own)), follow]) @ self.directions
        return np.asarray(self.directions.T @ L @ self.directions), changes

    def separation(self, information: np.ndarray, prior: np.ndarray) -> float:
        """Smallest rise of chi2 after the rival's refit, over all distinguishable changes of typical size.

        It takes the (P, P) information and the (P,) prior standard deviations.
        """
        return max(float(np.linalg.eigvalsh(self.information_after_refit(information, prior)[0])[0]), 0.0)


def log_harmonic_separation(
    information: np.ndarray, prior: np.ndarray, cases: Sequence[RivalSeparation]
) -> ValueAndGradient:
    r"""Logarithm of the sum of the inverse separations, which the smallest separation dominates.

    For (P, P) information and (P,) prior standard deviations it is log \sum_A tr L_A^{-1}, over every case A that may
    be true.
    """
    total, slopes = 0.0, np.zeros_like(information)
    for case in cases:
        everything = np.concatenate([case.own, case.fitted])
        L, T = case.information_after_refit(information, prior)
        inverse = np.linalg.inv(L + NEGLIGIBLE_CHI2_RISE * np.eye(len(L)))
        total += float(np.trace(inverse))
        # dL = T' dF T, since the best refit does not change in first order.
        slopes[np.ix_(everything, everything)] -= T @ inverse @ inverse @ T.T
    return float(np.log(total)), slopes / total


def log_condition(information: np.ndarray, typical: np.ndarray, independent: np.ndarray) -> ValueAndGradient:
    """Logarithm of the condition number of the regressor of the base parameters, in SI units.

    It is the common criterion of excitation (Gautier & Khalil, IJRR 11(4), 1992).

    Args:
        information: (P, P) Fisher information F.
        typical: (P,) typical sizes in which the information is given.
        independent: indices of unknowns whose columns are independent and span all others.
    """
    scale, here = 1.0 / typical[independent], np.ix_(independent, independent)
    values, vectors = np.linalg.eigh(information[here] * np.outer(scale, scale))
    smallest = max(values[0], 1e-12 * values[-1])
    first, last = scale * vectors[:, 0], scale * vectors[:, -1]
    slopes = np.zeros_like(information)
    slopes[here] = np.outer(last, last) / values[-1] - np.outer(first, first) / smallest
    return 0.5 * float(np.log(values[-1] / smallest)), 0.5 * slopes
