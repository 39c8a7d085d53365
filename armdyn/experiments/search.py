r"""The motion of least cost inside its limits: random motions, and from the best of them an augmented Lagrangian.

    min f(x)   subject to   c_i(x) <= 0

over the coefficients x of a Fourier series, by the multiplier method of Powell, Hestenes and Rockafellar (Nocedal &
Wright, Numerical Optimization, 2006, §17.3), each round by L-BFGS. Limits hold on a grid of times. What a motion is
wanted for, a gripper's or an arm's, says `MotionProblem`.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from armdyn.experiments.limits import MotionLimits
from armdyn.experiments.series import FEWEST_HARMONICS, Basis, Series

STIFFNESS = 0.5
"""Of the first round's penalty: an excess of 5 % at 20 instants costs as much as a standard deviation 1 % larger."""
HARDER = 3.0
"""Growth of the penalty from round to round."""
NEARLY = 0.02
"""Share by which a motion may exceed its limits while others are compared with it."""
LOST = 1e6
"""Cost of a motion along which a model cannot be integrated: beyond any that can be."""
SHRINK = 0.98
"""Factor by which a motion beyond its limits is made smaller at least, again and again."""
ROUNDING = 1e-9
"""Share by which a random motion stays below the limit that it is made to reach."""
SMALLEST = 1.0 / 64.0
"""Of its size: a motion that must be made smaller than that is given up."""

Say = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Evaluated:
    """Cost and limits at a motion.

    Attributes:
        cost: f.
        beyond: c by kind of limit, arrays of any shape; positive beyond the limit.
        gradient: (axes, size) derivatives by the coefficients of f + sum_k w_k . c_k, for weights w of the shapes of c.
    """

    cost: float
    beyond: list[np.ndarray]
    gradient: Callable[[Sequence[np.ndarray]], np.ndarray]


