"""Choose the effects of an arm: those of which the recordings are sure, and a background of small values of others."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armdyn.estimation.posterior import wald_distance
from armdyn.identify.fit import Fit, channel_rmse, continue_fit, fit
from armdyn.identify.linear_study import LinearStudy
from armdyn.identify.selection.background import background_widths, sure_unnamed_effects
from armdyn.identify.selection.candidate import Candidate
from armdyn.identify.selection.linear_scorer import LinearScorer
from armdyn.identify.selection.path import EffectPath, ProgressCallback, SearchStep
from armdyn.identify.selection.select_effects import SCORED_CHANGES_PER_KIND, larger_sets, search_set
from armdyn.identify.selection.set_score import EffectSetScore
from armdyn.identify.uncertainty import uncertainty

MAX_SUCCESSIVE_LINEARISATIONS = 5
"""Largest number of linearisations, each at the fit of the set that the one before chose; two or three suffice nearly
always."""

FITTED_REPLACEMENTS = 2
"""Number of effects, those with the largest predicted score, that are fitted in place of a load or a link's inertia."""


@dataclass(frozen=True, eq=False)
class LinearPath(EffectPath):
    """A path from the model as given to a set of effects, for a model that is linear in most parameters.

    Attributes:
        known_fit: the fit of the set, where it has been made already.
    """

    study: LinearStudy
    scorer: LinearScorer
    known_fit: Fit | None = None

    @cached_property
    def fit(self) -> Fit:
        """The fit after the last step."""
        if self.known_fit is not None:
            return self.known_fit
        return continue_fit(self.first_fit, self.study.tolerance)

    @cached_property
    def first_fit(self) -> Fit:
        """The first few steps of the fit, which tell whether it is worth its time."""
        return self._fitted(self.effects, self.chosen_set) if self.known_fit is None else self.known_fit

    def relinearised(self) -> "LinearPath":
        """The same set, with a scorer that is linearised at its fit."""
        if self.scorer_fit is self.fit:
            return self
        around = self.study.scorer(self.fit)
        chosen = around.evaluate(around.split_into_candidates(self.effects))
        return replace(self, scorer=around, chosen_set=chosen, scorer_fit=self.fit, known_fit=self.fit)

    def with_set(self, chosen: EffectSetScore) -> "LinearPath":
        """A path to another set of the scorer."""
        return replace(self, chosen_set=chosen, known_fit=None)

    def with_effects(self, effects: Sequence[Candidate]) -> "LinearPath":
        """A path to another set, of the scorer's candidates."""
        return self.with_set(self.scorer.evaluate(effects))


def select_for_arm(
    study: LinearStudy, given: SearchStep, say: ProgressCallback
) -> tuple[LinearScorer, list[SearchStep]]:
    """Choose the effects of an arm that have a name, and fit the model with them and, if it predicts better, with more.

    Effects are named if motions that were not fitted are predicted better with them, each by more nats than the choice
    among so many effects costs; see `LinearScorer`.

    Args:
        study: runs and catalogue.
        given: the fit of the model as given.
        say: called with a text on the progress.

    Returns:
        The scorer linearised at the model as given, and the steps: one for each named effect, the largest first, and a
        last one for the background, where there is one.
    """
    around = study.scorer(given.fit)
    found = _to_fixed_point(_first(study, given, say), say)
    found = without_empty_effects(_with_bodies_looked_at_anew(found, say))
    while unnamed := _sure_unnamed_effects(found):
        other = found.with_effects((*found.chosen_set.effects, *unnamed))
        other = without_empty_effects(_to_fixed_point(other, say))
        if best_path([found, other]) is found:
            break
        found = other
    found = _with_unsure_values_held(found)
    steps = [given, *found.with_indistinguishable_effects(found.steps(say))]
    return around, [*steps, *_background(found, steps[-1], say)]


def _sure_unnamed_effects(found: LinearPath) -> list[Candidate]:
    """Effects of which the runs are sure where the model has the best background, but which have no name."""
    scorer, effects = found.scorer, found.chosen_set.effects
    widths = background_widths(scorer, effects)
    return sure_unnamed_effects(scorer, effects, widths[0]) if widths else []


