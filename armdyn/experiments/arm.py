"""Design the motion of an arm that determines wanted unknowns best, within limits of torque and posture.

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

EVALUATED_INSTANTS_PER_SECOND = 8.0
"""Number of instants per second at which information and torques of a motion are computed."""
KINEMATIC_INSTANTS_FACTOR = 3
"""Factor on `EVALUATED_INSTANTS_PER_SECOND` for positions, speeds and accelerations, whose peaks are cheap to find."""
ARM_LBFGS_STEPS_BY_ROUND = (20, 40, 40, 30, 20, 15)
"""Numbers of L-BFGS steps in the rounds of the search for an arm's motion."""
ARM_SEARCH_STARTS = 3
"""Number of random motions of an arm from which the search starts."""
MAX_CONSTRAINED_POSTURE_MARGIN = 0.3
"""Margin of a posture below which its distance from obstacles is constrained; see `PostureConstraint.margin`."""
MIN_LINEARISABLE_POSTURE_MARGIN = -0.4
"""Margin below which a posture is so deep inside an obstacle that linearised constraints do not lead out of it."""
MARGIN_DIFFERENCE_STEP = 1e-4
"""Step of the finite differences of margins, rad or m."""
FORBIDDEN_POSTURE_EXCESS_SHARE = 0.03
"""Excess over limits that is assigned to a motion with a forbidden posture, as a share: such a motion is made smaller
by this share."""
MOTION_CENTRE_RANGE_SHARE = 0.7
"""Share of the range of positions from which the centre of a random motion is drawn."""
MAX_MOTION_CENTRES_TRIED = 200
"""Number of random centres that are tried before the arm counts as unable to rest anywhere."""


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
    """Search for the motion of an arm that minimises a criterion of its information matrix.

    Attributes:
        columns: the regressor of the wanted and all other unknowns.
        criterion: function of the information matrix that is minimised.
        series: Fourier series of which motions consist.
        limits: limits of joints and torques.
        postures: decides which postures are allowed.
        posture_half_spaces: half-spaces normal . q >= bound that contain the allowed postures, one at every instant of
            `kinematic_basis`: normals (n, nj) and bounds (n,), 0 and -infinity far from obstacles; None without them.
    """

    columns: TorqueRegressor
    criterion: InformationCriterion
    series: FourierSeries
    limits: MotionLimits
    postures: PostureConstraint
    posture_half_spaces: tuple[np.ndarray, np.ndarray] | None = None

    steps_per_round, start_count = ARM_LBFGS_STEPS_BY_ROUND, ARM_SEARCH_STARTS

    @cached_property
    def torque_basis(self) -> SeriesBasis:
        """The Fourier series at the (n,) instants at which information and torques are computed."""
        count = max(ceil(EVALUATED_INSTANTS_PER_SECOND * self.series.period), 4 * self.series.harmonics)
        return self.series.basis_at(self.series.period * np.arange(count) / count)

    @cached_property
    def kinematic_basis(self) -> SeriesBasis:
        """The Fourier series at `KINEMATIC_INSTANTS_FACTOR` times as many instants as `torque_basis`."""
        count = KINEMATIC_INSTANTS_FACTOR * len(self.torque_basis.time)
        return self.series.basis_at(self.series.period * np.arange(count) / count)

    @property
    def weight(self) -> float:
        """Number of recorded samples for each instant at which the information is computed."""
        return self.columns.rate * self.series.seconds / len(self.torque_basis.time)

    def information(self, x: np.ndarray) -> np.ndarray:
        """(P, P) Fisher information of a recording of the motion with coefficients x, and of the earlier ones."""
        columns = self.columns.values_along(self.torque_basis.motion(x), self.torque_basis.time)
        X = columns.reshape(-1, columns.shape[2])
        return np.asarray(self.weight * X.T @ X + self.columns.information_of_earlier_runs)

    def cost(self, x: np.ndarray) -> float:
        """Value of the criterion for the motion with coefficients x."""
        return self.criterion(self.information(x))[0]

    def grid_excess(self, x: np.ndarray) -> float:
        """Largest share by which a limit of position, speed, acceleration or torque is exceeded."""
        torque = self.columns.described_torque(self.torque_basis.motion(x))
        return max(self.kinematic_excess(x), float(np.max(np.abs(torque) / self.limits.effort)) - 1.0)

    def excess(self, x: np.ndarray) -> float:
        """Largest share by which a motion exceeds a limit; a forbidden posture is `FORBIDDEN_POSTURE_EXCESS_SHARE`."""
        excess = self.grid_excess(x)
        if excess > 0.0:
            return excess
        q = self.torque_basis.motion(x).q
        # Postures far apart are tested first: a motion that is too large mostly fails there at once.
        order = np.argsort(np.arange(len(q)) * 0.6180339887 % 1.0)
        return excess if all(self.postures.free(posture) for posture in q[order]) else FORBIDDEN_POSTURE_EXCESS_SHARE

    def random_centre(self, rng: np.random.Generator) -> np.ndarray | None:
        """A random posture that is allowed and that the joints' torques can hold; None if none was found."""
        still = np.zeros((len(self.limits.half_range), self.series.coefficient_count))
        for _ in range(MAX_MOTION_CENTRES_TRIED):
            away = self.limits.half_range * rng.uniform(-1.0, 1.0, len(still))
            still[:, 0] = self.limits.middle + MOTION_CENTRE_RANGE_SHARE * away
            if self.postures.free(still[:, 0]) and self.grid_excess(still) <= 0.0:
                return still[:, 0]
        return None

    def linearised_around(self, x: np.ndarray) -> "ArmProblem":
        """The problem with obstacles replaced by half-spaces, at those postures of a motion that are near one."""
        finer, margin = self.kinematic_basis.motion(x).q, self.postures.margin
        normal, bound = np.zeros(finer.shape), np.full(len(finer), -np.inf)
        for i, q in enumerate(self.torque_basis.motion(x).q):
            here = margin(q)
            if here > MAX_CONSTRAINED_POSTURE_MARGIN:
                continue
            steps = MARGIN_DIFFERENCE_STEP * np.eye(len(q))
            slope = np.array([margin(q + step) - here for step in steps]) / MARGIN_DIFFERENCE_STEP
            for away in range(-(KINEMATIC_INSTANTS_FACTOR // 2), KINEMATIC_INSTANTS_FACTOR // 2 + 1):
                k = (KINEMATIC_INSTANTS_FACTOR * i + away) % len(finer)
                normal[k], bound[k] = slope, slope @ finer[k] - (margin(finer[k]) if away else here)
        return replace(self, posture_half_spaces=(normal, bound))

    def motion_after_round(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """The motion after a round of the search, shortened so that no posture is deep inside an obstacle.

        The constraint linearised at a deep posture may lead further through the obstacle.
        """
        for share in (1.0, 0.5, 0.25, 0.1):
            x = before + share * (after - before)
            touching = (
                q for q in self.torque_basis.motion(x).q if not self.postures.free(q)
            )  # fast; distances are not
            if all(self.postures.margin(q) > MIN_LINEARISABLE_POSTURE_MARGIN for q in touching):
                return np.asarray(x)
        return before

    def cost_and_constraints(self, x: np.ndarray) -> EvaluatedMotion:
        """Criterion of a motion, and its constraints on torques and postures, with their gradient."""
        effort = self.limits.effort
        columns, torque, by_motion = self.columns.with_gradient(self.torque_basis.motion(x), self.torque_basis.time)
        X = columns.reshape(-1, columns.shape[2])
        value, by_information = self.criterion(self.weight * X.T @ X + self.columns.information_of_earlier_runs)
        by_columns = (2.0 * self.weight * X @ by_information).reshape(columns.shape)
        beyond = [two_sided_excess(torque / effort)]
        if self.posture_half_spaces is not None:
            normal, bound = self.posture_half_spaces
            beyond.append(bound - np.einsum("nj,nj->n", normal, self.kinematic_basis.motion(x).q))

        def gradient(weights: Sequence[np.ndarray]) -> np.ndarray:
            total = self.torque_basis.gradient(*by_motion(by_columns, (weights[0][0] - weights[0][1]) / effort))
            if self.posture_half_spaces is not None:
                total -= (weights[1][:, None] * normal).T @ self.kinematic_basis.functions[0]
            return total

        return EvaluatedMotion(value, beyond, gradient)
