"""Estimate parameters while data arrive: least squares over all data so far, started from the last estimate."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from armdyn.errors import InputError
from armdyn.estimation.covariance import free_covariance
from armdyn.estimation.descent import DescentResult, Outcome, descend
from armdyn.estimation.expansion import not_held_by_bound
from armdyn.identify.noise import variance_inflation
from armdyn.identify.problem import CostOfFreeUnknowns, Problem
from armdyn.model import Model
from armdyn.run import Run
from armdyn.threads import one_thread

ModelT = TypeVar("ModelT", bound=Model)
MinimiseFunction = Callable[[CostOfFreeUnknowns, np.ndarray], DescentResult]
"""Function that minimises the cost of a problem's free parameters from (p,) start values, such as `descend`."""


@dataclass(frozen=True)
class Estimate:
    """Estimated parameters.

    Attributes:
        names: names of the fitted parameters.
        values: (p,) estimates, each in the parameter's unit.
        covariance: (p, p) covariance: the inverse of the information matrix at the solution, priors included; it is
            valid if the residual is white noise of the assumed size.
        evaluations: number of evaluations of the model.
        outcome: why the descent ended.
        at_bound: parameters whose estimate is on a physical bound.
    """

    names: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray
    evaluations: int
    outcome: Outcome
    at_bound: tuple[str, ...]

    def value(self, name: str) -> float:
        """The estimate of one parameter, in its unit."""
        return float(self.values[self.names.index(name)])

    def std(self, name: str) -> float:
        """The standard deviation of one parameter, in its unit."""
        i = self.names.index(name)
        return float(np.sqrt(self.covariance[i, i]))


@one_thread
def estimate(
    model: Model,
    runs: Sequence[Run],
    noise: Mapping[str, float],
    minimise: MinimiseFunction = descend,
) -> Estimate:
    """Fit the parameters of a model that are marked `fitted`, starting from the model's values.

    Args:
        model: the model, with priors and bounds of its parameters.
        runs: runs with different names.
        noise: standard deviation per channel, in the channel's unit.
        minimise: the method that minimises the cost.

    Raises:
        InputError: no parameter is marked `fitted`, the noise of a channel is missing, the simulation diverges, or the
            runs do not determine the parameters.
    """
    for run in runs:
        for name in model.predicted_channels(run):
            if not noise.get(name, 0.0) > 0:
                raise InputError(f"{run.name}: the noise of '{name}' is not known: give its standard deviation")
    problem = Problem(model, runs, {(run.name, name): std for run in runs for name, std in noise.items()})
    free = problem.fitted
    if not free.any():
        raise InputError("nothing to fit: every parameter of the model is fixed")
    start = model.theta()[[column.index for column in problem.columns]]
    part = CostOfFreeUnknowns(problem, free, start)
    values, at, evaluations, outcome = minimise(part, start[free])
    if not np.isfinite(at.cost):
        raise InputError("the model's simulation diverges: start from other values")
    names = tuple(column.name for column, fits in zip(problem.columns, free, strict=True) if fits)
    inside = not_held_by_bound(part.lower - values, part.upper - values, at.gradient)
    at_bound = tuple(name for name, is_inside in zip(names, inside, strict=True) if not is_inside)
    return Estimate(names, values, parameter_covariance(names, at.hessian), evaluations, outcome, at_bound)


def parameter_covariance(names: Sequence[str], information: np.ndarray) -> np.ndarray:
    """Compute the (p, p) covariance of estimated parameters: the inverse of the Fisher information.

    Args:
        names: names of the parameters, for the error message.
        information: (p, p) Fisher information matrix: sum of s s' / sigma^2 over the samples, s the derivatives of a
            predicted sample, plus 1/std^2 of the priors on the diagonal.

    Raises:
        InputError: the runs do not determine the parameters; the message names the least determined ones.
    """
    scale = np.sqrt(np.diag(information))
    if not np.all(scale > 0):
        blind = [n for n, s in zip(names, scale, strict=True) if not s > 0]
        raise InputError(f"these runs do not determine {', '.join(blind)}: give their values, or a richer motion")
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    if values[0] < 1e-14 * values[-1]:
        tangled = [n for n, w in zip(names, vectors[:, 0], strict=True) if abs(w) > 0.1]
        raise InputError(
            f"these runs cannot distinguish {' from '.join(tangled)}: fix one of them or give a richer motion"
        )
    return free_covariance(information, np.ones(len(names), dtype=bool), negligible=0.0)


class Estimator(Generic[ModelT]):
    """Estimates a model's parameters by least squares from a growing recording.

    The cost of a long recording has many minima (for a pendulum of 0.37 m, one up to 3 s and ten at 10 s). Estimates
    that begin after 1 s and start from one another stay in the right minimum.

    Args:
        model: the model; its values are the first guess, and its `fitted` parameters are estimated with their priors
            and bounds.
        noise: standard deviation per channel, in the channel's unit.
        minimise: the method that minimises the cost.
    """

    def __init__(self, model: ModelT, noise: Mapping[str, float], minimise: MinimiseFunction = descend) -> None:
        self._minimise = minimise
        self.model: ModelT = model
        self.noise = dict(noise)

    def update(self, run: Run) -> Estimate:
        """Estimate the parameters from all data so far; `model` then has the new values."""
        found = estimate(self.model, [run], self.noise, self._minimise)
        self.model = self.model.with_values(dict(zip(found.names, found.values.tolist(), strict=True)))
        return found

    def std_inflation(self, run: Run) -> float:
        """Factor, at least 1, by which standard deviations must grow because the residual is more than white noise.

        It is the square root of `variance_inflation` for the worst channel of `run`. For example, friction that shakes
        the arm and a string that stretches leave correlated residuals.
        """
        prediction = self.model.predict(run, self.model.theta())
        residuals = [
            (run.channels[channel].value - prediction.values[rows]) / self.noise[channel]
            for channel, rows in prediction.slices.items()
        ]
        return float(np.sqrt(max([1.0, *(variance_inflation([residual]) for residual in residuals)])))
