"""Choose the effects that a repair of an arm adds: the few most important ones, or all that have strong evidence."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armdyn.identify.fit import continue_fit
from armdyn.identify.linear_study import LinearStudy
from armdyn.identify.selection.background import AllEffectsFit, fit_all_effects
from armdyn.identify.selection.candidate import Candidate
from armdyn.identify.selection.linear_scorer import LinearScorer
from armdyn.identify.selection.path import EffectPath, ProgressCallback, SearchStep
from armdyn.identify.selection.select_effects import eliminate, evidence_rule, search_set, share_rule
from armdyn.identify.selection.set_score import EffectSetScore

RELINEARISED_TILT_TYPICAL_SIZES = 3.0
"""Tilt of an arm's base, in typical sizes (0.3 rad), beyond which the model is linearised again at the tilt."""
MAX_REPORTED_PARAMETER_COUNT_RATIO = 2.0
"""Ratio of the number of parameters of all effects with strong evidence to that of the leading effects, up to which all
are reported."""

SearchRule = Callable[[LinearScorer, EffectSetScore, ProgressCallback], EffectSetScore]
"""Function that continues the search from a set of effects and returns the set to report."""


@dataclass(frozen=True, eq=False)
class LinearPath(EffectPath):
    """A path from the model as given to a set of effects, for a model that is linear in most parameters."""

    study: LinearStudy
    scorer: LinearScorer

    @cached_property
    def scorer_at_end(self) -> LinearScorer:
        """Scorer of sets of effects, linearised at the end of the path."""
        return self.study.scorer(self.fit, self.scorer.given_misfit)


def select_for_arm(
    study: LinearStudy, given: SearchStep, say: ProgressCallback
) -> tuple[LinearScorer, list[SearchStep], AllEffectsFit]:
    """Choose the effects of an arm that a repair reports.

    These are the few leading effects, which remove most of the squared error. All effects with strong evidence ("sure"
    effects) are reported, the leading ones first, if they are few as well, or if they leave only noise, or, for a servo
    arm, if small values of other effects would not predict other runs better: then none of them is one of the small
    errors that every robot description has. Which effects are sure is decided at the fit of all effects at once, which
    is nearer to the truth than a fit of a few.

    Args:
        study: runs and catalogue.
        given: the fit of the model as given.
        say: called with a text on the progress.

    Returns:
        The scorer linearised at the model as given, the steps to the reported effects, and the fit of all effects.
    """
    around = study.scorer(given.fit)
    found = leading = _to_fixed_point(_first(study, given, say), _leading, say)
    full = fit_all_effects(study, leading.effects, leading.fit, say)
    sure = leading
    if set(full.strong_effects.effects) != set(full.scorer.split_into_candidates(leading.effects)):
        sure = _to_fixed_point(LinearPath(study, full.scorer, full.strong_effects, study.present, full.fit), _sure, say)
    if study.squared_error(sure.fit) > study.squared_error(leading.fit):
        sure = _to_fixed_point(leading, _sure, say)  # a set whose own optimum is far from that of all effects
    first: tuple[Candidate, ...] = ()
    # The motion of a servo arm is fitted by what has a name: without a background nothing else would move.
    complete = full.prior_width == 0.0 and "drive" in study.model.stages
    if complete or _is_few(sure.chosen_set, leading) or study.all_residuals_are_noise(sure.fit):
        found = _with_links_looked_at_anew(sure, say)
        first = tuple(c for c in leading.scorer.split_into_candidates(leading.effects) if c in found.chosen_set.effects)
    return around, [given, *found.with_indistinguishable_effects(found.steps(say, first))], full


def _is_few(sure: EffectSetScore, leading: LinearPath) -> bool:
    """Whether sure effects have few values: `MAX_REPORTED_PARAMETER_COUNT_RATIO` times those of the leading ones."""
    lengths = [
        sum(len(c.names) for c in one.effects if c not in leading.scorer.given) for one in (sure, leading.chosen_set)
    ]
    return lengths[0] <= MAX_REPORTED_PARAMETER_COUNT_RATIO * lengths[1]


