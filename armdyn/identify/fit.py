"""One fit of a model to runs, with what is known of its quality."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from armdyn.identify.estimator import until
from armdyn.identify.least_squares import Descent, Outcome
from armdyn.identify.problem import Block, Problem
from armdyn.run import Run

GROSS = 20.0
"""Chi2 per sample beyond which derivatives at the present fit say little about a distant minimum."""
DEPENDENT = 1e-5
"""A sensitivity of which the others leave less than this share cannot be told from them."""
SETTLED_WINDOW = 3.0
"""s; shorter windows tell friction and creep too little to be fitted in them."""
NEAR_NOISE = 1.5
"""Chi2 per sample at which a fit is in no wrong minimum: there a swing in the wrong phase leaves the signal itself."""
GROWTHS = (1.5, 2.0, 1.25)
"""Factors from one stretch to the next, tried until the misfit is not gross: where much is missing from the model the
minimum moves as the stretch grows, and no factor follows it in every recording."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A minimum of the cost.

    Attributes:
        problem: model, runs, noise.
        free: (P,) bool, the unknowns that were fitted.
        values: (P,) of all unknowns.
        blocks: residuals there, and derivatives with respect to what is free.
        outcome: why the descent ended.
    """

    problem: Problem
    free: np.ndarray
    values: np.ndarray
    blocks: tuple[Block, ...]
    outcome: Outcome

    @property
    def samples(self) -> int:
        """Number of measured samples."""
        return sum(len(block.residual) for block in self.blocks)

    @cached_property
    def chi2(self) -> float:
        """Sum of squared residuals over the noise, without priors."""
        return float(sum(block.residual @ block.residual for block in self.blocks))

    @property
    def cost(self) -> float:
        """Chi2 with the priors' share."""
        prior = self.problem.prior_weight * (self.problem.prior_mean - self.values)
        return self.chi2 + float(prior @ prior)

    @property
    def chi2_per_sample(self) -> float:
        """1 when only noise is left."""
        return self.chi2 / self.samples

    @property
    def bic(self) -> float:
        """Bayesian information criterion (Schwarz 1978), with the noise as assumed."""
        constant = sum(len(b.residual) * np.log(2 * np.pi * b.noise**2) for b in self.blocks)
        return float(self.cost + constant + self.free.sum() * np.log(self.samples))

    @property
    def at_bound(self) -> tuple[str, ...]:
        """Fitted unknowns that ended on a physical bound other than their null value."""
        p = self.problem
        on = self.free & ((self.values <= p.lower) | (self.values >= p.upper)) & (self.values != p.null)
        return tuple(c.name for c, bound in zip(p.columns, on, strict=True) if bound)

    def rmse(self) -> dict[str, float]:
        """Root mean square residual by channel, in its unit."""
        return channel_rmse(self.blocks)


def channel_rmse(blocks: Sequence[Block]) -> dict[str, float]:
    """Root mean square residual by channel, in its unit."""
    result = {}
    for channel in dict.fromkeys(block.channel for block in blocks):
        misfits = np.concatenate([block.misfit for block in blocks if block.channel == channel])
        result[channel] = float(np.sqrt(np.mean(misfits**2)))
    return result


def fit(
    problem: Problem,
    free: np.ndarray,
    start: np.ndarray,
    *,
    windows: bool = False,
    growths: Sequence[float] = GROWTHS,
    most_steps: int = 30,
) -> Fit:
    """Minimise over the unknowns `free`.

    Args:
        problem: model, runs, noise.
        free: (P,) bool.
        start: (P,).
        windows: fit the first second, then longer and longer stretches, so that the start may be far off: a cold
            start on a long recording falls into one of many minima.
        growths: of the stretches.
        most_steps: of the last fit.
    """
    if not windows:
        return _descended(problem, free, start, most_steps)
    best: Fit | None = None
    for growth in growths:
        found = _descended(problem, free, followed(problem, free, start, growth), most_steps)
        best = found if best is None or found.cost < best.cost else best
        if best.chi2_per_sample < GROSS:
            break
    assert best is not None
    return best


