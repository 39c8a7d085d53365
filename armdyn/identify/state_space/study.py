"""Fits of a model that simulates a motion: fits of whole runs start from the measured motion."""

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property
from itertools import chain, tee

import numpy as np

from armdyn.estimation.expansion import QuadraticExpansion
from armdyn.identify.failed_fit import residual_variance_ratio
from armdyn.identify.fit import Fit
from armdyn.identify.holdout import predict_runs
from armdyn.identify.problem import Problem, transfer_mask, transfer_values
from armdyn.identify.selection.candidate import Candidate
from armdyn.identify.state_space.motion_start import find_start_state, find_start_states
from armdyn.identify.state_space.output_error import (
    OTHER_START_VALUES_TRIED,
    EffectSetOptimiser,
    best_fit,
    every_run_has_motion,
    fit_run,
)
from armdyn.identify.study import Study
from armdyn.identify.unidentified import UnidentifiedCombination, find_unidentified_combinations
from armdyn.model import Model
from armdyn.physics.simulated import as_simulated_model
from armdyn.run import Run

MAX_LISTED_GLITCHES = 5
"""Largest number of times of glitches that a sentence lists."""


class StateSpaceStudy(Study):
    """Fits a model that simulates a motion, with any effects, to runs; see `Study`."""

    later_ties = True
    ignores_input_errors = True

    def suited(self, model: Model) -> Model:
        """See `Study`; an unstable process is followed in pieces."""
        return as_simulated_model(model).suited_to(self.runs, self.noise)

    def with_exact_steps(self, at: Fit) -> Study | None:
        """See `Study`; a contact that effects bring may need shorter steps than the model as given."""
        problem = at.problem
        model = as_simulated_model(problem.model)
        thetas = [problem.theta(i, at.values) for i in range(len(problem.runs))]
        refinement = model.refined_for(problem.runs, problem.noise, thetas).following.refinement
        if refinement == model.following.refinement:
            return None
        begun = as_simulated_model(self.model)
        exact = replace(begun, following=replace(begun.following, refinement=refinement))
        return self.with_other_catalogue(self.catalogue, exact, self.catalogue_size)

    @cached_property
    def motion(self) -> EffectSetOptimiser:
        """Optimiser of sets of effects around the measured motion of all runs.

        Where the motion was not measured, the start state of each run is searched first.
        """
        everything = Problem(self.problem.model, [*self.runs, *self.held_out], self.noise, self.settings)
        present = everything.mask_of_unknowns(self.present_names)
        options = [everything.start_values()]
        if not every_run_has_motion(everything):
            alone = Problem(self.model, everything.runs, self.noise, self.settings)
            found = reversed(find_start_states(alone, alone.start_values()))
            options = [transfer_values(values, alone, everything) for values in found]
        motion = EffectSetOptimiser(everything, len(self.runs), present, options)
        self.problem.set_thresholds(motion.threshold_values)
        return motion

    @cached_property
    def _starts(self) -> dict[frozenset[str], Iterator[np.ndarray]]:
        """Start values by names of the effects' parameters, (P,) of `motion.problem`; iterate over a copy."""
        return {}

    @cached_property
    def _started(self) -> dict[Fit, tuple[Iterator[np.ndarray], int]]:
        """Start values, as in `_starts`, and number of further starts, by the fit that began there."""
        return {}

    @cached_property
    def _fits(self) -> dict[tuple[frozenset[str], int], Fit]:
        """Fits by names of the effects' parameters and number of further starts."""
        return {}

    def _fit_as_given(self) -> Fit:
        return self._fit_around(self.present, OTHER_START_VALUES_TRIED)

    def fit_base_with_effects(
        self, effects: Sequence[Candidate], near: Fit | None = None, values: np.ndarray | None = None
    ) -> Fit:
        """Fit the base model with some effects and no others to whole runs, from the measured motion.

        Args:
            effects: the effects.
            near: not used.
            values: not used.
        """
        del near, values
        return self._fit_around(effects, OTHER_START_VALUES_TRIED)

    def quick_fit(self, effects: Sequence[Candidate]) -> Fit:
        """Fit the base model with some effects quickly, to rank them: from few start values, even with large errors."""
        return self._fit_around(effects, 0)

    def _fit_around(self, effects: Sequence[Candidate], others: int) -> Fit:
        """The fit of these effects from the measured motion; see `best_fit` for `others`."""
        motion, names = self.motion, {name for c in effects for name in c.names}
        key = frozenset(names), others
        if key in self._fits:
            return self._fits[key]
        own = motion.problem.mask_of_unknowns(self.present_names)
        fitted = motion.problem.mask_of_unknowns(list(names)) & ~(own & ~motion.problem.fitted)
        free = (motion.base & ~own | fitted) & motion.influential
        if key[0] not in self._starts:
            (self._starts[key[0]],) = tee(motion.start_values(free), 1)
        starts, point = self._starts[key[0]], motion.optimised_point(free)
        places = chain(copy(starts), motion.rescaled_start_values(free, copy(starts)))
        own_starts = motion.start_unknowns & (as_simulated_model(self.model).following.restart is None)
        fitted = transfer_mask(free | own_starts, motion.problem, self.problem)
        found = best_fit(self.problem, fitted, (self.own(values, motion.problem) for values in places), others)
        if (
            others
            and found.chi2_per_sample > self.settings.noise.minimum_chi2
            and (likely := motion.likeliest_start_values(free))
        ):
            other = best_fit(self.problem, fitted, [self.own(v, motion.problem) for v in likely], others)
            found = min(found, other, key=lambda one: one.cost)
        if point is not None:
            found = replace(found, process_noise_values=self.own(point.values, motion.problem))
        self._started[found] = starts, others
        self._fits[key] = found
        return found

    def left(self, effects: Sequence[Candidate]) -> float:
        """Squared error of whole runs (see `squared_error`) with some effects, from a quick fit.

        It is rounded to four digits, so that of effects with equal influence, such as two frictions of a fixed pivot,
        the first one of the catalogue is preferred.
        """
        return float(f"{self.squared_error(self.quick_fit(effects)):.4g}")

    def move_thresholds(self, free: np.ndarray) -> list[str]:
        """Search thresholds anew beside a set of effects; see `EffectSetOptimiser.move_thresholds`."""
        moved = self.motion.move_thresholds(free)
        self.problem.set_thresholds(self.motion.threshold_values)
        for starts in [key for key in self._starts if not key.isdisjoint(moved)]:
            del self._starts[starts]
        for fitted in [key for key in self._fits if not key[0].isdisjoint(moved)]:
            del self._fits[fitted]
        return moved

    def foretold_costs(self, effects: Sequence[Candidate], further: Sequence[Candidate]) -> dict[Candidate, float]:
        """Foretell the cost of a set of effects with each of some further ones, without a fit.

        Whole training runs are linearised once, at the quick fit of the set; each further effect then promises the cost
        at the minimum of its own quadratic, rounded as `left` is.

        Args:
            effects: the set.
            further: further effects, each of which is added alone.
        """
        problem, found = self.problem, self.quick_fit(effects)
        free = {c: found.free | problem.mask_of_unknowns(c.names) for c in further}
        every = found.free | problem.mask_of_unknowns([name for c in further for name in c.names])
        values = np.where(every & ~found.free, problem.null, found.values)
        whole = problem.expansion(values, every)
        return {c: _foretold_cost(problem, values, whole, every, own) for c, own in free.items()}

    def residual_may_be_noise(self, fit: Fit) -> bool:
        """Whether the residual of a fit may be noise alone, in training and in held-out runs."""
        noise = self.settings.noise
        excess, by_chance = self._excess(fit)
        return bool(np.all(excess <= noise.chance_excess_stds / noise.excess_stds * by_chance))

    def explained_share(self, before: Fit, after: Fit) -> float:
        """Share of the squared error of the fit `before` that the fit `after` removes, on training and held-out runs.

        Held-out runs alone may be too short for a reliable estimate of their noise.
        """
        return 1.0 - self.squared_error(after) / self.squared_error(before)

    def model_error_weight(self, fit: Fit) -> float:
        """Weight of the model's own error in a residual, 0 to 1; see `Study.model_error_weight`.

        It is 1 where the motion was measured: there, the evidence with process noise distinguishes coloured noise from
        a missing effect.
        """
        return 1.0 if self.motion.motion_measured else super().model_error_weight(fit)

    def unidentified(self, fit: Fit) -> tuple[UnidentifiedCombination, ...]:
        """Combinations of parameters that the runs do not identify; see `find_unidentified_combinations`."""
        return find_unidentified_combinations(fit)

    def fit_has_failed(self, fit: Fit) -> bool:
        """Whether a fit has failed: its residual varies nearly as much as the signals (see `residual_variance_ratio`).

        A residual that is only noise is not a failure: in a recording without motion the signal itself is only noise.
        """
        if fit.chi2_per_sample < self.settings.noise.minimum_chi2:
            return False
        if not residual_variance_ratio(fit.blocks) <= self.settings.verdict.lost_share:
            return True
        return bool(self.held_out) and not residual_variance_ratio(self.held_out_blocks(fit)) <= 1.0

    def remarks(self, fit: Fit) -> list[str]:
        """See `Study.remarks`."""
        said = as_simulated_model(self.model).following.remark
        motion, found = self.motion, [said] if said else list[str]()
        free = transfer_mask(fit.free, fit.problem, motion.problem)
        for run, weights in zip(motion.box.runs, motion.sample_weights(free & ~motion.start_unknowns), strict=True):
            for channel, weight in zip(run.channels, weights, strict=True):
                when = run.run.channels[channel].time[weight > 1.0]
                if len(when):
                    times = ", ".join(f"{t:.4g}" for t in when[:MAX_LISTED_GLITCHES]) + (
                        ", ..." if len(when) > MAX_LISTED_GLITCHES else ""
                    )
                    found.append(
                        f"{run.run.name}: {channel}: {len(when)} of {len(weight)} samples lie far off "
                        f"and count little in the choice of effects: at {times} s"
                    )
        return found

    def _of_held_out(self, found: Fit) -> list[Fit]:
        if found not in self._started:
            return super()._of_held_out(found)
        problem, (starts, others) = self.motion.problem, self._started[found]

        def fit_own(alone: Problem, start: np.ndarray, own: np.ndarray, free: np.ndarray) -> Fit:
            each = (np.where(own, transfer_values(v, problem, alone), start) for v in copy(starts))
            return best_fit(alone, free, each, others)

        return predict_runs(found, self.held_out, fit_own)

    def _predictions(self, found: Fit, runs: Sequence[Run]) -> list[Fit]:
        def fit_own(alone: Problem, start: np.ndarray, own: np.ndarray, free: np.ndarray) -> Fit:
            del own
            return fit_run(alone, start if every_run_has_motion(alone) else find_start_state(alone, start, free), free)

        return predict_runs(found, runs, fit_own)


def _foretold_cost(
    problem: Problem, values: np.ndarray, whole: QuadraticExpansion, every: np.ndarray, own: np.ndarray
) -> float:
    """Cost of a fit at the minimum of an expansion at (P,) values by (P,) bool unknowns `every`, if `own` change."""
    part = own[every]
    quadratic = QuadraticExpansion(whole.cost, whole.gradient[part], whole.hessian[np.ix_(part, part)])
    room = (problem.lower - values)[own], (problem.upper - values)[own]
    step = np.clip(quadratic.step(*room, 0.0)[0], *room)
    cost = 2.0 * (quadratic.cost + quadratic.gradient @ step) + step @ quadratic.hessian @ step
    return float(f"{cost:.4g}") if np.isfinite(cost) else np.inf
