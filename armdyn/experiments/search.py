r"""Find the motion of least cost within limits: random motions, then an augmented Lagrangian from the best of them.

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

FIRST_PENALTY = 0.5
"""Penalty of the first round: an excess of 5 % at 20 instants costs as much as a standard deviation 1 % larger."""
PENALTY_GROWTH = 3.0
"""Growth of the penalty from round to round."""
COMPARED_EXCESS = 0.02
"""Share by which a motion may exceed its limits while it is compared with others."""
DIVERGED_COST = 1e6
"""Cost of a motion along which a model cannot be integrated, larger than any finite one."""
MAX_SHRINK_FACTOR = 0.98
"""Largest factor by which a motion beyond its limits is made smaller, repeatedly."""
LIMIT_CLEARANCE_SHARE = 1e-9
"""Share by which a random motion stays below the limit that it should reach."""
MIN_MOTION_SCALE = 1.0 / 64.0
"""Smallest factor on a motion; one that must be made smaller is given up."""

ReportProgress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class EvaluatedMotion:
    """Cost and limits of a motion.

    Attributes:
        cost: cost f.
        beyond: constraints c by kind of limit, arrays of any shape; positive where a limit is exceeded.
        gradient: derivatives (axes, size) of f + sum_k w_k . c_k by the coefficients, for weights w of the shapes of c.
    """

    cost: float
    beyond: list[np.ndarray]
    gradient: Callable[[Sequence[np.ndarray]], np.ndarray]


class MotionProblem(ABC):
    """Purpose and limits of a motion. Its coefficients x are (axes, size) of `series`, in rad or m.

    Attributes:
        series: the series of which motions consist.
        limits: limits of every axis.
        starts: number of random motions, the best of all, from which a search starts; the best after one round goes on.
    """

    series: FourierSeries
    limits: MotionLimits
    starts: int

    @property
    @abstractmethod
    def steps(self) -> tuple[int, ...]:
        """Numbers of L-BFGS steps of the rounds; the penalty of the limits grows from round to round."""

    @property
    @abstractmethod
    def finer(self) -> SeriesBasis:
        """The series at the instants at which positions, velocities and accelerations are limited."""

    @abstractmethod
    def cost(self, x: np.ndarray) -> float:
        """Exact cost of a motion, for comparing motions."""

    @abstractmethod
    def effect(self, x: np.ndarray) -> EvaluatedMotion:
        """Cost of a motion, and its limits except the kinematic ones, with their gradient."""

    @abstractmethod
    def excess(self, x: np.ndarray) -> float:
        """Largest share by which any limit is exceeded; negative inside all limits."""

    @abstractmethod
    def centre(self, rng: np.random.Generator) -> np.ndarray | None:
        """(axes,) centre of a random motion; None where none was found."""

    def about(self, x: np.ndarray) -> "MotionProblem":
        """The problem of one round, with everything that is linearised or chosen at the motion `x` of its start."""
        del x
        return self

    def accepted(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """The motion after a round, or a motion between, for limits that are linearised."""
        del before
        return after

    @property
    def unit(self) -> np.ndarray:
        """(axes,) size of a coefficient: a motion over half the range, or at full speed and the middle of the band."""
        reach = self.limits.velocity * self.series.period / (np.pi * self.series.harmonics)
        return np.minimum(self.limits.half, reach)

    def evaluate(self, x: np.ndarray) -> EvaluatedMotion:
        """Cost and all limits of a motion, with their gradient."""
        inner, beyond = self.effect(x), self.limits.beyond(self.finer.motion(x))

        def gradient(weights: Sequence[np.ndarray]) -> np.ndarray:
            parts = [(w[0] - w[1]) / size for w, size in zip(weights, self.limits.sizes, strict=False)]
            return np.asarray(inner.gradient(weights[len(parts) :]) + self.finer.gradient(*parts))

        return EvaluatedMotion(inner.cost, [*beyond, *inner.beyond], gradient)

    def kinematic_excess(self, x: np.ndarray) -> float:
        """Largest share by which a position, velocity or acceleration exceeds its limit."""
        return float(np.max(self.limits.beyond(self.finer.motion(x))))


def scale_about_centre(x: np.ndarray, size: float) -> np.ndarray:
    """Scale a motion about its centre."""
    smaller = size * x
    smaller[:, 0] = x[:, 0]
    return smaller


def shrink_within_limits(problem: MotionProblem, x: np.ndarray, tolerance: float = 0.0) -> np.ndarray | None:
    """Make a motion smaller until its limits hold on the grid; None where almost nothing would remain."""
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
    """Random motions inside the limits, as large as these allow; fewer than `most` where some could not be made."""
    found = []
    for k in range(most):
        x = random_motion(problem, rng)
        if x is not None:
            found.append(x)
        say(f"{k + 1} of {most} random motions tried")
    return found


def random_motion(problem: MotionProblem, rng: np.random.Generator) -> np.ndarray | None:
    """(axes, size) coefficients of a random motion; None where it could not be made.

    The number of harmonics is random as well. Every axis moves as far and as fast as its own limits allow; then the
    whole motion is made smaller until all other limits hold.
    """
    series, limits = problem.series, problem.limits
    centre = problem.centre(rng)
    if centre is None:
        return None
    x = rng.standard_normal((len(centre), series.size))
    x = x @ series.low(int(rng.integers(MIN_HARMONICS, series.harmonics + 1)))
    x[:, 0] = 0.0
    peaks = np.abs(problem.finer.motion(x)).max(axis=1)
    apart = np.minimum(limits.upper - centre, centre - limits.lower)
    room = np.array([apart, limits.velocity, limits.acceleration]) / peaks
    x *= (1.0 - LIMIT_CLEARANCE_SHARE) * room.min(axis=0)[:, None]
    x[:, 0] = centre
    return shrink_within_limits(problem, x)


def best_motion(
    problem: MotionProblem, starts: Sequence[np.ndarray], costs: Sequence[float], say: ReportProgress
) -> np.ndarray:
    """(axes, size) coefficients of the best motion from the best of (axes, size) starts, nearly inside the limits."""
    rounds, done = len(problem.steps) + min(problem.starts, len(starts)) - 1, count(1)

    def one_more() -> None:
        say(f"{next(done)} of {rounds} rounds of the design done")

    tried = []
    for k, i in enumerate(np.argsort(costs)[: problem.starts]):
        x = optimise_motion(problem, starts[i], last=1, done=one_more)
        inside = shrink_within_limits(problem, x, COMPARED_EXCESS)
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
    """(axes, size) coefficients of a motion with a lower cost, nearly inside the limits.

    Args:
        problem: purpose and limits of the motion.
        start: (axes, size) coefficients of the start.
        first: first round of the multiplier method.
        last: round before which to stop; None means all rounds.
        done: called after each round.
    """
    multipliers: list[np.ndarray] | None = None
    unit, x = problem.unit[:, None], start
    for k in range(first, len(problem.steps) if last is None else last):
        lagrangian = AugmentedLagrangian(problem.about(x), FIRST_PENALTY * PENALTY_GROWTH**k, multipliers)
        found = minimize(
            lambda point, cost=lagrangian: cost(point.reshape(start.shape)), (x / unit).ravel(), jac=True,
            method="L-BFGS-B", options={"maxiter": problem.steps[k], "maxcor": 20},
        )  # fmt: skip
        x = problem.accepted(x, found.x.reshape(start.shape) * unit)
        multipliers = lagrangian.updated(x)
        done()
    return x


@dataclass(frozen=True, eq=False)
class AugmentedLagrangian:
    """The augmented Lagrangian f + (rho/2) sum max(0, c + lambda/rho)^2, in units of `MotionProblem.unit`.

    Attributes:
        problem: problem with the cost f and the limits c.
        penalty: penalty rho.
        multipliers: multipliers lambda, of the shapes of c; None for zero.
    """

    problem: MotionProblem
    penalty: float
    multipliers: Sequence[np.ndarray] | None = None

    def __call__(self, point: np.ndarray) -> tuple[float, np.ndarray]:
        """Value at (axes, size) coefficients, and its flat gradient."""
        unit = self.problem.unit[:, None]
        found = self.problem.evaluate(point * unit)
        active = [np.maximum(c + m / self.penalty, 0.0) for c, m in self._pairs(found.beyond)]
        value = found.cost + 0.5 * self.penalty * sum(float(np.sum(part**2)) for part in active)
        gradient = found.gradient([self.penalty * part for part in active]) * unit
        if not (np.isfinite(value) and np.all(np.isfinite(gradient))):
            return DIVERGED_COST, np.zeros(point.size)
        return value, gradient.ravel()

    def updated(self, x: np.ndarray) -> list[np.ndarray]:
        """Multipliers after a round that ended at (axes, size) coefficients."""
        pairs = self._pairs(self.problem.evaluate(x).beyond)
        return [np.maximum(m + self.penalty * c, 0.0) for c, m in pairs]

    def _pairs(self, beyond: Sequence[np.ndarray]) -> list[tuple[np.ndarray, np.ndarray]]:
        given = self.multipliers or [np.zeros(c.shape) for c in beyond]
        return list(zip(beyond, given, strict=True))
