r"""The motion of the gripper that tells rivals apart best.

Maximised is the smallest separation, over every ordered pair of hypotheses, of what one predicts from what the other
can be refitted to, within the limits of gripper and swing. At the minimum over the rival's unknowns its derivatives
with respect to them vanish, so that (envelope theorem; Milgrom & Segal, Econometrica 70, 2002)

    d lambda / dc = 2 r' (dy_H/dc - dy_R/dc),      r = y_H - y_R at the refit,

is exact with one reverse pass through each model, for any number of coefficients c.
"""

from collections.abc import Sequence
from copy import copy

import numpy as np

from armdyn.errors import InputError, TaskFailedError
from armdyn.experiments.hypothesis import Experiment, Hypothesis, PredictedExperiment
from armdyn.experiments.limits import GripperLimits, two_sided
from armdyn.experiments.search import Evaluated, MotionProblem, Say, random_motions, search, shrink
from armdyn.experiments.separation import Rival, linear_separation
from armdyn.experiments.series import Basis, Series
from armdyn.pendulum.path import GripperPath

BAND = 2.5
"""Hz; within 2 m/s^2 a faster motion is smaller than 8 mm, and hardly swings the load."""
LONGEST_PERIOD = 9.6
"""s: 24 harmonics; a longer motion repeats one of at most this length."""
SHORTEST = 3.0
"""s; a shorter motion holds no swing of a load on a usual string."""
LONGEST = 120.0
"""s."""
STEP = 0.01
"""s between the nodes of a motion."""
COARSE = 0.02
"""s between the nodes while it is searched for; the outcome is computed with `STEP`."""
TRIED = 24
"""Random motions, of which the best are carried on."""
STEPS = (10, 16, 16)
"""L-BFGS steps of the rounds with two hypotheses; more hypotheses share these numbers."""
STARTS = 2
"""See `MotionProblem.starts`."""
FEWEST_STEPS = 10
"""Of a round."""
SHARPNESS = 4.0
"""Of the smooth minimum over pairs of the logarithm of the separation."""
REFIT_STEPS = 2
"""Of a rival at every motion: it starts where it was at the one before."""
HARDEST = 4
"""Pairs that a round is made for, of those that its start separates least."""
BLIND = 0.05
"""Rise of chi2 that the best of the random motions reaches of a pair that no motion separates: design gains a factor of
10 to 1000, the pairs that can be separated start at 0.3."""
LEAST = 1e-6
"""Added to a rise of chi2: pairs that no motion separates have a logarithm."""
NEGLIGIBLE = 5e-4
"""Share in the smooth minimum below which a pair's slope is left out: it takes a reverse pass."""
SLACK = 0.05
"""Excess that counts for a string that goes slack: the motion is made smaller by such steps."""

Pair = tuple[int, int]
"""Indices of the hypothesis that is true and of the rival that is refitted."""


def motion_series(seconds: float) -> Series:
    """The series of which a gripper's motion is made.

    Raises:
        InputError: no motion can have this duration.
    """
    if not SHORTEST <= seconds <= LONGEST:
        raise InputError(f"a motion of {seconds:g} s: give {SHORTEST:g} to {LONGEST:g} s")
    return Series(STEP * round(seconds / STEP), BAND, LONGEST_PERIOD, from_start=True)


