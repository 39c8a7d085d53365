r"""Find the motion of least cost within limits, by an augmented Lagrangian method from the best random motions.

    min f(x)   subject to   c_i(x) <= 0

over the coefficients x of a Fourier series, by the multiplier method of Powell, Hestenes and Rockafellar (Nocedal &
Wright, Numerical Optimization, 2006, §17.3), each round by L-BFGS. Limits are evaluated on a grid of times.
`MotionProblem` defines the cost f, for a gripper or an arm.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np
from scipy.optimize import minimize

from armdyn.experiments.limits import MotionLimits
from armdyn.experiments.series import MIN_HARMONICS, FourierSeries, SeriesBasis

FIRST_ROUND_PENALTY_FACTOR = 0.5
"""Penalty factor of the first round: an excess of 5 % at 20 instants costs as much as a standard deviation 1 %
larger."""
PENALTY_GROWTH = 3.0
"""Factor by which the penalty grows from round to round."""
MAX_COMPARED_LIMIT_EXCESS_SHARE = 0.02
"""Share by which a motion may exceed its limits when motions are compared during the search."""
DIVERGED_COST = 1e6
"""Cost that is assigned to a motion along which the simulation diverges; it is larger than any other cost."""
MAX_SHRINK_FACTOR = 0.98
"""Largest factor in one step of making a motion smaller until it is within its limits."""
LIMIT_CLEARANCE_SHARE = 1e-9
"""Share by which a random motion remains below its nearest limit."""
MIN_MOTION_SCALE = 1.0 / 64.0
"""Smallest factor by which a motion may be scaled; a motion that must be smaller is discarded."""

ReportProgress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class EvaluatedMotion:
    """Cost and constraints of a motion, with their gradient.

    Attributes:
        cost: cost f.
        constraints: constraint values c, one array for each kind of limit; positive where a limit is exceeded.
        gradient: derivatives (axes, size) of f + sum_k w_k . c_k by the coefficients, for weights w of the shapes of c.
    """

    cost: float
    constraints: list[np.ndarray]
    gradient: Callable[[Sequence[np.ndarray]], np.ndarray]


class MotionProblem(ABC):
    """Cost and limits of a motion, whose unknowns are (axes, size) Fourier coefficients x, in rad or m.

    Attributes:
        series: Fourier series of which motions consist.
        limits: limits of every axis.
        start_count: number of the best random motions that one round improves; the best result is improved further.
    """

    series: FourierSeries
    limits: MotionLimits
    start_count: int

    @property
    @abstractmethod
    def steps_per_round(self) -> tuple[int, ...]:
        """Number of L-BFGS steps of each round; the penalty of exceeded limits grows from round to round."""

    @property
    @abstractmethod
    def kinematic_basis(self) -> SeriesBasis:
        """The Fourier series at the instants at which positions, velocities and accelerations are limited."""

    @abstractmethod
    def cost(self, x: np.ndarray) -> float:
        """Exact cost of the motion with coefficients x, for the comparison of motions."""

    @abstractmethod
    def cost_and_constraints(self, x: np.ndarray) -> EvaluatedMotion:
        """Cost and constraints of the motion x, without those of position, velocity and acceleration."""

    @abstractmethod
    def excess(self, x: np.ndarray) -> float:
        """Largest share by which the motion x exceeds a limit; negative within all limits."""

    @abstractmethod
    def random_centre(self, rng: np.random.Generator) -> np.ndarray | None:
        """(axes,) random centre of a motion; None if none was found."""

    def linearised_around(self, x: np.ndarray) -> "MotionProblem":
        """The problem of one round of the search, with limits that are linearised at the start `x` of the round."""
        del x
        return self

    def motion_after_round(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """The motion from which the next round starts: `after`, or one between `before` and `after`."""
        del before
        return after

    @property
    def coefficient_scale(self) -> np.ndarray:
        """(axes,) scale of a Fourier coefficient: half the range of positions, or less for a slow axis."""
        reach = self.limits.velocity * self.series.period / (np.pi * self.series.harmonics)
        return np.minimum(self.limits.half_range, reach)

    def evaluate(self, x: np.ndarray) -> EvaluatedMotion:
        """Cost and all constraints of the motion x, with their gradient."""
        inner, beyond = self.cost_and_constraints(x), self.limits.excess(self.kinematic_basis.motion(x))

        def gradient(weights: Sequence[np.ndarray]) -> np.ndarray:
            parts = [(w[0] - w[1]) / size for w, size in zip(weights, self.limits.full_scale, strict=False)]
            return np.asarray(inner.gradient(weights[len(parts) :]) + self.kinematic_basis.gradient(*parts))

        return EvaluatedMotion(inner.cost, [*beyond, *inner.constraints], gradient)

    def kinematic_excess(self, x: np.ndarray) -> float:
        """Largest share by which the motion x exceeds a limit of position, velocity or acceleration."""
        return float(np.max(self.limits.excess(self.kinematic_basis.motion(x))))


def scale_about_centre(x: np.ndarray, size: float) -> np.ndarray:
    """Multiply the Fourier coefficients x of a motion by `size`, except its centre."""
    smaller = size * x
    smaller[:, 0] = x[:, 0]
    return smaller


def shrink_within_limits(problem: MotionProblem, x: np.ndarray, tolerance: float = 0.0) -> np.ndarray | None:
    """Make a motion smaller until it exceeds its limits by at most `tolerance`; None if too little would remain."""
    size = 1.0
    while size >= MIN_MOTION_SCALE:
        smaller = scale_about_centre(x, size)
        excess = problem.excess(smaller)
        if excess <= tolerance:
            return smaller
        size *= float(np.clip(1.0 / (1.0 + excess), 0.5, MAX_SHRINK_FACTOR)) if np.isfinite(excess) else 0.5
    return None


def random_motions(
    problem: MotionProblem, most: int, rng: np.random.Generator, say: ReportProgress
) -> list[np.ndarray]:
    """Up to `most` random motions that are as large as the limits allow."""
    found = []
    for k in range(most):
        x = random_motion(problem, rng)
        if x is not None:
            found.append(x)
        say(f"{k + 1} of {most} random motions tried")
    return found


def random_motion(problem: MotionProblem, rng: np.random.Generator) -> np.ndarray | None:
    """(axes, size) Fourier coefficients of a random motion; None if no motion is within the limits.

    The number of harmonics is random as well. Every axis moves as far and as fast as its own limits allow; then the
    whole motion is made smaller until all other limits hold.
    """
    series, limits = problem.series, problem.limits
    centre = problem.random_centre(rng)
    if centre is None:
        return None
    x = rng.standard_normal((len(centre), series.coefficient_count))
    x = x @ series.low_harmonics_projection(int(rng.integers(MIN_HARMONICS, series.harmonics + 1)))
    x[:, 0] = 0.0
    peaks = np.abs(problem.kinematic_basis.motion(x)).max(axis=1)
    apart = np.minimum(limits.upper - centre, centre - limits.lower)
    room = np.array([apart, limits.velocity, limits.acceleration]) / peaks
    x *= (1.0 - LIMIT_CLEARANCE_SHARE) * room.min(axis=0)[:, None]
    x[:, 0] = centre
    return shrink_within_limits(problem, x)


def best_motion(
    problem: MotionProblem, starts: Sequence[np.ndarray], costs: Sequence[float], say: ReportProgress
) -> np.ndarray:
    """(axes, size) Fourier coefficients of the best motion that is found from `starts` with these `costs`."""
    rounds, done = len(problem.steps_per_round) + min(problem.start_count, len(starts)) - 1, count(1)

    def one_more() -> None:
        say(f"{next(done)} of {rounds} rounds of the design done")

    tried = []
    for k, i in enumerate(np.argsort(costs)[: problem.start_count]):
        x = optimise_motion(problem, starts[i], last=1, done=one_more)
        inside = shrink_within_limits(problem, x, MAX_COMPARED_LIMIT_EXCESS_SHARE)
        tried.append((np.inf if inside is None else problem.cost(inside), k, x))
    _, _, x = min(tried)
    return optimise_motion(problem, x, first=1, done=one_more)


def optimise_motion(
    problem: MotionProblem,
    start: np.ndarray,
    *,
    first: int = 0,
    last: int | None = None,
    done: Callable[[], None] = lambda: None,
) -> np.ndarray:
    """Improve a motion by rounds of the multiplier method; the result is nearly within the limits.

    Args:
        problem: purpose and limits of the motion.
        start: (axes, size) Fourier coefficients of the start.
        first: first round of the multiplier method.
        last: round before which to stop; None means all rounds.
        done: called after each round.
    """
    multipliers: list[np.ndarray] | None = None
    unit, x = problem.coefficient_scale[:, None], start
    for k in range(first, len(problem.steps_per_round) if last is None else last):
        lagrangian = AugmentedLagrangian(
            problem.linearised_around(x), FIRST_ROUND_PENALTY_FACTOR * PENALTY_GROWTH**k, multipliers
        )
        found = minimize(
            lambda point, cost=lagrangian: cost(point.reshape(start.shape)), (x / unit).ravel(), jac=True,
            method="L-BFGS-B", options={"maxiter": problem.steps_per_round[k], "maxcor": 20},
        )  # fmt: skip
        x = problem.motion_after_round(x, found.x.reshape(start.shape) * unit)
        multipliers = lagrangian.updated(x)
        done()
    return x


@dataclass(frozen=True, eq=False)
class AugmentedLagrangian:
    """The augmented Lagrangian f + (rho/2) sum max(0, c + lambda/rho)^2, for scaled coefficients.

    Attributes:
        problem: problem with the cost f and the limits c.
        penalty: penalty rho.
        multipliers: multipliers lambda, with the shapes of c; None means zero.
    """

    problem: MotionProblem
    penalty: float
    multipliers: Sequence[np.ndarray] | None = None

    def __call__(self, point: np.ndarray) -> tuple[float, np.ndarray]:
        """Value at (axes, size) scaled coefficients, and its gradient as one vector."""
        unit = self.problem.coefficient_scale[:, None]
        found = self.problem.evaluate(point * unit)
        active = [np.maximum(c + m / self.penalty, 0.0) for c, m in self._pairs(found.constraints)]
        value = found.cost + 0.5 * self.penalty * sum(float(np.sum(part**2)) for part in active)
        gradient = found.gradient([self.penalty * part for part in active]) * unit
        if not (np.isfinite(value) and np.all(np.isfinite(gradient))):
            return DIVERGED_COST, np.zeros(point.size)
        return value, gradient.ravel()

    def updated(self, x: np.ndarray) -> list[np.ndarray]:
        """Multipliers lambda after a round that ended at (axes, size) coefficients x."""
        pairs = self._pairs(self.problem.evaluate(x).constraints)
        return [np.maximum(m + self.penalty * c, 0.0) for c, m in pairs]

    def _pairs(self, beyond: Sequence[np.ndarray]) -> list[tuple[np.ndarray, np.ndarray]]:
        given = self.multipliers or [np.zeros(c.shape) for c in beyond]
        return list(zip(beyond, given, strict=True))
