"""One fit of a model to runs, and its quality."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armdyn.estimation.covariance import embedded, free_covariance
from armdyn.estimation.descent import Outcome
from armdyn.estimation.expansion import not_held_by_bound
from armdyn.identify.problem import Problem
from armdyn.identify.residual.block import ResidualBlock, blocks_by_channel, chi2_sum, sample_count
from armdyn.recording.gaps import run_until
from armdyn.run import Channel, Run

MIN_INDEPENDENT_DERIVATIVE_SHARE = 1e-5
"""An unknown is not identifiable if less than this share of its derivatives (root of squares) is independent of those
of other unknowns."""

MAX_CONTINUATIONS, STEPS_PER_FIT_CONTINUATION = 16, 8
"""Largest number of times that a fit which ran out of steps is continued, and number of further steps each time. Where
parameters compensate each other, the cost is a bent valley, and a step goes down only a hundredth of it."""
NEGLIGIBLE_CHI2_FALL_PER_SAMPLE = 1.0
"""Fall of chi2 over `STEPS_PER_FIT_CONTINUATION`, in units of chi2 per sample, that changes no ranking."""


@dataclass(frozen=True, eq=False)
class Fit:
    """Result of a least-squares fit: the values of all unknowns at the minimum of the cost, and the residuals there.

    Attributes:
        problem: the model, runs and noise.
        free: (P,) bool, True for unknowns that were fitted.
        values: (P,) values of all unknowns.
        blocks: residuals at these values, and derivatives with respect to the free unknowns.
        outcome: why the minimisation ended.
        process_noise_values: (P,) values of the unknowns in a fit with process noise, in which random kicks stand for
            the model's own error; None where they were not computed.
        weighted: the problem whose cost was minimised, where its weights and priors are not those of `problem`: a
            sample of an arm counts as much as the model's own error lets it count.
    """

    problem: Problem
    free: np.ndarray
    values: np.ndarray
    blocks: tuple[ResidualBlock, ...]
    outcome: Outcome
    process_noise_values: np.ndarray | None = None
    weighted: Problem | None = None

    @property
    def minimised(self) -> Problem:
        """The problem whose cost was minimised."""
        return self.problem if self.weighted is None else self.weighted

    @cached_property
    def minimised_cost(self) -> float:
        """The cost that was minimised, at the minimum: weighted squared residuals and priors."""
        if self.weighted is None:
            return self.cost
        noise, prior = self.weighted.noise, self.weighted.prior_weight * (self.weighted.prior_mean - self.values)
        return sum(float(b.misfit @ b.misfit) / noise[b.run, b.channel] ** 2 for b in self.blocks) + float(
            prior @ prior
        )

    @cached_property
    def posterior_covariance(self) -> np.ndarray:
        """(P, P) inverse of the Hessian of the minimised cost; zero for unknowns that are fixed or on a bound."""
        problem, own = self.minimised, np.flatnonzero(self.free)
        weight = problem.prior_weight[own] ** 2
        hessian, downhill = np.diag(weight), weight * (problem.prior_mean - self.values)[own]
        for block in self.blocks:
            share = (block.noise / problem.noise[block.run, block.channel]) ** 2
            S = block.sensitivities[:, own]
            hessian += share * S.T @ S
            downhill += share * S.T @ block.residual
        room = (problem.lower - self.values)[own], (problem.upper - self.values)[own]
        inside = not_held_by_bound(*room, -downhill)
        return embedded(free_covariance(hessian, inside), own, len(self.free))

    def change_by_gain(self, channels: Collection[str]) -> tuple[np.ndarray, float]:
        """(P,) changes of the fitted values if channels have a gain in common that is larger than 1, over its excess.

        Also the information on this gain that the fitted values cannot imitate.
        """
        problem, across, own = self.minimised, np.zeros(len(self.free)), 0.0
        for block in self.blocks:
            if block.channel in channels:
                share, s = (block.noise / problem.noise[block.run, block.channel]) ** 2, block.predicted / block.noise
                across += share * block.sensitivities.T @ s
                own += share * float(s @ s)
        change = -self.posterior_covariance @ across
        return change, max(own + float(across @ change), 0.0)

    @property
    def samples(self) -> int:
        """Number of measured samples."""
        return sample_count(self.blocks)

    @cached_property
    def chi2(self) -> float:
        """Sum of the squared residuals over the noise variance, without priors."""
        return chi2_sum(self.blocks)

    @property
    def cost(self) -> float:
        """Chi2 plus the cost of the priors; infinite where a simulation diverges."""
        prior = self.problem.prior_weight * (self.problem.prior_mean - self.values)
        return self.chi2 + float(prior @ prior)

    @property
    def chi2_per_sample(self) -> float:
        """Squared residual over the noise variance, per sample; 1 where the residual is only noise."""
        return self.chi2 / self.samples

    @property
    def bic(self) -> float:
        """Bayesian information criterion (Schwarz 1978) of the fit, with the assumed noise."""
        constant = sum(len(b.residual) * np.log(2 * np.pi * b.noise**2) for b in self.blocks)
        return float(self.cost + constant + self.free.sum() * np.log(self.samples))

    @property
    def consider_parameters(self) -> np.ndarray:
        """(P,) bool: consider parameters, which are not fitted but have a prior whose uncertainty counts."""
        return ~self.free & np.array([c.parameter.is_consider_parameter for c in self.problem.columns], dtype=bool)

    @property
    def at_bound(self) -> tuple[str, ...]:
        """Fitted unknowns whose value is on a physical bound other than their null value."""
        p = self.problem
        on = self.free & ((self.values <= p.lower) | (self.values >= p.upper)) & (self.values != p.null)
        return tuple(c.name for c, bound in zip(p.columns, on, strict=True) if bound)

    def rmse(self) -> dict[str, float]:
        """Root mean square residual by channel, in the channel's unit."""
        return channel_rmse(self.blocks)

    def covariates(self) -> dict[str, Mapping[str, Channel]]:
        """Signals on which the residuals may depend, by run; see `Model.covariates`."""
        problem = self.problem
        return {
            run.name: problem.model.covariates(run, problem.theta(i, self.values)) for i, run in enumerate(problem.runs)
        }

    def contribution(self, effects: Collection[str]) -> dict[str, float]:
        """Root mean square difference that `effects` make to the predictions, by channel, in the channel's unit."""
        own = np.array([column.parameter.effect in effects for column in self.problem.columns])
        here, without = (self.problem.blocks(v) for v in (self.values, np.where(own, self.problem.null, self.values)))
        pairs = zip(here, without, strict=True)
        return channel_rmse([replace(there, residual=there.residual - one.residual) for one, there in pairs])


