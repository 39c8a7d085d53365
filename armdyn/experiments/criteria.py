r"""What a motion is chosen by: a number that follows from its information matrix, with the exact gradient.

Unknowns are counted in their typical sizes. F (P, P) is the Fisher information of the motion and \Lambda the inverse of
the variances before it. K = (F + \Lambda)^{-1} is the covariance of all unknowns after it, of which a block is that of
some of them with the others as nuisance: the Schur complement of F + \Lambda, inverted.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.linalg import cho_factor, cho_solve


class Criterion(Protocol):
    """A number to be made small."""

    def __call__(self, information: np.ndarray) -> tuple[float, np.ndarray]:
        """The number of a (P, P) information matrix, and its (P, P) symmetric derivatives."""
        ...


def covariance(information: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """(P, P) K.

    Args:
        information: (P, P) F.
        prior: (P,) standard deviations before; infinite for none.
    """
    matrix = information + np.diag(prior**-2.0)
    scale = 1.0 / np.sqrt(np.diag(matrix))
    factor = cho_factor(matrix * np.outer(scale, scale))
    return np.asarray(cho_solve(factor, np.diag(scale)) * scale[:, None])


@dataclass(frozen=True, eq=False)
class DOptimality:
    r"""Mean logarithm of the standard deviations of the wanted unknowns, those of all directions alike: D-optimal.

    log det K_{WW} / (2 |W|), which is twice the expected gain of information less a constant (Chaloner & Verdinelli,
    Statistical Science 10(3), 1995).

    Attributes:
        wanted: indices of the unknowns.
        prior: (P,) standard deviations before.
    """

    wanted: np.ndarray
    prior: np.ndarray

    def __call__(self, information: np.ndarray) -> tuple[float, np.ndarray]:
        """See `Criterion`."""
        K = covariance(information, self.prior)
        block = K[np.ix_(self.wanted, self.wanted)]
        _, logarithm = np.linalg.slogdet(block)
        columns = K[:, self.wanted]
        size = 2.0 * len(self.wanted)
        return float(logarithm) / size, -columns @ np.linalg.solve(block, columns.T) / size


@dataclass(frozen=True, eq=False)
class RivalSeparation:
    """One effect on one joint that may be the truth, and everything that may be fitted in its place.

    Attributes:
        effect: its name.
        joint: where it acts, ``""`` for the base.
        rival: name of the effect that is fitted in its place.
        own: indices of its unknowns.
        fitted: indices of the rival's unknowns on all joints, and of the nuisance.
        directions: (len(own), k) of its changes that some motion tells from the fitted ones, orthonormal.
    """

    effect: str
    joint: str
    rival: str
    own: np.ndarray
    fitted: np.ndarray
    directions: np.ndarray

    def left(self, information: np.ndarray, prior: np.ndarray) -> np.ndarray:
        """(k, k) L, the rise of chi2 after the refit being d' L d for a change d along `directions`, in typical sizes.

        The Schur complement F_AA - F_AB (F_BB + Lambda_B)^-1 F_BA.
        """
        return self.refitted(
            information, covariance(information[np.ix_(self.fitted, self.fitted)], prior[self.fitted])
        )[0]

    def refitted(self, information: np.ndarray, K: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(k, k) L, and (len(own) + len(fitted), k) the changes of all these unknowns, the refit included.

        Args:
            information: (P, P) F.
            K: covariance of the fitted unknowns alone.
        """
        onto = K @ information[np.ix_(self.fitted, self.own)]  # what is fitted per change of the hidden effect
        complement = information[np.ix_(self.own, self.own)] - information[np.ix_(self.own, self.fitted)] @ onto
        changes = np.vstack([np.eye(len(self.own)), -onto]) @ self.directions
        return np.asarray(self.directions.T @ complement @ self.directions), changes

    def separation(self, information: np.ndarray, prior: np.ndarray) -> float:
        """Smallest rise of chi2 after the refit, over all changes of typical size that can be told."""
        return max(float(np.linalg.eigvalsh(self.left(information, prior))[0]), 0.0)


FAINT = 1e-4
"""Rise of chi2 that is taken for nothing: it keeps the logarithm finite where two effects are still the same."""


@dataclass(frozen=True, eq=False)
class Separated:
    r"""Logarithm of the harmonic sum of all separations: the smallest one decides.

    log \sum_A tr L_A^{-1}, over every effect and joint A that may be hidden.

    Attributes:
        hidden: what may be the truth.
        prior: (P,) standard deviations before.
    """

    hidden: Sequence[RivalSeparation]
    prior: np.ndarray

    def __call__(self, information: np.ndarray) -> tuple[float, np.ndarray]:
        """See `Criterion`."""
        total, slopes = 0.0, np.zeros_like(information)
        known: dict[bytes, np.ndarray] = {}  # an effect's joints mostly have the same to be fitted in their place
        for case in self.hidden:
            everything = np.concatenate([case.own, case.fitted])
            key = case.fitted.tobytes()
            if key not in known:
                known[key] = covariance(information[np.ix_(case.fitted, case.fitted)], self.prior[case.fitted])
            L, T = case.refitted(information, known[key])
            inverse = np.linalg.inv(L + FAINT * np.eye(len(L)))
            total += float(np.trace(inverse))
            # dL = T' dF T, as the best refit does not change in first order.
            slopes[np.ix_(everything, everything)] -= T @ inverse @ inverse @ T.T
        return float(np.log(total)), slopes / total


@dataclass(frozen=True, eq=False)
class Conditioned:
    """Logarithm of the condition number of the regression on base parameters, in SI units: the usual criterion.

    Gautier & Khalil, IJRR 11(4), 1992; FloBaRoID and FIGAROH minimise it.

    Attributes:
        independent: indices of unknowns whose columns are independent and span the others.
        typical: (P,) sizes that the information is counted in.
    """

    independent: np.ndarray
    typical: np.ndarray

    def __call__(self, information: np.ndarray) -> tuple[float, np.ndarray]:
        """See `Criterion`."""
        scale = 1.0 / self.typical[self.independent]
        here = np.ix_(self.independent, self.independent)
        values, vectors = np.linalg.eigh(information[here] * np.outer(scale, scale))
        smallest = max(values[0], 1e-12 * values[-1])
        first, last = scale * vectors[:, 0], scale * vectors[:, -1]
        slopes = np.zeros_like(information)
        slopes[here] = np.outer(last, last) / values[-1] - np.outer(first, first) / smallest
        return 0.5 * float(np.log(values[-1] / smallest)), 0.5 * slopes