class MotionProblem(ABC):
    """What a motion is wanted for. Coefficients are (axes, size) of `series`, in rad or m.

    Attributes:
        series: of which motions are made.
        limits: of every axis.
        finer: the series at the instants at which positions, velocities and accelerations are held against the limits.
        starts: random motions, the best of all, from which a search starts; the best after its first round goes on.
    """

    series: Series
    limits: MotionLimits
    starts: int

    @property
    @abstractmethod
    def steps(self) -> tuple[int, ...]:
        """L-BFGS steps of the rounds; limits are worked in a little more sharply in each."""

    @property
    @abstractmethod
    def finer(self) -> Basis:
        """See above."""

    @abstractmethod
    def cost(self, x: np.ndarray) -> float:
        """What the search makes small, exactly, for comparing motions."""

    @abstractmethod
    def effect(self, x: np.ndarray) -> Evaluated:
        """Cost with its gradient, and all limits but those of `limits` on positions and their derivatives."""

    @abstractmethod
    def excess(self, x: np.ndarray) -> float:
        """Largest share by which any limit is exceeded; negative inside all."""

    @abstractmethod
    def centre(self, rng: np.random.Generator) -> np.ndarray | None:
        """(axes,) about which a random motion may be made; None where none was found."""

    def about(self, x: np.ndarray) -> "MotionProblem":
        """The problem of one round, with what is linearised or chosen at the motion with which it begins."""
        del x
        return self

    def accepted(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """The motion after a round, or one between; for limits that are linearised."""
        del before
        return after

    @property
    def unit(self) -> np.ndarray:
        """(axes,) size of a coefficient: a motion over half the range, or at full speed and the middle of the band."""
        reach = self.limits.velocity * self.series.period / (np.pi * self.series.harmonics)
        return np.minimum(self.limits.half, reach)

    def evaluate(self, x: np.ndarray) -> Evaluated:
        """Cost, and all limits."""
        inner, beyond = self.effect(x), self.limits.beyond(self.finer.motion(x))

        def gradient(weights: Sequence[np.ndarray]) -> np.ndarray:
            parts = [(w[0] - w[1]) / size for w, size in zip(weights, self.limits.sizes, strict=False)]
            return np.asarray(inner.gradient(weights[len(parts) :]) + self.finer.gradient(*parts))

        return Evaluated(inner.cost, [*beyond, *inner.beyond], gradient)

    def kinematic_excess(self, x: np.ndarray) -> float:
        """Largest share by which a position, velocity or acceleration exceeds its limit."""
        return max(float(part.max()) for part in self.limits.beyond(self.finer.motion(x)))


def scale(x: np.ndarray, size: float) -> np.ndarray:
    """The motion made smaller about its centre."""
    smaller = size * x
    smaller[:, 0] = x[:, 0]
    return smaller


def shrink(problem: MotionProblem, x: np.ndarray, tolerance: float = 0.0) -> np.ndarray | None:
    """The motion made smaller until its limits hold on the grid; None where almost nothing would be left of it."""
    size = 1.0
    while size >= SMALLEST:
        smaller = scale(x, size)
        excess = problem.excess(smaller)
        if excess <= tolerance:
            return smaller
        size *= float(np.clip(1.0 / (1.0 + excess), 0.5, SHRINK)) if np.isfinite(excess) else 0.5
    return None


def random_motions(problem: MotionProblem, count: int, rng: np.random.Generator, say: Say) -> list[np.ndarray]:
    """Random motions inside the limits, as large as these allow; fewer than `count` where not all could be made."""
    found = []
    for k in range(count):
        x = random_motion(problem, rng)
        if x is not None:
            found.append(x)
        say(f"{k + 1} of {count} random motions tried")
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
    x = rng.standard_normal((len(centre), series.size)) @ series.low(
        int(rng.integers(FEWEST_HARMONICS, series.harmonics + 1))
    )
    x[:, 0] = 0.0
    motion = problem.finer.motion(x)
    apart = np.minimum(limits.upper - centre, centre - limits.lower)
    peaks = [np.abs(part).max(axis=0) for part in (motion.q, motion.v, motion.a)]
    allowed = (apart, limits.velocity, limits.acceleration)
    x *= (1.0 - ROUNDING) * np.min([size / peak for size, peak in zip(allowed, peaks, strict=True)], axis=0)[:, None]
    x[:, 0] = centre
    return shrink(problem, x)


def search(problem: MotionProblem, starts: Sequence[np.ndarray], costs: Sequence[float], say: Say) -> np.ndarray:
    """(axes, size) coefficients of the best motion found from the best of the starts, nearly inside the limits.

    Args:
        problem: what the motion is wanted for.
        starts: motions inside the limits, (axes, size) each.
        costs: of each, in the order of `MotionProblem.cost`.
        say: told how far it is.
    """
    rounds = len(problem.steps) + min(problem.starts, len(starts)) - 1
    tried = []
    for k, i in enumerate(np.argsort(costs)[: problem.starts]):
        x = improve(problem, starts[i], last=1)
        inside = shrink(problem, x, NEARLY)
        tried.append((np.inf if inside is None else problem.cost(inside), k, x))
        say(f"{k + 1} of {rounds} rounds of the design done")
    done = len(tried)
    _, _, x = min(tried)

    def count(k: int) -> None:
        say(f"{done + k} of {rounds} rounds of the design done")

    return improve(problem, x, first=1, done=count)


def improve(
    problem: MotionProblem,
    start: np.ndarray,
    *,
    first: int = 0,
    last: int | None = None,
    done: Callable[[int], None] = lambda _: None,
) -> np.ndarray:
    """(axes, size) coefficients of a motion of less cost, nearly inside the limits.

    Args:
        problem: what the motion is wanted for.
        start: (axes, size).
        first: the round of the multiplier method to begin with.
        last: the round to end before; all where it is not given.
        done: told the number of each round that is done.
    """
    multipliers: list[np.ndarray] | None = None
    unit, x = problem.unit[:, None], start
    for k in range(first, len(problem.steps) if last is None else last):
        lagrangian = Lagrangian(problem.about(x), STIFFNESS * HARDER**k, multipliers)
        found = minimize(
            lambda point, cost=lagrangian: cost(point.reshape(start.shape)), (x / unit).ravel(), jac=True,
            method="L-BFGS-B", options={"maxiter": problem.steps[k], "maxcor": 20},
        )  # fmt: skip
        x = problem.accepted(x, found.x.reshape(start.shape) * unit)
        multipliers = lagrangian.updated(x)
        done(k)
    return x


@dataclass(frozen=True, eq=False)
class Lagrangian:
    """f + (rho/2) sum max(0, c + lambda/rho)^2, over coefficients in units of `MotionProblem.unit`.

    Attributes:
        problem: of f and c.
        penalty: rho.
        multipliers: lambda, of the shapes of c; None for zero.
    """

    problem: MotionProblem
    penalty: float
    multipliers: Sequence[np.ndarray] | None = None

    def __call__(self, point: np.ndarray) -> tuple[float, np.ndarray]:
        """Value at (axes, size), and its flat gradient."""
        unit = self.problem.unit[:, None]
        found = self.problem.evaluate(point * unit)
        active = [np.maximum(c + m / self.penalty, 0.0) for c, m in self._pairs(found.beyond)]
        value = found.cost + 0.5 * self.penalty * sum(float(np.sum(part**2)) for part in active)
        gradient = found.gradient([self.penalty * part for part in active]) * unit
        if not (np.isfinite(value) and np.all(np.isfinite(gradient))):
            return LOST, np.zeros(point.size)
        return value, gradient.ravel()

    def updated(self, x: np.ndarray) -> list[np.ndarray]:
        """The multipliers after a round that ended at (axes, size) coefficients."""
        pairs = self._pairs(self.problem.evaluate(x).beyond)
        return [np.maximum(m + self.penalty * c, 0.0) for c, m in pairs]

    def _pairs(self, beyond: Sequence[np.ndarray]) -> list[tuple[np.ndarray, np.ndarray]]:
        given = self.multipliers or [np.zeros(c.shape) for c in beyond]
        return list(zip(beyond, given, strict=True))
