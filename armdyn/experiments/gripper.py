r"""Design the motion of a gripper with a load on a string that distinguishes rival hypotheses best.

The smallest separation is maximised, over every ordered pair of hypotheses, between the prediction of one and the best
refit of the other, within the limits of gripper and swing. At the minimum over the rival's unknowns the derivatives
with respect to them vanish, so that (envelope theorem; Milgrom & Segal, Econometrica 70, 2002)

    d lambda / dc = 2 r' (dy_H/dc - dy_R/dc),      r = y_H - y_R at the refit,

is exact with one reverse pass through each model, for any number of coefficients c.
"""

from collections.abc import Iterable, Sequence
from copy import copy
from functools import cached_property
from itertools import permutations

import numpy as np

from armdyn.errors import InputError, TaskFailedError
from armdyn.experiments.hypothesis import Hypothesis, PlannedExperiment, PredictedExperiment
from armdyn.experiments.limits import GripperLimits, two_sided_excess
from armdyn.experiments.search import (
    EvaluatedMotion,
    MotionProblem,
    ReportProgress,
    best_motion,
    random_motions,
    shrink_within_limits,
)
from armdyn.experiments.separation import RivalRefitCost, linear_separation
from armdyn.experiments.series import FourierSeries, SeriesBasis
from armdyn.pendulum.path import GripperPath

GRIPPER_MAX_FREQUENCY_HZ = 2.5
"""Highest frequency of a designed motion of the gripper, Hz; within 2 m/s^2 a faster motion is smaller than 8 mm, and
hardly swings the load."""
GRIPPER_MAX_PERIOD_SECONDS = 9.6
"""Longest period of a gripper's motion, s, which has 24 harmonics; a longer motion repeats a period."""
MIN_GRIPPER_MOTION_SECONDS = 3.0
"""Shortest designed motion of a gripper, s; a shorter one contains no swing of a load on a usual string."""
MAX_GRIPPER_MOTION_SECONDS = 120.0
"""Longest designed motion of a gripper, s."""
GRIPPER_NODE_INTERVAL_SECONDS = 0.01
"""Time between the nodes of a gripper's motion, s."""
COARSE_NODE_INTERVAL_SECONDS = 0.02
"""Time between the nodes of a gripper's motion during the search, s; the result has `GRIPPER_NODE_INTERVAL_SECONDS`."""
RANDOM_GRIPPER_MOTIONS_TRIED = 24
"""Number of random motions of a gripper, the best of which are optimised."""
GRIPPER_LBFGS_STEPS_BY_ROUND = (10, 16, 16)
"""Numbers of L-BFGS steps in the rounds of the search with two hypotheses; with more hypotheses they are divided."""
GRIPPER_SEARCH_STARTS = 2
"""Number of random motions of a gripper from which the search starts."""
MIN_LBFGS_STEPS_PER_ROUND = 10
"""Least number of L-BFGS steps in a round of the search."""
SMOOTH_MINIMUM_SHARPNESS = 4.0
"""Sharpness of the smooth minimum of the logarithms of the separations of all pairs of hypotheses."""
RIVAL_REFIT_STEPS_PER_MOTION = 2
"""Number of steps of a rival's refit at each motion; the refit starts from the values at the previous motion."""
HYPOTHESIS_PAIRS_PER_ROUND = 4
"""Number of pairs of hypotheses that a round of the search optimises: those that are separated least at its start."""
MAX_INSEPARABLE_CHI2_RISE = 0.05
"""Rise of chi2 by the best random motion up to which no motion separates a pair of hypotheses. Pairs that a motion
separates have 0.3 or more, and the design increases it by a factor of 10 to 1000."""
CHI2_RISE_ADDED_FOR_LOGARITHM = 1e-6
"""Number added to a rise of chi2, so that its logarithm exists for a pair that no motion separates."""
NEGLIGIBLE_SHARE_OF_SMOOTH_MINIMUM = 5e-4
"""Share of a pair of hypotheses in the smooth minimum below which its gradient is neglected."""
SLACK_STRING_EXCESS_SHARE = 0.05
"""Excess over limits that is assigned to a motion that slackens the string, as a share: such a motion is made smaller
by this share."""

HypothesisPair = tuple[int, int]
"""Indices of the hypothesis that is true and of the rival that is refitted."""


