r"""Nonlinear least squares with priors and bounds on any model.

    J(theta) = 1/2 sum_i r_i^2 / sigma_i^2 + 1/2 sum_j (theta_j - mean_j)^2 / std_j^2,     r = measured - predicted

by Levenberg-Marquardt (Nocedal & Wright, Numerical Optimization, §10.3) or by the paper's gradient descent with
backtracking. Both accept a step only when the cost falls by a share of what its linear model promises.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple, Protocol

import numpy as np

from armdyn.errors import InputError
from armdyn.identify.information import Information
from armdyn.model import Model
from armdyn.parameter import Parameter
from armdyn.run import Run

GROSS = 20.0
"""Squared error per sample, over the noise's, beyond which derivatives say little about a distant minimum."""
PATIENCE = 2
"""Steps in a row that take next to nothing from a gross error before a descent gives up."""
SUFFICIENT_DECREASE = 1e-4
"""Share of the predicted decrease that a step must deliver (Armijo)."""


class Expansion(NamedTuple):
    """The cost around a point.

    Attributes:
        cost: J.
        gradient: (p,).
        hessian: (p, p) Gauss-Newton, positive semidefinite.
    """

    cost: float
    gradient: np.ndarray
    hessian: np.ndarray


class Outcome(Enum):
    """Why the descent ended; the value is what a person should read."""

    CONVERGED = "converged: the next step would change no parameter by more than a thousandth of its uncertainty"
    STALLED = "stalled: no step lowers the cost further; the data may not determine all free parameters"
    OUT_OF_STEPS = "not converged within the allowed number of steps: start closer or free fewer parameters"


@dataclass(frozen=True)
class Estimate:
    """Result of a fit.

    Attributes:
        names: fitted parameters.
        values: (p,) in their units.
        covariance: (p, p) inverse of the information at the solution, priors included; it holds as far as the
            residual is white with the assumed noise.
        cost: J at the solution.
        evaluations: of the model.
        outcome: why it ended.
        at_bound: parameters that ended on their physical bound.
    """

    names: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray
    cost: float
    evaluations: int
    outcome: Outcome
    at_bound: tuple[str, ...]

    def value(self, name: str) -> float:
        """Value of one parameter."""
        return float(self.values[self.names.index(name)])

    def std(self, name: str) -> float:
        """Standard deviation of one parameter."""
        i = self.names.index(name)
        return float(np.sqrt(self.covariance[i, i]))


