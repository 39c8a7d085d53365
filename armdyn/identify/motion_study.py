"""Fits of an arm's simulated motion, for arms whose servos do not measure their torque."""

from collections import Counter, defaultdict
from copy import copy
from dataclasses import replace
from itertools import pairwise

import numpy as np

from armdyn.arm.closed_loop.motion_model import SIMULATION_STEPS_SECONDS, MotionModel
from armdyn.identify.fit import Fit, fit, run_duration
from armdyn.identify.linear_study import LinearStudy
from armdyn.identify.problem import Problem
from armdyn.identify.selection.candidate import Candidate
from armdyn.model import Model

INDEPENDENT_ERROR_SECONDS = 1.0
"""Length of a stretch of a recording, s, with errors that are independent of the next. With 5 s the load friction and
the rotor of an XL330 are not found (held out 62 instead of 42 mrad); the correlation time of the residuals is minutes
where a joint follows a slow wave."""
MAX_FIT_STEPS, FIT_TOLERANCE_STDS = 4, 0.1
"""Largest number of steps of the other fits, and length of a step, in standard deviations, that is not worth the time:
each step simulates all recordings."""
MAX_GIVEN_FIT_STEPS = 3
"""Largest number of steps of the fit of gain and delay alone, which cannot make up for the friction that is missing."""


MAX_STEP_ERROR_NATS = 0.5
"""Largest error of one joint's simulation with a step, in nats of a fit: a value may move by a standard deviation."""
MAX_STEP_ERROR_SHARE, MAX_NOISE_RATIO = 0.2, 1.2
"""Largest error of a step over the model's own, which is what is left beyond so many variances of the noise."""
USUAL_FRICTIONS = ("joint_viscous_friction", "joint_coulomb_friction")
"""Frictions that most servos have, in which a simulation sticks and slides."""


class MotionStudy(LinearStudy):
    """Fits of an arm's simulated motion; see `Study`.

    Attributes:
        read: another answer to the same question, with which a search may begin.
        begins_with_usual_effects: whether a search may begin with effects that servo arms usually have.
    """

    most_steps, tolerance, indirect_steps = MAX_FIT_STEPS, FIT_TOLERANCE_STDS, 0
    read: Model | None = None
    begins_with_usual_effects = True

    def suited_step(self, found: Fit) -> float:
        """The longest step of the simulation, s, whose error is small beside the model's own at a fit.

        The error of a joint that follows to the noise moves no value by what its runs can tell.
        """
        problem, noise = self.problem, (found.problem if found.weighted is None else found.weighted).noise
        assert isinstance(problem.model, MotionModel)
        own = defaultdict[str, float](float)
        for block in found.blocks:
            sensor = self.noise[block.run, block.channel]
            excess = float(block.misfit @ block.misfit) - MAX_NOISE_RATIO * len(block.misfit) * sensor**2
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

    def beginning_with(self, read: Model, *, usual: bool = True) -> "MotionStudy":
        """The same study, whose search of effects may begin with another answer, or with usual effects as well."""
        study = copy(self)
        study.read, study.begins_with_usual_effects = read, usual
        return study

    def read_start(self) -> tuple[tuple[Candidate, ...], np.ndarray]:
        """Effects of the answer with which a search may begin, none without one, and (P,) values."""
        problem, values = self.problem, self.problem.start_values()
        known = {} if self.read is None else {n: p for n, p in self.read.parameters.items() if n in problem.model.names}
        for name, p in known.items():
            values[problem.mask_of_unknowns([name])] = p.value
        own = {name for name, p in known.items() if p.effect and p.fitted}
        parts = [c.without_parameters(set(c.names) - own) for c in self.candidates]
        return tuple(c for c in parts if c.names), values

    def _fit_as_given(self) -> Fit:
        wanted = self.problem.fitted & self.problem.mask_of_unknowns(self.model.names)
        return fit(
            self.problem, wanted, self.problem.start_values(), most_steps=MAX_GIVEN_FIT_STEPS, tolerance=self.tolerance
        )

    def cross_predictions_of_training(self, found: Fit) -> list[Fit]:
        """None: each would need a fit of its own, and held-out runs are simulated as whole motions."""
        del found
        return []

    @property
    def independent_errors(self) -> float:
        """See `LinearStudy.independent_errors`: a servo pulls an arm back in a moment, so that errors are forgotten."""
        return max(sum(map(run_duration, self.runs)) / INDEPENDENT_ERROR_SECONDS, 1.0)

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
