"""Estimation while data arrive: least squares over everything so far, started from the last estimate."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Generic, Literal, TypeVar

import numpy as np

from armdyn.errors import InputError
from armdyn.identify.least_squares import Estimate, LeastSquares, gradient_descent, levenberg_marquardt
from armdyn.identify.noise import variance_inflation
from armdyn.model import Model
from armdyn.run import Channel, Run

ModelT = TypeVar("ModelT", bound=Model)
Method = Literal["levenberg_marquardt", "gradient_descent"]
METHODS: Mapping[str, Callable[..., Estimate]] = {
    "levenberg_marquardt": levenberg_marquardt,
    "gradient_descent": gradient_descent,
}


class Estimator(Generic[ModelT]):
    """Batch least squares on a growing recording.

    A cold start on a long recording falls into one of many minima (one up to 3 s, ten at 10 s for a 0.37 m pendulum);
    started at 1 s and followed from there, the estimate stays in the right one.

    Args:
        model: its values are the first guess; its `fitted` parameters are free, with their priors and bounds.
        noise: standard deviation per channel, in the channel's unit.
        method: ``"levenberg_marquardt"``, or ``"gradient_descent"`` as in the paper.
    """

    def __init__(self, model: ModelT, noise: Mapping[str, float], method: Method = "levenberg_marquardt") -> None:
        if method not in METHODS:
            raise InputError(f"unknown method '{method}': choose one of {', '.join(METHODS)}")
        self._minimise = METHODS[method]
        self.model: ModelT = model
        self.noise = dict(noise)
        self.estimate: Estimate | None = None

    def update(self, run: Run) -> Estimate:
        """Estimate from all data so far; `model` then holds the new values."""
        problem = LeastSquares(self.model, [run], self.noise)
        self.estimate = self._minimise(problem)
        self.model = self.model.with_values(dict(zip(self.estimate.names, self.estimate.values.tolist(), strict=True)))
        return self.estimate

    def widening(self, run: Run) -> float:
        """Factor on the standard deviations for what white noise of the assumed size does not explain, at least 1.

        The root of `variance_inflation` of the worst channel. Friction that shakes the arm, and a string that
        stretches, leave correlated errors.
        """
        prediction = self.model.predict(run, self.model.theta())
        residuals = [
            (run.channels[channel].value - prediction.values[rows]) / self.noise[channel]
            for channel, rows in prediction.slices.items()
        ]
        return float(np.sqrt(max([1.0, *(variance_inflation([residual]) for residual in residuals)])))


def until(run: Run, end: float) -> Run:
    """The part of a run up to `end` s."""
    channels = {
        name: Channel(c.time[: (n := int(np.searchsorted(c.time, end, side="right")))], c.value[:n], c.unit)
        for name, c in run.channels.items()
    }
    return replace(run, channels=channels)