def motion_series(seconds: float) -> FourierSeries:
    """The Fourier series of which a gripper's motion of a duration, s, consists.

    Raises:
        InputError: no motion can have this duration.
    """
    if not MIN_GRIPPER_MOTION_SECONDS <= seconds <= MAX_GRIPPER_MOTION_SECONDS:
        raise InputError(
            f"a motion of {seconds:g} s: give {MIN_GRIPPER_MOTION_SECONDS:g} to {MAX_GRIPPER_MOTION_SECONDS:g} s"
        )
    return FourierSeries(
        GRIPPER_NODE_INTERVAL_SECONDS * round(seconds / GRIPPER_NODE_INTERVAL_SECONDS),
        GRIPPER_MAX_FREQUENCY_HZ,
        GRIPPER_MAX_PERIOD_SECONDS,
        relative_to_start_position=True,
    )


class GripperProblem(MotionProblem):
    """Search for the motion of a gripper that separates hypotheses best; the motion's nodes are `step` s apart.

    Attributes:
        pairs: pairs of hypotheses to separate; at first all ordered pairs.
    """

    start_count = GRIPPER_SEARCH_STARTS

    def __init__(
        self,
        hypotheses: Sequence[Hypothesis],
        experiment: PlannedExperiment,
        series: FourierSeries,
        limits: GripperLimits,
        step: float = COARSE_NODE_INTERVAL_SECONDS,
    ) -> None:
        self.series, self.limits, self.swing = series, limits.along, limits.swing
        self._nodes = round(series.seconds / step) + 1
        still = self.motion(np.zeros((1, series.coefficient_count)))
        self._predicted = [PredictedExperiment(h, experiment.along_motion(still)) for h in hypotheses]
        self.pairs: tuple[HypothesisPair, ...] = tuple(permutations(range(len(hypotheses)), 2))
        self._values: dict[HypothesisPair, np.ndarray] = {}

    @cached_property
    def kinematic_basis(self) -> SeriesBasis:
        """The Fourier series at the nodes, at which positions, velocities and accelerations are limited."""
        return self.series.basis_at(np.linspace(0.0, self.series.seconds, self._nodes))

    @property
    def steps_per_round(self) -> tuple[int, ...]:
        """Number of L-BFGS steps of each round, smaller for more pairs of hypotheses."""
        share = 2.0 / min(len(self.pairs), HYPOTHESIS_PAIRS_PER_ROUND)
        return tuple(max(round(share * count), MIN_LBFGS_STEPS_PER_ROUND) for count in GRIPPER_LBFGS_STEPS_BY_ROUND)

    def motion(self, x: np.ndarray) -> GripperPath:
        """The gripper's motion with (1, size) Fourier coefficients x."""
        q, v, a = self.kinematic_basis.motion(x)
        return GripperPath(0.0, float(self.kinematic_basis.time[1]), q[:, 0], v[:, 0], a[:, 0])

    def predictions_along(self, x: np.ndarray) -> list[PredictedExperiment]:
        """Prediction of every hypothesis along the motion with (1, size) Fourier coefficients x."""
        motion = self.motion(x)
        return [predicted.along_motion(motion) for predicted in self._predicted]

    def separations(self, x: np.ndarray) -> np.ndarray:
        """(pairs,) rise of chi2 that separates each pair of hypotheses, by linearisation."""
        here = self.predictions_along(x)
        return np.array([linear_separation(here[i], here[j]) for i, j in self.pairs])

    def cost(self, x: np.ndarray) -> float:
        """Negative logarithm of the smallest separation, by linearisation."""
        return -float(np.log(max(self.separations(x).min(), 0.0) + CHI2_RISE_ADDED_FOR_LOGARITHM))

    def excess(self, x: np.ndarray) -> float:
        """Largest share by which a motion exceeds a limit of gripper or swing.

        It is `SLACK_STRING_EXCESS_SHARE` where the motion exceeds no limit, but a string goes slack.
        """
        excess = self.kinematic_excess(x)
        if excess > 0.0:
            return excess
        here = self.predictions_along(x)
        widest = max(float(np.abs(p.swing(p.start)).max()) for p in here) / self.swing - 1.0
        if not widest <= 0.0:
            return widest
        taut = all(float(p.tension(p.start).min()) > 0.0 for p in here)
        return max(excess, widest) if taut else SLACK_STRING_EXCESS_SHARE

    def random_centre(self, rng: np.random.Generator) -> np.ndarray:
        """(1,) position at which the gripper's motion starts: 0."""
        del rng
        return np.zeros(1)

    def linearised_around(self, x: np.ndarray) -> "GripperProblem":
        """The problem for those pairs of hypotheses that the motion x separates least, with converged refits."""
        here = self.predictions_along(x)
        hardest = self.with_pairs(np.argsort(self.separations(x))[:HYPOTHESIS_PAIRS_PER_ROUND])
        hardest._values = {
            (i, j): RivalRefitCost(here[j], here[i].predict(here[i].start)[0]).chi2_increase_and_refit()[1]
            for i, j in hardest.pairs
        }
        return hardest

    def with_pairs(self, which: Iterable[int]) -> "GripperProblem":
        """The problem for only those pairs of hypotheses that have these indices."""
        other = copy(self)
        other.pairs = tuple(self.pairs[k] for k in which)
        return other

    def cost_and_constraints(self, x: np.ndarray) -> EvaluatedMotion:
        """Negative smooth minimum of the logarithms of the separations, and the limits of the swing, with gradient."""
        here = self.predictions_along(x)
        truths = [p.predict(p.start)[0] for p in here]
        rises, residuals = np.empty(len(self.pairs)), []
        for k, (i, j) in enumerate(self.pairs):
            rises[k], values = RivalRefitCost(here[j], truths[i]).chi2_increase_and_refit(
                self._values[i, j], RIVAL_REFIT_STEPS_PER_MOTION
            )
            self._values[i, j] = values
            residuals.append(truths[i] - here[j].predict(values)[0])
        logs = np.log(rises + CHI2_RISE_ADDED_FOR_LOGARITHM)
        shares = np.exp(-SMOOTH_MINIMUM_SHARPNESS * (logs - logs.min()))
        smallest = float(logs.min() - np.log(shares.sum()) / SMOOTH_MINIMUM_SHARPNESS)
        shares /= shares.sum()
        pulls = [
            2.0 * share / (rise + CHI2_RISE_ADDED_FOR_LOGARITHM) * r
            for share, rise, r in zip(shares, rises, residuals, strict=True)
        ]

        def gradient(weights: Sequence[np.ndarray]) -> np.ndarray:
            total = np.zeros(x.size)
            for i, (predicted, by) in enumerate(zip(here, weights, strict=True)):
                own = [pull for pull, (truth, _) in zip(pulls, self.pairs, strict=True) if truth == i]
                pull = -np.sum(own, axis=0) if own else np.zeros(len(truths[i]))
                push = (by[0] - by[1]) / self.swing
                if pull.any() or push.any():
                    total += predicted.coefficient_gradient(predicted.start, self.kinematic_basis, pull, push)
            for share, pull, (i, j) in zip(shares, pulls, self.pairs, strict=True):
                if share > NEGLIGIBLE_SHARE_OF_SMOOTH_MINIMUM:
                    total += here[j].coefficient_gradient(self._values[i, j], self.kinematic_basis, pull)
            return total[None]

        return EvaluatedMotion(-smallest, [two_sided_excess(p.swing(p.start) / self.swing) for p in here], gradient)


