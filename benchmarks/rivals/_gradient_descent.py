"""The paper's gradient descent with backtracking, as a rival of Levenberg-Marquardt."""

import numpy as np

from armdyn.estimation.descent import DescentResult, DescentSettings, Outcome, sufficient_decrease
from armdyn.estimation.expansion import not_held_by_bound
from armdyn.identify.problem import CostOfFreeUnknowns


def gradient_descent(
    problem: CostOfFreeUnknowns, start: np.ndarray, settings: DescentSettings = DescentSettings(most_steps=500)
) -> DescentResult:
    """Minimise a cost by steepest descent with backtracking, as in the paper; parameters are scaled by typical size.

    The arguments are those of `descend`.
    """
    values = np.clip(start, problem.lower, problem.upper)
    at = problem.expand(values)
    evaluations, length, outcome = 1, 0.0, Outcome.OUT_OF_STEPS
    for _ in range(settings.most_steps):
        room = problem.lower - values, problem.upper - values
        free = not_held_by_bound(*room, at.gradient)
        if at.step(*room, 0.0)[1] < settings.tolerance:
            outcome = Outcome.CONVERGED
            break
        direction = -(problem.typical**2) * at.gradient * free
        # The first step is a tenth of the typical size; later ones start at twice the last accepted length.
        length = 2 * length if length > 0 else 0.1 / float(np.max(np.abs(direction / problem.typical)))
        while True:
            trial = np.clip(values + length * direction, problem.lower, problem.upper)
            left = problem.value(trial, at.cost)
            evaluations += 1
            if sufficient_decrease(at, left, trial - values):
                break
            length /= 2
            if length * float(np.max(np.abs(direction / problem.typical))) < 1e-12:
                return DescentResult(values, at, evaluations, Outcome.STALLED)
        values, at = trial, problem.expand(trial)
    return DescentResult(values, at, evaluations, outcome)
