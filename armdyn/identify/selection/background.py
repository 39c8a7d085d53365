"""What is small in an arm: values of every effect on every joint, each held near nothing by one width.

A model that is to predict holds more than what has a name. Beside the named effects every effect of the catalogue on
every joint has a value x, in typical sizes, with a prior x ~ N(0, s^2). One width s for all is chosen by predicting
whole runs: every training run from the others, fifths of a lone one, and the held-out runs from all training runs
(ridge regression, its penalty by cross-validation; Hoerl & Kennard, Technometrics 12, 1970). What the evidence is sure
of is as free as what has a name.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import log

import numpy as np

from armdyn.identify.fit import Fit, fit
from armdyn.identify.problem import Problem, transferred
from armdyn.identify.selection.candidate import Candidate
from armdyn.identify.selection.linear_scorer import LinearScorer
from armdyn.identify.selection.path import Step
from armdyn.identify.selection.select_effects import by_evidence, select
from armdyn.identify.selection.set_score import SetScore
from armdyn.identify.study import Study
from armdyn.run import Run

WIDTHS = (0.0, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
"""Widths that are tried, in typical sizes."""
PRICE = log(len(WIDTHS))
"""Nats that a background must gain: its width is one of several."""
MOST_ROUNDS = 5
"""Expansions, each around what the last one led to; two or three nearly always."""
STEPS = 8
"""Gauss-Newton steps of the whole model from the linear solution, at most."""


@dataclass(frozen=True, eq=False)
class FullModel:
    """All effects at once: what is sure as free as in any fit, all others held near nothing by one width.

    Attributes:
        scorer: of sets, from sums around the fit before.
        sure: the set that the evidence is sure of.
        width: s, in typical sizes; 0 where only what is sure is held.
        widths: (c,) of the scorer's unknowns.
        fit: of all values together.
        covariance: (P, P) of all unknowns of the study.
    """

    scorer: LinearScorer
    sure: SetScore
    width: float
    widths: np.ndarray
    fit: Fit
    covariance: np.ndarray


@dataclass(frozen=True)
class SmallValues:
    """Small values beside the named effects.

    Attributes:
        width: see `FullModel`.
        values: by parameter, in its unit.
        fit: of named effects and small values together.
        covariance: (P, P) of all unknowns of the study.
        in_turn: every training run with the values that the others give; none of one run.
    """

    width: float
    values: dict[str, float]
    fit: Fit
    covariance: np.ndarray
    in_turn: tuple[Fit, ...]


def fit_full_model(study: Study, effects: Sequence[Candidate], near: Fit, say: Callable[[str], None]) -> FullModel:
    """The full model, expanded anew around every fit of it until it leaves no less.

    Args:
        study: runs and catalogue.
        effects: those from which the search for what is sure sets out.
        near: the fit around which the first sums are.
        say: told how far the search is.
    """
    best: FullModel | None = None
    for _ in range(MOST_ROUNDS):
        scorer = study.scorer(near)
        sure = select(scorer, by_evidence(scorer), scorer.of(scorer.within(effects)), say)
        by_width = {s: scorer.predicted(scorer.widths(sure.effects, s)) - PRICE * (s > 0.0) for s in WIDTHS}
        width = max(by_width, key=by_width.__getitem__)
        widths = scorer.widths(sure.effects, width)
        say(f"fitting {np.count_nonzero(widths)} values")
        found = FullModel(scorer, sure, width, widths, *_fitted(study, scorer, widths))
        # Sums foretell little of what is far from linear.
        if best is not None and study.squared_error(found.fit) >= study.squared_error(best.fit):
            break
        known, best = scorer.within(effects), found
        if width == 0.0 and set(known) == set(sure.effects):
            break
        effects, near = sure.effects, found.fit
    assert best is not None
    return best


def find_background(study: Study, told: Step, full: FullModel) -> SmallValues | None:
    """The background beside named effects; None where it does not predict other runs better."""
    scorer, before = full.scorer, study.scorer(told.fit)
    named = before.within(told.effects)
    unnamed = before.errors_predicted(before.widths(named, 0.0))
    gained = scorer.predicted(full.widths) - scorer.log_likelihood(unnamed)
    if gained < PRICE or study.squared_error(full.fit) >= study.squared_error(told.fit):
        return None
    problem, names = study.problem, [n for c in scorer.candidates if c not in named for n in c.names]
    own = np.flatnonzero(problem.of(names) & (full.fit.values != problem.null))
    if len(own) == 0:
        return None
    values = {problem.columns[i].name: float(full.fit.values[i]) for i in own}
    in_turn = tuple(_in_turn(study, scorer, full.widths))
    return SmallValues(full.width, values, full.fit, full.covariance, in_turn)


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
