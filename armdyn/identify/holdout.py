"""Runs that no fit has seen: how well a model predicts held-out runs, and exam runs.

Held-out runs take part in choosing which effects are added; their error therefore flatters the model a little. An exam
run takes part in nothing: no fit, no noise, no name and no choice depends on it. Nothing looks at exam runs until the
end, so that nothing was chosen in their favour.
"""

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import replace
from enum import Enum

import numpy as np

from armdyn.identify.fit import Fit, determined, fit
from armdyn.identify.motion_start import start_of
from armdyn.identify.output_error import best_minimum, fit_run, shows_motion
from armdyn.identify.prepare import check_distinct, check_distinct_data, pieces, without_gaps
from armdyn.identify.problem import Block, Problem, transferred
from armdyn.model import Model
from armdyn.physics.simulated import SimulatedModel
from armdyn.run import Run

Starts = tuple[Problem, Iterator[np.ndarray]]
"""A problem that holds the runs, and (P,) values where they may begin, the likeliest first; iterate over a copy."""


def held_out_blocks(found: Fit, held_out: Sequence[Run], starts: Starts | None = None) -> list[Block] | None:
    """Residuals of held-out runs; where none are given, of every training run predicted from the others.

    Only what belongs to a single run, such as how the load swung at its start, is fitted to a held-out run.

    Args:
        found: to the training runs.
        held_out: other runs.
        starts: where the held-out runs begin, where that is known.

    Returns:
        None when there is a single run and so nothing to hold out.
    """
    runs = found.problem.runs
    if held_out:
        return [block for run in held_out for block in _predicted(found, found.values, run, starts=starts)]
    if len(runs) < 2:
        return None
    return [block for run, rest in _without_each(found) for block in _predicted(rest, rest.values, run, found)]


def _without_each(found: Fit) -> Iterator[tuple[Run, Fit]]:
    """Every run with the fit to the others."""
    runs = found.problem.runs
    for left_out in runs:
        others = Problem(found.problem.model, [r for r in runs if r is not left_out], found.problem.noise)
        free, start = _transferred(found, found.values, others)
        free = free & determined(others, free, start)
        rest = others.fit(free, start, most_steps=8, tolerance=0.1)
        yield left_out, Fit(others, free, rest.values, tuple(others.blocks(rest.values, free)), rest.outcome)


def _predicted(
    found: Fit, values: np.ndarray, run: Run, whole: Fit | None = None, starts: Starts | None = None
) -> tuple[Block, ...]:
    """Residuals of one run; where it was part of the fit `whole`, its own unknowns start from there."""
    alone = Problem(found.problem.model, [run], found.problem.noise)
    free, start = _transferred(found, values, alone)
    own = alone.per_run | _stated_apart(found.problem, alone)
    free = free & own
    if not free.any():
        return tuple(alone.blocks(start, free))
    if whole is not None:
        start = np.where(own, _transferred(whole, whole.values, alone)[1], start)
    elif starts is not None:
        each = (np.where(own, transferred(v, starts[0], alone), start) for v in copy(starts[1]))
        return best_minimum(alone, free, each).blocks
    elif isinstance(alone.model, SimulatedModel):
        return fit_run(alone, start if shows_motion(alone) else start_of(alone, start, free), free).blocks
    return fit(alone, free, start).blocks


def _stated_apart(problem: Problem, alone: Problem) -> np.ndarray:
    """(P,) bool: unknowns of `alone` that were measured by hand for its run, with another result than for the others.

    A load of another mass keeps the mass that was weighed, not that of the runs which were fitted.
    """
    (run,) = alone.runs
    others = {(name, known) for other in problem.runs for name, known in other.known.items()}
    apart = {name for name, known in run.known.items() for n, other in others if n == name and other != known}
    return np.array([column.parameter.name in apart for column in alone.columns], dtype=bool)


def _transferred(found: Fit, values: np.ndarray, target: Problem) -> tuple[np.ndarray, np.ndarray]:
    """What is free and where it starts in another problem with the same model."""
    source = found.problem
    place = {source.key(i): i for i in range(len(values))}
    by_parameter = {c.parameter.name: i for i, c in enumerate(source.columns)}
    lone = target.runs[0].name if len(target.runs) == 1 else None
    kept = _stated_apart(source, target) if lone is not None else np.zeros(len(target.columns), dtype=bool)
    free, start = np.zeros(len(target.columns), dtype=bool), target.start()
    for j, column in enumerate(target.columns):
        name = column.parameter.name
        i = place.get((name, lone), None if kept[j] else place.get(target.key(j)))
        if i is not None:
            free[j], start[j] = found.free[i], values[i]
        elif name in by_parameter:  # of a run that was not there: what is its own stays a guess
            free[j] = found.free[by_parameter[name]]
    return free, start


class HoldoutKind(Enum):
    """Runs that an error belongs to; the value says what part they took."""

    EXAM = "exam: runs that took part in nothing, neither in a fit nor in choosing"
    HELD_OUT = "held out: runs that took part in choosing the effects, and in no fit"
    IN_TURN = "held out: each run predicted from the others; these errors took part in choosing the effects"
    TRAINING = "a single run: nothing was held out"


def judges(held_out: Sequence[Run], exam: Sequence[Run], runs: Sequence[Run]) -> tuple[HoldoutKind, ...]:
    """Who judged the model besides the runs that it was fitted to, the most independent first."""
    others = HoldoutKind.HELD_OUT if held_out else HoldoutKind.IN_TURN if len(runs) > 1 else HoldoutKind.TRAINING
    return (HoldoutKind.EXAM, others) if exam else (others,)


def prepared_exam(
    model: Model, runs: Sequence[Run], held_out: Sequence[Run], exam: Sequence[Run], taken: Sequence[Run]
) -> list[Run]:
    """Exam runs, checked and thinned, each under a name of its own.

    Args:
        model: which they will be held against.
        runs: for training, as given.
        held_out: likewise.
        exam: likewise.
        taken: the prepared training and held-out runs, whose names stay as they are and which show the sensors.

    Raises:
        InputError: an exam run is a training or held-out run, or a copy of one, or cannot be used.
    """
    check_distinct({"a training run": runs, "a held-out run": held_out, "an exam run": exam})
    check_distinct_data(model, [*runs, *held_out, *exam])
    names = {run.name for run in taken}
    result: list[Run] = []
    for i, run in enumerate(exam):
        name = run.name if run.name not in names else f"exam/{run.name}"
        name = name if name not in names else f"exam {i + 1}/{run.name}"
        names.add(name)
        result += pieces(model, without_gaps(model, replace(run, name=name)), taken)
    return result