class GripperProblem(MotionProblem):
    """A motion of the gripper that separates hypotheses.

    Args:
        hypotheses: two or more.
        experiment: what is measured; its motion is replaced.
        series: of which motions are made.
        limits: of gripper and swing.
        step: s between the nodes.

    Attributes:
        pairs: that are to be separated; all ordered ones at first.
    """

    starts = STARTS

    def __init__(
        self,
        hypotheses: Sequence[Hypothesis],
        experiment: Experiment,
        series: Series,
        limits: GripperLimits,
        step: float = COARSE,
    ) -> None:
        self.series, self.limits, self.swing = series, limits.along, limits.swing
        self._basis = series.at(np.linspace(0.0, series.seconds, round(series.seconds / step) + 1))
        still = self.motion(np.zeros((1, series.size)))
        self._predicted = [PredictedExperiment(h, experiment.along(still)) for h in hypotheses]
        count = range(len(hypotheses))
        self.pairs: tuple[Pair, ...] = tuple((i, j) for i in count for j in count if i != j)
        self._values: dict[Pair, np.ndarray] = {}

    @property
    def finer(self) -> Basis:
        """The nodes themselves."""
        return self._basis

    @property
    def steps(self) -> tuple[int, ...]:
        """Of the rounds, fewer for more pairs."""
        share = 2.0 / min(len(self.pairs), HARDEST)
        return tuple(max(round(share * count), FEWEST_STEPS) for count in STEPS)

    def motion(self, x: np.ndarray) -> GripperPath:
        """The motion of (1, size) coefficients."""
        moved, time = self._basis.motion(x), self._basis.time
        return GripperPath(0.0, float(time[1]), moved.q[:, 0], moved.v[:, 0], moved.a[:, 0])

    def along(self, x: np.ndarray) -> list[PredictedExperiment]:
        """What every hypothesis predicts along the motion of (1, size) coefficients."""
        motion = self.motion(x)
        return [predicted.along(motion) for predicted in self._predicted]

    def separations(self, x: np.ndarray) -> np.ndarray:
        """(pairs,) rise of chi2 of each pair, by linearisation."""
        here = self.along(x)
        return np.array([linear_separation(here[i], here[j]) for i, j in self.pairs])

    def cost(self, x: np.ndarray) -> float:
        """Less the logarithm of the smallest separation, by linearisation."""
        return -float(np.log(max(self.separations(x).min(), 0.0) + LEAST))

    def excess(self, x: np.ndarray) -> float:
        """Largest share by which a limit of gripper or swing is exceeded; `SLACK` where a string goes slack."""
        excess = self.kinematic_excess(x)
        if excess > 0.0:
            return excess
        here = self.along(x)
        widest = max(float(np.abs(p.swing(p.start)).max()) for p in here) / self.swing - 1.0
        if not widest <= 0.0:
            return widest
        taut = all(float(p.tension(p.start).min()) > 0.0 for p in here)
        return max(excess, widest) if taut else SLACK

    def centre(self, rng: np.random.Generator) -> np.ndarray:
        """Where the motion starts."""
        del rng
        return np.zeros(1)

    def about(self, x: np.ndarray) -> "GripperProblem":
        """For the pairs that the motion separates least; their rivals are refitted to the end, as none is later on."""
        here = self.along(x)
        hardest = self.only(tuple(self.pairs[k] for k in np.argsort(self.separations(x))[:HARDEST]))
        hardest._values = {
            (i, j): Rival(here[j], here[i].predict(here[i].start)[0]).refitted()[1] for i, j in hardest.pairs
        }
        return hardest

    def only(self, pairs: tuple[Pair, ...]) -> "GripperProblem":
        """The same for these pairs alone."""
        other = copy(self)
        other.pairs = pairs
        return other

    def effect(self, x: np.ndarray) -> Evaluated:
        """Less the smooth minimum of the logarithm of the separations, and the swings, with their gradient."""
        here = self.along(x)
        truths = [p.predict(p.start)[0] for p in here]
        rises, rests = np.empty(len(self.pairs)), []
        for k, (i, j) in enumerate(self.pairs):
            rises[k], values = Rival(here[j], truths[i]).refitted(self._values[i, j], REFIT_STEPS)
            self._values[i, j] = values
            rests.append(truths[i] - here[j].predict(values)[0])
        logs = np.log(rises + LEAST)
        shares = np.exp(-SHARPNESS * (logs - logs.min()))
        smallest = float(logs.min() - np.log(shares.sum()) / SHARPNESS)
        shares /= shares.sum()
        by_rise = shares * 2.0 / (rises + LEAST)

        def gradient(weights: Sequence[np.ndarray]) -> np.ndarray:
            total = np.zeros(x.size)
            for i, (predicted, by) in enumerate(zip(here, weights, strict=True)):
                rest = np.zeros(len(truths[i]))
                for weight, left, (truth, _) in zip(by_rise, rests, self.pairs, strict=True):
                    if truth == i:
                        rest -= weight * left
                push = (by[0] - by[1]) / self.swing
                if rest.any() or push.any():
                    total += predicted.by_coefficients(predicted.start, self._basis, rest, push)
            for share, weight, left, (i, j) in zip(shares, by_rise, rests, self.pairs, strict=True):
                if share > NEGLIGIBLE:
                    total += here[j].by_coefficients(self._values[i, j], self._basis, weight * left)
            return total[None]

        return Evaluated(-smallest, [two_sided(p.swing(p.start) / self.swing) for p in here], gradient)


def design_motion(
    hypotheses: Sequence[Hypothesis],
    experiment: Experiment,
    seconds: float,
    limits: GripperLimits | None = None,
    seed: int = 0,
    say: Say = lambda _: None,
) -> tuple[GripperPath, float]:
    """Find the motion that makes the smallest separation of any two hypotheses largest.

    Args:
        hypotheses: two or more.
        experiment: what is measured; its motion is replaced.
        seconds: duration of the motion.
        limits: of gripper and swing.
        seed: of the random motions.
        say: told how far it is.

    Returns:
        The motion, within the limits, and the smallest rise of chi2 over all ordered pairs, by linearisation, for the
        median of the random motions.

    Raises:
        InputError: no motion can have this duration.
        TaskFailedError: no load keeps its string taut and within the limit of the swing, however small the motion.
    """
    series, limits = motion_series(seconds), limits or GripperLimits()
    problem = GripperProblem(hypotheses, experiment, series, limits)
    starts = random_motions(problem, TRIED, np.random.default_rng(seed), say)
    if not starts:
        raise TaskFailedError("however little the gripper moves, the load swings too far: allow it a wider --swing")
    rises = np.array([problem.separations(x) for x in starts])
    # A pair that none of them separates is left to other experiments, unless there is no other pair.
    widest = dict(zip(problem.pairs, rises.max(axis=0), strict=True))
    wanted = [k for k, (i, j) in enumerate(problem.pairs) if max(widest[i, j], widest[j, i]) > BLIND]
    if wanted:
        problem, rises = problem.only(tuple(problem.pairs[k] for k in wanted)), rises[:, wanted]
    found = search(problem, starts, [-float(rise) for rise in rises.min(axis=1)], say)
    fine = GripperProblem(hypotheses, experiment, series, limits, STEP)
    inside = shrink(fine, found)
    return fine.motion(found * 0.0 if inside is None else inside), float(np.median(rises.min(axis=1)))
