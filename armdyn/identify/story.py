"""All that is missing in an arm: the search by sums, gone on from its own end until nothing is found there."""

from collections.abc import Sequence

import numpy as np

from armdyn.identify.appraisal import HARM, Appraisal
from armdyn.identify.background import sure_effects
from armdyn.identify.candidate import Candidate
from armdyn.identify.choose import best_set, chosen, without_worthless
from armdyn.identify.fit import Fit, converged
from armdyn.identify.study import Study
from armdyn.identify.summed import Summed
from armdyn.identify.way import Leg, Progress, Step

FAR = 3.0
"""Typical sizes beyond which sums around null say little of a base that is turned: 0.3 rad."""
MOST_ROUNDS = 4
"""Expansions around the end of a repair of an arm; two nearly always."""


def whole_story(study: Study, given: Step, say: Progress) -> tuple[Summed, list[Step]]:
    """The appraiser of an arm around its fit as given, and the way to where nothing is missing that can be told.

    Few effects are hoped to explain everything; where many small errors remain, only what is large has a name.
    """
    around_given, legs = _told(study, given, say)
    return around_given, [given, *(step for leg in legs for step in leg.with_ties(leg.steps(say)))]


def _told(study: Study, given: Step, say: Progress) -> tuple[Summed, list[Leg]]:
    appraiser, legs = _few_or_large(study, given, say)
    last = _end(legs, given)
    if study.leaves_noise(last.fit):
        return appraiser, legs
    every = _with_all_that_is_sure(study, given, legs, say)
    return appraiser, every if study.predicts_to_noise(_end(every, given).fit) else legs


def _with_all_that_is_sure(study: Study, given: Step, legs: list[Leg], say: Progress) -> list[Leg]:
    """The way gone on to all that the evidence is sure of beside what was found.

    One strong effect makes the frictions of all joints look like many small errors. Where only noise is left with them,
    they are no errors.
    """
    last = _end(legs, given)
    around = study.appraiser(last.fit, sparse=True)
    if around.limited > 0.0:  # all effects together leave more than noise
        return legs
    present = around.within(last.effects)
    beside = sure_effects(study, present, around.sums, say)
    whole = without_worthless(around, around.of((*present, *beside)), around.given)
    if set(present) <= set(whole.effects):
        return [*legs, *_leg(study, around, whole, last, last.fit, present, together=True)]
    return _leg(study, around, whole, given, last.fit, around.given)


def _few_or_large(study: Study, given: Step, say: Progress) -> tuple[Summed, list[Leg]]:
    starts = _starts(study, given.fit, say)
    appraiser, few = _to_the_end(study, given, starts, say, sparse=True)
    if _few_explain_all(study, _end(few, given)):
        return appraiser, few
    other, large = _to_the_end(study, given, starts, say, sparse=False)
    one, end = _end(few, given), _end(large, given)
    if one.fit.free.sum() <= end.fit.free.sum() and study.squared_error(one.fit) < study.squared_error(end.fit):
        return appraiser, few
    # What was far from linear at first is linear around what leads.
    again = _to_fixed_point(study, given, large, say, sparse=True)
    more = _end(again, given)
    return other, again if more.fit.free.sum() > end.fit.free.sum() and _few_explain_all(study, more) else large


def _end(legs: Sequence[Leg], given: Step) -> Leg | Step:
    return legs[-1] if legs else given


def _to_the_end(
    study: Study, given: Step, starts: "Sequence[_Start]", say: Progress, sparse: bool
) -> tuple[Summed, list[Leg]]:
    """The appraiser of an arm around its fit as given, and the way to the fixed point; see `Summed` for `sparse`."""
    appraiser, whole, ahead, around_given = _best_around(study, starts, say, sparse)
    way = _leg(study, appraiser, whole, given, ahead, appraiser.given)
    return around_given, _to_fixed_point(study, given, way, say, sparse)


