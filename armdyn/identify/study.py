"""The base class of studies: fits of a model, with any effects of a catalogue, to runs; each fit is computed once."""

from abc import ABC, abstractmethod
from collections.abc import Collection, Sequence
from functools import cached_property
from typing import ClassVar

import numpy as np

from armdyn.effects.effect import Effect
from armdyn.identify.fit import Fit
from armdyn.identify.holdout import HoldoutKind, joined_residual_blocks, leave_one_out_predictions, predict_runs
from armdyn.identify.prepare import noise_std_by_run_and_channel, prepare_runs, stated_noise
from armdyn.identify.problem import Problem, transfer_mask, transfer_values
from armdyn.identify.residual.block import ResidualBlock, chi2_sum, sample_count
from armdyn.identify.residual.noise_tests import ResidualTests, ScoreTest, residual_tests, score_tests
from armdyn.identify.selection.candidate import Candidate, group_by_effect
from armdyn.identify.selection.linear_scorer import LinearScorer
from armdyn.identify.selection.set_score import EffectSetScore, EffectSetScorer
from armdyn.identify.settings import DEFAULT_SETTINGS, Settings
from armdyn.identify.unidentified import UnidentifiedCombination
from armdyn.model import Model
from armdyn.run import Run
from armdyn.threads import one_thread


