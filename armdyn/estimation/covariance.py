"""Covariance of the values of a fit, from the information of its samples and priors, some of it on bounds."""

import numpy as np

from armdyn.estimation.solve import inverse_positive, pseudo_inverse


def free_covariance(
    information: np.ndarray,
    free: np.ndarray,
    scores: np.ndarray | None = None,
    negligible: float | None = None,
) -> np.ndarray:
    r"""(P, P) covariance of P unknowns, zero for those that are not free, such as those on a bound.

    With the information H on the free unknowns it is H^-1, the bound of Cramér and Rao (Kay, Fundamentals of
    Statistical Signal Processing: Estimation Theory, §3.7), or, where the errors are larger or more correlated than the
    fit assumed, the sandwich H^-1 S H^-1 with the covariance S of the slope (White, Econometrica 50, 1982).

    Args:
        information: (P, P) information matrix, with that of the priors.
        free: (P,) bool.
        scores: (P, P) covariance S of the slope; None where the errors are those that the fit assumed.
        negligible: eigenvalues of the scaled information below this share of the largest count as zero, and their
            directions as known; None where unknowns that nothing tells are to have a very large variance.
    """
    own = np.flatnonzero(free)
    inverse = information_inverse(information[np.ix_(own, own)], negligible)
    covariance = np.zeros(information.shape)
    covariance[np.ix_(own, own)] = inverse if scores is None else inverse @ scores[np.ix_(own, own)] @ inverse
    return covariance


def information_inverse(information: np.ndarray, negligible: float | None = None) -> np.ndarray:
    """(P, P) inverse of an information matrix, whatever the units of its unknowns; see `free_covariance`."""
    if negligible is None:
        return inverse_positive(information)
    scale = np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
    scales = np.outer(scale, scale)
    return np.asarray(pseudo_inverse(information / scales, negligible) / scales)
