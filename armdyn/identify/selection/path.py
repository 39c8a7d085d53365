"""Add chosen effects to the given model one at a time, the most important one first, and fit the model each time."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from armdyn.identify.fit import Fit, continue_fit
from armdyn.identify.residual.noise_tests import ResidualTests
from armdyn.identify.selection.candidate import Candidate, group_by_effect
from armdyn.identify.selection.ranking import order_by_gain, tied_effects
from armdyn.identify.selection.set_score import EffectSetScore, EffectSetScorer
from armdyn.identify.study import Study

ProgressCallback = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class SearchStep:
    """One step of a search for missing effects, with the fit after it.

    Attributes:
        added: effects that this step added; empty for the model as given.
        tied_effects: effects that these runs cannot distinguish from the one added.
        effects: all effects after the step.
        fit: the fit after the step.
        tests: tests of the residual after the step.
        background_width: prior width of small values of other effects that the step adds; 0 for none.
    """

    added: tuple[Candidate, ...]
    tied_effects: tuple[Candidate, ...]
    effects: tuple[Candidate, ...]
    fit: Fit
    tests: ResidualTests
    background_width: float = 0.0


@dataclass(frozen=True, eq=False)
class EffectPath:
    """The steps from the model as given to a chosen set of effects; they are fitted only when needed.

    Attributes:
        study: runs and catalogue.
        scorer: the scorer that chose the set.
        chosen_set: the chosen set, each effect on one joint.
        given_effects: effects of the model as given.
        scorer_fit: the fit at which the scorer is linearised.
    """

    study: Study
    scorer: EffectSetScorer
    chosen_set: EffectSetScore
    given_effects: tuple[Candidate, ...]
    scorer_fit: Fit

    @cached_property
    def effects(self) -> tuple[Candidate, ...]:
        """All effects after the last step: those of the model as given and those of the chosen set."""
        return self._with(self.given_effects, *self.scorer.removable(self.chosen_set))

    @cached_property
    def fit(self) -> Fit:
        """The fit after the last step."""
        return continue_fit(self._fitted(self.effects, self.chosen_set))

    def steps(self, say: ProgressCallback) -> list[SearchStep]:
        """Fit every step, each with one more effect; the effects that these runs cannot tell apart are not computed.

        Args:
            say: called with a text on the progress.
        """
        study, effects, found = self.study, self.given_effects, list[SearchStep]()
        way = order_by_gain(self.scorer, self.chosen_set.effects, self.scorer.given)
        for i, (added, chosen) in enumerate(way, start=1):
            effects = self._with(effects, added)
            say(f"{i - 1} of {len(way)} steps fitted, now {added.name_in_sentence}")
            fit = self.fit if i == len(way) else self._fitted(effects, chosen)
            tests = study.tests(fit, effects)
            found.append(SearchStep((added,), (), effects, fit, tests))
        return found

    def with_indistinguishable_effects(self, steps: Sequence[SearchStep]) -> list[SearchStep]:
        """Add to each step the effects that could replace those it added, because these runs cannot tell them apart."""
        whole = self.scorer.optimise(self.chosen_set.effects)
        ties = (tied_effects(self.scorer, whole, [a for c in step.added for a in c.split_by_joint()]) for step in steps)
        return [replace(step, tied_effects=one) for step, one in zip(steps, ties, strict=True)]

    def _with(self, effects: Sequence[Candidate], *added: Candidate) -> tuple[Candidate, ...]:
        given = self.study.present  # it keeps its place, also where the same effect is added on further joints
        return (*given, *group_by_effect((*(e for e in effects if e not in given), *added)))

    def _fitted(self, effects: Sequence[Candidate], one: EffectSetScore) -> Fit:
        return self.study.fit_base_with_effects(
            effects, self.scorer_fit, self.study.values_predicted_by_scorer(self.scorer, one)
        )
