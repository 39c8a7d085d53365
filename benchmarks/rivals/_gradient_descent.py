"""The paper's gradient descent with backtracking, as a rival of Levenberg-Marquardt."""

import numpy as np

from armdyn.estimation.descent import DescentResult, Outcome, newton_step, not_held_by_bound, sufficient_decrease
from armdyn.identify.problem import CostOfFreeUnknowns


def gradient_descent(
    problem: CostOfFreeUnknowns, start: np.ndarray, *, most_steps: int = 500, tolerance: float = 1e-2
) -> DescentResult:
    """Minimise a cost by steepest descent with backtracking, as in the paper; parameters are scaled by typical size.

    The arguments are those of `descend`.
    """
    values = np.clip(start, problem.lower, problem.upper)
    at = problem.evaluate(values)
    evaluations, length, outcome = 1, 0.0, Outcome.OUT_OF_STEPS
    for _ in range(most_steps):
        free = not_held_by_bound(problem, values, at.gradient)
        if newton_step(at, free, 0.0)[1] < tolerance:
            outcome = Outcome.CONVERGED
            break
        direction = -(problem.typical**2) * at.gradient * free
        # The first step is a tenth of the typical size; later ones start at twice the last accepted length.
        length = 2 * length if length > 0 else 0.1 / float(np.max(np.abs(direction / problem.typical)))
        while True:
            trial = np.clip(values + length * direction, problem.lower, problem.upper)
            after = problem.evaluate(trial)
            evaluations += 1
            if sufficient_decrease(at, after, trial - values):
                break
            length /= 2
            if length * float(np.max(np.abs(direction / problem.typical))) < 1e-12:
                return DescentResult(values, at, evaluations, Outcome.STALLED)
        values, at = trial, after
    return DescentResult(values, at, evaluations, outcome)
