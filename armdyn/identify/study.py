"""A study: a model, runs and a catalogue, with every fit that a diagnosis or a repair needs, each computed once."""

from abc import ABC, abstractmethod
from collections.abc import Collection, Sequence
from functools import cached_property
from typing import ClassVar

import numpy as np

from armdyn.effects.effect import Effect
from armdyn.identify.fit import MAX_CHI2_OF_STATED_NOISE, Fit
from armdyn.identify.holdout import HoldoutKind, all_blocks, leave_one_out_predictions, predict_runs
from armdyn.identify.prepare import prepare_runs, run_noise, stated_noise
from armdyn.identify.problem import Problem, ResidualBlock, chi2_sum, sample_count, transfer_mask, transfer_values
from armdyn.identify.residual.noise_tests import ResidualTests, ScoreTest, residual_tests, score_tests
from armdyn.identify.selection.candidate import Candidate, group_by_effect
from armdyn.identify.selection.linear_scorer import LinearScorer
from armdyn.identify.selection.set_score import SetScore, SetScorer
from armdyn.identify.unidentified import UnidentifiedCombination
from armdyn.model import Model
from armdyn.run import Run
from armdyn.threads import one_thread

CHANCE_DEVIATES, SURE_DEVIATES = 0.5, 3.0
"""Standard deviations of a mean square: the smallest error that is compared, and the largest that may be noise
alone."""


