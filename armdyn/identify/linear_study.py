"""Fits of a model whose predictions are linear in most parameters, such as an arm's."""

from collections.abc import Collection, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property

import numpy as np

from armdyn.identify.explained_share import ChannelScale, explained_error_share
from armdyn.identify.fit import Fit, channel_rmse, continue_fit, fit, identifiable
from armdyn.identify.problem import Problem, transfer_mask, transfer_values
from armdyn.identify.residual.repetition import repeated_square
from armdyn.identify.selection.candidate import Candidate
from armdyn.identify.selection.linear_scorer import LinearScorer
from armdyn.identify.selection.set_score import EffectSetScore
from armdyn.identify.selection.sums import INDIRECT_UNKNOWN_FIT_STEPS, sums, with_thresholds
from armdyn.identify.study import Study
from armdyn.identify.uncertainty import model_error_dominates

MAX_ADDED_EFFECT_FIT_STEPS = 8
"""Largest number of steps of a fit with added effects."""
FIT_TOLERANCE_STDS = 0.02
"""Length of a step, in standard deviations, below which such a fit has converged."""
CACHED_SCORERS = 3
"""Number of scorers that are cached, the most recently used ones."""


class LinearStudy(Study):
    """Fits a model whose predictions are linear in most parameters, with any effects, to runs; see `Study`.

    Attributes:
        uncertain: see `LinearScorer`.
        leaves_out: see `LinearScorer`.
    """

    most_steps, tolerance = MAX_ADDED_EFFECT_FIT_STEPS, FIT_TOLERANCE_STDS
    indirect_steps = INDIRECT_UNKNOWN_FIT_STEPS
    later_ties = False
    sums_predict = True
    uncertain: Collection[str] = ()
    leaves_out = True

    @property
    def independent_errors(self) -> float:
        """Number of independent samples of the model's own error in one channel."""
        return self.settings.noise.model_errors

    @cached_property
    def _scorers(self) -> dict[Fit, LinearScorer]:
        return {}

    def with_values_held(self, names: Collection[str]) -> "LinearStudy":
        """A study in which some values of absent effects stay at null, whatever effects are chosen."""
        study = copy(self)
        left = [c.without_parameters(names) for c in self.candidates]
        study.candidates = tuple(c for c in left if c.names)
        study.__dict__.pop("_scorers", None)
        return study

    def _fit_as_given(self) -> Fit:
        wanted = self.problem.fitted & self.problem.mask_of_unknowns(self.model.names)
        free = identifiable(self.problem, wanted, self.problem.start_values())
        found = fit(self.problem, free, self.problem.start_values())
        again = identifiable(self.problem, wanted, found.values)
        found = found if np.array_equal(again, free) else fit(self.problem, again, found.values)
        far = bool(self.present) and bool(np.any(found.free)) and model_error_dominates(self, found)
        return self._with_model_error(found) if far else found

    def _with_model_error(self, found: Fit) -> Fit:
        """The fit of the same unknowns in which the model's own error counts as it does in fits of added effects."""
        scorer = self.scorer(found)
        free = transfer_mask(found.free, self.problem, scorer.problem)[scorer.columns]
        return continue_fit(
            self.fit_with_prior_widths(scorer, scorer.prior_widths(scorer.given, 0.0) * free, found.values)
        )

    def fit_base_with_effects(self, effects: Sequence[Candidate], near: Fit, values: np.ndarray | None = None) -> Fit:
        """Fit the base model with some effects and no others.

        Args:
            effects: the effects.
            near: fit at which the model is linearised to predict start values.
            values: (P,) start values, if they are known.
        """
        if values is None:
            scorer = self.scorer(near)
            values = self.values_predicted_by_scorer(scorer, scorer.evaluate(scorer.split_into_candidates(effects)))
        scorer = self.scorer(near)
        widths = scorer.prior_widths(scorer.split_into_candidates(effects), 0.0)
        return self.fit_with_prior_widths(scorer, widths, values)

    def fit_with_prior_widths(self, scorer: LinearScorer, widths: np.ndarray, values: np.ndarray) -> Fit:
        """Fit the whole model with the weights of a scorer, in which the model's own error counts as it repeats itself.

        Args:
            scorer: the scorer.
            widths: (c,) prior widths of the scorer's unknowns, in typical sizes; an unknown of width 0 is not fitted.
            values: (P,) start values.
        """
        moving, std = widths > 0.0, np.zeros(len(scorer.problem.columns))
        std[scorer.columns[moving]] = widths[moving] * scorer.typical[moving]
        std = transfer_values(std, scorer.problem, self.problem, missing=0.0)
        weighted = self.problem.with_weights(scorer.effective_noise, np.where(std > 0.0, std, np.inf))
        return fit(
            self.problem, std > 0.0, values, most_steps=self.most_steps, tolerance=self.tolerance, weighted=weighted
        )

    def with_thresholds(self, at: Fit) -> Fit:
        """A copy of a fit with the likeliest value of every threshold of absent effects; predictions do not change."""
        absent = [atom for c in self.candidates for atom in c.split_by_joint()]
        values, _ = with_thresholds(self.problem, {run.name for run in self.runs}, at.values, absent, at.free)
        return replace(at, values=values)

    def explained_share(self, before: Fit, after: Fit) -> float:
        """Share of the squared error of the fit `before` that the fit `after` removes; on held-out runs, if any."""
        first, last = (self.held_out_blocks(one) if self.held_out else one.blocks for one in (before, after))
        return explained_error_share(channel_rmse(first), channel_rmse(last), ChannelScale.of(first))

    def cross_predictions_of_training(self, found: Fit) -> list[Fit]:
        """Predictions of training runs from each other, if there are held-out runs as well; else an empty list."""
        return self.leave_one_run_out_predictions(found) if self.held_out else []

    def leaves_noise(self, given: Fit, fit: Fit) -> bool:
        """Whether what a fit leaves is noise: nothing in it that repeats itself in other runs is worth a name.

        Args:
            given: fit of the model as given.
            fit: the fit.
        """
        # Noise with a longer memory than any sensor's has to be small beside the misfit as given.
        share = self.settings.noise.repeated_share
        coloured = fit.chi2_per_sample <= self.settings.noise.estimated_chi2
        others, errors = self.held_out_predictions(fit), channel_rmse(fit.blocks)
        return all(
            repeated_square(channel, [fit], others) <= share * error**2
            and (coloured or errors[channel] ** 2 <= share * error**2)
            for channel, error in channel_rmse(given.blocks).items()
        )

    def worth(self, scorer: LinearScorer, at: Fit, one: EffectSetScore, scale: LinearScorer) -> float:
        """Log likelihood, nats, of what a set predicts of runs to which it was not fitted, less its complexity.

        Args:
            scorer: scorer that is linearised at the fit of the set.
            at: this fit.
            one: the set, with its score by this scorer.
            scale: scorer with the errors that count, so that several sets are comparable.
        """
        del at
        errors = scorer.prediction_errors(scorer.prior_widths(one.effects, 0.0))
        return scale.log_likelihood(errors) - scale.complexity_penalty(one.effects)

    def scorer(self, at: Fit) -> LinearScorer:
        """Scorer of sets of effects, linearised at a fit; the last few are cached."""
        found = self._scorers.pop(at, None)
        if found is None:
            found = self._scorer_around(at)
        self._scorers[at] = found
        if len(self._scorers) > CACHED_SCORERS:
            del self._scorers[next(iter(self._scorers))]
        return found

    def _scorer_around(self, at: Fit) -> LinearScorer:
        everything = Problem(self.problem.model, [*self.runs, *self.held_out], self.noise, self.settings)
        values = transfer_values(at.values, self.problem, everything)
        free = transfer_mask(at.free, self.problem, everything)
        present = everything.mask_of_unknowns([n for c in self.present for n in c.names])
        own = [
            a
            for c in self.present
            for a in c.split_by_joint()
            if np.all(everything.fitted[everything.mask_of_unknowns(a.names)])
        ]
        present &= ~everything.mask_of_unknowns([n for c in own for n in c.names])
        atoms = [*own, *(atom for c in self.candidates for atom in c.split_by_joint())]
        absent = [c for c in atoms if not np.any(free & everything.mask_of_unknowns(c.names))]
        around = sums(everything, {run.name for run in self.runs}, values, absent, free, self.indirect_steps)
        always = everything.fitted & (present | ~everything.is_effect) & (free | everything.per_run)
        return LinearScorer(
            around, always, atoms, own, self.catalogue_size, self.independent_errors, self.uncertain,
            leaves_out=self.leaves_out,
        )  # fmt: skip