def _leading(scorer: LinearScorer, now: EffectSetScore, say: ProgressCallback) -> EffectSetScore:
    """Select the effects that remove most of the squared error and are each significant."""
    found = search_set(scorer, share_rule(scorer), now, say)
    return eliminate(scorer, evidence_rule(scorer).cost, found)


def _sure(scorer: LinearScorer, now: EffectSetScore, say: ProgressCallback) -> EffectSetScore:
    """Select all effects of which the evidence is sure."""
    return search_set(scorer, evidence_rule(scorer), now, say)


def _to_fixed_point(found: LinearPath, rule: SearchRule, say: ProgressCallback) -> LinearPath:
    """The path to the set that is chosen at its own optimum: a repair of the repaired model adds nothing.

    A parameter that multiplies others, such as a delay of a spring's torque, is visible only with them present.
    """
    sets, paths = list[frozenset[Candidate]](), list[LinearPath]()
    while True:
        around = found.scorer_at_end
        present = around.evaluate(around.split_into_candidates(found.effects))
        sets.append(frozenset(present.effects))
        paths.append(found)
        again = rule(around, present, say)
        if frozenset(again.effects) in sets:
            return max(paths[sets.index(frozenset(again.effects)) :], key=_worth)
        found = replace(found, scorer=around, chosen_set=again, scorer_fit=found.fit)


def _with_links_looked_at_anew(found: LinearPath, say: ProgressCallback) -> LinearPath:
    """The path to all sure effects, in which each changed link remains preferred to all others when left unchanged.

    From a link that is changed much, other effects with the same influence are not visible, since sums are at its
    optimum.
    """
    model = found.study.problem.model
    for link in [c for c in found.chosen_set.effects if c not in found.scorer.given]:
        if link not in found.chosen_set.effects or not model.changes_link(link.names):
            continue
        without = replace(
            found, chosen_set=found.scorer.evaluate([c for c in found.chosen_set.effects if c is not link])
        )
        around = without.scorer_at_end
        again = _sure(around, around.evaluate(around.split_into_candidates(without.effects)), say)
        if set(again.effects) == set(around.split_into_candidates(found.effects)):
            continue
        other = _to_fixed_point(replace(found, scorer=around, chosen_set=again, scorer_fit=without.fit), _sure, say)
        if _worth(other) > _worth(found):
            found = other
    return found


def _worth(path: LinearPath) -> float:
    return path.scorer_at_end.evaluate(path.scorer_at_end.split_into_candidates(path.effects)).score


def _first(study: LinearStudy, given: SearchStep, say: ProgressCallback) -> LinearPath:
    """The path to the leading effects at the fit as given, or at that of a base that is tilted far."""
    around = study.scorer(given.fit)
    best = LinearPath(study, around, _leading(around, around.evaluate(around.given), say), given.effects, given.fit)
    for candidate in study.candidates:
        if candidate.joints:
            continue
        # It turns the whole arm, and a large angle is not linear.
        say(f"fitting with {candidate.name_in_sentence}")
        fit = continue_fit(
            study.fit_base_with_effects((*study.present, candidate), given.fit, given.fit.values)
        )  # sums are far off
        own = study.problem.mask_of_unknowns(candidate.names)
        angles, typical = fit.values[own] - study.problem.null[own], study.problem.typical[own]
        if np.any(np.abs(angles) > RELINEARISED_TILT_TYPICAL_SIZES * typical):
            turned = study.scorer(fit, around.given_misfit)
            held = turned.evaluate((*turned.given, *turned.split_into_candidates((candidate,))))
            whole = _leading(turned, held, say)
            if turned.leading_effects_cost(whole) < around.leading_effects_cost(best.chosen_set):
                best = LinearPath(study, turned, whole, given.effects, fit)
    return best
