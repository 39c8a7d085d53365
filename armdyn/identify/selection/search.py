"""Find the effects that are missing, and add them one after the other, what explains most first."""

from collections.abc import Sequence
from dataclasses import dataclass

from armdyn.identify.explained import RepairStep
from armdyn.identify.fit import channel_rmse
from armdyn.identify.residual.missing_force import ForceCurve, between
from armdyn.identify.selection.background import FullModel
from armdyn.identify.selection.candidate import Candidate
from armdyn.identify.selection.for_arms import select_for_arm
from armdyn.identify.selection.path import Path, Progress, Step
from armdyn.identify.selection.ranking import RankedEffect, rank_effects
from armdyn.identify.selection.set_score import SetScore, SetScorer
from armdyn.identify.state_space.scorer import StateSpaceScorer
from armdyn.identify.study import LITTLE, Study
from armdyn.identify.whole_runs import improved


@dataclass(frozen=True, eq=False)
class Search:
    """How a search went.

    Attributes:
        steps: the model as given first.
        suspects: what could have been the first effect, best first.
        further: of the effects that the last step lacks, the one that is worth most; None where none is worth anything.
        full: of an arm, all effects at once.
    """

    steps: tuple[Step, ...]
    suspects: tuple[RankedEffect, ...] = ()
    further: Candidate | None = None
    full: FullModel | None = None

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
    full = None
    first = study.first()
    scorer: SetScorer
    given = Step((), (), study.present, first, study.tests(first, study.present))
    if study.model.linear:
        scorer, steps, full = select_for_arm(study, given, say)
    else:
        scorer, whole = _by_evidence(study, say)
        steps = _way(study, given, scorer, whole, say)
    named = steps[min(1, len(steps) - 1)]
    found = rank_effects(scorer, scorer.within(named.added), named.tied)
    around = study.scorer(steps[-1].fit) if study.model.linear else scorer
    return Search(tuple(steps), found, _further(around, around.within(steps[-1].effects)), full)


def _further(scorer: SetScorer, effects: Sequence[Candidate]) -> Candidate | None:
    now = scorer.settle(effects)
    options = (scorer.of((*now.effects, c)) for c in scorer.candidates if c not in now.effects)
    best = max(options, key=lambda one: one.score, default=now)
    return next((c for c in best.effects if c not in now.effects), None) if best.score > now.score else None


def _way(study: Study, given: Step, scorer: SetScorer, whole: SetScore, say: Progress) -> list[Step]:
    """The way to a set without what lowers the error by little; what ties with what is told without that, too."""
    path = Path(study, scorer, whole, given.effects, given.fit)
    steps = path.steps(say)
    told = without_little(study, [given, *steps])
    if len(told) == 1 + len(steps):
        return [given, *path.with_ties(steps)]
    return _way(study, given, scorer, scorer.of(scorer.within(told[-1].effects)), say)


def _by_evidence(study: Study, say: Progress) -> tuple[StateSpaceScorer, SetScore]:
    """The set chosen around the motion, and by which scorer."""
    scorer = StateSpaceScorer(study)
    return scorer, improved(study, scorer, scorer.best_set(say), say)


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


def repair_step(study: Study, step: Step, held_out: dict[str, float] | None = None) -> RepairStep:
    """One step, with its errors on every kind of run; those on held-out runs may be known already."""
    if held_out is None:
        held_out = channel_rmse(study.held_out_blocks(step.fit))
    return RepairStep(
        added=tuple(c.effect for c in step.added),
        joints=tuple(dict.fromkeys(j for c in step.added for j in c.joints)),
        tied_with=tuple(c.effect for c in step.tied),
        rmse=step.fit.rmse(),
        held_out_rmse=held_out,
        chi2_per_sample=step.fit.chi2_per_sample,
        bic=step.fit.bic,
        exam_rmse=channel_rmse(study.exam_blocks(step.fit)),
    )
