"""Runs that no fit has seen: how well a model predicts held-out runs and exam runs.

Held-out runs help to choose which effects are added, so their error flatters the model a little. An exam run is used
for nothing else: no fit, no noise estimate, no name and no choice depends on it. Exam runs are evaluated only at the
end.
"""

from collections.abc import Iterator, Sequence
from copy import copy
from enum import Enum
from math import sqrt

import numpy as np

from armdyn.identify.fit import Fit, determined, fit
from armdyn.identify.problem import Block, Problem, transferred, transferred_mask
from armdyn.identify.state_space.motion_start import start_of
from armdyn.identify.state_space.output_error import best_minimum, fit_run, shows_motion
from armdyn.physics.simulated import SimulatedModel
from armdyn.run import Run

MAX_ERROR_INCREASE = 0.02
"""Relative increase of a predicted run's total error that an effect may cause."""

Starts = tuple[Problem, Iterator[np.ndarray]]
"""A problem that contains the runs, and (P,) candidate start values, the likeliest first; iterate over a copy."""


def predictions(found: Fit, held_out: Sequence[Run], starts: Starts | None = None) -> list[Fit]:
    """Predict every run of `held_out` with a fit that has not seen it.

    Only unknowns of a single run, such as the swing at its start, are fitted to a held-out run.

    Args:
        found: the fit to the training runs.
        held_out: runs that were not fitted.
        starts: start values of the held-out runs, where they are known.
    """
    return [_predicted(found, run, starts=starts) for run in held_out]


def predictions_in_turn(found: Fit) -> list[Fit]:
    """Predict every training run by a fit to the other training runs; an empty list for a single run."""
    return [_predicted(rest, run, found) for run, rest in _without_each(found)] if found.problem.runs[1:] else []


def blocks_of(fits: Sequence[Fit]) -> list[Block]:
    """Residual blocks of several fits."""
    return [block for one in fits for block in one.blocks]


def _without_each(found: Fit) -> Iterator[tuple[Run, Fit]]:
    """Every run, with the fit to the other runs."""
    problem = found.problem
    for left_out in problem.runs:
        rest = [r for r in problem.runs if r is not left_out]
        others = Problem(problem.model, rest, problem.noise).with_wide_priors(sqrt(found.chi2_per_sample))
        start = transferred(found.values, problem, others)
        free = determined(others, transferred_mask(found.free, problem, others), start)
        yield left_out, fit(others, free, start, most_steps=8, tolerance=0.1)


def _predicted(found: Fit, run: Run, whole: Fit | None = None, starts: Starts | None = None) -> Fit:
    """Predict one run, its own unknowns fitted; where it was part of the fit `whole`, they start from there."""
    source = found.problem
    alone = Problem(source.model, [run], source.noise)
    apart = _stated_apart(source, alone)
    start, own = np.where(apart, alone.start(), transferred(found.values, source, alone)), alone.per_run | apart
    fitted = {column.parameter.name for column, fits in zip(source.columns, found.free, strict=True) if fits}
    free = own & np.array([column.parameter.name in fitted for column in alone.columns], dtype=bool)
    if not free.any():
        return Fit(alone, free, start, tuple(alone.blocks(start, free)), found.outcome)
    if whole is not None:
        start = np.where(own, transferred(whole.values, whole.problem, alone), start)
    elif starts is not None:
        each = (np.where(own, transferred(v, starts[0], alone), start) for v in copy(starts[1]))
        return best_minimum(alone, free, each)
    elif isinstance(alone.model, SimulatedModel):
        return fit_run(alone, start if shows_motion(alone) else start_of(alone, start, free), free)
    return fit(alone, free, start)


def _stated_apart(problem: Problem, alone: Problem) -> np.ndarray:
    """(P,) bool: unknowns of `alone` whose stated value in its run differs from that of the other runs.

    A load of another mass keeps the mass that was weighed, not the mass of the fitted runs.
    """
    (run,) = alone.runs
    others = {(name, known) for other in problem.runs for name, known in other.known.items()}
    apart = {name for name, known in run.known.items() for n, other in others if n == name and other != known}
    return np.array([column.parameter.name in apart for column in alone.columns], dtype=bool)


class HoldoutKind(Enum):
    """Kind of the runs on which an error was measured; the value says how the runs were used."""

    EXAM = "exam: runs that took part in nothing, neither in a fit nor in choosing"
    HELD_OUT = "held out: runs that took part in choosing the effects, and in no fit"
    IN_TURN = "held out: each run predicted from the others; these errors took part in choosing the effects"
    TRAINING = "a single run: nothing was held out"
