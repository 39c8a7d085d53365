"""Covariance of the values of a fit: the inverse of their information, or a sandwich if errors are not as assumed."""

import numpy as np

from armdyn.estimation.solve import inverse_positive, pseudo_inverse

UNSEEN_INFORMATION_SHARE = 1e-12
"""Share of the largest information below which a direction counts as one without information."""


def free_covariance(information: np.ndarray, free: np.ndarray, negligible: float | None = None) -> np.ndarray:
    """(P, P) covariance of P unknowns, zero for those that are not free, such as those on a bound.

    It is the inverse of the information on the free ones, the bound of Cramér and Rao (Kay, Fundamentals of Statistical
    Signal Processing: Estimation Theory, §3.7).

    Args:
        information: (P, P) information matrix of the samples and the priors.
        free: (P,) bool.
        negligible: eigenvalues of the information, scaled to a diagonal of ones, that are below this share of the
            largest count as zero, and their directions as known; None where unknowns that nothing tells are to have a
            very large variance.
    """
    own = np.flatnonzero(free)
    inner = information[np.ix_(own, own)]
    if negligible is None:
        return embedded(inverse_positive(inner), own, len(information))
    scale = np.sqrt(np.maximum(np.diag(inner), np.finfo(float).tiny))
    scales = np.outer(scale, scale)
    return embedded(pseudo_inverse(inner / scales, negligible) / scales, own, len(information))


def sandwich_covariance(inverse: np.ndarray, scores: np.ndarray) -> np.ndarray:
    """(P, P) covariance H^-1 S H^-1 of a fit whose errors are larger or more correlated than it assumed.

    Args:
        inverse: (P, P) inverse of the information H, as of `free_covariance`.
        scores: (P, P) covariance S of the slope of the cost (White, Econometrica 50, 1982).
    """
    return np.asarray(inverse @ scores @ inverse)


def consider_covariance(change: np.ndarray, std: np.ndarray, known: np.ndarray | float = 0.0) -> np.ndarray:
    """(P, P) covariance K diag(d^2) K' that quantities which no fit changes add to that of the fitted values.

    Args:
        change: (P, m) derivatives K of the P fitted values by the m assumed quantities, such as -H^-1 S' s (Schmidt,
            Advances in Control Systems 3, 1966; Tapley, Schutz & Born, Statistical Orbit Determination, 2004, §6.3).
        std: (m,) standard deviations of these before the samples.
        known: (m,) information of the samples on each that the fitted values cannot imitate, s's - s'S H^-1 S's: with
            it the standard deviation d of a quantity, of which the samples show no error, is less.
    """
    spread = change / np.sqrt(std**-2.0 + known)
    return np.asarray(spread @ spread.T)


def covariance_root(information: np.ndarray) -> np.ndarray:
    """(P, P) A with A A' the inverse of an information matrix; directions without information get no error."""
    if not len(information):
        return information.copy()
    scale = np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    kept = values > UNSEEN_INFORMATION_SHARE * values[-1]
    roots = np.where(kept, 1.0 / np.sqrt(np.where(kept, values, 1.0)), 0.0)
    return np.asarray(vectors * roots / scale[:, None])


def embedded(matrix: np.ndarray, columns: np.ndarray, count: int) -> np.ndarray:
    """(count, count) matrix with a (p, p) one at the (p,) indices `columns`, and zeros elsewhere."""
    whole = np.zeros((count, count))
    whole[np.ix_(columns, columns)] = matrix
    return whole
