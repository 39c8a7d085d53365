"""Search for the effects that a model lacks, and fit the model as they are added, the most important one first."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import singledispatch

from armdyn.identify.explained_share import RepairStep
from armdyn.identify.fit import channel_rmse
from armdyn.identify.linear_study import LinearStudy
from armdyn.identify.motion.motion_selection import select_for_motion
from armdyn.identify.motion.motion_study import MotionStudy
from armdyn.identify.residual.missing_force import ForceCurve, compare_missing_forces
from armdyn.identify.selection.arm_selection import select_for_arm
from armdyn.identify.selection.candidate import Candidate
from armdyn.identify.selection.path import EffectPath, ProgressCallback, SearchStep
from armdyn.identify.selection.ranking import RankedEffect, name_tied_effect, rank_effects
from armdyn.identify.selection.set_score import EffectSetScore, EffectSetScorer
from armdyn.identify.state_space.scorer import StateSpaceScorer
from armdyn.identify.state_space.study import StateSpaceStudy
from armdyn.identify.study import Study
from armdyn.identify.whole_runs import improve_effect_set_by_run_errors

BACKGROUND_STEP = "background"
"""Name of the step of a repair that adds small values of many effects, which reports do not list."""


@dataclass(frozen=True, eq=False)
class Search:
    """Result of a search for missing effects.

    Attributes:
        steps: steps of the search; the first is the model as given.
        ranked_effects: effects that may be missing, each added alone to the model as given, the best first.
        further_effect: the best effect that the last step lacks; None where no further effect improves the score.
    """

    steps: tuple[SearchStep, ...]
    ranked_effects: tuple[RankedEffect, ...] = ()
    further_effect: Candidate | None = None

    @property
    def last(self) -> SearchStep:
        """The last step of the search."""
        return self.steps[-1]

    @property
    def named(self) -> SearchStep:
        """The last step without a background: that with all named effects."""
        return next(step for step in reversed(self.steps) if step.background_width == 0.0)

    @property
    def first_ties(self) -> tuple[Candidate, ...]:
        """Effects that these runs cannot distinguish from the effect that the first step added."""
        return self.steps[1].tied_effects if len(self.steps) > 1 else ()

    @property
    def all_ties(self) -> tuple[Candidate, ...]:
        """Effects that these runs cannot distinguish from the effects that the search added."""
        return tuple(dict.fromkeys(effect for step in reversed(self.steps) for effect in self.ties(step)))

    def missing_force(self, *, law: bool = False) -> tuple[ForceCurve, ...]:
        """Curves of the missing force of the model as given and, if effects were added, of the last step.

        Args:
            law: whether to compute the force of the added effects as well.
        """
        repaired = self.named.fit if len(self.steps) > 1 else None
        with_background = self.last.fit if self.last is not self.named else None
        return compare_missing_forces(self.steps[0].fit, repaired, with_background, law=law)

    def ties(self, step: SearchStep) -> tuple[Candidate, ...]:
        """Effects that these runs cannot distinguish from those added in a step; empty if these were removed later."""
        ended = {name for effect in self.last.effects for name in effect.names}
        if ended.isdisjoint(name for effect in step.added for name in effect.names):
            return ()
        return tuple(effect for effect in step.tied_effects if not ended.issuperset(effect.names))


def search(study: Study, progress: ProgressCallback | None = None) -> Search:
    """Search for the effects that the model of a study lacks, and fit the model as they are added one by one.

    Args:
        study: runs, model and catalogue.
        progress: called with a short text at every step.
    """
    say = progress or (lambda _: None)
    say("fitting the model as it is")
    first = study.first()
    return select_effects(study, SearchStep((), (), study.present, first, study.tests(first, study.present)), say)


@singledispatch
def select_effects(study: Study, given: SearchStep, say: ProgressCallback) -> Search:
    """Choose the effects to add to the model as `given`; the method depends on the type of the study."""
    raise NotImplementedError(type(study).__name__)


@select_effects.register
def _(study: LinearStudy, given: SearchStep, say: ProgressCallback) -> Search:
    scorer, steps = select_for_arm(study, given, say)
    return _searched(steps, scorer, study.scorer(Search(tuple(steps)).named.fit))


@select_effects.register
def _(study: MotionStudy, given: SearchStep, say: ProgressCallback) -> Search:
    found, steps = select_for_motion(study, given, say)
    return _searched(steps, found.scorer, found.scorer)


@select_effects.register
def _(study: StateSpaceStudy, given: SearchStep, say: ProgressCallback) -> Search:
    scorer = StateSpaceScorer(study)
    steps = _path(
        study,
        given,
        scorer,
        improve_effect_set_by_run_errors(study, scorer, scorer.search_best_effect_set(say), say),
        say,
    )
    return _searched(steps, scorer, scorer)


def _searched(steps: Sequence[SearchStep], scorer: EffectSetScorer, at_end: EffectSetScorer) -> Search:
    """The result of a search; `scorer` ranks what could have been first, `at_end` what the last step lacks."""
    named = steps[min(1, len(steps) - 1)]
    found = rank_effects(scorer, scorer.split_into_candidates(named.added), named.tied_effects)
    return Search(tuple(steps), found, _further(at_end, at_end.split_into_candidates(steps[-1].effects)))


def _further(scorer: EffectSetScorer, effects: Sequence[Candidate]) -> Candidate | None:
    now = scorer.optimise(effects)
    options = (scorer.evaluate((*now.effects, c)) for c in scorer.addable(now))
    best = max(options, key=lambda one: one.score, default=now)
    return next((c for c in best.effects if c not in now.effects), None) if best.score > now.score else None


def _path(
    study: StateSpaceStudy, given: SearchStep, scorer: EffectSetScorer, whole: EffectSetScore, say: ProgressCallback
) -> list[SearchStep]:
    """The path to a set without effects that reduce the error by little; ties of those removed are tested too."""
    path = EffectPath(study, scorer, whole, given.effects, given.fit)
    steps = path.steps(say)
    told = drop_small_steps(study, [given, *steps])
    if len(told) == 1 + len(steps):
        return [given, *path.with_indistinguishable_effects(steps)]
    return _path(study, given, scorer, scorer.evaluate(scorer.split_into_candidates(told[-1].effects)), say)


def drop_small_steps(study: StateSpaceStudy, steps: list[SearchStep]) -> list[SearchStep]:
    """Leave out the last steps of a search if each parameter that they add lowers the error by little.

    A model of a real pendulum is never complete, so a further effect of the catalogue always explains a little of the
    residual. Where the residual is only noise, all steps are kept.
    """
    left = [study.squared_error(step.fit) for step in steps]
    values = [int(step.fit.free.sum()) for step in steps]
    for k in range(len(steps) - 1):
        if study.residual_may_be_noise(steps[k].fit):
            break
        later = range(k + 1, len(steps))
        if any(c.effect in study.asked for j in later for c in steps[j].added):
            continue  # in an experiment made for this effect, its evidence counts
        if all(left[j] > left[k] * study.settings.search.needed_share(max(values[j] - values[k], 1)) for j in later):
            return steps[: k + 1]
    return steps


def repair_step(study: Study, step: SearchStep) -> RepairStep:
    """Describe one step of a search by its errors on every kind of run."""
    small = background_values(study, step)
    return RepairStep(
        added=(BACKGROUND_STEP,) if small else tuple(c.effect for c in step.added),
        joints=tuple(dict.fromkeys(j for c in step.added for j in c.joints)),
        tied_with=tuple(name_tied_effect(c, step.added) for c in step.tied_effects),
        rmse=step.fit.rmse(),
        held_out_rmse=channel_rmse(study.held_out_blocks(step.fit)),
        chi2_per_sample=step.fit.chi2_per_sample,
        bic=step.fit.bic,
        exam_rmse=channel_rmse(study.exam_blocks(step.fit)),
        values=len(small),
    )


def background_names(study: Study, step: SearchStep) -> set[str]:
    """Names of the parameters of a step's background, which have no name in a report."""
    named = {name for c in step.effects for name in c.names}
    free = [c for c, fits in zip(study.problem.columns, step.fit.free, strict=True) if fits and c.parameter.effect]
    return {c.name for c in free if c.name not in named} if step.background_width else set()


def background_values(study: Study, step: SearchStep) -> dict[str, float]:
    """Values of a step's background by parameter name, in the parameter's unit; empty where the step has none."""
    names, problem = background_names(study, step), study.problem
    values = zip(problem.columns, step.fit.values, problem.null, strict=True)
    return {c.name: float(value) for c, value, null in values if c.name in names and value != null}
