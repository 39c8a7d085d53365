"""Predict runs that were not fitted: held-out runs and exam runs.

Held-out runs help to choose which effects are added, so their error is a little too small. Exam runs are used for
nothing but their error: no fit, no noise estimate and no choice depends on them.
"""

from collections.abc import Callable, Iterator, Sequence
from enum import Enum
from math import sqrt

import numpy as np

from armdyn.identify.fit import Fit, fit, identifiable
from armdyn.identify.problem import Problem, transfer_mask, transfer_values
from armdyn.identify.residual.block import ResidualBlock
from armdyn.run import Run

FitRunUnknowns = Callable[[Problem, np.ndarray, np.ndarray, np.ndarray], Fit]
"""Function that fits the unknowns which belong to a single run, such as its start state. Its arguments are the problem
of that run, (P,) start values, a (P,) mask of the run's unknowns, and a (P,) mask of those that are fitted."""


def _descend(alone: Problem, start: np.ndarray, own: np.ndarray, free: np.ndarray) -> Fit:
    del own
    return fit(alone, free, start)


def predict_runs(found: Fit, held_out: Sequence[Run], fit_own: FitRunUnknowns = _descend) -> list[Fit]:
    """Predict held-out runs with the values of a fit to other runs; one `Fit` for each.

    Args:
        found: the fit to the other runs.
        held_out: the runs to predict.
        fit_own: function that fits those unknowns that belong to a run alone, such as its start state.
    """
    return [_predicted(found, run, fit_own) for run in held_out]


def leave_one_out_predictions(found: Fit) -> list[Fit]:
    """Predict every training run by a fit to the other training runs (leave one out); empty for a single run."""
    if len(found.problem.runs) == 1:
        return []

    def fit_own(alone: Problem, start: np.ndarray, own: np.ndarray, free: np.ndarray) -> Fit:
        return fit(alone, free, np.where(own, transfer_values(found.values, found.problem, alone), start))

    return [_predicted(rest, run, fit_own) for run, rest in _without_each(found)]


def joined_residual_blocks(fits: Sequence[Fit]) -> list[ResidualBlock]:
    """Residual blocks of several fits in one list."""
    return [block for one in fits for block in one.blocks]


def _without_each(found: Fit) -> Iterator[tuple[Run, Fit]]:
    """Every run, with the fit to the other runs."""
    problem = found.problem
    for left_out in problem.runs:
        rest = [r for r in problem.runs if r is not left_out]
        others, weighted = Problem(problem.model, rest, problem.noise, problem.settings), None
        if found.weighted is not None:
            weighted = found.weighted.of_runs(rest)
        else:
            others = others.with_wide_priors(sqrt(found.chi2_per_sample))
        start, free = transfer_values(found.values, problem, others), transfer_mask(found.free, problem, others)
        if weighted is None:
            free = identifiable(others, free, start)
        yield left_out, fit(others, free, start, most_steps=8, tolerance=0.1, weighted=weighted)


def _predicted(found: Fit, run: Run, fit_own: FitRunUnknowns) -> Fit:
    """Predict one run, its own unknowns fitted."""
    source = found.problem
    alone = Problem(source.model, [run], source.noise, source.settings)
    apart = _stated_apart(source, alone)
    start = np.where(apart, alone.start_values(), transfer_values(found.values, source, alone))
    own = alone.per_run | apart
    fitted = {column.parameter.name for column, fits in zip(source.columns, found.free, strict=True) if fits}
    free = own & np.array([column.parameter.name in fitted for column in alone.columns], dtype=bool)
    if free.any():
        return fit_own(alone, start, own, free)
    return Fit(alone, free, start, tuple(alone.blocks(start, free)), found.outcome)


def _stated_apart(problem: Problem, alone: Problem) -> np.ndarray:
    """(P,) bool: unknowns of `alone` whose stated value in its run differs from that of the other runs.

    A load of another mass keeps the mass that was weighed, not the mass of the fitted runs.
    """
    (run,) = alone.runs
    others = {(name, known) for other in problem.runs for name, known in other.known.items()}
    apart = {name for name, known in run.known.items() for n, other in others if n == name and other != known}
    return np.array([column.parameter.name in apart for column in alone.columns], dtype=bool)


class HoldoutKind(Enum):
    """Kind of the runs on which an error was measured; the value is a text on how these runs were used."""

    EXAM = "exam: runs that were neither fitted nor used to choose the effects"
    HELD_OUT = "held out: runs that helped to choose the effects, and were not fitted"
    LEAVE_ONE_OUT = "held out: each run predicted from the others; these errors helped to choose the effects"
    TRAINING = "a single run: nothing was held out"
