"""Find the effects that are missing, and add them one after the other, what explains most first."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from armdyn.identify.appraisal import HARM, Appraisal, Appraiser
from armdyn.identify.candidate import Candidate
from armdyn.identify.choose import best_set, chosen, without_worthless
from armdyn.identify.explained import RepairStep
from armdyn.identify.filtered import Filtered
from armdyn.identify.fit import Fit, channel_rmse
from armdyn.identify.least_squares import GROSS
from armdyn.identify.missing_force import ForceCurve, between
from armdyn.identify.score import ResidualTests
from armdyn.identify.study import Study
from armdyn.identify.summed import Summed
from armdyn.identify.suspects import Suspect, merged, ordered_steps, suspects

FAR = 3.0
"""Typical sizes beyond which sums around null say little of a base that is turned: 0.3 rad."""

LITTLE = 0.125
"""Share of the squared error above the noise that each further value of a pendulum must explain: every value that the
public recordings need explains 0.17 of it or more, a lag that the simulated robot's own errors imitate 0.10."""

COMPARED, PAIRED = 12, 6
"""Effects, those that promise most, that are compared alone over whole runs, and of these, whose pairs are."""
CLEARLY = 2
"""Values more that a pair is as good as without having them, to be taken in place of what evidence chose."""

MOST_ROUNDS = 4
"""Expansions around the end of a repair of an arm; two nearly always."""

Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Step:
    """One change of the model.

    Attributes:
        added: effects that came in; empty for the model as given.
        tied: effects that these runs cannot tell from the one added.
        effects: all effects after it.
        fit: the minimum after it.
        tests: what is left.
    """

    added: tuple[Candidate, ...]
    tied: tuple[Candidate, ...]
    effects: tuple[Candidate, ...]
    fit: Fit
    tests: ResidualTests


@dataclass(frozen=True, eq=False)
class Search:
    """All steps, the model as given first, and what could have been the first effect, best first."""

    steps: tuple[Step, ...]
    suspects: tuple[Suspect, ...] = ()

    @property
    def last(self) -> Step:
        """Where it ended."""
        return self.steps[-1]

    @property
    def leading_ties(self) -> tuple[Candidate, ...]:
        """Effects that these runs cannot tell from the first one: what comes after it may have its own."""
        return self.steps[1].tied if len(self.steps) > 1 else ()

    @property
    def tied(self) -> tuple[Candidate, ...]:
        """Effects that these runs cannot tell from those that it ended with."""
        return tuple(dict.fromkeys(effect for step in reversed(self.steps) for effect in self.ties(step)))

    def missing_force(self, *, law: bool = False) -> tuple[ForceCurve, ...]:
        """What the model as given cannot explain and, where something was added, what is left; see `between`."""
        return between(self.steps[0].fit, self.last.fit if len(self.steps) > 1 else None, law=law)

    def ties(self, step: Step) -> tuple[Candidate, ...]:
        """Effects that these runs cannot tell from what a step added; none where that is gone at the end."""
        ended = {name for effect in self.last.effects for name in effect.names}
        if ended.isdisjoint(name for effect in step.added for name in effect.names):
            return ()
        return tuple(effect for effect in step.tied if not ended.issuperset(effect.names))


def search(study: Study, progress: Progress | None = None) -> Search:
    """Choose around the fit of the model as given; refit every step of the way to what was chosen.

    `progress` is told every step in a few words.
    """
    say = progress or (lambda _: None)
    say("fitting the model as it is")
    first = study.first()
    appraiser: Appraiser
    given = Step((), (), study.present, first, study.tests(first, study.present))
    if study.model.linear:
        appraiser, steps = _by_sums(study, given, say)
    else:
        appraiser, whole = _by_evidence(study, first, say)
        steps = without_little(study, [given, *_climbed(study, appraiser, whole, given, first, say)])
    named = steps[min(1, len(steps) - 1)]
    return Search(tuple(steps), suspects(appraiser, appraiser.within(named.added), named.tied))


