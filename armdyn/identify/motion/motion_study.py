"""Fits of an arm's simulated motion, for arms whose servos do not measure their torque."""

from collections import Counter, defaultdict
from copy import copy
from dataclasses import replace
from itertools import pairwise

import numpy as np

from armdyn.arm.closed_loop.motion_model import SIMULATION_STEPS_SECONDS, MotionModel
from armdyn.arm.slots import DAMPING, FRICTION, LINK, simplest_effect
from armdyn.identify.fit import Fit, fit, run_duration
from armdyn.identify.linear_study import LinearStudy
from armdyn.identify.problem import Problem
from armdyn.identify.selection.candidate import Candidate
from armdyn.identify.selection.linear_scorer import LinearScorer
from armdyn.identify.selection.set_score import EffectSetScore, EffectSetScorer
from armdyn.model import Model
from armdyn.parameter import Prior

MAX_FIT_STEPS, FIT_TOLERANCE_STDS = 4, 0.1
"""Largest number of steps of the other fits, and length of a step, in standard deviations, that is not worth the time:
each step simulates all recordings."""
START_SHARES = (1.0, 0.5, 0.2, 0.05)
"""Shares of a predicted change of all values that are tried as the start of a fit."""
MAX_GIVEN_FIT_STEPS = 3
"""Largest number of steps of the fit of gain and delay alone, which cannot make up for the friction that is missing."""


MAX_STEP_ERROR_NATS = 0.5
"""Largest error of one joint's simulation with a step, in nats of a fit: a value may move by a standard deviation."""
MAX_STEP_ERROR_SHARE = 0.2
"""Largest error of a step over the model's own, which is what is left beyond the noise."""
LINKS = frozenset({simplest_effect(LINK).name})
"""Effect on links, of which those that the model does not change are known by their description."""
USUAL_FRICTIONS = tuple(simplest_effect(slot).name for slot in (DAMPING, FRICTION))
"""Frictions that most servos have, in which a simulation sticks and slides."""


class MotionStudy(LinearStudy):
    """Fits of an arm's simulated motion; see `Study`.

    Attributes:
        answer: an answer with longer steps, with which a search begins; None begins with usual effects.
        sensed: the model with the effects that wrenches alone show, which are among those; None without a wrench.
    """

    most_steps, tolerance, indirect_steps = MAX_FIT_STEPS, FIT_TOLERANCE_STDS, 0
    uncertain, leaves_out = LINKS, False
    answer: Model | None = None
    sensed: Model | None = None

    def with_whole_catalogue(self, model: Model) -> Model:
        """See `Study`; links that the model does not change are known by their description."""
        whole = super().with_whole_catalogue(model)
        links = {n: p for n, p in whole.parameters.items() if p.effect in self.uncertain and n not in model.parameters}
        known = {
            n: replace(p, prior=Prior(p.null, self.settings.search.link_width * p.typical)) for n, p in links.items()
        }
        return whole.with_parameters(known)

    def suited_step(self, found: Fit) -> float:
        """The longest step of the simulation, s, whose error is small beside the model's own at a fit.

        The error of a joint that follows to the noise moves no value by what its runs can tell.
        """
        problem, noise = self.problem, (found.problem if found.weighted is None else found.weighted).noise
        assert isinstance(problem.model, MotionModel)
        own = defaultdict[str, float](float)
        for block in found.blocks:
            sensor = self.noise[block.run, block.channel]
            excess = (
                float(block.misfit @ block.misfit) - self.settings.noise.variance_ratio * len(block.misfit) * sensor**2
            )
            own[block.channel] += max(excess, 0.0)
        for step, finer in pairwise(SIMULATION_STEPS_SECONDS):
            coarse, fine = (replace(problem.model, step=longest) for longest in (step, finer))
            nats, square = (defaultdict[str, float](float) for _ in range(2))
            for i, run in enumerate(problem.runs):
                theta = problem.theta(i, found.values)
                there, here = (model.predict_values(run, theta) for model in (coarse, fine))
                for channel, values in there.items():
                    square[channel] += float(np.sum((values - here[channel]) ** 2))
                    nats[channel] += 0.5 * float(np.sum(((values - here[channel]) / noise[run.name, channel]) ** 2))
            if all(
                nats[channel] <= MAX_STEP_ERROR_NATS or square[channel] <= MAX_STEP_ERROR_SHARE**2 * own[channel]
                for channel in nats
            ):
                return step
        return SIMULATION_STEPS_SECONDS[-1]

    def beginning_with(self, answer: Model) -> "MotionStudy":
        """The same study, whose search of effects begins with an answer."""
        study = copy(self)
        study.answer = answer
        return study

    def effects_of_answer(self, answer: Model) -> tuple[tuple[Candidate, ...], np.ndarray]:
        """Named effects of an answer with which a search begins, and (P,) values."""
        problem, values = self.problem, self.problem.start_values()
        known = {n: p for n, p in answer.parameters.items() if n in problem.model.names}
        for name, p in known.items():
            values[problem.mask_of_unknowns([name])] = p.value
        own = {name for name, p in known.items() if p.effect and p.fitted and p.effect not in self.uncertain}
        parts = [c.without_parameters(set(c.names) - own) for c in self.candidates]
        return tuple(c for c in parts if c.names), values

    def _fit_as_given(self) -> Fit:
        wanted = self.problem.fitted & self.problem.mask_of_unknowns(self.model.names)
        return fit(
            self.problem, wanted, self.problem.start_values(), most_steps=MAX_GIVEN_FIT_STEPS, tolerance=self.tolerance
        )

    def values_predicted_by_scorer(self, scorer: EffectSetScorer, one: EffectSetScore) -> np.ndarray:
        """See `Study`; as far along the way as the simulated motion follows the linear prediction."""
        assert isinstance(scorer, LinearScorer)
        free = np.zeros(len(self.problem.columns), dtype=bool)
        tried = [self.own(scorer.values_part_way(one, share), scorer.problem) for share in START_SHARES]
        return min(tried, key=lambda values: np.nan_to_num(self.problem.cost(values, free), nan=np.inf))

    def worth(self, scorer: LinearScorer, at: Fit, one: EffectSetScore, scale: LinearScorer) -> float:
        """See `LinearStudy.worth`; training runs are judged by their fit, and freedom costs what it does in evidence.

        The linear scores that propose a set do not charge it, since they promise too little where a motion bends.
        """
        del scorer
        errors = scale.mean_squared_errors_of(at.blocks, self.held_out_blocks(at))
        price = scale.complexity_penalty(one.effects) + one.occam_penalty_nats + scale.unnamed_nats(at)
        return scale.log_likelihood(errors) - price

    def cross_predictions_of_training(self, found: Fit) -> list[Fit]:
        """None: each would need a fit of its own, and held-out runs are simulated as whole motions."""
        del found
        return []

    @property
    def independent_errors(self) -> float:
        """See `LinearStudy.independent_errors`: a servo pulls an arm back in a moment, so that errors are forgotten."""
        return max(sum(map(run_duration, self.runs)) / self.settings.noise.servo_error_seconds, 1.0)

    def coarsely_weighted(self, before: Fit) -> Problem:
        """The problem with the error of a fit as noise, by channel, and as many samples as are independent."""
        errors, counts = before.rmse(), Counter[str]()
        for block in before.blocks:
            counts[block.channel] += len(block.residual)
        noise = {
            (run, channel): errors[channel] * (counts[channel] / self.independent_errors) ** 0.5
            for run, channel in self.noise
            if channel in errors
        }
        return self.problem.with_weights(noise, np.full(len(self.problem.columns), np.inf))