class Study(ABC):
    """Fits of one model with any of the catalogue's effects.

    One formulation contains every effect at its null value; a fit frees the columns that it needs. Models whose
    predictions are linear in most values and models with states are fitted in different ways: `Study.of` gives a
    `LinearStudy` or a `StateSpaceStudy`.

    Args:
        model: the model, with the effects that it has.
        runs: training runs.
        held_out: whole runs that are never fitted but help to choose effects.
        catalogue: effects that may be missing.
        exam: whole runs that are used for nothing else; only `exam_blocks` uses them.
        asked: names of effects for which the last run was designed; their residual need not exceed all other errors.
        catalogue_size: number of effects among which the catalogue was chosen, where there were more.

    Raises:
        InputError: a run cannot be used; see `prepare_runs`.
    """

    later_ties: ClassVar[bool]
    """Whether a diagnosis is undecided where any step of the search has a tie, and not the first step only."""
    sums_predict: ClassVar[bool] = False
    """Whether sums at one fit predict the result of any set of effects, and of held-out runs."""
    ignored_chi2: ClassVar[float] = 0.0
    """Chi2 per sample that the errors of measured inputs cause in the predictions, and that is no missing effect."""

    @staticmethod
    def of(
        model: Model,
        runs: Sequence[Run],
        held_out: Sequence[Run],
        catalogue: Sequence[Effect],
        exam: Sequence[Run] = (),
        asked: Collection[str] = (),
        catalogue_size: int = 0,
    ) -> "Study":
        """Make the study that suits a model; arguments and errors are those of the class."""
        from armdyn.identify.linear_study import LinearStudy
        from armdyn.identify.state_space.study import StateSpaceStudy

        kind = LinearStudy if model.linear else StateSpaceStudy
        return kind(model, runs, held_out, catalogue, exam, asked, catalogue_size)

    @one_thread
    def __init__(
        self,
        model: Model,
        runs: Sequence[Run],
        held_out: Sequence[Run],
        catalogue: Sequence[Effect],
        exam: Sequence[Run] = (),
        asked: Collection[str] = (),
        catalogue_size: int = 0,
    ) -> None:
        self.model = model
        self.catalogue = tuple(catalogue)
        self.asked = frozenset(asked)
        self.catalogue_size = catalogue_size
        self.runs, self.held_out, self.exam = prepare_runs(model, runs, held_out, exam)
        everything = [*self.runs, *self.held_out, *self.exam]
        self.noise = run_noise(model, everything)
        self.stated_noise = stated_noise(model, everything)
        # The catalogue's effects come last: an effect of the model on some joints may be missing on others.
        self.recorded = frozenset(name for run in everything for name in run.all_channels)
        shown = [effect for effect in catalogue if effect.is_visible_in(self.recorded)]
        self.effects = {effect.name: effect for effect in (*model.effects, *shown)}
        extended = model.with_candidates(self.effects.values())
        self.problem = Problem(extended, self.runs, self.noise)
        present = (effect for effect in model.effects if effect.quantities)
        self.present = tuple(
            Candidate.of(effect.name, model.parameter_names_by_joint(effect.name)) for effect in present
        )
        given = set(model.names)
        absent = (
            (
                effect.name,
                {j: ns for j, ns in extended.parameter_names_by_joint(effect.name).items() if not set(ns) <= given},
            )
            for effect in extended.effects
        )
        self.candidates = tuple(Candidate.of(name, parts) for name, parts in absent if parts)
        self._held_out: dict[Fit, list[Fit]] = {}
        self._in_turn: dict[Fit, list[Fit]] = {}
        self._exam: dict[Fit, list[Fit]] = {}
        self.present_names = [name for c in self.present for name in c.names]

    def choosing_from(
        self, catalogue: Sequence[Effect], model: Model | None = None, catalogue_size: int = 0
    ) -> "Study":
        """A study of the same runs with other effects to choose from, and with another model where one is given."""
        return Study.of(
            self.model if model is None else model,
            self.runs,
            self.held_out,
            catalogue,
            self.exam,
            self.asked,
            catalogue_size,
        )

    @one_thread
    def first(self) -> Fit:
        """The fit of the model as given."""
        return self._first

    @cached_property
    def _first(self) -> Fit:
        return self._fit_as_given()

    @abstractmethod
    def _fit_as_given(self) -> Fit:
        """Fit the model as given."""

    @abstractmethod
    def fit_with(self, effects: Sequence[Candidate], near: Fit, values: np.ndarray | None = None) -> Fit:
        """Fit the model's base with exactly these effects.

        Args:
            effects: the effects.
            near: a fit of a similar set, at which the fit may start.
            values: (P,) start values that are better than those of `near`, where there are any.
        """

    @abstractmethod
    def explained_share(self, before: Fit, after: Fit) -> float:
        """Share of the squared error of a fit `before` that effects explain which were added in the fit `after`."""

    def model_error_weight(self, fit: Fit) -> float:
        """Weight of the model's own error against the noise in a residual, 0 to 1."""
        return 1.0 - MAX_CHI2_OF_STATED_NOISE / max(MAX_CHI2_OF_STATED_NOISE, fit.chi2_per_sample)

    def scorer(self, at: Fit, given_misfit: float | None = None) -> LinearScorer | None:
        """Scorer of sets of effects from sums at a fit; None for models that are not linear in most values."""
        del at, given_misfit
        return None

    def unidentified(self, fit: Fit) -> tuple[UnidentifiedCombination, ...]:
        """Combinations of values that the runs do not identify; none where priors and links show that already."""
        del fit
        return ()

    def is_lost(self, fit: Fit) -> bool:
        """Whether the fit ended in a minimum that is unrelated to the recordings; never where there is only one."""
        del fit
        return False

    def describe_glitches(self, fit: Fit) -> list[str]:
        """Sentences, without full stops, on samples that had little weight in choosing, for each run and channel."""
        del fit
        return []

    def squared_error(self, fit: Fit) -> float:
        """Mean squared error above the noise, over it, of training plus held-out runs; at least that of chance."""
        return float(self.excess(fit).sum())

    def excess(self, fit: Fit) -> np.ndarray:
        """(1,) or (2,) mean squared error above the noise, over it: training, held-out; at least that of chance."""
        excess, by_chance = self._excess(fit)
        return np.maximum(excess, by_chance)

    def chi2_of_stated(self, blocks: Sequence[ResidualBlock]) -> tuple[float, int]:
        """Squared error of the samples with a stated noise, over that noise, and the number of these samples."""
        stated = [(block, self.stated_noise.get((block.run, block.channel))) for block in blocks]
        known = [(block, std) for block, std in stated if std]
        chi2 = sum(float(block.misfit @ block.misfit) / std**2 for block, std in known)
        return chi2, sample_count([block for block, _ in known])

    def _excess(self, fit: Fit) -> tuple[np.ndarray, float]:
        """Mean squared error above the noise, over the noise, by kind of run, and the part due to chance."""
        kinds = [list(fit.blocks), self.held_out_blocks(fit) if self.held_out else []]
        samples = np.array([sample_count(kind) for kind in kinds if kind])
        means = np.array([chi2_sum(kind) for kind in kinds if kind]) / samples
        return means - 1.0, CHANCE_DEVIATES * float(np.sqrt(2.0 / samples.min()))

    def model_with(self, effects: Collection[Candidate]) -> Model:
        """The model with exactly these effects."""
        model = self.model
        for candidate in self.present:
            if candidate not in effects:
                model = model.without_effect(candidate.effect)
        for candidate in effects:
            if candidate not in self.present:
                effect = self.effects[candidate.effect]
                model = model.with_effect(effect.on(*candidate.joints) if candidate.joints else effect)
        return model

    def without_unused_effects(self, found: Fit) -> Fit:
        """The same fit, of a model with only the fitted effects besides those of the model as given."""
        fitted = {column.parameter.name for column, fits in zip(self.problem.columns, found.free, strict=True) if fits}
        used = group_by_effect(
            [a for c in self.candidates for a in c.split_by_joint() if not fitted.isdisjoint(a.names)]
        )
        problem = Problem(self.model_with((*self.present, *used)), self.runs, self.noise)
        free = transfer_mask(found.free, self.problem, problem)
        return Fit(problem, free, transfer_values(found.values, self.problem, problem), found.blocks, found.outcome)

    def own_values(self, scorer: SetScorer, one: SetScore) -> np.ndarray:
        """(P,) values of the study's unknowns for a scored set."""
        return self.own(scorer.values(one), scorer.problem)

    def own(self, values: np.ndarray, problem: Problem) -> np.ndarray:
        """(P,) values of the study's unknowns, from those of a problem with more or other runs."""
        return transfer_values(values, problem, self.problem)

    def scores(self, at: Fit, effects: Sequence[Candidate]) -> list[ScoreTest]:
        """Predicted contributions of effects that are not in `effects`; an effect may be there on other joints."""
        taken = {name for c in effects for name in c.names}
        left = (c.without_parameters(taken) for c in (*self.candidates, *self.present))
        return score_tests(at, [c for c in left if c.names])

    def tests(self, at: Fit, effects: Sequence[Candidate]) -> ResidualTests:
        """Tests of the residual of a fit with these effects."""
        return residual_tests(at, self.scores(at, effects))

    def held_out_blocks(self, found: Fit) -> list[ResidualBlock]:
        """Residuals of the held-out runs; without any, of every training run predicted from the others."""
        return all_blocks(self.held_out_predictions(found))

    def held_out_predictions(self, found: Fit) -> list[Fit]:
        """Predictions of the held-out runs; without any, of every training run from the others."""
        if found not in self._held_out:
            self._held_out[found] = self._of_held_out(found) if self.held_out else self.predictions_in_turn(found)
        return self._held_out[found]

    def _of_held_out(self, found: Fit) -> list[Fit]:
        return self._predictions(found, self.held_out)

    def _predictions(self, found: Fit, runs: Sequence[Run]) -> list[Fit]:
        return predict_runs(found, runs)

    def predictions_beside_held_out(self, found: Fit) -> list[Fit]:
        """Predictions of training runs from each other, beside those of held-out runs; empty where they take long."""
        del found
        return []

    def predictions_in_turn(self, found: Fit) -> list[Fit]:
        """Predictions of every training run from the others; an empty list for a single run."""
        if found not in self._in_turn:
            self._in_turn[found] = leave_one_out_predictions(found)
        return self._in_turn[found]

    @property
    def recordings(self) -> list[tuple[Run, str]]:
        """All recordings before their preparation, each with its role: training, held_out or exam."""
        roles = {"training": self.runs, "held_out": self.held_out, "exam": self.exam}
        return [(run.recording, role) for role, runs in roles.items() for run in runs]

    @property
    def holdout_kinds(self) -> tuple[HoldoutKind, ...]:
        """Kinds of the runs that judge a model besides the fitted runs, the most independent first."""
        several = HoldoutKind.LEAVE_ONE_OUT if len(self.runs) > 1 else HoldoutKind.TRAINING
        others = HoldoutKind.HELD_OUT if self.held_out else several
        return (HoldoutKind.EXAM, others) if self.exam else (others,)

    def exam_blocks(self, found: Fit) -> list[ResidualBlock]:
        """Residuals of the exam runs, empty where there are none; only for use after all choices are made."""
        return all_blocks(self.exam_predictions(found))

    def exam_predictions(self, found: Fit) -> list[Fit]:
        """Predictions of the exam runs; only for use after all choices are made."""
        if found not in self._exam:
            self._exam[found] = self._predictions(found, self.exam)
        return self._exam[found]