class LeastSquares:
    """The cost of one model over runs.

    Free are the parameters marked `fitted`: a shared one once, a per-run one once for every run, where it is called
    ``name[run]`` when there are several runs.
    """

    def __init__(self, model: Model, runs: Sequence[Run], noise: Mapping[str, float]) -> None:
        if not runs:
            raise InputError("nothing to fit: give at least one run")
        self.model, self.runs, self.noise = model, tuple(runs), noise
        recorded = {name for run in runs for name in run.everything}
        free = [p for p in model.parameters.values() if p.fitted and p.shows_in(recorded)]
        if not free:
            raise InputError("nothing to fit: every parameter of the model is fixed")
        self._theta = model.theta()
        self._measured = [self._scaled_measurement(run) for run in self.runs]
        columns: list[tuple[str, Parameter]] = [(p.name, p) for p in free if p.scope == "shared"]
        self._of_run: list[tuple[list[int], list[int]]] = []  # per run: entries of the vector, columns of the model
        shared = list(range(len(columns)))
        for run in self.runs:
            own = [p for p in free if p.scope == "per_run"]
            mine = [*shared, *range(len(columns), len(columns) + len(own))]
            columns += [(p.name if len(self.runs) == 1 else f"{p.name}[{run.name}]", p) for p in own]
            self._of_run.append((mine, [model.names.index(columns[i][1].name) for i in mine]))
        self.names = tuple(name for name, _ in columns)
        parameters = [p for _, p in columns]
        self.lower = np.array([p.lower for p in parameters])
        self.upper = np.array([p.upper for p in parameters])
        self.typical = np.array([p.typical for p in parameters])
        self._start = np.array([p.value for p in parameters])
        self._prior_mean = np.array([p.prior.mean if p.prior else 0.0 for p in parameters])
        self._prior_weight = np.array([1.0 / p.prior.std if p.prior else 0.0 for p in parameters])

    def start(self) -> np.ndarray:
        """(p,) the model's present values of the free parameters."""
        return self._start.copy()

    def evaluate(self, values: np.ndarray) -> Expansion:
        """Cost, gradient and Gauss-Newton Hessian at (p,) values of the free parameters."""
        prior_residual = self._prior_weight * (self._prior_mean - values)
        cost = float(prior_residual @ prior_residual) / 2
        gradient = -self._prior_weight * prior_residual
        hessian = np.diag(self._prior_weight**2)
        for run, (mine, columns), (measured, weight) in zip(self.runs, self._of_run, self._measured, strict=True):
            theta = self._theta.copy()
            theta[columns] = values[mine]
            prediction = self.model.predict(run, theta)
            residual = measured - prediction.values * weight
            scaled = prediction.sensitivities[:, columns] * weight[:, None]
            cost += float(residual @ residual) / 2
            gradient[mine] -= scaled.T @ residual
            hessian[np.ix_(mine, mine)] += scaled.T @ scaled
        return Expansion(cost, gradient, hessian)

    def _scaled_measurement(self, run: Run) -> tuple[np.ndarray, np.ndarray]:
        """(n,) measured values over their noise, and (n,) one over the noise, in the order of the prediction."""
        channels = self.model.predicted_channels(run)
        for name in channels:
            if not self.noise.get(name, 0.0) > 0:
                raise InputError(f"{run.name}: the noise of '{name}' is not known: give its standard deviation")
        weights = [np.full(len(run.channels[name].value), 1.0 / self.noise[name]) for name in channels]
        weight = np.concatenate(weights)
        return np.concatenate([run.channels[name].value for name in channels]) * weight, weight


class Cost(Protocol):
    """What `descend` minimises: bounds, and the cost expanded around a point."""

    lower: np.ndarray
    upper: np.ndarray

    def evaluate(self, values: np.ndarray) -> Expansion:
        """Cost, gradient and Gauss-Newton Hessian at (p,) values."""


class Descent(NamedTuple):
    """Where a descent ended: (p,) values, the cost around them, evaluations spent, and why it ended."""

    values: np.ndarray
    at: Expansion
    evaluations: int
    outcome: Outcome


def levenberg_marquardt(
    problem: LeastSquares, start: np.ndarray | None = None, *, most_steps: int = 50, tolerance: float = 1e-2
) -> Estimate:
    """Minimise the cost by Gauss-Newton steps, damped in proportion to the Hessian's diagonal where they fail.

    Args:
        problem: model, runs and noise.
        start: (p,) the model's present values when not given; clipped to the bounds.
        most_steps: after these it counts as not converged.
        tolerance: converged when the next step is shorter, in standard deviations of each parameter.
    """
    begin = problem.start() if start is None else start
    values, at, evaluations, outcome = descend(problem, begin, most_steps=most_steps, tolerance=tolerance)
    return _estimate(problem, values, at, evaluations, outcome)


def descend(
    problem: Cost, start: np.ndarray, *, most_steps: int = 50, tolerance: float = 1e-2, samples: int = 0
) -> Descent:
    """The iteration of `levenberg_marquardt`, with the same arguments, on any cost.

    Where the number of samples is given, a cost that is gross and creeps ends as stalled: `PATIENCE` steps in a row
    that take from it less than one sample's share.
    """
    values = np.clip(start, problem.lower, problem.upper)
    at = problem.evaluate(values)
    evaluations, damping, outcome, creeping = 1, 0.0, Outcome.OUT_OF_STEPS, 0
    for _ in range(most_steps):
        free = off_bounds(problem, values, at.gradient)
        step, size = _newton_step(at, free, 0.0)
        if size < tolerance:
            outcome = Outcome.CONVERGED
            break
        if damping > 0:
            step, _ = _newton_step(at, free, damping)
        while True:
            trial = np.clip(values + step, problem.lower, problem.upper)
            after = problem.evaluate(trial)
            evaluations += 1
            if sufficient_decrease(at, after, trial - values):
                break
            damping = max(10.0 * damping, 1e-3)
            if damping > 1e9:
                return Descent(values, at, evaluations, Outcome.STALLED)
            step, _ = _newton_step(at, free, damping)
        gross = 2.0 * after.cost > GROSS * samples > 0.0
        creeping = creeping + 1 if gross and at.cost - after.cost < after.cost / samples else 0
        values, at = trial, after
        if creeping == PATIENCE:
            outcome = Outcome.STALLED
            break
        damping = damping / 10 if damping > 1e-6 else 0.0
    return Descent(values, at, evaluations, outcome)


