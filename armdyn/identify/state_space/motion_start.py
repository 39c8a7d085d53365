"""Find the start state of a motion that was not measured: many start states are tried on the first part of each run.

A fit from one guess fails: at angle 0 with the gripper at rest the guess is a saddle point, and the cost of a recording
of ten periods has ten minima. So the start state of each run is searched separately, from many guesses, over the first
part of the run. The guesses that fit about as well as the best are compared over longer and longer parts, until one is
clearly better.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from armdyn.estimation.solve import least_squares
from armdyn.identify.fit import first_seconds, identifiable, run_duration
from armdyn.identify.problem import Problem

FITTED_START_STATES = 8
"""Number of start states, those with the least cost, from which a fit starts on the first part of a run."""
MAX_FOLLOWED_START_STATES = 4
"""Largest number of start states that are compared over longer parts of a run."""
RIVAL_COST_RATIO = 2.0
"""Ratio of the cost of a start state to that of the best, multiplied over all parts so far, up to which both are kept.
The cost of a wrong one grows many times as the part grows."""
STRETCH_GROWTH = 2.0
"""Ratio of the length of a part of a run to that of the part before."""


def find_start_states(problem: Problem, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the start state of every run, for a model that simulates a motion which was not measured.

    Args:
        problem: model, runs and noise.
        values: (P,) start values.

    Returns:
        (P,) values with the start states found, and (P,) values in which the parameters shared by all runs are fitted
        to the first parts of the runs as well.
    """
    begin, shared = values.copy(), []
    for i, run in enumerate(problem.runs):
        single = Problem(problem.model, [run], problem.noise, problem.settings)
        places = problem.unknowns_of_run(i)[[c.index for c in single.columns]]
        found = find_start_state(single, values[places], single.fitted)
        own = problem.per_run[places]
        begin[places[own]] = found[own]
        row = values.copy()
        row[places] = found
        shared.append(row)
    return begin, np.where(problem.per_run, begin, np.median(shared, axis=0))


def find_start_state(single: Problem, values: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Fit the first part of a single run, with a global search for its start state; return (P,) values.

    Args:
        single: problem of one run.
        values: (P,) start values.
        free: (P,) bool, unknowns that may change.
    """
    (run,), model = single.runs, single.model
    theta = single.theta(0, values)
    guesses = model.possible_start_states(run, theta)
    if not guesses:
        return values
    moved = free & single.mask_of_unknowns(list(guesses[0]))
    window, end = model.start_state_window_seconds(theta), run_duration(run)
    cut = _cut(single, window)
    own = _descended(cut, free, window, values)
    near_noise = 2.0 * _cost(cut, own) < cut.settings.noise.minimum_chi2 * cut.samples
    if near_noise and np.array_equal(identifiable(cut, moved, own), moved):
        return own
    rows = [values, *(_with(single, values, guess, moved) for guess in guesses)]
    shared = free_in_window(single, free, window) & ~moved
    promised = [_promised_cost(cut, shared, row) for row in rows]
    order = sorted(range(len(rows)), key=lambda i: float(f"{promised[i]:.5g}"))  # mirror images keep their order
    found = [_descended(cut, free, window, rows[i]) for i in order[:FITTED_START_STATES]]
    rivals = _best(single, [_Rival(values, values, _log_cost(cut, values)) for values in found])
    while len(rivals) > 1 and window < end:
        window *= STRETCH_GROWTH
        cut = _cut(single, window)
        now = [_descended(cut, free, window, rival.now) for rival in rivals]
        rivals = [
            _Rival(rival.initial_values, values, rival.cost + _log_cost(cut, values))
            for rival, values in zip(rivals, now, strict=True)
        ]
        rivals = _best(single, rivals)
    return rivals[0].initial_values


def _descended(cut: Problem, free: np.ndarray, window: float, values: np.ndarray) -> np.ndarray:
    """(P,) values after a few steps on a stretch of `window` s; effects are fitted where it determines them."""
    held, first = cut.with_weak_priors(values), free_in_window(cut, free, window)
    found = held.fit(first, values, most_steps=8)
    if not np.array_equal(first, free) and 2.0 * found.expansion.cost >= cut.settings.noise.minimum_chi2 * cut.samples:
        # Friction that takes half of the first swing's energy must be fitted; else the start of the swing is wrong
        # instead.
        other = held.fit(free, values, most_steps=8)
        found = other if other.expansion.cost < found.expansion.cost else found
    return found.values


def free_in_window(problem: Problem, free: np.ndarray, window: float) -> np.ndarray:
    """(P,) bool: unknowns of `free` that can be fitted to `window` s of a run.

    Those of effects that all runs share are left out if the part is too short for them.
    """
    return (
        free
        if window >= problem.model.min_seconds_to_identify_effect
        else free & (problem.per_run | ~problem.is_effect)
    )


@dataclass(frozen=True, eq=False)
class _Rival:
    """One of several start states, with its values after the first stretch, its present values, and its cost so far.

    Attributes:
        initial_values: (P,) values after the first stretch.
        now: (P,) present values.
        cost: sum over the stretches of the logarithm of the cost.
    """

    initial_values: np.ndarray
    now: np.ndarray
    cost: float


def _cut(problem: Problem, window: float) -> Problem:
    """A problem with the first part of every run."""
    return Problem(problem.model, [first_seconds(run, window) for run in problem.runs], problem.noise, problem.settings)


def _with(single: Problem, values: np.ndarray, guess: Mapping[str, float], moved: np.ndarray) -> np.ndarray:
    row = [guess.get(column.parameter.name, value) for column, value in zip(single.columns, values, strict=True)]
    return np.where(moved, np.clip(row, single.lower, single.upper), values)


def _promised_cost(cut: Problem, free: np.ndarray, values: np.ndarray) -> float:
    """Cost of a start state after the shared values are optimised for it: a wrong mass must not choose the swing."""
    with np.errstate(all="ignore"):
        at = cut.with_weak_priors(values).expansion(values, free)
    if not np.isfinite(at.cost):
        return np.inf
    return at.cost - 0.5 * float(at.gradient @ least_squares(at.hessian, at.gradient, 1e-12))


def _cost(cut: Problem, values: np.ndarray) -> float:
    return cut.expansion(values, np.zeros(len(values), dtype=bool)).cost


def _log_cost(cut: Problem, values: np.ndarray) -> float:
    return float(np.log(_cost(cut, values)))


def _best(single: Problem, rivals: Sequence[_Rival]) -> list[_Rival]:
    """The best start state and those that may still win; of two that predict the same for the whole run, the first.

    With the gripper at rest, a swing and its mirror image give the same tension.
    """
    order = sorted(rivals, key=lambda rival: round(rival.cost, 4))
    kept: list[_Rival] = []
    for rival in order:
        if len(kept) == MAX_FOLLOWED_START_STATES or rival.cost > order[0].cost + np.log(RIVAL_COST_RATIO):
            break
        if not any(_same(single, rival.now, other.now) for other in kept):
            kept.append(rival)
    return kept


def _same(single: Problem, one: np.ndarray, other: np.ndarray) -> bool:
    if np.all(np.abs(one - other) < 0.1 * single.typical):
        return True
    nothing = np.zeros(len(one), dtype=bool)
    pairs = zip(single.blocks(one, nothing), single.blocks(other, nothing), strict=True)
    return all(np.allclose(a.residual, b.residual, rtol=0, atol=1e-3) for a, b in pairs)
