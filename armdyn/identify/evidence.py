r"""How strongly runs favour one fit over another when the noise may be coloured.

An autoregression fitted to the residual of the *richest* model whitens the residuals and derivatives of all the models
that are compared; each is then moved to its own generalised least-squares minimum by one Gauss-Newton step,

    c = min_d |W (r - J d)|^2 + priors,      LR = c_poor - c_rich,      Delta BIC = LR - k ln N.

Whitening with the residual of the poorer model would let the autoregression explain the missing physics.
(Judge et al., Theory and Practice of Econometrics, §8.2, for the estimator; Wilks 1938 for the test.)
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2 as chi2_distribution

from armdyn.identify.fit import Fit
from armdyn.identify.noise import whitened, whitening

Whitening = Mapping[str, tuple[np.ndarray, float]]


@dataclass(frozen=True, eq=False)
class Weighed:
    """A fit under a whitening.

    Attributes:
        cost: c.
        samples: N after whitening.
        count: effective number of fitted unknowns, sum_i (1 - C_ii / prior variance): those that the runs determine
            rather than the priors (MacKay, Neural Computation 4, 1992, eq. 4.9), rounded.
        values: (P,) the generalised least-squares estimate.
        covariance: (P, P) of it; zero for what was not fitted.
    """

    cost: float
    samples: int
    count: int
    values: np.ndarray
    covariance: np.ndarray

    @property
    def bic(self) -> float:
        """Up to a constant that all fits under one whitening share."""
        return self.cost + self.count * float(np.log(self.samples))


def whitening_of(fit: Fit) -> Whitening:
    """The whitening that the residual of a fit asks for."""
    return whitening(fit.blocks)


def weighed(fit: Fit, whitening: Whitening) -> Weighed:
    """A fit's generalised least-squares cost, estimate and covariance."""
    problem = fit.problem
    free = np.flatnonzero(fit.free)
    information = np.diag(problem.prior_weight[free] ** 2)
    prior = (problem.prior_weight * (problem.prior_mean - fit.values))[free]
    gradient = problem.prior_weight[free] * prior
    cost, samples = float(prior @ prior), 0
    for block in fit.blocks:
        coefficients, std = whitening[block.channel]
        residual = whitened(block.residual, coefficients) / std
        sensitivities = whitened(block.sensitivities[:, free], coefficients) / std
        information += sensitivities.T @ sensitivities
        gradient += sensitivities.T @ residual
        cost += float(residual @ residual)
        samples += len(residual)
    scale = np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
    on_bound = (fit.values <= problem.lower)[free] & (gradient < 0) | (fit.values >= problem.upper)[free] & (
        gradient > 0
    )
    moving = ~on_bound
    values, covariance = fit.values.copy(), np.zeros((len(fit.free), len(fit.free)))
    if moving.any():
        inner = scale[moving]
        inverse = np.linalg.pinv(
            information[np.ix_(moving, moving)] / np.outer(inner, inner), rcond=1e-12, hermitian=True
        )
        inverse = inverse / np.outer(inner, inner)
        step = inverse @ gradient[moving]
        cost -= float(gradient[moving] @ step)
        here = free[moving]
        values[here] = np.clip(fit.values[here] + step, problem.lower[here], problem.upper[here])
        covariance[np.ix_(here, here)] = inverse
    # What is on a bound counts as well: it could have moved.
    determined = 1.0 - np.diag(covariance)[free] * problem.prior_weight[free] ** 2
    return Weighed(cost, samples, round(float(np.sum(determined))), values, covariance)


def p_value(drop: float, count: int, *, one_sided: bool = False) -> float:
    """Probability that `count` superfluous unknowns lower the cost by `drop`; half of it at a bound."""
    if drop <= 0.0:
        return 1.0
    p = float(chi2_distribution.sf(drop, count))
    return p / 2 if one_sided and count == 1 else p
