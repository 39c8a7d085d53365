"""How well a fitted model predicts whole runs that took no part in the fit."""

from collections.abc import Iterator, Sequence

import numpy as np

from armdyn.identify.first_fit import start_of
from armdyn.identify.fit import Fit, determined, fit
from armdyn.identify.problem import Block, Problem
from armdyn.run import Run


def held_out_blocks(found: Fit, held_out: Sequence[Run]) -> list[Block] | None:
    """Residuals of held-out runs; where none are given, of every training run predicted from the others.

    Only what belongs to a single run, such as how the load swung at its start, is fitted to a held-out run.

    Returns:
        None when there is a single run and so nothing to hold out.
    """
    runs = found.problem.runs
    if held_out:
        return [block for run in held_out for block in _predicted(found, found.values, run)]
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


def chi2_of(blocks: Sequence[Block]) -> float:
    """Sum of squared residuals over the noise."""
    return float(sum(block.residual @ block.residual for block in blocks))


def _predicted(found: Fit, values: np.ndarray, run: Run, whole: Fit | None = None) -> tuple[Block, ...]:
    """Residuals of one run; where it was part of the fit `whole`, its own unknowns start from there."""
    alone = Problem(found.problem.model, [run], found.problem.noise)
    free, start = _transferred(found, values, alone)
    own = alone.per_run | _stated_apart(found.problem, alone)
    free = free & own
    if not free.any():
        return tuple(alone.blocks(start, free))
    if whole is not None:
        start = np.where(own, _transferred(whole, whole.values, alone)[1], start)
    else:
        start = start_of(alone, start, free)
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
