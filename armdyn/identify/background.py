"""What is small in an arm: values of every effect on every joint, each held near nothing by one width.

A model that is to predict holds more than what has a name. Beside the named effects every effect of the catalogue on
every joint has a value x, in typical sizes, with a prior x ~ N(0, s^2). One width s for all is chosen by predicting
whole runs: every training run from the others, fifths of a lone one, and the held-out runs from all training runs
(ridge regression, its penalty by cross-validation; Hoerl & Kennard, Technometrics 12, 1970). What the evidence is sure
of is as free as what has a name.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from armdyn.identify.appraisal import SURE
from armdyn.identify.candidate import Candidate
from armdyn.identify.fit import Fit, fit
from armdyn.identify.linear_scorer import LinearScorer
from armdyn.identify.problem import Problem, transferred
from armdyn.identify.select_effects import by_evidence, select
from armdyn.identify.study import Study
from armdyn.run import Run

WIDTHS = (0.0, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
"""Widths that are tried, in typical sizes."""
ROUNDS = 5
STEPS = 4
"""Gauss-Newton steps of the whole model from the linear solution, at most."""


@dataclass(frozen=True)
class SmallValues:
    """Small values beside the named effects.

    Attributes:
        width: s, in typical sizes; 0 where only what is sure is held.
        values: by parameter, in its unit.
        fit: of named effects and small values together.
        covariance: (P, P) of all unknowns of the study.
        in_turn: every training run with the values that the others give; none where runs are held out, or of one run.
    """

    width: float
    values: dict[str, float]
    fit: Fit
    covariance: np.ndarray
    in_turn: tuple[Fit, ...]


def find_background(
    study: Study, named: Sequence[Candidate], last: Fit, say: Callable[[str], None]
) -> SmallValues | None:
    """The background beside named effects; None where it does not predict other runs better.

    Args:
        study: runs and catalogue.
        named: the effects that have a name.
        last: their fit.
        say: told how far the search is.
    """
    best, at = None, last
    for _ in range(ROUNDS):
        say("choosing what is small")
        scorer = study.scorer(at)
        told = scorer.of(scorer.within(named))
        sure = select(scorer, by_evidence(scorer), told, say).effects
        small = [c for c in scorer.candidates if scorer.makes_up(c) == 1]
        width = max(WIDTHS, key=lambda s: scorer.predicted(scorer.widths(sure, s, small)))
        widths = scorer.widths(sure, width, small)
        if scorer.predicted(widths) < scorer.predicted(scorer.widths(told.effects, 0.0)) + SURE:
            break
        say(f"fitting {np.count_nonzero(widths)} values")
        found, covariance = _fitted(study, scorer, widths)
        print("   round", width, len(sure), study.excess(found), "last", study.excess(last), found.outcome)
        # Sums foretell little of what is far from linear.
        if study.squared_error(found) >= study.squared_error(at):
            break
        best, at = (scorer, told, widths, width, found, covariance), found
    if best is None:
        return None
    scorer, told, widths, width, found, covariance = best
    problem, names = study.problem, [n for c in scorer.candidates if c not in told.effects for n in c.names]
    own = np.flatnonzero(problem.of(names) & (found.values != problem.null))
    values = {problem.columns[i].name: float(found.values[i]) for i in own}
    in_turn = () if study.held_out else tuple(_in_turn(study, scorer, widths))
    return SmallValues(width, values, found, covariance, in_turn)


def _fitted(study: Study, scorer: LinearScorer, widths: np.ndarray) -> tuple[Fit, np.ndarray]:
    """Named and small values, of (c,) `widths`, at the minimum of the whole model, and their (P, P) covariance."""
    found, given = _with_priors(study, scorer, widths, study.runs, scorer.training), study.problem
    free = found.free
    at = Fit(given, free, found.values, tuple(given.blocks(found.values, free)), found.outcome)
    covariance, own = np.zeros((len(free), len(free))), np.flatnonzero(free)
    information = found.problem.expansion(found.values, free).hessian
    scale = np.sqrt(np.diag(information))
    covariance[np.ix_(own, own)] = np.linalg.inv(information / np.outer(scale, scale)) / np.outer(scale, scale)
    return at, covariance


def _in_turn(study: Study, scorer: LinearScorer, widths: np.ndarray) -> Iterator[Fit]:
    """See `SmallValues.in_turn`."""
    for run, others in scorer.without_each():
        rest = _with_priors(study, scorer, widths, [r for i, r in enumerate(study.runs) if i != run], others)
        alone = Problem(study.problem.model, [study.runs[run]], study.noise)
        free = np.zeros(len(alone.columns), dtype=bool)
        values = transferred(rest.values, rest.problem, alone)
        yield Fit(alone, free, values, tuple(alone.blocks(values, free)), rest.outcome)


def _with_priors(study: Study, scorer: LinearScorer, widths: np.ndarray, runs: Sequence[Run], units: np.ndarray) -> Fit:
    """The whole model fitted to runs, whose units in the sums are (u,), with (c,) widths as priors of its values.

    Steps begin at the minimum of the expansion, where links may be no bodies yet.
    """
    sums, moving = scorer.sums, widths > 0.0
    columns = scorer.columns[moving]
    start = scorer.values_after(scorer.solution(widths, units))
    width = np.zeros(len(start))
    width[columns] = widths[moving] * scorer.typical[moving]
    problem = Problem(study.problem.model, runs, {**study.problem.noise, **scorer.levels})
    width = transferred(width, sums.problem, problem, missing=0.0)
    free = width > 0.0
    unknown = free & (problem.prior_weight == 0.0)
    problem.prior_weight[unknown], problem.prior_mean[unknown] = 1.0 / width[unknown], problem.null[unknown]
    return fit(problem, free, transferred(start, sums.problem, problem), most_steps=STEPS)