class Study(ABC):
    """Base class of studies, which fit one model, with any effects of a catalogue, to runs.

    The least-squares problem contains every effect at its null value; a fit varies the unknowns of its effects. Models
    whose predictions are linear in most parameters are fitted by a `LinearStudy`, models that simulate a motion by a
    `StateSpaceStudy`; `make_study` makes one of them.

    Args:
        model: the model, with the effects that it has.
        runs: training runs.
        held_out: whole runs that are never fitted but help to choose effects.
        catalogue: effects that may be missing.
        exam: whole runs that are used for nothing else; only `exam_blocks` uses them.
        asked: names of effects to distinguish which the last run was designed; a small influence of these is enough.
        catalogue_size: number of effects from which the catalogue was chosen, if it is larger than the catalogue.
        settings: numbers that decide the answer.

    Raises:
        InputError: a run cannot be used; see `prepare_runs`.
    """

    later_ties: ClassVar[bool]
    """Whether a diagnosis is undecided if the effects of any step have rivals that fit as well, not only the first."""
    sums_predict: ClassVar[bool] = False
    """Whether one linearisation predicts the fit of any set of effects."""
    ignores_input_errors: ClassVar[bool] = False
    """Whether a residual near the noise may come from errors of the measured inputs, and is not a missing effect."""

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
        settings: Settings = DEFAULT_SETTINGS,
    ) -> None:
        self.model, self.settings = model, settings
        self.catalogue = tuple(catalogue)
        self.asked = frozenset(asked)
        self.catalogue_size = catalogue_size
        self.runs, self.held_out, self.exam = prepare_runs(model, runs, held_out, exam)
        everything = [*self.runs, *self.held_out, *self.exam]
        self.noise = noise_std_by_run_and_channel(model, everything)
        self.stated_noise = stated_noise(model, everything)
        self.model = model = self.suited(model)
        # The catalogue's effects come last: an effect of the model on some joints may be missing on others.
        self.recorded = frozenset(name for run in self.runs for name in run.all_channels)
        shown = [effect for effect in catalogue if model.can_show(effect, self.recorded)]
        self.effects = {effect.name: effect for effect in (*model.effects, *shown)}
        extended = self.with_whole_catalogue(model)
        self.problem = Problem(extended, self.runs, self.noise, self.settings)
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

    def suited(self, model: Model) -> Model:
        """The model as it predicts these runs."""
        return model

    def with_exact_steps(self, at: Fit) -> "Study | None":
        """The study with shorter steps of simulation, if a fit needs them; else None."""
        del at
        return None

    def with_whole_catalogue(self, model: Model) -> Model:
        """The model with all effects of the catalogue, the new ones at their null values and fixed."""
        return model.with_fixed_null_effects(self.effects.values())

    def with_other_catalogue(
        self, catalogue: Sequence[Effect], model: Model | None = None, catalogue_size: int = 0
    ) -> "Study":
        """A study of the same runs with other effects to choose from.

        Args:
            catalogue: effects that may be missing.
            model: another model; None keeps the model.
            catalogue_size: see `Study`.
        """
        return type(self)(
            self.model if model is None else model,
            self.runs,
            self.held_out,
            catalogue,
            self.exam,
            self.asked,
            catalogue_size,
            self.settings,
        )

    @one_thread
    def first(self) -> Fit:
        """The fit of the model as given, without added effects; it is computed once."""
        return self._first

    @cached_property
    def _first(self) -> Fit:
        return self._fit_as_given()

    @abstractmethod
    def _fit_as_given(self) -> Fit:
        """Fit the model as given."""

    @abstractmethod
    def fit_base_with_effects(self, effects: Sequence[Candidate], near: Fit, values: np.ndarray | None = None) -> Fit:
        """Fit the base model with some effects and no others.

        Args:
            effects: the effects.
            near: fit of a similar set of effects, from which start values follow.
            values: (P,) better start values, if they are known.
        """

    def with_thresholds(self, at: Fit) -> Fit:
        """A copy of a fit with the likeliest value of every threshold of absent effects, for an arm; else the fit."""
        return at

    @abstractmethod
    def explained_share(self, before: Fit, after: Fit) -> float:
        """Share of the squared error of the fit `before` that the fit `after`, with more effects, removes."""

    def model_error_weight(self, fit: Fit) -> float:
        """Weight of the model's own error in a residual, from 0 (only noise) to 1 (the noise does not matter)."""
        limit = self.settings.noise.stated_chi2
        return 1.0 - limit / max(limit, fit.chi2_per_sample)

    def scorer(self, at: Fit) -> LinearScorer | None:
        """Scorer of sets of effects, linearised at a fit; None for models that are not linear in most parameters."""
        del at
        return None

    def unidentified(self, fit: Fit) -> tuple[UnidentifiedCombination, ...]:
        """Combinations of parameters that the runs do not identify; empty for models that report this otherwise."""
        del fit
        return ()

    def leaves_noise(self, given: Fit, fit: Fit) -> bool | None:
        """Whether what a fit leaves is noise rather than an error of the model; None where other tests decide.

        Args:
            given: fit of the model as given, whose error is the measure of what is left.
            fit: the fit.
        """
        del given, fit
        return None

    def fit_has_failed(self, fit: Fit) -> bool:
        """Whether a fit has failed: it ended in a minimum that has nothing to do with the recordings."""
        del fit
        return False

    def remarks(self, fit: Fit) -> list[str]:
        """Sentences, without full stops, on suspected glitches, which count little, and on unusual predictions."""
        del fit
        return []

    def squared_error(self, fit: Fit) -> float:
        """Sum of `excess`: the squared error of a fit above the noise, relative to the noise variance."""
        return float(self.excess(fit).sum())

    def excess(self, fit: Fit) -> np.ndarray:
        """Mean squared error of a fit above the noise, relative to the noise variance, for each kind of runs.

        Returns:
            (1,) for training runs, or (2,) for training and held-out runs; not below what noise may have by chance.
        """
        excess, by_chance = self._excess(fit)
        return np.maximum(excess, by_chance)

    def chi2_by_stated_noise(self, blocks: Sequence[ResidualBlock]) -> tuple[float, int]:
        """Sum of squared errors over the stated noise variance, for samples whose recording states the noise.

        Returns:
            The sum, and the number of these samples.
        """
        stated = [(block, self.stated_noise.get((block.run, block.channel))) for block in blocks]
        known = [(block, std) for block, std in stated if std]
        chi2 = sum(float(block.misfit @ block.misfit) / std**2 for block, std in known)
        return chi2, sample_count([block for block, _ in known])

    def _excess(self, fit: Fit) -> tuple[np.ndarray, float]:
        """Mean squared error above the noise, over the noise, by kind of run, and the part due to chance."""
        kinds = [list(fit.blocks), self.held_out_blocks(fit) if self.held_out else []]
        samples = np.array([sample_count(kind) for kind in kinds if kind])
        means = np.array([chi2_sum(kind) for kind in kinds if kind]) / samples
        return means - 1.0, self.settings.noise.excess_stds * float(np.sqrt(2.0 / samples.min()))

    def model_with(self, effects: Collection[Candidate]) -> Model:
        """The base model with some effects of the catalogue and no others."""
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
        """The same fit for a smaller model, which has only the given and the fitted effects; it is faster."""
        fitted = {column.parameter.name for column, fits in zip(self.problem.columns, found.free, strict=True) if fits}
        used = group_by_effect(
            [a for c in self.candidates for a in c.split_by_joint() if not fitted.isdisjoint(a.names)]
        )
        problem = Problem(self.model_with((*self.present, *used)), self.runs, self.noise, self.settings)
        free = transfer_mask(found.free, self.problem, problem)
        return Fit(problem, free, transfer_values(found.values, self.problem, problem), found.blocks, found.outcome)

    def values_predicted_by_scorer(self, scorer: EffectSetScorer, one: EffectSetScore) -> np.ndarray:
        """(P,) values of the study's unknowns that a scorer predicts for a set of effects."""
        return self.own(scorer.values(one), scorer.problem)

    def own(self, values: np.ndarray, problem: Problem) -> np.ndarray:
        """(P,) values of the study's unknowns, transferred from those of another problem of the same model."""
        return transfer_values(values, problem, self.problem)

    def scores(self, at: Fit, effects: Sequence[Candidate]) -> list[ScoreTest]:
        """Predicted contributions to a fit of all effects that are not in `effects`, or not on all joints."""
        taken = {name for c in effects for name in c.names}
        left = (c.without_parameters(taken) for c in (*self.candidates, *self.present))
        return score_tests(at, [c for c in left if c.names])

    def tests(self, at: Fit, effects: Sequence[Candidate]) -> ResidualTests:
        """Test the residual of a fit with some effects against noise and against all other effects."""
        return residual_tests(at, self.scores(at, effects))

    def held_out_blocks(self, found: Fit) -> list[ResidualBlock]:
        """Residuals of the held-out runs; if there are none, of every training run as predicted from the others."""
        return joined_residual_blocks(self.held_out_predictions(found))

    def held_out_predictions(self, found: Fit) -> list[Fit]:
        """Predictions of the held-out runs; if there are none, of every training run from the others."""
        if found not in self._held_out:
            self._held_out[found] = (
                self._of_held_out(found) if self.held_out else self.leave_one_run_out_predictions(found)
            )
        return self._held_out[found]

    def _of_held_out(self, found: Fit) -> list[Fit]:
        return self._predictions(found, self.held_out)

    def _predictions(self, found: Fit, runs: Sequence[Run]) -> list[Fit]:
        return predict_runs(found, runs)

    def cross_predictions_of_training(self, found: Fit) -> list[Fit]:
        """Predictions of training runs from each other, in addition to those of held-out runs; empty by default."""
        del found
        return []

    def leave_one_run_out_predictions(self, found: Fit) -> list[Fit]:
        """Predictions of every training run from the other training runs; an empty list for a single run."""
        if found not in self._in_turn:
            self._in_turn[found] = leave_one_out_predictions(found)
        return self._in_turn[found]

    def blocks_by_role(self, found: Fit) -> dict[str, list[ResidualBlock]]:
        """Residuals of all recordings by their role, as in `recordings`; to be used only after all choices are made."""
        held_out = self.held_out_blocks(found) if self.held_out else []
        return {"training": list(found.blocks), "held_out": held_out, "exam": self.exam_blocks(found)}

    @property
    def recordings(self) -> list[tuple[Run, str]]:
        """All recordings as they were before preparation, each with its role: training, held_out or exam."""
        roles = {"training": self.runs, "held_out": self.held_out, "exam": self.exam}
        return [(run.recording, role) for role, runs in roles.items() for run in runs]

    @property
    def holdout_kinds(self) -> tuple[HoldoutKind, ...]:
        """Kinds of runs on which the model's error is measured in addition to training runs, the least used first."""
        several = HoldoutKind.LEAVE_ONE_OUT if len(self.runs) > 1 else HoldoutKind.TRAINING
        others = HoldoutKind.HELD_OUT if self.held_out else several
        return (HoldoutKind.EXAM, others) if self.exam else (others,)

    def exam_blocks(self, found: Fit) -> list[ResidualBlock]:
        """Residuals of the exam runs, empty if there are none; to be used only after all choices are made."""
        return joined_residual_blocks(self.exam_predictions(found))

    def exam_predictions(self, found: Fit) -> list[Fit]:
        """Predictions of the exam runs; to be used only after all choices are made."""
        if found not in self._exam:
            self._exam[found] = self._predictions(found, self.exam)
        return self._exam[found]
