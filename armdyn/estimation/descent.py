r"""Nonlinear least squares with priors and bounds on any model.

    J(theta) = 1/2 sum_i r_i^2 / sigma_i^2 + 1/2 sum_j (theta_j - mean_j)^2 / std_j^2,     r = measured - predicted

by Levenberg-Marquardt (Nocedal & Wright, Numerical Optimization, §10.3). A step is accepted only where the cost falls
by a share of the decrease that its linear model predicts.
"""

from enum import Enum
from typing import NamedTuple, Protocol

import numpy as np

GROSS_ERROR_TO_NOISE_VARIANCE = 20.0
"""Squared error per sample, over the noise variance, above which an error is gross: derivatives then do not lead to a
distant minimum."""
MAX_STALLED_STEPS = 2
"""Number of steps in a row with hardly any decrease of a gross error, after which a minimisation stops."""
SUFFICIENT_DECREASE = 1e-4
"""Share of the predicted decrease of the cost that a step must reach to be accepted (Armijo's rule)."""


class QuadraticExpansion(NamedTuple):
    """Quadratic expansion of the cost J at a point.

    Attributes:
        cost: J at the point.
        gradient: (p,) first derivatives of J.
        hessian: (p, p) Gauss-Newton approximation, positive semidefinite.
    """

    cost: float
    gradient: np.ndarray
    hessian: np.ndarray


class Outcome(Enum):
    """Reason why a minimisation ended; the value is a text for a reader."""

    CONVERGED = "converged: the next step would change no parameter by more than a thousandth of its uncertainty"
    STALLED = "stalled: no step lowers the cost further; the data may not determine all free parameters"
    OUT_OF_STEPS = "not converged within the allowed number of steps: start closer or free fewer parameters"


class Cost(Protocol):
    """A cost that `descend` can minimise: (p,) lower and upper bounds, and a method that expands it at a point."""

    lower: np.ndarray
    upper: np.ndarray

    def evaluate(self, values: np.ndarray, limit: float = np.inf) -> QuadraticExpansion:
        """Evaluate the cost, its gradient and its Gauss-Newton Hessian at (p,) values.

        Args:
            values: (p,) values.
            limit: a cost above it may be returned as infinite, with any gradient and Hessian.
        """


class DescentResult(NamedTuple):
    """Result of a minimisation: (p,) values, the cost's expansion there, the number of evaluations, why it ended."""

    values: np.ndarray
    expansion: QuadraticExpansion
    evaluations: int
    outcome: Outcome


def descend(
    problem: Cost, start: np.ndarray, *, most_steps: int = 50, tolerance: float = 1e-2, samples: int = 0
) -> DescentResult:
    """Minimise a cost within bounds by Gauss-Newton steps, damped where a step would not lower the cost.

    Args:
        problem: the cost to minimise.
        start: (p,) start values; they are clipped to the bounds.
        most_steps: largest number of steps; a descent that needs more has not converged.
        tolerance: a descent has converged where the next step is shorter than this, in standard deviations of each
            parameter.
        samples: number of samples. If it is given, a minimisation with a gross error ends after `MAX_STALLED_STEPS`
            steps in a row that each lower the cost by less than one sample's share.
    """
    values = np.clip(start, problem.lower, problem.upper)
    at = problem.evaluate(values)
    evaluations, damping, outcome, creeping = 1, 0.0, Outcome.OUT_OF_STEPS, 0
    for _ in range(most_steps):
        free = not_held_by_bound(problem, values, at.gradient)
        step, size = newton_step(at, free, 0.0)
        if size < tolerance:
            outcome = Outcome.CONVERGED
            break
        if damping > 0:
            step, _ = newton_step(at, free, damping)
        while True:
            trial = np.clip(values + step, problem.lower, problem.upper)
            after = problem.evaluate(trial, at.cost)
            evaluations += 1
            if sufficient_decrease(at, after, trial - values):
                break
            damping = max(10.0 * damping, 1e-3)
            step, _ = newton_step(at, free, damping)
            # A step that promises less than one of the length `tolerance` is worth no further evaluation.
            if -float(at.gradient @ step) < tolerance**2 or damping > 1e9:
                return DescentResult(values, at, evaluations, Outcome.STALLED)
        gross = 2.0 * after.cost > GROSS_ERROR_TO_NOISE_VARIANCE * samples > 0.0
        creeping = creeping + 1 if gross and at.cost - after.cost < after.cost / samples else 0
        values, at = trial, after
        if creeping == MAX_STALLED_STEPS:
            outcome = Outcome.STALLED
            break
        damping = damping / 10 if damping > 1e-6 else 0.0
    return DescentResult(values, at, evaluations, outcome)


def not_held_by_bound(problem: Cost, values: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """(p,) bool: False for a parameter on a bound beyond which the cost would fall further."""
    below = (values <= problem.lower) & (gradient > 0)
    above = (values >= problem.upper) & (gradient < 0)
    return ~(below | above)


def sufficient_decrease(before: QuadraticExpansion, after: QuadraticExpansion, step: np.ndarray) -> bool:
    """Whether the cost fell by at least `SUFFICIENT_DECREASE` of what the gradient predicts (Armijo's rule)."""
    promised = -float(before.gradient @ step)
    return bool(np.isfinite(after.cost) and before.cost - after.cost >= SUFFICIENT_DECREASE * max(promised, 0.0))


@np.errstate(all="ignore")  # near a divergence the curvature overflows, and the step is not a descent step
def newton_step(at: QuadraticExpansion, free: np.ndarray, damping: float) -> tuple[np.ndarray, float]:
    """(p,) damped Gauss-Newton step of the `free` values, and its length in standard deviations, sqrt(step' H step)."""
    step = np.zeros(len(at.gradient))
    free = free & (np.diag(at.hessian) > 0.0)  # a value without effect stays: its step would be 0/0
    if not free.any():
        return step, 0.0
    matrix = at.hessian[np.ix_(free, free)]
    scale = np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    scaled = matrix / np.outer(scale, scale) + damping * np.eye(len(scale))
    reduced = -at.gradient[free] / scale
    try:
        solution = np.linalg.solve(scaled, reduced)
    except np.linalg.LinAlgError:
        solution = np.linalg.lstsq(scaled, reduced, rcond=1e-12)[0]
    step[free] = solution / scale
    return step, float(np.sqrt(max(step @ at.hessian @ step, 0.0)))