@np.errstate(all="ignore")  # the values of a diverging simulation are infinite
def channel_rmse(blocks: Sequence[ResidualBlock]) -> dict[str, float]:
    """Root mean square residual by channel, in the channel's unit."""
    misfits = {channel: np.concatenate([b.misfit for b in mine]) for channel, mine in blocks_by_channel(blocks).items()}
    return {channel: float(np.sqrt(np.mean(misfit**2))) for channel, misfit in misfits.items()}


def fit(
    problem: Problem,
    free: np.ndarray,
    start: np.ndarray,
    *,
    most_steps: int = 30,
    tolerance: float = 0.02,
    weighted: Problem | None = None,
) -> Fit:
    """Fit some unknowns of a problem by least squares; see `descend`.

    Args:
        problem: the model, runs and noise.
        free: (P,) bool, unknowns that are fitted.
        start: (P,) start values; unknowns that are not fitted keep them.
        most_steps: largest number of steps.
        tolerance: length of a step, in standard deviations, below which the fit has converged.
        weighted: the same problem with other weights and priors, whose cost is minimised; None means `problem`.
    """
    minimised = problem if weighted is None else weighted
    found = minimised.fit(free, start, most_steps=most_steps, tolerance=tolerance)
    blocks = minimised.blocks(found.values, free)
    if weighted is not None:
        blocks = [block.with_noise(problem.noise[block.run, block.channel]) for block in blocks]
    return Fit(problem, free, found.values, tuple(blocks), found.outcome, weighted=weighted)


def continue_fit(found: Fit, tolerance: float = 0.02) -> Fit:
    """Continue a fit that ran out of steps, as long as further steps lower the cost noticeably; see `fit`."""
    for _ in range(MAX_CONTINUATIONS):
        if found.outcome is not Outcome.OUT_OF_STEPS:
            break
        again = fit(
            found.problem, found.free, found.values, most_steps=STEPS_PER_FIT_CONTINUATION, tolerance=tolerance,
            weighted=found.weighted,
        )  # fmt: skip
        before, found = found, replace(again, process_noise_values=found.process_noise_values)
        # Where the residual is far above the noise, it takes the noise's place.
        gross = max(1.0, found.chi2_per_sample) if found.weighted is None else 1.0
        if before.minimised_cost - found.minimised_cost < NEGLIGIBLE_CHI2_FALL_PER_SAMPLE * gross:
            break
    return found


def identifiable(problem: Problem, free: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Find the unknowns that the runs and priors identify.

    An unknown counts as identifiable where the unknowns before it cannot imitate its influence. Unknowns of the base
    model come first, so they are preferred to those of effects.

    Args:
        problem: the model, runs and noise.
        free: (P,) bool, unknowns to choose from.
        values: (P,) values of all unknowns.

    Returns:
        (P,) bool.
    """
    typical = problem.typical[free]
    whole = np.zeros((len(free), len(free)))
    whole[np.ix_(free, free)] = problem.expansion(values, free, guesses=False).hessian * np.outer(typical, typical)
    return independent_columns(whole, free)


def independent_columns(gram: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Find the unknowns whose derivatives are linearly independent of those of earlier unknowns.

    Args:
        gram: (P, P) products S' S of the derivatives S of all samples.
        wanted: (P,) bool, unknowns to choose from.

    Returns:
        (P,) bool.
    """
    index = np.flatnonzero(wanted)
    gram = gram[np.ix_(index, index)]
    norms = np.sqrt(np.maximum(np.diag(gram), 0.0))  # rounding may leave a negative number
    kept = np.zeros(len(wanted), dtype=bool)
    factor = np.empty((0, len(index)))  # rows of the Cholesky factor of the unknowns kept so far
    for j in np.flatnonzero(norms > 1e-9 * np.max(norms, initial=0.0)):
        rest = gram[j] - factor[:, j] @ factor
        if rest[j] > (MIN_INDEPENDENT_DERIVATIVE_SHARE * norms[j]) ** 2:
            factor = np.vstack([factor, rest / np.sqrt(rest[j])])
            kept[index[j]] = True
    return kept


def first_seconds(run: Run, window: float) -> Run:
    """Cut a run `window` s after the first sample of the channels that a model can predict."""
    return run_until(run, _begin(run) + window)


def run_duration(run: Run) -> float:
    """Time from the first to the last sample of a run's channels that a model can predict, s."""
    return max(float(run.channels[name].time[-1]) for name in run.predictable_channels or run.channels) - _begin(run)


def _begin(run: Run) -> float:
    return min(float(run.channels[name].time[0]) for name in run.predictable_channels or run.channels)