def _first(study: LinearStudy, given: SearchStep, say: ProgressCallback) -> LinearPath:
    """The best path of those that begin at different fits, as a model that is not linear shows other effects at each.

    These are the model as given, a fit with every effect near its typical size, and one with an effect of the whole arm
    that is large.
    """
    around = study.scorer(given.fit)
    paths = [
        LinearPath(study, around, search_set(around, around.evaluate(around.given), say), given.effects, given.fit)
    ]
    for candidate in study.candidates:
        if candidate.joints:
            continue
        say(f"fitting with {candidate.name_in_sentence}")
        fit = continue_fit(
            study.fit_base_with_effects((*study.present, candidate), given.fit, given.fit.values)
        )  # sums are far off
        own = study.problem.mask_of_unknowns(candidate.names)
        sizes = (fit.values[own] - study.problem.null[own]) / study.problem.typical[own]
        if np.any(np.abs(sizes) > study.settings.search.linear_typical_sizes):
            turned = study.scorer(fit)
            start = turned.evaluate((*turned.given, *turned.split_into_candidates((candidate,))))
            paths.append(LinearPath(study, turned, search_set(turned, start, say), given.effects, fit))
    found = best_path(paths)
    if found.scorer.predicts_to_the_noise(found.chosen_set.effects):
        return found
    say("fitting with every effect")
    wide = around.prior_widths((), 1.0)
    change = around.changed_values(around.best_change(wide, around.training))
    near = study.fit_with_prior_widths(around, wide, study.own(change, around.problem))
    whole = study.scorer(near)
    chosen = search_set(whole, whole.evaluate(whole.given), say)
    return best_path([found, LinearPath(study, whole, chosen, given.effects, near)])


def _to_fixed_point(found: LinearPath, say: ProgressCallback) -> LinearPath:
    """The best path to a set that is chosen again at its own optimum, or of those to sets that choose one another.

    A parameter that multiplies others, such as a delay of a spring's torque, is visible only with them present.
    """
    best, seen = found, {frozenset(found.effects)}
    for _ in range(MAX_SUCCESSIVE_LINEARISATIONS):
        at_end = found.relinearised()
        found = at_end.with_set(search_set(at_end.scorer, at_end.chosen_set, say))
        if frozenset(found.effects) in seen:
            break
        seen.add(frozenset(found.effects))
        best = best_path([best, found])
    return best


def _with_bodies_looked_at_anew(found: LinearPath, say: ProgressCallback) -> LinearPath:
    """The best path after each body, such as a load, was replaced by the effects that promise most without it.

    A load's place multiplies its mass, and a link that is changed much hides a load with the same influence, so sums at
    the fit with a body promise little of what replaces it: the best replacements are fitted.
    """
    bodies, margin = _bodies(found), found.study.settings.search.acceptance_nats
    rivals = [c for c in bodies if any(other.joints == c.joints and other is not c for other in bodies)]
    for body in bodies:
        for simpler in (c for c in rivals if c.joints == body.joints and len(c.names) < len(body.names)):
            if body in found.chosen_set.effects:
                others = [c for c in found.chosen_set.effects if c not in (body, simpler)]
                other = found.with_effects([*others, simpler]).relinearised()
                found = best_path([found, other], margin)
        if body not in found.chosen_set.effects or body in found.scorer.given:
            continue
        without = found.with_effects([c for c in found.chosen_set.effects if c is not body]).relinearised()
        larger = larger_sets(without.scorer, without.chosen_set, SCORED_CHANGES_PER_KIND)
        promising = [one for one in larger if body not in one.effects][:FITTED_REPLACEMENTS]
        best = best_path([found, *(without.with_set(one) for one in promising)], margin)
        if best is not found:
            found = _to_fixed_point(best, say)
        elif body in rivals:
            again = without.with_set(search_set(without.scorer, without.chosen_set, say))
            if set(again.effects) != set(found.effects):
                found = best_path([found, _to_fixed_point(again, say)])
    return found


def _bodies(found: LinearPath) -> list[Candidate]:
    """Candidates that change a link: loads and inertias of links."""
    model = found.study.problem.model
    return [c for c in found.scorer.searched_effects if c.joints and model.changes_link(c.names)]


def best_path(paths: Sequence[LinearPath], tie: float | None = None) -> LinearPath:
    """The path whose set predicts best at its own optimum, less its complexity; of ties that with fewest values.

    Args:
        paths: the paths.
        tie: difference, nats, up to which two count as tied; None means that of the settings.
    """
    if len({frozenset(path.effects) for path in paths}) == 1:
        return paths[0]
    ended = [path.relinearised() for path in paths]
    scale = ended[-1].scorer  # one scale for all: the errors of the wide model depend on the point of linearisation
    worth = [
        one.study.worth(one.scorer, one.fit, one.chosen_set, scale) if np.isfinite(one.chosen_set.score) else -np.inf
        for one in ended
    ]
    margin = paths[0].study.settings.search.tie_nats if tie is None else tie
    tied = [path for path, one in zip(paths, worth, strict=True) if one >= max(worth) - margin]
    return min(tied, key=lambda path: sum(len(c.names) for c in path.chosen_set.effects))