def _by_sums(study: Study, given: Step, say: Progress) -> tuple[Summed, list[Step]]:
    """The appraiser of an arm around its fit as given, and the way to where nothing is missing that can be told.

    Few effects are hoped to explain everything; where many small errors remain, only what is large has a name.
    """
    appraiser, steps = _whole_story(study, given, say, sparse=True)
    if _few_explain_all(study, steps[-1]):
        return appraiser, steps
    other, way = _whole_story(study, given, say, sparse=False)
    if _better_and_no_larger(study, steps[-1].fit, way[-1].fit):
        return appraiser, steps
    # What was far from linear at first is linear around what leads.
    whole = _to_fixed_point(study, way, say, sparse=True)
    return other, whole if len(whole) > len(way) and _few_explain_all(study, whole[-1]) else way


def _whole_story(study: Study, given: Step, say: Progress, sparse: bool) -> tuple[Summed, list[Step]]:
    """The appraiser of an arm around its fit as given, and the way to the fixed point; see `Summed` for `sparse`."""
    appraiser, whole, ahead, around_given = _best_around(study, given.fit, say, sparse)
    way = _climbed(study, appraiser, whole, given, ahead, say, appraiser.given)
    return around_given, _to_fixed_point(study, [given, *way], say, sparse)


def _few_explain_all(study: Study, last: Step) -> bool:
    """Whether noise is all that the effects found so far leave, or that the whole catalogue would, and all are large.

    An effect that is no larger than every description is wrong by is one of many small errors, found or not.
    """
    around = study.appraiser(last.fit, sparse=True)
    if not (around.complete or study.leaves_noise(last.fit)):
        return False
    return not around.usual(around.of(around.within(last.effects)))


def _better_and_no_larger(study: Study, one: Fit, other: Fit) -> bool:
    """Whether a fit leaves less than another one, with no more values."""
    return bool(one.free.sum() <= other.free.sum()) and study.squared_error(one) < study.squared_error(other)


def _to_fixed_point(study: Study, steps: list[Step], say: Progress, sparse: bool) -> list[Step]:
    """The way with what is still found around its end, until nothing is: a repair of the repaired model adds nothing.

    What multiplies others, such as a delay of a spring's torque, shows where they are.
    """
    for _ in range(MOST_ROUNDS if len(steps) > 1 else 0):
        around, last = study.appraiser(steps[-1].fit, sparse), steps[-1]
        present = around.within(last.effects)
        kept = without_worthless(around, around.of(present), around.given).effects
        whole = chosen(around, kept, say)
        if set(whole.effects) == set(present):
            break
        if kept == around.of(present).effects:
            steps = [*steps, *_climbed(study, around, whole, last, last.fit, say, present)]
            continue
        # Something stood for what came later.
        again = [steps[0], *_climbed(study, around, whole, steps[0], last.fit, say, around.given)]
        if again[-1].fit.chi2_per_sample > (1.0 + HARM) * last.fit.chi2_per_sample:
            break
        steps = again
    return steps


def _by_evidence(study: Study, first: Fit, say: Progress) -> tuple[Filtered, Appraisal]:
    """The set chosen around the motion, and by which appraiser."""
    appraiser = Filtered(study)
    whole = appraiser.best_set(say)
    fit = study.fit_with((*study.present, *whole.effects), first)
    if fit.chi2_per_sample > GROSS:
        say("comparing pairs over whole runs")
        whole = appraiser.settle(_pair_or(study, appraiser, whole))
        fit = study.fit_with((*study.present, *whole.effects), first)
    # What came first may have stood for what came later.
    useless = [c for c in whole.effects if np.all(_at_null(fit, c))]
    return appraiser, appraiser.settle([c for c in whole.effects if c not in useless])


def _pair_or(study: Study, appraiser: Filtered, whole: Appraisal) -> tuple[Candidate, ...]:
    """A set, or one of one or two effects that leaves clearly less in output error.

    Far above the noise kicks excuse what adds up over many swings; a friction that large swings hide shows in whole
    runs only.
    """

    def left(effects: tuple[Candidate, ...]) -> float:
        return study.left((*study.present, *effects))

    appraiser.settle(())
    promised = sorted(appraiser.candidates, key=lambda c: -appraiser.of((c,)).worth)[:COMPARED]
    alone = sorted(promised, key=lambda c: left((c,)))[:PAIRED]
    sets = [*((c,) for c in alone), *combinations(alone, 2)]
    best = min(sets, key=lambda one: left(one) / (1.0 - LITTLE) ** len(one))
    more = max(len(best) - len(whole.effects), 0) + CLEARLY
    return best if left(best) < (1.0 - LITTLE) ** more * left(whole.effects) else whole.effects


