"""The background of an arm: small values of every effect on every joint, with one common prior width.

A model that predicts well contains more than the few effects that a report names. In addition to these, every effect of
the catalogue on every joint has parameters x, in typical sizes, with a prior x ~ N(0, s^2). The common width s is
chosen by predicting whole runs: every training run from the others, each fifth of a single one from the rest, and the
held-out runs from all training runs (ridge regression with the penalty chosen by cross-validation; Hoerl & Kennard,
Technometrics 12, 1970). Effects with strong evidence ("sure" effects) have no such prior.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import log

import numpy as np

from armdyn.identify.fit import Fit, fit
from armdyn.identify.linear_study import LinearStudy
from armdyn.identify.problem import Problem, transfer_values
from armdyn.identify.selection.candidate import Candidate
from armdyn.identify.selection.linear_scorer import LinearScorer
from armdyn.identify.selection.path import SearchStep
from armdyn.identify.selection.select_effects import evidence_rule, search_set
from armdyn.identify.selection.set_score import EffectSetScore
from armdyn.run import Run

PRIOR_STDS_TRIED_TYPICAL_SIZES = (0.0, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
"""Prior widths that are tried for the small values, in typical sizes."""
BACKGROUND_PRICE_NATS = log(len(PRIOR_STDS_TRIED_TYPICAL_SIZES))
"""Gain of log likelihood, nats, that a background needs, because its width is chosen among several."""
MAX_SUCCESSIVE_LINEARISATIONS = 5
"""Largest number of linearisations, each at the optimum of the one before; two or three suffice nearly always."""
MAX_BACKGROUND_STEPS = 8
"""Largest number of Gauss-Newton steps of the nonlinear model, from the solution of the linearised one."""


@dataclass(frozen=True, eq=False)
class AllEffectsFit:
    """Fit of a model with all effects of the catalogue at once.

    Effects with strong evidence are fitted freely; the values of all others have a prior with one common width.

    Attributes:
        study: runs and catalogue.
        scorer: scorer of sets of effects, linearised at the previous fit.
        strong_effects: the set of effects with strong evidence.
        prior_width: common prior width, in typical sizes; 0 where the other effects are left out.
        prior_widths: (c,) prior widths of the scorer's unknowns.
        fit: fit of all values together.
        covariance: (P, P) covariance of all unknowns of the study.
    """

    study: LinearStudy
    scorer: LinearScorer
    strong_effects: EffectSetScore
    prior_width: float
    prior_widths: np.ndarray
    fit: Fit
    covariance: np.ndarray


@dataclass(frozen=True)
class BackgroundFit:
    """Small values of many effects that reports do not name, fitted together with the named effects.

    Attributes:
        prior_width: width of their prior, in typical sizes; see `AllEffectsFit`.
        values: the small values by parameter name, in the parameter's unit.
        fit: fit of named effects and small values together.
        covariance: (P, P) covariance of all unknowns of the study.
        leave_one_out_predictions: predictions of every training run by a fit to the others; empty for a single run.
    """

    prior_width: float
    values: dict[str, float]
    fit: Fit
    covariance: np.ndarray
    leave_one_out_predictions: tuple[Fit, ...]


def fit_all_effects(
    study: LinearStudy, effects: Sequence[Candidate], near: Fit, say: Callable[[str], None]
) -> AllEffectsFit:
    """Fit all effects of the catalogue at once, linearised again at every fit until the residual stops falling.

    Args:
        study: runs and catalogue.
        effects: effects from which the search for effects with strong evidence starts.
        near: the fit at which the model is linearised first.
        say: called with a text on the progress of the search.
    """
    best: AllEffectsFit | None = None
    for _ in range(MAX_SUCCESSIVE_LINEARISATIONS):
        scorer = study.scorer(near)
        sure = search_set(scorer, evidence_rule(scorer), scorer.evaluate(scorer.split_into_candidates(effects)), say)
        by_width = {
            s: scorer.prediction_log_likelihood(scorer.prior_widths(sure.effects, s))
            - BACKGROUND_PRICE_NATS * (s > 0.0)
            for s in PRIOR_STDS_TRIED_TYPICAL_SIZES
        }
        width = max(by_width, key=by_width.__getitem__)
        widths = scorer.prior_widths(sure.effects, width)
        say(f"fitting {np.count_nonzero(widths)} values")
        found = AllEffectsFit(study, scorer, sure, width, widths, *_fitted(study, scorer, widths))
        # Sums predict little of a model that is far from linear.
        if best is not None and study.squared_error(found.fit) >= study.squared_error(best.fit):
            break
        known, best = scorer.split_into_candidates(effects), found
        if width == 0.0 and set(known) == set(sure.effects):
            break
        effects, near = sure.effects, found.fit
    assert best is not None
    return best


def find_background(full: AllEffectsFit, named_step: SearchStep) -> BackgroundFit | None:
    """Find the small values to add to a model with named effects.

    Args:
        full: fit of all effects at once.
        named_step: step of the search with the named effects alone.

    Returns:
        The small values; None where they do not improve the prediction of other runs.
    """
    study, scorer, before = full.study, full.scorer, full.study.scorer(named_step.fit)
    named = before.split_into_candidates(named_step.effects)
    unnamed = before.prediction_errors(before.prior_widths(named, 0.0))
    gained = scorer.prediction_log_likelihood(full.prior_widths) - scorer.log_likelihood(unnamed)
    if gained < BACKGROUND_PRICE_NATS or study.squared_error(full.fit) >= study.squared_error(named_step.fit):
        return None
    problem, names = study.problem, [n for c in scorer.candidates if c not in named for n in c.names]
    own = np.flatnonzero(problem.mask_of_unknowns(names) & (full.fit.values != problem.null))
    if len(own) == 0:
        return None
    values = {problem.columns[i].name: float(full.fit.values[i]) for i in own}
    in_turn = tuple(_in_turn(study, scorer, full.prior_widths))
    return BackgroundFit(full.prior_width, values, full.fit, full.covariance, in_turn)


def _fitted(study: LinearStudy, scorer: LinearScorer, widths: np.ndarray) -> tuple[Fit, np.ndarray]:
    """Named and small values with (c,) prior widths, at the minimum of the whole model, and their (P, P) covariance."""
    found, given = _with_priors(study, scorer, widths, study.runs, scorer.training), study.problem
    free = found.free
    at = Fit(given, free, found.values, tuple(given.blocks(found.values, free)), found.outcome)
    covariance, own = np.zeros((len(free), len(free))), np.flatnonzero(free)
    information = found.problem.expansion(found.values, free).hessian
    scale = np.sqrt(np.diag(information))
    covariance[np.ix_(own, own)] = np.linalg.inv(information / np.outer(scale, scale)) / np.outer(scale, scale)
    return at, covariance


def _in_turn(study: LinearStudy, scorer: LinearScorer, widths: np.ndarray) -> Iterator[Fit]:
    """Every training run, predicted by a fit to the others; see `BackgroundFit.leave_one_out_predictions`."""
    for run, others in scorer.leave_one_out():
        rest = _with_priors(study, scorer, widths, [r for i, r in enumerate(study.runs) if i != run], others)
        alone = Problem(study.problem.model, [study.runs[run]], study.noise)
        free = np.zeros(len(alone.columns), dtype=bool)
        values = transfer_values(rest.values, rest.problem, alone)
        yield Fit(alone, free, values, tuple(alone.blocks(values, free)), rest.outcome)


def _with_priors(
    study: LinearStudy, scorer: LinearScorer, widths: np.ndarray, runs: Sequence[Run], units: np.ndarray
) -> Fit:
    """Fit the whole model to runs, whose units in the sums are (u,), with (c,) prior widths of its values.

    The steps start at the minimum of the expansion, where a link may not yet be a physical body.
    """
    sums, moving = scorer.sums, widths > 0.0
    columns = scorer.columns[moving]
    start = scorer.changed_values(scorer.best_change(widths, units))
    width = np.zeros(len(start))
    width[columns] = widths[moving] * scorer.typical[moving]
    problem = Problem(study.problem.model, runs, {**study.problem.noise, **scorer.effective_noise})
    width = transfer_values(width, sums.problem, problem, missing=0.0)
    free = width > 0.0
    unknown = free & (problem.prior_weight == 0.0)
    problem.prior_weight[unknown], problem.prior_mean[unknown] = 1.0 / width[unknown], problem.null[unknown]
    return fit(problem, free, transfer_values(start, sums.problem, problem), most_steps=MAX_BACKGROUND_STEPS)
