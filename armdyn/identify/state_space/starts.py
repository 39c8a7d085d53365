"""Search for start values of a fit, for a model whose given values are only guesses.

A motion simulated in short pieces, each started at the measurement, is nearly linear in all values: the cost has few
minima there, and they lie near the minimum of the whole recording.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from armdyn.identify.fit import first_seconds
from armdyn.identify.problem import Problem, transfer_mask, transfer_values
from armdyn.identify.state_space.grey_box import GreyBox
from armdyn.identify.state_space.noise_evidence import evaluate_all_kicks
from armdyn.physics.simulated import as_simulated_model

TRIED_START_VALUE_COUNT, MAX_RETURNED_OPTIMA = 24, 3
"""Number of start values that are tried, and largest number of different results that are returned."""
MAX_START_TO_MODEL_VALUE_RATIO = 3.0
"""Largest ratio of a tried value to the model's value, or of the model's value to a tried one. Where the model's value
is 0: largest tried value, in typical sizes."""
SHORT_PIECE_SWING_PERIODS = 1.0 / 8.0
"""Length of the short pieces of the motion, in periods of the swing: in half a swing, a stiffness four times too large
is already another oscillation."""
START_SEARCH_SWING_PERIODS = 8.0
"""Length of the first part of every run that is used for the search, in periods of the swing."""
START_OPTIMISATION_ROUNDS = 4
"""Number of rounds in which values are optimised in short pieces."""
STARTS_REACHING_SAME_BEST_OPTIMUM = 3
"""Number of start values that lead to the best optimum so far, after which the search ends."""
SAME_OPTIMUM_RELATIVE_TOLERANCE = 0.05
"""Relative difference up to which two results are the same optimum."""


def likeliest_start_values(problem: Problem, training: int, wanted: np.ndarray, values: np.ndarray) -> list[np.ndarray]:
    """Find (P,) start values for a fit, the likeliest first.

    The list is empty if no value is a guess, or if all simulations diverge.

    Args:
        problem: model and runs; the fitted runs come first.
        training: number of fitted runs.
        wanted: (P,) bool, unknowns that are fitted.
        values: (P,) values of the model.
    """
    model = as_simulated_model(problem.model)
    guessed = wanted & problem.mask_of_unknowns(model.guessed_parameters) & ~problem.per_run
    if not guessed.any():
        return []
    needed = problem.needed_effects(values, wanted)
    runs = [
        first_seconds(run, START_SEARCH_SWING_PERIODS * model.oscillation_period(run, problem.theta(i, values)))
        for i, run in enumerate(problem.runs[:training])
    ]
    # Contacts that need shorter steps than the equations do not matter for a start value.
    quick = model.with_only_effects(needed)
    if model.following.refinement > 1:
        quick = replace(quick, following=replace(model.following, refinement=1))
    cut = Problem(quick, runs, problem.noise, problem.settings)
    free = transfer_mask(wanted, problem, cut)
    ends = list[tuple[float, np.ndarray]]()
    for tried in _spread(problem, guessed, values):
        evidence, end = _settled(cut, free, transfer_values(tried, problem, cut))
        if np.isfinite(evidence):
            ends.append((evidence, transfer_values(end, cut, problem)))
            best = max(ends, key=lambda one: one[0])[1]
            if sum(nearly_equal(end, best, guessed) for _, end in ends) == STARTS_REACHING_SAME_BEST_OPTIMUM:
                break
    told = list[np.ndarray]()
    for _, end in sorted(ends, key=lambda one: -one[0]):
        if len(told) < MAX_RETURNED_OPTIMA and not any(nearly_equal(end, other, guessed) for other in told):
            told.append(end)
    return told


def nearly_equal(one: np.ndarray, other: np.ndarray, where: np.ndarray) -> bool:
    """Whether two vectors (P,) of values are nearly equal for the unknowns `where`, (P,) bool."""
    return bool(np.allclose(one[where], other[where], rtol=SAME_OPTIMUM_RELATIVE_TOLERANCE, atol=0.0))


def _settled(cut: Problem, free: np.ndarray, values: np.ndarray) -> tuple[float, np.ndarray]:
    """Evidence and (P,) values, with the starts of the runs, after optimising in short pieces from (P,) values."""
    box = GreyBox(cut, values, len(cut.runs), np.zeros(len(values), dtype=bool), SHORT_PIECE_SWING_PERIODS)
    with np.errstate(all="ignore"):  # diverging values have no finite evidence
        point = box.optimise(free, box.initial_point(values), (evaluate_all_kicks,) * START_OPTIMISATION_ROUNDS)
    return point.evidence, box.values_with_start_states(point)


def _spread(problem: Problem, guessed: np.ndarray, values: np.ndarray) -> Iterator[np.ndarray]:
    """(P,) values, the given ones first, then an even sequence within their bounds (additive recurrence).

    Its steps are powers of 1/g with g^(k+1) = g + 1 in k dimensions (Roberts, The unreasonable effectiveness of
    quasirandom sequences, 2018).
    """
    places = np.flatnonzero(guessed).tolist()
    ratio = 2.0
    for _ in range(32):
        ratio = (1.0 + ratio) ** (1.0 / (len(places) + 1))
    steps = ratio ** -np.arange(1.0, len(places) + 1)
    yield values
    for k in range(1, TRIED_START_VALUE_COUNT):
        tried = values.copy()
        for j, share in zip(places, (0.5 + k * steps) % 1.0, strict=True):
            tried[j] = _between(problem, j, values[j], share)
        yield tried


def _between(problem: Problem, unknown: int, value: float, share: float) -> float:
    """A value of an unknown between the lowest (share 0) and the highest (share 1) that is tried."""
    lower, upper = problem.lower[unknown], problem.upper[unknown]
    if weight := problem.prior_weight[unknown]:
        mean = problem.prior_mean[unknown]
        lower, upper = max(lower, mean - 2.0 / weight), min(upper, mean + 2.0 / weight)
    typical = problem.typical[unknown]
    ends = (
        np.sort([value / MAX_START_TO_MODEL_VALUE_RATIO, value * MAX_START_TO_MODEL_VALUE_RATIO])
        if value
        else MAX_START_TO_MODEL_VALUE_RATIO * np.array([-typical, typical])
    )
    low, high = np.clip(ends, lower, upper)
    if low * high > 0.0:
        return float(np.sign(value) * abs(low) ** (1.0 - share) * abs(high) ** share)
    return float(low + share * (high - low))
