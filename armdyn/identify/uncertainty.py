"""How certain fitted values are, with the model's own error counted in where it is larger than the noise.

Where the residual is of the size of the noise, an autoregression whitens it, and the covariance is that of generalised
least squares. Where the model's own error is larger, whitening would take that error for noise with a memory and
promise far too much. The covariance is then that of the ordinary least squares that were solved, with errors as large
and as correlated as the residual of each channel c shows them,

    H = sum_c S_c' S_c + P,    Cov = H^-1 (sum_c f_c S_c' S_c + P) H^-1,    f_c = max(1, variance_inflation),

S_c the derivatives over the noise and P the priors (White, Econometrica 50, 1982, for the form).

What no fit changes though it is only known to a standard deviation d, such as the gravity in which a pendulum swings,
adds K d^2 K', where K = -H^-1 sum_c S_c' s_c is how the minimum moves with it, and s_c its derivatives over the noise
(consider covariance: Tapley, Schutz & Born, Statistical Orbit Determination, 2004, §6.3). Fitted, it would take up what
the model lacks.

Measured on simulated recordings of a Baxter arm, with one effect fitted and one that is in no catalogue: 90 % of 336
values within 3 standard deviations, with whitening 76 % (docs/repair.md). What is missing may still shift a value by
more than any residual shows.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from armdyn.identify.fit import Fit
from armdyn.identify.noise import Whitening, variance_inflation, whitening
from armdyn.identify.problem import by_channel, chi2_of, samples_of
from armdyn.identify.study import Study

FAR_ABOVE_STATED = 2.0
"""Chi2 per sample, against the noise as stated, beyond which the model's own error is larger than the noise."""
FAR_ABOVE_ESTIMATED = 10.0
"""The same where the noise is only estimated: third differences take noise with a correlation of 0.8 from one sample to
the next for 7.5 times weaker than it is."""
NEARLY_NO_PRIOR = 1e-4
"""Share of the priors' weight that is left to ask what the runs alone determine: a hundred times wider."""


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """What a fit leaves uncertain.

    Attributes:
        fit: the minimum.
        inflation: by channel, f_c; empty where the residual is of the size of the noise.
    """

    fit: Fit
    inflation: dict[str, float]

    @property
    def widened(self) -> float:
        """Factor on the standard deviations for the model's own error, for the worst channel; 1 where it is small."""
        return float(np.sqrt(max(self.inflation.values(), default=1.0)))

    @cached_property
    def covariance(self) -> np.ndarray:
        """(P, P) of all unknowns; zero for what is held exactly or by a bound."""
        return _covariance(self.fit, self.inflation) if self.inflation else whitened_covariance(self.fit)

    @cached_property
    def of_runs_alone(self) -> np.ndarray:
        """(P, P) the covariance nearly without priors and bounds: huge in what only they determine."""
        return _covariance(self.fit, self.inflation or _inflation(self.fit), NEARLY_NO_PRIOR, bounded=False)


def uncertainty(study: Study, fit: Fit) -> Uncertainty:
    """The uncertainty of a fit, by whichever of noise and model error is larger."""
    return Uncertainty(fit, _inflation(fit) if model_limited(study, fit) else {})


def whitened_covariance(fit: Fit) -> np.ndarray:
    """(P, P) of generalised least squares under an autoregression of the residual; zero for what is held by a bound.

    Judge et al., Theory and Practice of Econometrics, §8.2.
    """
    return _covariance(fit, dict.fromkeys(by_channel(fit.blocks), 1.0), filters=whitening(fit.blocks))


def _covariance(
    fit: Fit,
    factors: Mapping[str, float],
    trust: float = 1.0,
    *,
    bounded: bool = True,
    filters: Mapping[str, Whitening] | None = None,
) -> np.ndarray:
    """(P, P) of what is fitted or known to a prior; zero for the rest, and where `bounded` for what a bound holds.

    Not finite where the simulation diverges.

    Args:
        fit: the minimum.
        factors: f_c by channel.
        trust: share of their weight that the priors have.
        bounded: whether bounds count.
        filters: by channel, what whitens the residual; None where it is not whitened.
    """
    problem, free, considered = fit.problem, np.flatnonzero(fit.free), np.flatnonzero(fit.considered)
    weight = problem.prior_weight[free] ** 2
    bread = trust * np.diag(weight)
    meat, gradient = bread.copy(), weight * (problem.prior_mean - fit.values)[free]
    beside = np.zeros((len(free), len(considered)))
    for block in fit.blocks:
        residual, S, s = block.residual, block.sensitivities[:, free], block.sensitivities[:, considered]
        if filters is not None:
            residual, S, s = (filters[block.channel](signal) for signal in (residual, S, s))
        information = S.T @ S
        bread += information
        meat += factors[block.channel] * information
        gradient += S.T @ residual
        beside += S.T @ s
    if not (np.isfinite(bread).all() and np.isfinite(beside).all()):
        return np.full((len(fit.free), len(fit.free)), np.nan)
    lowest, highest = (fit.values <= problem.lower)[free], (fit.values >= problem.upper)[free]
    held = bounded & (lowest & (gradient < 0) | highest & (gradient > 0))
    here, (bread, meat) = free[~held], (matrix[np.ix_(~held, ~held)] for matrix in (bread, meat))
    scale = np.sqrt(np.maximum(np.diag(bread), np.finfo(float).tiny))
    scales = np.outer(scale, scale)
    inverse = np.linalg.pinv(bread / scales, rcond=1e-13, hermitian=True) / scales
    covariance = np.zeros((len(fit.free), len(fit.free)))
    covariance[np.ix_(here, here)] = inverse @ meat @ inverse
    moved = np.zeros((len(fit.free), len(considered)))
    moved[here], moved[considered] = -inverse @ beside[~held], np.eye(len(considered))
    return covariance + moved / problem.prior_weight[considered] ** 2 @ moved.T


def model_limited(study: Study, fit: Fit) -> bool:
    """Whether in some channel the model's own error is larger than the noise."""
    for blocks in by_channel(fit.blocks).values():
        chi2, samples = study.chi2_of_stated(blocks)
        far, whole = FAR_ABOVE_STATED, samples_of(blocks)
        if samples < whole:
            chi2, samples, far = chi2_of(blocks), whole, FAR_ABOVE_ESTIMATED
        if chi2 > far * samples:
            return True
    return False


def _inflation(fit: Fit) -> dict[str, float]:
    """By channel, at least 1."""
    return {
        channel: max(1.0, variance_inflation([block.residual for block in blocks]))
        for channel, blocks in by_channel(fit.blocks).items()
    }