def without_empty_effects(found: LinearPath, least: float | None = None) -> LinearPath:
    """The path without effects all of whose values are within `least` deviations of nothing; see `SearchSettings`."""
    found = found.relinearised()
    while empty := empty_effects(found.study, found.fit, found.chosen_set.effects, least):
        fewer = [[c for c in found.chosen_set.effects if c is not gone] for gone in empty]
        found = found.with_effects(max(fewer, key=lambda effects: found.scorer.evaluate(effects).score)).relinearised()
    return found


def empty_effects(
    study: LinearStudy, fit: Fit, effects: Sequence[Candidate], least: float | None = None
) -> list[Candidate]:
    """Those of some effects all of whose fitted values together are within `least` deviations of nothing."""
    least = study.settings.search.value_stds if least is None else least
    problem, covariance = study.problem, uncertainty(study, fit).covariance
    values = {
        c: np.flatnonzero(problem.mask_of_unknowns(c.names) & fit.free) for c in effects if c not in study.present
    }
    sizes = {
        c: wald_distance((fit.values - problem.null)[own], covariance[np.ix_(own, own)]) for c, own in values.items()
    }
    return [c for c, size in sizes.items() if size <= least]


def _with_unsure_values_held(found: LinearPath) -> LinearPath:
    """The path with some values of effects at null, if the runs are sure of an effect but of none of its values.

    A link's ten values have many combinations with nearly the same torques. Those of which the runs are least sure are
    held one by one, and the others adapt, until the runs are sure of all others: backward elimination (Draper & Smith,
    Applied Regression Analysis, §15), as base parameters of an arm are made (Gautier, J. Robot. Syst. 8, 1991).
    """
    least = found.study.settings.search.value_stds
    width = next(iter(background_widths(found.scorer, found.chosen_set.effects)), 0.0)
    unsure = found.scorer.effects_without_sure_value(found.chosen_set.effects, width, least)
    bodies = _bodies(found)
    for load in [c for c in unsure if c in bodies]:
        # A load of no mass that has a place would lose its torque with any of its values.
        rivals = [c for c in bodies if c.joints == load.joints and len(c.names) > len(load.names)]
        if rivals:
            others = [c for c in found.chosen_set.effects if c is not load]
            found = found.with_effects([*others, rivals[0]]).relinearised()
    scorer, effects = found.scorer, found.chosen_set.effects
    held = scorer.unsure_values(effects, width, least)
    if not held:
        return found
    study, gone = found.study.with_values_held(held), found.study.problem.mask_of_unknowns(held)
    values = np.where(gone, study.problem.null, found.fit.values)
    again = fit(study.problem, found.fit.free & ~gone, values, weighted=found.fit.weighted)
    around = study.scorer(again)
    chosen = around.evaluate(around.split_into_candidates(found.effects))
    given = tuple(c.without_parameters(held) for c in found.given_effects)
    return LinearPath(study, around, chosen, given, again, again)


def _background(path: LinearPath, named: SearchStep, say: ProgressCallback) -> list[SearchStep]:
    """The step that adds the best background of which no run is sure and that leaves every named effect its value.

    Empty where no background predicts better.
    """
    study, scorer, effects = path.study, path.scorer, path.chosen_set.effects
    least = study.settings.search.value_stds
    for width in background_widths(scorer, effects):
        widths = scorer.prior_widths(effects, width)
        distances = scorer.wald_distances(widths, [(c,) for c in effects if c not in scorer.given])
        if min(distances, default=np.inf) <= least or sure_unnamed_effects(scorer, effects, width):
            continue
        say(f"fitting {np.count_nonzero(widths)} values")
        fit = study.fit_with_prior_widths(scorer, widths, named.fit.values)
        if _predicts_better(study, named.fit, fit) and not empty_effects(study, fit, effects):
            return [SearchStep((), (), named.effects, fit, study.tests(fit, named.effects), width)]
        break
    return []


def _predicts_better(study: LinearStudy, named: Fit, whole: Fit) -> bool:
    """Whether the squared error of predicted runs, if there are any, is smaller with a background."""
    before, after = (channel_rmse(study.held_out_blocks(fit)).values() for fit in (named, whole))
    return not before or sum(e**2 for e in after) < sum(e**2 for e in before)