def off_bounds(problem: Cost, values: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """(p,) bool: False for a parameter on a bound that the gradient pushes it against."""
    below = (values <= problem.lower) & (gradient > 0)
    above = (values >= problem.upper) & (gradient < 0)
    return ~(below | above)


def gradient_descent(
    problem: LeastSquares, start: np.ndarray | None = None, *, most_steps: int = 500, tolerance: float = 1e-2
) -> Estimate:
    """Minimise the cost by steepest descent with backtracking, as in the paper; parameters are scaled by their size.

    Arguments as for `levenberg_marquardt`.
    """
    values = np.clip(problem.start() if start is None else start, problem.lower, problem.upper)
    at = problem.evaluate(values)
    evaluations, length, outcome = 1, 0.0, Outcome.OUT_OF_STEPS
    for _ in range(most_steps):
        free = off_bounds(problem, values, at.gradient)
        if _newton_step(at, free, 0.0)[1] < tolerance:
            outcome = Outcome.CONVERGED
            break
        direction = -(problem.typical**2) * at.gradient * free
        # First a tenth of the typical size, later twice the length that worked.
        length = 2 * length if length > 0 else 0.1 / float(np.max(np.abs(direction / problem.typical)))
        while True:
            trial = np.clip(values + length * direction, problem.lower, problem.upper)
            after = problem.evaluate(trial)
            evaluations += 1
            if sufficient_decrease(at, after, trial - values):
                break
            length /= 2
            if length * float(np.max(np.abs(direction / problem.typical))) < 1e-12:
                return _estimate(problem, values, at, evaluations, Outcome.STALLED)
        values, at = trial, after
    return _estimate(problem, values, at, evaluations, outcome)


def sufficient_decrease(before: Expansion, after: Expansion, step: np.ndarray) -> bool:
    """Armijo's rule: the cost fell by a share of what the gradient promised."""
    promised = -float(before.gradient @ step)
    return bool(np.isfinite(after.cost) and before.cost - after.cost >= SUFFICIENT_DECREASE * max(promised, 0.0))


def _newton_step(at: Expansion, free: np.ndarray, damping: float) -> tuple[np.ndarray, float]:
    """(p,) step, and its length in standard deviations of the most certain direction, sqrt(step' H step)."""
    step = np.zeros(len(at.gradient))
    if not free.any():
        return step, 0.0
    matrix = at.hessian[np.ix_(free, free)]
    scale = np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    scaled = matrix / np.outer(scale, scale) + damping * np.eye(len(scale))
    reduced = -at.gradient[free] / scale
    try:
        solution = np.linalg.solve(scaled, reduced)
    except np.linalg.LinAlgError:
        solution = np.linalg.lstsq(scaled, reduced, rcond=1e-12)[0]
    step[free] = solution / scale
    return step, float(np.sqrt(max(step @ at.hessian @ step, 0.0)))


def _estimate(problem: LeastSquares, values: np.ndarray, at: Expansion, evaluations: int, outcome: Outcome) -> Estimate:
    free = off_bounds(problem, values, at.gradient)
    information = Information(problem.names, at.hessian)
    return Estimate(
        names=problem.names,
        values=values,
        covariance=information.covariance(),
        cost=at.cost,
        evaluations=evaluations,
        outcome=outcome,
        at_bound=tuple(name for name, f in zip(problem.names, free, strict=True) if not f),
    )
