"""What a motion of an arm is wanted for, inside its limits of torque and of posture, and what a recording would tell.

Distances to collisions are linearised about the last motion at the postures near them, again in every round.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil
from typing import Protocol

import numpy as np

from armdyn.experiments.columns import Columns
from armdyn.experiments.criteria import Criterion
from armdyn.experiments.limits import MotionLimits, two_sided
from armdyn.experiments.search import Evaluated, MotionProblem
from armdyn.experiments.series import Basis, Series

GRID = 8.0
"""Instants per second at which information and torques are worked out: eight times the highest frequency."""
FINER = 3
"""Times as many for positions, speeds and accelerations, whose peaks cost little to look for."""
STEPS = (20, 40, 40, 30, 20, 15)
"""L-BFGS steps of the rounds."""
STARTS = 3
"""See `MotionProblem.starts`."""
NEAR = 0.3
"""Margin of a posture, see `Postures.margin`, from which its distance is watched."""
DEEPEST = -0.4
"""Margin below which a posture is too deep in what is forbidden to be led out of it."""
NUDGE = 1e-4
"""rad or m: of the finite differences of margins."""
TOUCHING = 0.03
"""Excess that counts for a posture that is forbidden: a random motion with one is made smaller by such steps."""
CENTRAL = 0.7
"""Of the range of positions from which the centre of a random motion is drawn."""
TRIES = 200
"""Centres that are drawn before there is taken to be none at which the arm can stand."""


class Postures(Protocol):
    """Which postures are free, of collisions for one."""

    def free(self, q: np.ndarray) -> bool:
        """Whether the posture (nj,) is allowed, without any distance asked for; quick."""
        ...

    def margin(self, q: np.ndarray) -> float:
        """How far the posture (nj,) is from what is forbidden beyond what is asked for, about 1 for far."""
        ...


@dataclass(frozen=True, eq=False)
class ArmProblem(MotionProblem):
    """A motion of an arm with less of a criterion.

    Attributes:
        columns: what is wanted and what else is unknown.
        criterion: of the information, to be made small.
        series: of which motions are made.
        limits: of joints and torques.
        postures: which are free.
        cuts: half-spaces normal . q >= bound in which postures must stay, one at every instant of the finer grid:
            normals (n, nj), 0 where nothing is near, and bounds (n,), -infinity there; None where there are none.
    """

    columns: Columns
    criterion: Criterion
    series: Series
    limits: MotionLimits
    postures: Postures
    cuts: tuple[np.ndarray, np.ndarray] | None = None

    steps, starts = STEPS, STARTS

    @cached_property
    def grid(self) -> Basis:
        """The series at (n,) instants of one period, at which information and torques are worked out."""
        count = max(ceil(GRID * self.series.period), 4 * self.series.harmonics)
        return self.series.at(self.series.period * np.arange(count) / count)

    @cached_property
    def finer(self) -> Basis:
        """The same at instants `FINER` times as dense."""
        count = FINER * len(self.grid.time)
        return self.series.at(self.series.period * np.arange(count) / count)

    @property
    def weight(self) -> float:
        """Samples of the recording per instant of the grid."""
        return self.columns.rate * self.series.seconds / len(self.grid.time)

    def information(self, x: np.ndarray) -> np.ndarray:
        """(P, P) Fisher information of a recording of the whole motion."""
        columns = self.columns.at(self.grid.motion(x))
        X = columns.reshape(-1, columns.shape[2])
        return np.asarray(self.weight * X.T @ X)

    def cost(self, x: np.ndarray) -> float:
        """The criterion."""
        return self.criterion(self.information(x))[0]

    def grid_excess(self, x: np.ndarray) -> float:
        """Largest share by which a limit of positions, speeds, accelerations or torques is exceeded."""
        torque = self.columns.torque(self.grid.motion(x))
        return max(self.kinematic_excess(x), float(np.max(np.abs(torque) / self.limits.effort)) - 1.0)

    def excess(self, x: np.ndarray) -> float:
        """The same; `TOUCHING` where all these hold and a posture is not free."""
        excess = self.grid_excess(x)
        if excess > 0.0:
            return excess
        q = self.grid.motion(x).q
        # Postures far apart first: a motion that is too large mostly shows it at once.
        order = np.argsort(np.arange(len(q)) * 0.6180339887 % 1.0)
        return excess if all(self.postures.free(posture) for posture in q[order]) else TOUCHING

    def centre(self, rng: np.random.Generator) -> np.ndarray | None:
        """A posture at which the arm is free and its torques suffice."""
        still = np.zeros((len(self.limits.half), self.series.size))
        for _ in range(TRIES):
            centre = self.limits.middle + CENTRAL * self.limits.half * rng.uniform(-1.0, 1.0, len(self.limits.half))
            still[:, 0] = centre
            if self.postures.free(centre) and self.grid_excess(still) <= 0.0:
                return np.asarray(centre)
        return None

    def about(self, x: np.ndarray) -> "ArmProblem":
        """With half-spaces about the postures of a motion that are near something forbidden."""
        finer = self.finer.motion(x).q
        normal, bound = np.zeros(finer.shape), np.full(len(finer), -np.inf)
        for i, q in enumerate(self.grid.motion(x).q):
            margin = self.postures.margin(q)
            if margin > NEAR:
                continue
            slope = np.array([self.postures.margin(q + step) - margin for step in NUDGE * np.eye(len(q))]) / NUDGE
            for k in range(FINER * i - FINER // 2, FINER * i + FINER // 2 + 1):
                here = finer[k % len(finer)]
                left = margin if k == FINER * i else self.postures.margin(here)
                normal[k % len(finer)], bound[k % len(finer)] = slope, slope @ here - left
        return replace(self, cuts=(normal, bound))

    def accepted(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """The motion after a round, or one between, so that no posture is deep in what is forbidden.

        Linearised about a deep posture, the way out may lead on through an obstacle.
        """
        for share in (1.0, 0.5, 0.25, 0.1):
            x = before + share * (after - before)
            touching = (q for q in self.grid.motion(x).q if not self.postures.free(q))  # quick, where distances are not
            if all(self.postures.margin(q) > DEEPEST for q in touching):
                return np.asarray(x)
        return before

    def effect(self, x: np.ndarray) -> Evaluated:
        """Criterion, torques and postures with their gradient."""
        effort = self.limits.effort
        columns, torque, by_motion = self.columns.with_slopes(self.grid.motion(x))
        X = columns.reshape(-1, columns.shape[2])
        value, by_information = self.criterion(self.weight * X.T @ X)
        by_columns = (2.0 * self.weight * X @ by_information).reshape(columns.shape)
        beyond = [two_sided(torque / effort)]
        if self.cuts is not None:
            normal, bound = self.cuts
            beyond.append(bound - np.einsum("nj,nj->n", normal, self.finer.motion(x).q))

        def gradient(weights: Sequence[np.ndarray]) -> np.ndarray:
            total = self.grid.gradient(*by_motion(by_columns, (weights[0][0] - weights[0][1]) / effort))
            if self.cuts is not None:
                total -= (weights[1][:, None] * normal).T @ self.finer.functions[0]
            return total

        return Evaluated(value, beyond, gradient)

    def narrower(self, limit: str, joint: int, factor: float) -> "ArmProblem":
        """The same with less room."""
        return replace(self, limits=self.limits.narrower(limit, joint, factor))
