"""Design an arm's motion for a purpose, within limits of torque and posture, and predict its information.

Distances to obstacles are linearised at the postures of the last motion that are near them, again in every round.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil
from typing import Protocol

import numpy as np

from armdyn.experiments.columns import TorqueRegressor
from armdyn.experiments.criteria import InformationCriterion
from armdyn.experiments.limits import MotionLimits, two_sided_excess
from armdyn.experiments.search import EvaluatedMotion, MotionProblem
from armdyn.experiments.series import FourierSeries, SeriesBasis

INSTANTS_PER_SECOND = 8.0
"""Instants per second at which information and torques are computed: eight times the highest frequency."""
KINEMATIC_REFINEMENT = 3
"""Factor on that number for positions, speeds and accelerations, whose peaks cost little to find."""
ARM_ROUND_STEPS = (20, 40, 40, 30, 20, 15)
"""Numbers of L-BFGS steps of the rounds."""
ARM_STARTS = 3
"""Number of random motions from which the search starts; see `MotionProblem.starts`."""
MAX_CONSTRAINED_MARGIN = 0.3
"""Margin of a posture below which its distance is constrained; see `PostureConstraint.margin`."""
MIN_MARGIN = -0.4
"""Margin below which a posture is too deep inside an obstacle to be led out of it."""
MARGIN_DIFFERENCE = 1e-4
"""Step of the finite differences of margins, rad or m."""
FORBIDDEN_POSTURE_EXCESS = 0.03
"""Excess of a motion with a forbidden posture: a random motion with one is made smaller in such steps."""
CENTRE_RANGE_SHARE = 0.7
"""Share of the range of positions from which the centre of a random motion is drawn."""
MAX_CENTRES = 200
"""Number of centres that are drawn before the arm counts as unable to stand anywhere."""


class PostureConstraint(Protocol):
    """Decides which postures are allowed, for example free of collisions."""

    def free(self, q: np.ndarray) -> bool:
        """Whether the posture (nj,) is allowed, without any safety distance; fast."""
        ...

    def margin(self, q: np.ndarray) -> float:
        """Distance of the posture (nj,) from a forbidden one, less the required distance; about 1 far from any."""
        ...


@dataclass(frozen=True, eq=False)
class ArmProblem(MotionProblem):
    """Find a motion of an arm that minimises a criterion.

    Attributes:
        columns: the regressor of the wanted and all other unknowns.
        criterion: function of the information that is minimised.
        series: the series of which motions consist.
        limits: limits of joints and torques.
        postures: decides which postures are allowed.
        cuts: half-spaces normal . q >= bound that contain the allowed postures, one at every instant of the finer grid:
            normals (n, nj), 0 where nothing is near, and bounds (n,), -infinity there; None where there are none.
    """

    columns: TorqueRegressor
    criterion: InformationCriterion
    series: FourierSeries
    limits: MotionLimits
    postures: PostureConstraint
    cuts: tuple[np.ndarray, np.ndarray] | None = None

    steps, starts = ARM_ROUND_STEPS, ARM_STARTS

    @cached_property
    def grid(self) -> SeriesBasis:
        """The series at (n,) instants of one period, at which information and torques are computed."""
        count = max(ceil(INSTANTS_PER_SECOND * self.series.period), 4 * self.series.harmonics)
        return self.series.at(self.series.period * np.arange(count) / count)

    @cached_property
    def finer(self) -> SeriesBasis:
        """The series at instants `KINEMATIC_REFINEMENT` times as dense as in `grid`."""
        count = KINEMATIC_REFINEMENT * len(self.grid.time)
        return self.series.at(self.series.period * np.arange(count) / count)

    @property
    def weight(self) -> float:
        """Number of samples of the recording per instant of the grid."""
        return self.columns.rate * self.series.seconds / len(self.grid.time)

    def information(self, x: np.ndarray) -> np.ndarray:
        """(P, P) Fisher information of a recording of the whole motion."""
        columns = self.columns.at(self.grid.motion(x))
        X = columns.reshape(-1, columns.shape[2])
        return np.asarray(self.weight * X.T @ X)

    def cost(self, x: np.ndarray) -> float:
        """Value of the criterion for a motion."""
        return self.criterion(self.information(x))[0]

    def grid_excess(self, x: np.ndarray) -> float:
        """Largest share by which a limit of position, speed, acceleration or torque is exceeded."""
        torque = self.columns.torque(self.grid.motion(x))
        return max(self.kinematic_excess(x), float(np.max(np.abs(torque) / self.limits.effort)) - 1.0)

    def excess(self, x: np.ndarray) -> float:
        """Largest share by which a limit is exceeded; `FORBIDDEN_POSTURE_EXCESS` for a forbidden posture alone."""
        excess = self.grid_excess(x)
        if excess > 0.0:
            return excess
        q = self.grid.motion(x).q
        # Postures far apart are tested first: a motion that is too large mostly fails there at once.
        order = np.argsort(np.arange(len(q)) * 0.6180339887 % 1.0)
        return excess if all(self.postures.free(posture) for posture in q[order]) else FORBIDDEN_POSTURE_EXCESS

    def centre(self, rng: np.random.Generator) -> np.ndarray | None:
        """A posture that is allowed and that the joints' torques can hold."""
        still = np.zeros((len(self.limits.half), self.series.size))
        for _ in range(MAX_CENTRES):
            away = self.limits.half * rng.uniform(-1.0, 1.0, len(still))
            still[:, 0] = self.limits.middle + CENTRE_RANGE_SHARE * away
            if self.postures.free(still[:, 0]) and self.grid_excess(still) <= 0.0:
                return still[:, 0]
        return None

    def about(self, x: np.ndarray) -> "ArmProblem":
        """The problem with half-spaces at the postures of a motion that are near an obstacle."""
        finer, margin = self.finer.motion(x).q, self.postures.margin
        normal, bound = np.zeros(finer.shape), np.full(len(finer), -np.inf)
        for i, q in enumerate(self.grid.motion(x).q):
            here = margin(q)
            if here > MAX_CONSTRAINED_MARGIN:
                continue
            steps = MARGIN_DIFFERENCE * np.eye(len(q))
            slope = np.array([margin(q + step) - here for step in steps]) / MARGIN_DIFFERENCE
            for away in range(-(KINEMATIC_REFINEMENT // 2), KINEMATIC_REFINEMENT // 2 + 1):
                k = (KINEMATIC_REFINEMENT * i + away) % len(finer)
                normal[k], bound[k] = slope, slope @ finer[k] - (margin(finer[k]) if away else here)
        return replace(self, cuts=(normal, bound))

    def accepted(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """The motion after a round, or a motion between, in which no posture is deep inside an obstacle.

        The constraint linearised at a deep posture may lead further through the obstacle.
        """
        for share in (1.0, 0.5, 0.25, 0.1):
            x = before + share * (after - before)
            touching = (q for q in self.grid.motion(x).q if not self.postures.free(q))  # fast; distances are not
            if all(self.postures.margin(q) > MIN_MARGIN for q in touching):
                return np.asarray(x)
        return before

    def effect(self, x: np.ndarray) -> EvaluatedMotion:
        """Criterion, torques and postures of a motion, with their gradient."""
        effort = self.limits.effort
        columns, torque, by_motion = self.columns.with_slopes(self.grid.motion(x))
        X = columns.reshape(-1, columns.shape[2])
        value, by_information = self.criterion(self.weight * X.T @ X)
        by_columns = (2.0 * self.weight * X @ by_information).reshape(columns.shape)
        beyond = [two_sided_excess(torque / effort)]
        if self.cuts is not None:
            normal, bound = self.cuts
            beyond.append(bound - np.einsum("nj,nj->n", normal, self.finer.motion(x).q))

        def gradient(weights: Sequence[np.ndarray]) -> np.ndarray:
            total = self.grid.gradient(*by_motion(by_columns, (weights[0][0] - weights[0][1]) / effort))
            if self.cuts is not None:
                total -= (weights[1][:, None] * normal).T @ self.finer.functions[0]
            return total

        return EvaluatedMotion(value, beyond, gradient)
