r"""Nonlinear least squares with priors and bounds on any model.

    J(theta) = 1/2 sum_i r_i^2 / sigma_i^2 + 1/2 sum_j (theta_j - mean_j)^2 / std_j^2,     r = measured - predicted

by Levenberg-Marquardt (Nocedal & Wright, Numerical Optimization, §10.3). A step is accepted only where the cost falls
by a share of the decrease that its linear model predicts.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple, Protocol

import numpy as np

from armdyn.estimation.equations import NormalEquations
from armdyn.estimation.expansion import Expansion
from armdyn.estimation.solve import pseudo_inverses

MAX_STALLED_STEPS = 2
"""Number of steps in a row with hardly any decrease of a gross error, after which a minimisation stops."""
SUFFICIENT_DECREASE = 1e-4
"""Share of the predicted decrease of the cost that a step must reach to be accepted (Armijo's rule)."""
MAX_DAMPING = 1e9
"""Damping above which no step is tried."""
STEP_SHARE_AFTER_FAILURE = 0.25
"""Share of a step of one of many problems that is tried after the whole step has failed."""


class Outcome(Enum):
    """Reason why a minimisation ended; the value is a text for a reader."""

    CONVERGED = "converged: the next step would change no parameter by more than a thousandth of its uncertainty"
    STALLED = "stalled: no step lowers the cost further; the data may not determine all free parameters"
    OUT_OF_STEPS = "not converged within the allowed number of steps: start closer or free fewer parameters"


class Cost(Protocol):
    """A cost that `descend` can minimise: (p,) lower and upper bounds, its value, and its expansion at a point.

    The bounds of the next step are those after an expansion.
    """

    lower: np.ndarray
    upper: np.ndarray

    def value(self, values: np.ndarray, limit: float) -> float:
        """The cost at (p,) values; one above the `limit` may be returned as infinite."""

    def expand(self, values: np.ndarray) -> Expansion:
        """Expand the cost at (p,) values that are kept.

        A robust cost may weight its residuals anew here; its values are comparable until the next expansion.
        """


@dataclass(frozen=True)
class Damping:
    """How the damping of steps, a share of the curvature along each unknown, changes.

    Attributes:
        first: damping of the first step.
        least: damping after a success from a damping up to `negligible`.
        negligible: see `least`.
        after_failure: least damping after a step that failed.
        growth: factor by which it grows with each failure.
        relief: factor by which it falls with each success.
    """

    first: float = 0.0
    least: float = 0.0
    negligible: float = 1e-6
    after_failure: float = 1e-3
    growth: float = 10.0
    relief: float = 10.0

    def failed(self, damping: float) -> float:
        """The damping after a failure."""
        return max(self.growth * damping, self.after_failure)

    def succeeded(self, damping: float) -> float:
        """The damping after a success."""
        return damping / self.relief if damping > self.negligible else self.least


@dataclass(frozen=True)
class DescentSettings:
    """How a descent steps, and when it ends.

    Attributes:
        most_steps: largest number of steps; a descent that needs more has not converged.
        tolerance: it has converged where the next step is shorter than this, in standard deviations of each parameter;
            0 to go on.
        least_gain: it has converged where a step has lowered the cost by less than this. If it is given, the cost is
            not expanded again after the last step.
        most_tries: largest number of steps, each damped more than the one before, that are tried from one point.
        uphill: whether any step is accepted after which the cost is finite. Full Gauss-Newton steps solve an equation
            with a product of two unknowns soon, on a way along which the cost rises; descending steps creep.
        gross_chi2: squared error per sample, over the noise variance, above which an error is gross: derivatives then
            do not lead to a distant minimum.
        damping: how the damping of steps changes.
    """

    most_steps: int = 50
    tolerance: float = 1e-2
    least_gain: float = 0.0
    most_tries: int = 1000
    uphill: bool = False
    gross_chi2: float = np.inf
    damping: Damping = Damping()


class DescentResult(NamedTuple):
    """Result of a minimisation.

    Attributes:
        values: (p,) values.
        expansion: the last expansion of the cost: there, or, where `least_gain` is given, before the last step.
        evaluations: number of evaluations.
        outcome: why it ended.
    """

    values: np.ndarray
    expansion: Expansion
    evaluations: int
    outcome: Outcome


def descend(
    cost: Cost, start: np.ndarray, settings: DescentSettings = DescentSettings(), *, samples: int = 0
) -> DescentResult:
    """Minimise a cost within bounds by Gauss-Newton steps, damped where a step would not lower the cost.

    Args:
        cost: the cost to minimise.
        start: (p,) start values; they are clipped to the bounds.
        settings: how it steps, and when it ends.
        samples: number of samples. If it is given, a minimisation with a gross error ends after `MAX_STALLED_STEPS`
            steps in a row that each lower the cost by less than one sample's share.
    """
    values = np.clip(start, cost.lower, cost.upper)
    at = cost.expand(values)
    evaluations, damping, creeping = 1, settings.damping.first, 0
    for steps_left in reversed(range(settings.most_steps)):
        room = cost.lower - values, cost.upper - values
        if settings.tolerance > 0.0:
            step, size = at.step(*room, 0.0)
            if size < settings.tolerance:
                return DescentResult(values, at, evaluations, Outcome.CONVERGED)
        if damping > 0.0 or settings.tolerance == 0.0:
            step, _ = at.step(*room, damping)
        for _ in range(settings.most_tries):
            trial = np.clip(values + step, cost.lower, cost.upper)
            left = cost.value(trial, at.cost)
            evaluations += 1
            if sufficient_decrease(at, left, trial - values) or (settings.uphill and np.isfinite(left)):
                break
            damping = settings.damping.failed(damping)
            step, _ = at.step(*room, damping)
            # A step that promises less than one of the length `tolerance` is worth no further evaluation.
            if -float(at.gradient @ step) < settings.tolerance**2 or damping > MAX_DAMPING:
                return DescentResult(values, at, evaluations, Outcome.STALLED)
        else:
            return DescentResult(values, at, evaluations, Outcome.STALLED)
        gained, values = at.cost - left, trial
        if abs(gained) < settings.least_gain:
            return DescentResult(values, at, evaluations, Outcome.CONVERGED)
        if steps_left == 0 and settings.least_gain > 0.0:
            break
        gross = 2.0 * left > settings.gross_chi2 * samples > 0.0
        creeping = creeping + 1 if gross and gained < left / samples else 0
        at = cost.expand(values)
        if creeping == MAX_STALLED_STEPS:
            return DescentResult(values, at, evaluations, Outcome.STALLED)
        damping = settings.damping.succeeded(damping)
    return DescentResult(values, at, evaluations, Outcome.OUT_OF_STEPS)


def sufficient_decrease(before: Expansion, left: float, step: np.ndarray) -> bool:
    """Whether the cost fell by at least `SUFFICIENT_DECREASE` of what the gradient predicts (Armijo's rule)."""
    promised = -float(before.gradient @ step)
    return bool(np.isfinite(left) and before.cost - left >= SUFFICIENT_DECREASE * max(promised, 0.0))


class ManyDescents(NamedTuple):
    """Minima of J problems.

    Attributes:
        values: (J, n) values.
        equations: sums there, one unit for each problem.
        linearised_last: whether the last linearisation is that at the values of all problems.
    """

    values: np.ndarray
    equations: NormalEquations
    linearised_last: bool


def descend_each(
    linearise: Callable[[np.ndarray], NormalEquations], start: np.ndarray, most_steps: int
) -> ManyDescents:
    """Minimise the squared errors of many independent problems at once, by Gauss-Newton steps of each.

    A problem keeps its values where a step does not lower its error, and tries a quarter of the step next.

    Args:
        linearise: returns the equations at (J, n) values, one unit for each problem, with the n values first among the
            unknowns; a squared error that is not finite is none that a step may lead to.
        start: (J, n) start values.
        most_steps: number of steps.
    """
    J, n = start.shape
    values, sums = start, linearise(start)
    step, better = _best_steps(sums, n), np.ones(J, dtype=bool)
    for _ in range(most_steps):
        after = linearise(values + step)
        better = after.square < sums.square
        values = np.where(better[:, None], values + step, values)
        sums = NormalEquations.stacked([sums, after]).only(np.arange(J) + J * better)
        step = np.where(better[:, None], _best_steps(after, n), STEP_SHARE_AFTER_FAILURE * step)
    return ManyDescents(values, sums, bool(better.all()))


def _best_steps(sums: NormalEquations, n: int) -> np.ndarray:
    """(J, n) steps to the best values of each problem, by its linearisation."""
    return np.asarray((pseudo_inverses(sums.gram[:, :n, :n]) @ sums.slope[:, :n, None])[:, :, 0])