def _at_null(fit: Fit, candidate: Candidate) -> np.ndarray:
    own = fit.problem.of(candidate.names) & fit.free
    return fit.values[own] == fit.problem.null[own]


def _best_around(study: Study, first: Fit, say: Progress, sparse: bool) -> tuple[Summed, Appraisal, Fit, Summed]:
    """The set chosen by sums, with its appraiser and the fit around which that is; the appraiser around `first`."""
    starts: list[tuple[Fit, tuple[Candidate, ...]]] = [(first, ())]
    for candidate in study.candidates:
        if not candidate.joints:  # it turns the whole arm, and a large angle is far from linear
            say(f"fitting with {candidate.spoken}")
            turned = study.converge(study.fit_with((*study.present, candidate), first))
            own = study.problem.of(candidate.names)
            angles, typical = turned.values[own] - study.problem.null[own], study.problem.typical[own]
            if np.any(np.abs(angles) > FAR * typical):
                starts.append((turned, (candidate,)))
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


def _climbed(
    study: Study,
    appraiser: Appraiser,
    whole: Appraisal,
    last: Step,
    ahead: Fit,
    say: Progress,
    firm: Sequence[Candidate] = (),
) -> list[Step]:
    """Steps from the last one to the set `whole`, each refitted to all samples.

    Args:
        study: runs and catalogue.
        appraiser: that chose the set.
        whole: the set, on one joint each.
        last: where the way begins.
        ahead: the fit around which the sums are.
        say: told every step.
        firm: effects that are there already.
    """
    effects = last.effects
    steps: list[Step] = []
    given = study.present  # stays as it is, also where the same effect comes on further joints
    way = list(ordered_steps(appraiser, whole, firm))
    for i, rise in enumerate(way):
        effects = (*given, *merged((*(e for e in effects if e not in given), rise.added)))
        say(f"{i} of {len(way)} steps fitted, now {rise.added.spoken}")
        fit = study.fit_with(effects, ahead, study.own_values(appraiser, rise.appraisal))
        if rise is way[-1]:
            fit = study.converge(fit)
        steps.append(Step((rise.added,), rise.tied, effects, fit, study.tests(fit, effects)))
    return steps


def without_little(study: Study, steps: list[Step]) -> list[Step]:
    """The way without its end, where each value that comes lowers the error by little.

    Real pendulums are never whole: what is left is something, and the next effect of the catalogue a little of it. At
    the noise there is no such rest: what contradicts a weighed mass shows in no error.
    """
    left = [study.squared_error(step.fit) for step in steps]
    values = [int(step.fit.free.sum()) for step in steps]
    for k in range(len(steps) - 1):
        if study.is_at_noise(steps[k].fit):
            break
        later = range(k + 1, len(steps))
        if any(c.effect in study.asked for j in later for c in steps[j].added):
            continue  # an experiment that was made to see an effect shows it by what it is worth
        if all(left[j] > left[k] * (1.0 - LITTLE) ** max(values[j] - values[k], 1) for j in later):
            return steps[: k + 1]
    return steps


def repair_step(study: Study, step: Step) -> RepairStep:
    """One step, with its errors on every kind of run."""
    return RepairStep(
        added=tuple(c.effect for c in step.added),
        joints=tuple(dict.fromkeys(j for c in step.added for j in c.joints)),
        tied_with=tuple(c.effect for c in step.tied),
        rmse=step.fit.rmse(),
        held_out_rmse=channel_rmse(study.held_out_blocks(step.fit)),
        chi2_per_sample=step.fit.chi2_per_sample,
        bic=step.fit.bic,
        exam_rmse=channel_rmse(study.exam_blocks(step.fit)),
    )
