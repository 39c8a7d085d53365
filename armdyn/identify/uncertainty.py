"""Uncertainty of fitted values, with the model's own error included where it is larger than the noise.

Where the residual is of the size of the noise, an autoregression whitens it, and the covariance is that of generalised
least squares. Where the model's own error is larger, whitening would treat that error as noise with memory and give far
too small deviations. The covariance is then that of the ordinary least squares that were solved, with errors as large
and as correlated as the residual of each channel c:

    H = sum_c S_c' S_c + P,    Cov = H^-1 (sum_c f_c S_c' S_c + P) H^-1,    f_c = max(1, variance_inflation),

where S_c are the derivatives over the noise and P the priors (White, Econometrica 50, 1982, for the form).

A consider parameter, which no fit changes although it has a prior of standard deviation d, such as the gravity in which
a pendulum swings, adds K d^2 K', where K = -H^-1 sum_c S_c' s_c is the derivative of the minimum by it, and s_c its
derivatives over the noise (`consider_covariance`). A fit of such a parameter would absorb errors of the model. A gain
that all readings of a sensor share is one too, with the predictions y_c over the noise as s_c. It moves the values, and
no prediction of this sensor's readings.

Measured on simulated recordings of a Baxter arm, with one effect fitted and one that is in no catalogue: 90 % of 336
values within 3 standard deviations, with whitening 76 % (docs/repair.md). What is missing may still shift a value by
more than any residual shows.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from armdyn.estimation.covariance import consider_covariance, embedded, free_covariance, sandwich_covariance
from armdyn.estimation.expansion import not_held_by_bound
from armdyn.identify.fit import Fit
from armdyn.identify.noise import WhiteningFilter, variance_inflation, whitening_filters
from armdyn.identify.residual.block import blocks_by_channel, chi2_sum, sample_count
from armdyn.identify.study import Study
from armdyn.model import AssumedGain

REDUCED_PRIOR_WEIGHT = 1e-4
"""Share of the priors' weight that remains in a covariance of the runs alone: a hundred times wider priors."""
NEGLIGIBLE_INFORMATION_SHARE = 1e-13
"""Share of the largest information below which a direction of the unknowns is only rounding."""


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Uncertainty of the fitted values of a fit.

    Attributes:
        fit: the fit.
        variance_inflation: factor on the noise variance by channel, for the model's own error; empty where the residual
            is of the size of the noise.
    """

    fit: Fit
    variance_inflation: dict[str, float]

    @property
    def std_inflation(self) -> float:
        """Factor by which the model's own error widens the standard deviations, for the worst channel; 1 if small."""
        return float(np.sqrt(max(self.variance_inflation.values(), default=1.0)))

    @cached_property
    def covariance(self) -> np.ndarray:
        """(P, P) covariance of all unknowns; zero for unknowns that are fixed or on a bound."""
        return self.covariance_with_exact_gains + sum(self._by_gains.values())

    @cached_property
    def covariance_with_exact_gains(self) -> np.ndarray:
        """(P, P) covariance of all unknowns as if the gains of the sensors were known, for predictions of readings."""
        if self.fit.weighted is not None:
            return self.fit.posterior_covariance
        return (
            _covariance(self.fit, self.variance_inflation) if self.variance_inflation else whitened_covariance(self.fit)
        )

    @cached_property
    def _by_gains(self) -> dict[AssumedGain, np.ndarray]:
        """(P, P) covariance by each of the gains that readings share."""
        problem, found = self.fit.problem, dict[AssumedGain, np.ndarray]()
        freed = {column.parameter.name for column, free in zip(problem.columns, self.fit.free, strict=True) if free}
        for gain in problem.model.assumed_gains(freed):
            change, known = self.fit.change_by_gain(gain.channels)
            beside = ~problem.mask_of_unknowns(gain.relative)
            found[gain] = consider_covariance((change * beside)[:, None], np.array([gain.std]), known)
        return found

    @property
    def open_questions(self) -> tuple[str, ...]:
        """Sentences, without full stops, on gains that readings share, from which most of a value's variance comes."""
        alone = np.diag(self.covariance_with_exact_gains)
        return tuple(g.question for g, more in self._by_gains.items() if g.question and np.any(np.diag(more) > alone))

    @cached_property
    def covariance_without_priors(self) -> np.ndarray:
        """(P, P) covariance almost without priors and bounds: very large for unknowns that only these determine."""
        factors = self.variance_inflation or _inflation(self.fit)
        return _covariance(self.fit, factors, REDUCED_PRIOR_WEIGHT, bounded=False) + sum(self._by_gains.values())


def uncertainty(study: Study, fit: Fit) -> Uncertainty:
    """Uncertainty of a fit, from the noise or, where the model's own error is larger, from that error."""
    return Uncertainty(fit, _inflation(fit) if model_error_dominates(study, fit) else {})


def whitened_covariance(fit: Fit) -> np.ndarray:
    """(P, P) covariance of a fit's unknowns if its residual is noise that is correlated in time.

    It is that of generalised least squares, with an autoregression as the model of the noise (Judge et al., Theory and
    Practice of Econometrics, §8.2); zero for unknowns on a bound.
    """
    return _covariance(fit, dict.fromkeys(blocks_by_channel(fit.blocks), 1.0), filters=whitening_filters(fit.blocks))


def _covariance(
    fit: Fit,
    factors: Mapping[str, float],
    trust: float = 1.0,
    *,
    bounded: bool = True,
    filters: Mapping[str, WhiteningFilter] | None = None,
) -> np.ndarray:
    """(P, P) covariance of fitted and consider parameters; zero for others, and where `bounded` for values on a bound.

    It is not finite where the simulation diverges.

    Args:
        fit: the fit.
        factors: factor f_c by channel.
        trust: share of the priors' weight that is used.
        bounded: whether bounds are respected.
        filters: whitening filter by channel; None where the residual is not whitened.
    """
    problem, free, considered = fit.problem, np.flatnonzero(fit.free), np.flatnonzero(fit.consider_parameters)
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
    room = (problem.lower - fit.values)[free], (problem.upper - fit.values)[free]
    inside = not_held_by_bound(*room, -gradient) if bounded else np.ones(len(free), dtype=bool)
    inverse = free_covariance(bread, inside, NEGLIGIBLE_INFORMATION_SHARE)
    covariance = embedded(sandwich_covariance(inverse, meat), free, len(fit.free))
    moved = np.zeros((len(fit.free), len(considered)))
    moved[free], moved[considered] = -inverse @ beside, np.eye(len(considered))
    return covariance + consider_covariance(moved, 1.0 / problem.prior_weight[considered])


def model_error_dominates(study: Study, fit: Fit) -> bool:
    """Whether the model's own error is larger than the noise, in at least one channel of a fit."""
    for blocks in blocks_by_channel(fit.blocks).values():
        chi2, samples = study.chi2_by_stated_noise(blocks)
        far, whole = study.settings.noise.stated_chi2, sample_count(blocks)
        if samples < whole:
            chi2, samples, far = chi2_sum(blocks), whole, study.settings.noise.estimated_chi2
        if chi2 > far * samples:
            return True
    return False


def _inflation(fit: Fit) -> dict[str, float]:
    """Factor f_c by channel, at least 1."""
    return {
        channel: max(1.0, variance_inflation([block.residual for block in blocks]))
        for channel, blocks in blocks_by_channel(fit.blocks).items()
    }