def _leg(
    study: Study,
    appraiser: Summed,
    whole: Appraisal,
    last: Leg | Step,
    ahead: Fit,
    firm: Sequence[Candidate],
    together: bool = False,
) -> list[Leg]:
    """To a set from what was there last; none where that holds all of it."""
    if set(whole.effects) <= set(firm):
        return []
    return [Leg(study, appraiser, whole, last.effects, ahead, tuple(firm), together)]


def _few_explain_all(study: Study, last: Leg | Step) -> bool:
    """Whether noise is all that the effects found so far leave, or that the whole catalogue would, and all are large.

    An effect that is no larger than every description is wrong by is one of many small errors, found or not.
    """
    around = study.appraiser(last.fit, sparse=True)
    if not (around.complete or study.leaves_noise(last.fit)):
        return False
    return not around.usual(around.of(around.within(last.effects)))


def _to_fixed_point(study: Study, given: Step, legs: list[Leg], say: Progress, sparse: bool) -> list[Leg]:
    """The way with what is still found around its end, until nothing is: a repair of the repaired model adds nothing.

    What multiplies others, such as a delay of a spring's torque, shows where they are.
    """
    for _ in range(MOST_ROUNDS if legs else 0):
        last = _end(legs, given)
        around = study.appraiser(last.fit, sparse)
        present = around.within(last.effects)
        kept = without_worthless(around, around.of(present), around.given).effects
        whole = chosen(around, kept, say)
        if set(whole.effects) == set(present):
            break
        if kept == around.of(present).effects:
            legs = [*legs, *_leg(study, around, whole, last, last.fit, present)]
            continue
        # Something stood for what came later.
        again = _leg(study, around, whole, given, last.fit, around.given)
        if _end(again, given).fit.chi2_per_sample > (1.0 + HARM) * last.fit.chi2_per_sample:
            break
        legs = again
    return legs


_Start = tuple[Fit, tuple[Candidate, ...]]
"""A fit that sums may be around, and the effects that it has beside the model as given."""


def _starts(study: Study, first: Fit, say: Progress) -> list[_Start]:
    """The fit of the model as given, and such as a far turned base needs."""
    starts: list[_Start] = [(first, ())]
    for candidate in study.candidates:
        if not candidate.joints:  # it turns the whole arm, and a large angle is far from linear
            say(f"fitting with {candidate.spoken}")
            turned = converged(study.fit_with((*study.present, candidate), first))
            own = study.problem.of(candidate.names)
            angles, typical = turned.values[own] - study.problem.null[own], study.problem.typical[own]
            if np.any(np.abs(angles) > FAR * typical):
                starts.append((turned, (candidate,)))
    return starts


def _best_around(
    study: Study, starts: Sequence[_Start], say: Progress, sparse: bool
) -> tuple[Summed, Appraisal, Fit, Summed]:
    """The set chosen by sums, with its appraiser and the fit around which that is; the appraiser around the first."""
    appraisers = [study.appraiser(fit, sparse) for fit, _ in starts]
    found = {}
    for appraiser, (_, firm) in zip(appraisers, starts, strict=True):
        atoms = appraiser.within(firm)
        held = (*appraiser.given, *atoms)
        if not atoms or appraiser.of(held).worth > -np.inf:
            whole = chosen(appraiser, held, say)
            found[whole] = appraiser
            if atoms:  # what a turned base does to a slide, an offset does as well, with fewer values
                rest = [c for c in whole.effects if c not in atoms]
                others = [appraisers[0].of((*rest, c)) for c in appraisers[0].candidates if c not in whole.effects]
                found |= {other: appraisers[0] for other in others if other.worth > -np.inf}
    nothing = appraisers[0].of(appraisers[0].given)
    better = [one for one in found if one.misfit < nothing.misfit]
    whole = best_set(appraisers[0], nothing, better) if better else nothing
    appraiser = found.get(whole, appraisers[0])
    return appraiser, whole, starts[appraisers.index(appraiser)][0], appraisers[0]