def design_motion(
    hypotheses: Sequence[Hypothesis],
    experiment: PlannedExperiment,
    seconds: float,
    limits: GripperLimits | None = None,
    seed: int = 0,
    say: ReportProgress = lambda _: None,
) -> tuple[GripperPath, float]:
    """Find the gripper's motion of a duration, s, that maximises the smallest separation of any two hypotheses.

    Returns:
        The motion within the limits; and, for comparison, the smallest rise of chi2 over all ordered pairs by a random
        motion: the median of the random motions.

    Raises:
        InputError: no motion can have this duration.
        TaskFailedError: every motion, however small, makes a string slack or exceeds the limit of the swing.
    """
    series, limits = motion_series(seconds), limits or GripperLimits()
    problem = GripperProblem(hypotheses, experiment, series, limits)
    starts = random_motions(problem, RANDOM_GRIPPER_MOTIONS_TRIED, np.random.default_rng(seed), say)
    if not starts:
        raise TaskFailedError("however little the gripper moves, the load swings too far: allow it a wider --swing")
    rises = np.array([problem.separations(x) for x in starts])
    # A pair that no random motion separates is left to other experiments, unless it is the only one.
    widest = dict(zip(problem.pairs, rises.max(axis=0), strict=True))
    wanted = [
        k for k, (i, j) in enumerate(problem.pairs) if max(widest[i, j], widest[j, i]) > MAX_INSEPARABLE_CHI2_RISE
    ]
    if wanted:
        problem, rises = problem.with_pairs(wanted), rises[:, wanted]
    found = best_motion(problem, starts, [-float(rise) for rise in rises.min(axis=1)], say)
    fine = GripperProblem(hypotheses, experiment, series, limits, GRIPPER_NODE_INTERVAL_SECONDS)
    inside = shrink_within_limits(fine, found)
    return fine.motion(found * 0.0 if inside is None else inside), float(np.median(rises.min(axis=1)))