def _descended(problem: Problem, free: np.ndarray, start: np.ndarray, most_steps: int) -> Fit:
    found = problem.fit(free, start, most_steps=most_steps)
    return Fit(problem, free, found.values, tuple(problem.blocks(found.values, free)), found.outcome)


def followed(problem: Problem, free: np.ndarray, start: np.ndarray, growth: float) -> np.ndarray:
    """(P,) the minimum over the first second, followed while the stretch grows."""
    values = start
    for window in _windows(problem, growth):
        cut = Problem(problem.model, [first_part(run, window) for run in problem.runs], problem.noise).held_near(values)
        # All are held weakly, so that none need be left out: what seems dependent beside the growth of an error near
        # the upright is known well.
        values = stretched(cut, free, window, values, tolerance=0.3).values
    return values


def stretched(cut: Problem, free: np.ndarray, window: float, values: np.ndarray, *, tolerance: float = 0.02) -> Descent:
    """A few steps on a stretch of `window` s; effects are fitted where it is long, or not explained without them."""
    first = told(cut, free, window)
    found = cut.fit(first, values, most_steps=8, tolerance=tolerance)
    if np.array_equal(first, free) or 2.0 * found.at.cost < NEAR_NOISE * cut.samples:
        return found
    # Friction that takes half of the first swing's energy is told by it; without it the swing's start is bent instead.
    other = cut.fit(free, values, most_steps=8, tolerance=tolerance)
    return other if other.at.cost < found.at.cost else found


def determined(problem: Problem, free: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(P,) bool: those of `free` that the runs, with the priors, tell from all the others before them.

    Unknowns of the base come first, so that of two which cannot be told apart the base's is kept.
    """
    typical = problem.typical[free]
    whole = np.zeros((len(free), len(free)))
    whole[np.ix_(free, free)] = problem.expansion(values, free).hessian * np.outer(typical, typical)
    return independent(whole, free)


def independent(gram: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """(P,) bool: those of `wanted` whose sensitivities no earlier ones imitate; (P, P) `gram` holds their products."""
    index = np.flatnonzero(wanted)
    gram = gram[np.ix_(index, index)]
    norms = np.sqrt(np.diag(gram))
    kept = np.zeros(len(wanted), dtype=bool)
    factor = np.empty((0, len(index)))  # rows of the Cholesky factor of what has been kept
    for j in np.flatnonzero(norms > 1e-9 * np.max(norms, initial=0.0)):
        rest = gram[j] - factor[:, j] @ factor
        if rest[j] > (DEPENDENT * norms[j]) ** 2:
            factor = np.vstack([factor, rest / np.sqrt(rest[j])])
            kept[index[j]] = True
    return kept


def told(problem: Problem, free: np.ndarray, window: float) -> np.ndarray:
    """(P,) bool: what of `free` is fitted to a stretch of `window` s: the base, and effects where it is long enough."""
    base = np.array([not column.parameter.effect for column in problem.columns])
    return free if window >= SETTLED_WINDOW else free & (problem.per_run | base)


def _windows(problem: Problem, growth: float) -> list[float]:
    longest = max(duration(run) for run in problem.runs)
    result, window = [], problem.model.start.window
    while window is not None and window < 0.9 * longest:
        result.append(window)
        window *= growth
    return result


def first_part(run: Run, window: float) -> Run:
    """What was recorded until `window` s after the first sample of what is compared."""
    return until(run, _begin(run) + window)


def duration(run: Run) -> float:
    """From the first to the last sample of what is compared, s."""
    return max(float(run.channels[name].time[-1]) for name in run.measured or run.channels) - _begin(run)


def _begin(run: Run) -> float:
    return min(float(run.channels[name].time[0]) for name in run.measured or run.channels)
