"""Compute the evidence of any set of effects, each at the noise for which the set is most likely.

The model's own error (kicks of the speeds, once in every half swing) and the sensors' coloured error are unknown; so a
set of effects is scored by its evidence at the noise that suits it best (type-II maximum likelihood: Bishop, Pattern
Recognition and Machine Learning, 2006, §3.5).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from armdyn.estimation.equations import NormalEquations
from armdyn.estimation.posterior import NormalPrior, freedom_nats, size_nats
from armdyn.estimation.solve import log_det, solve_positive
from armdyn.identify.problem import Problem
from armdyn.identify.state_space.grey_run import (
    LINEARISED_PRIOR_STD_TYPICAL_SIZES,
    LinearisedRun,
    RunNoise,
    scale_noise,
)
from armdyn.identify.state_space.innovations import ColouredNoise

TRIED_LOG_KICK_SIZES = np.arange(-7.0, 10.1, 1.2)
"""Natural logarithms of the tried sizes of the kicks, relative to the accuracy with which one piece of the motion
determines a speed."""
TRIED_COLOURED_TO_WHITE_VARIANCES = (0.0, 1.0, 6.0, 36.0, 216.0, 1296.0, 7776.0)
"""Tried variances of the correlated sensor error, over that of the white noise."""
TRIED_CORRELATION_TIMES_IN_PERIODS = (0.02, 0.08, 1.0 / 3.0)
"""Tried correlation times of the sensor error, in periods of the swing: with a longer one the error would be an offset.
"""
NOISE_LEVEL_FACTORS = (0.6, 1.6)
"""Tried factors, besides 1, on the noise of one of several channels."""
COARSE_STRIDES = (3, 3)
"""Strides in the grids of sensor errors and of kicks for a first coarse search."""
NOISE_OPTIMISATION_ROUNDS = 3
"""Number of rounds in which the noises of several runs, and the values and noise levels, are optimised in turn."""


@dataclass(frozen=True, eq=False)
class NoiseTable:
    """Normal equations of one run's innovations (prediction errors) at S noise settings.

    Attributes:
        noises: the S noise settings.
        equations: a unit for each of them.
        kick_count: number of different sizes of the kicks, which follow one another in `noises`.
    """

    noises: tuple[RunNoise, ...]
    equations: NormalEquations
    kick_count: int

    @property
    def rows(self) -> float:
        """Number of innovations of the run."""
        return float(self.equations.count[0])


def evaluate_noises(around: LinearisedRun, noises: Sequence[RunNoise], kicks: np.ndarray) -> NoiseTable:
    """Evaluate a linearised run at each of some sensor noises, combined with each of (K,) sizes of the kicks."""
    found = around.innovations(noises, kicks)
    every = tuple(replace(noise, process_noise_std=float(kick)) for noise in noises for kick in kicks)
    return NoiseTable(every, found, len(kicks))


def evaluate_one_noise(around: LinearisedRun, noise: RunNoise) -> NoiseTable:
    """Evaluate a linearised run at one noise setting."""
    return evaluate_noises(around, [noise], np.array([noise.process_noise_std]))


def evaluate_all_kicks(around: LinearisedRun, noise: RunNoise) -> NoiseTable:
    """Evaluate a linearised run over the whole range of kicks, with one sensor noise."""
    return evaluate_noises(around, [noise], around.kick_unit * np.exp(TRIED_LOG_KICK_SIZES))


def evaluate_all_noises(around: LinearisedRun, noise: RunNoise) -> NoiseTable:
    """Evaluate a linearised run over the whole range of kicks and of correlated errors of one channel.

    That channel is the one with the most information on the motion; the others keep the sensor noise of `noise`.
    """
    noise = scale_noise(noise, 1.0 / min(noise.white_noise_ratios))
    swing, kicks = around.run.swing, around.kick_unit * np.exp(TRIED_LOG_KICK_SIZES)
    colours = [ColouredNoise()] + [
        ColouredNoise(r, t * swing)
        for r, t in product(TRIED_COLOURED_TO_WHITE_VARIANCES[1:], TRIED_CORRELATION_TIMES_IN_PERIODS)
    ]
    k = around.most_informative_channel
    noises = [
        replace(noise, coloured_noise=(*noise.coloured_noise[:k], colour, *noise.coloured_noise[k + 1 :]))
        for colour in colours
    ]
    return evaluate_noises(around, noises, kicks)


def evaluate_nearby_noises(around: LinearisedRun, noise: RunNoise) -> NoiseTable:
    """Evaluate a linearised run at noise settings near a given one."""
    noise = scale_noise(noise, 1.0 / min(noise.white_noise_ratios))
    kicks = (
        np.clip(
            noise.process_noise_std / around.kick_unit,
            np.exp(TRIED_LOG_KICK_SIZES[0]),
            np.exp(TRIED_LOG_KICK_SIZES[-1]),
        )
        * around.kick_unit
    )
    kicks = kicks * np.exp(np.arange(-4.0, 4.0))
    found = [noise]
    for c, colour in enumerate(noise.coloured_noise):
        for other in _neighbours(colour, around.run.swing):
            found.append(
                replace(noise, coloured_noise=(*noise.coloured_noise[:c], other, *noise.coloured_noise[c + 1 :]))
            )
        for factor in NOISE_LEVEL_FACTORS if len(noise.white_noise_ratios) > 1 else ():
            found.append(
                replace(
                    noise,
                    white_noise_ratios=(
                        *noise.white_noise_ratios[:c],
                        factor * noise.white_noise_ratios[c],
                        *noise.white_noise_ratios[c + 1 :],
                    ),
                )
            )
    return evaluate_noises(around, found, kicks)


def _neighbours(colour: ColouredNoise, swing: float) -> list[ColouredNoise]:
    """Neighbours of a colour in the grid."""
    if colour.variance_ratio == 0.0:
        return [
            ColouredNoise(TRIED_COLOURED_TO_WHITE_VARIANCES[1], t * swing)
            for t in TRIED_CORRELATION_TIMES_IN_PERIODS[1::2]
        ]
    r = TRIED_COLOURED_TO_WHITE_VARIANCES.index(
        min(TRIED_COLOURED_TO_WHITE_VARIANCES, key=lambda x: abs(x - colour.variance_ratio))
    )
    t = int(np.argmin([abs(x * swing - colour.correlation_time) for x in TRIED_CORRELATION_TIMES_IN_PERIODS]))
    found = [ColouredNoise()] if r == 1 else []
    for dr, dt in ((-1, 0), (1, 0), (0, -1), (0, 1), (2, 0), (-2, 0)):
        if 0 < r + dr < len(TRIED_COLOURED_TO_WHITE_VARIANCES) and 0 <= t + dt < len(
            TRIED_CORRELATION_TIMES_IN_PERIODS
        ):
            found.append(
                ColouredNoise(
                    TRIED_COLOURED_TO_WHITE_VARIANCES[r + dr], TRIED_CORRELATION_TIMES_IN_PERIODS[t + dt] * swing
                )
            )
    return found


@dataclass(frozen=True, eq=False)
class SetEvidence:
    """Evidence of a set of effects at the noise for which the set is most likely.

    Attributes:
        log_evidence: log evidence of the training runs, nats.
        prediction_log_likelihood: log likelihood of the other runs, which are predicted from the training runs, nats.
        occam_penalty_nats: penalty, nats, for the freedom of the unknowns; it is already subtracted in `value`.
        change: (P,) change of the unknowns from the point of linearisation.
        noise_indices: by run, index of the most likely noise setting in the run's table.
        noise_factors: by run, most likely factor on that noise.
        information: (P, P) information matrix of the training runs at these noises.
        within_bounds: False if an effect has a value on a bound (other than its null value) beyond which the runs would
            be much more likely.
    """

    log_evidence: float
    prediction_log_likelihood: float
    occam_penalty_nats: float
    change: np.ndarray
    noise_indices: tuple[int, ...]
    noise_factors: tuple[float, ...]
    information: np.ndarray
    within_bounds: bool


class RunNoiseTables:
    """Tables of several runs, linearised at one point, from which the evidence of any set of effects follows.

    Args:
        tables: table of each run; the fitted runs come first.
        values: (P,) values at the point of linearisation.
        problem: the problem of these unknowns.
        training: number of runs that are fitted; the others are predicted.
        removable: (P,) bool, unknowns that are at their null values where they are not fitted.
        begin: by run, index of the noise setting from which a short search starts; None for a full search.
    """

    def __init__(
        self,
        tables: Sequence[NoiseTable],
        values: np.ndarray,
        problem: Problem,
        training: int,
        removable: np.ndarray,
        begin: Sequence[int] | None = None,
    ) -> None:
        self._begin, self._rounds = begin, NOISE_OPTIMISATION_ROUNDS if begin is None else 1
        self.tables, self.values, self.problem, self.training = tuple(tables), values, problem, training
        self._removable = removable
        self._owner = np.array([-1 if c.run is None else c.run for c in problem.columns])
        self.rows = sum(table.rows for table in tables[:training])
        with np.errstate(divide="ignore"):
            known = np.minimum(1.0 / problem.prior_weight, 1.0 / problem.guess_weight)
            width = np.minimum(LINEARISED_PRIOR_STD_TYPICAL_SIZES * problem.typical, known)
        self._typical = np.minimum(problem.typical, width)
        guessed = np.where(problem.guess_weight > 0, problem.guess_mean - values, 0.0)
        centre = np.where(problem.prior_weight > 0, problem.prior_mean - values, guessed)
        self._prior = NormalPrior(width, centre, problem.lower - values, problem.upper - values)

    def coarsened(self, like: SetEvidence) -> "RunNoiseTables":
        """Tables with fewer noise settings, for a quick comparison of many sets of effects.

        Args:
            like: evidence of a set, from whose noise the search starts.
        """
        thinned, begin = [], []
        for table, pick in zip(self.tables, like.noise_indices, strict=True):
            colours = len(table.noises) // table.kick_count
            at = np.array(
                [
                    c * table.kick_count + k
                    for c in range(0, colours, COARSE_STRIDES[0])
                    for k in range(0, table.kick_count, COARSE_STRIDES[1])
                ]
            )
            begin.append(int(np.argmin(np.abs(at - pick))))
            kicks = len(range(0, table.kick_count, COARSE_STRIDES[1]))
            thinned.append(NoiseTable(tuple(table.noises[i] for i in at), table.equations.only(at), kicks))
        return RunNoiseTables(thinned, self.values, self.problem, self.training, self._removable, begin)

    @np.errstate(all="ignore")
    def evidence(self, free: np.ndarray) -> SetEvidence:
        """Compute the evidence of a set of effects at its most likely noise.

        Args:
            free: (P,) bool, unknowns that are fitted; all other effects get their null values.
        """
        p = self.problem
        c = np.flatnonzero(free & ((self._owner < 0) | (self._owner < self.training)))
        gone = np.flatnonzero(~free & self._removable & (self.values != p.null))
        away = (p.null - self.values)[gone]
        parts = [t.equations.after_change(gone, away, c) for t in self.tables]
        prior = self._prior.only(c)
        R = self.training
        picks = list(self._begin or (len(t.noises) // 2 for t in self.tables))
        levels, value = [1.0] * len(parts), -np.inf

        def summed(runs: Iterable[int]) -> tuple[np.ndarray, np.ndarray]:
            """(c, c) and (c,) sums of some runs at the noise of each."""
            H, g = np.zeros((len(c), len(c))), np.zeros(len(c))
            for i in runs:
                H += parts[i].gram[picks[i]] / levels[i] ** 2
                g += parts[i].slope[picks[i]] / levels[i] ** 2
            return H, g

        for _ in range(1 if R == 1 else self._rounds):
            for r in range(R):
                others = [i for i in range(R) if i != r]
                over, level = self._over(parts[r], *summed(others), c, levels[r])
                over = over + sum(float(parts[i].log_likelihood(np.array(levels[i]))[picks[i]]) for i in others)
                picks[r] = int(np.argmax(over))
                levels[r] = float(level[picks[r]])
                value = float(over[picks[r]]) + _peak(over, picks[r], self.tables[r].kick_count)
        H, g = summed(range(R))
        best = prior.posterior(H, g)
        d = best.change
        value -= 0.5 * (best.squared_error_change - float(prior.unbounded_change(H, g)[1]))
        change = np.zeros(len(self.values))
        change[c], change[gone] = d, away
        own = c[p.is_effect[c]]
        sizes = (self.values + change - p.null)[own] / p.typical[own]
        spread = float(size_nats(sizes))
        predicted = 0.0
        for r in range(R, len(parts)):
            said, picks[r], levels[r] = self._predicted(r, change, c, H, np.flatnonzero(free & (self._owner == r)))
            predicted += said
        information = np.zeros((len(change), len(change)))
        information[np.ix_(c, c)] = H
        ends = (self.values + change)[c] != p.null[c]
        inside = not np.any((best.gain_beyond_bound_nats > p.settings.search.acceptance_nats) & ends & p.is_effect[c])
        occam = float(freedom_nats(H, self._typical[c])) + spread
        return SetEvidence(value - spread, predicted, occam, change, tuple(picks), tuple(levels), information, inside)

    def _predicted(
        self, r: int, change: np.ndarray, c: np.ndarray, known: np.ndarray, own: np.ndarray
    ) -> tuple[float, int, float]:
        """Log density of a run as the training runs predict it, at the noise that suits it best.

        The uncertainty of the fitted values is integrated out, and so are the unknowns of the run alone (`own`): a
        length known to a micrometre may still be a swing too long or too short after a thousand swings.

        Args:
            r: index of the run.
            change: (P,) change fitted to the training runs.
            c: (k,) indices of the unknowns fitted to them.
            known: (k, k) information of the training runs on these.
            own: (m,) indices of the unknowns of the run alone.
        """
        loose, moved = np.concatenate([c, own]), np.flatnonzero(change)
        table = self.tables[r]
        part = table.equations.after_change(moved, change[moved], loose)
        A = np.diag(np.concatenate([self._prior.width[c], self.problem.typical[own]]) ** -2.0)
        A[: len(c), : len(c)] += known
        square = part.square - np.sum(part.slope * solve_positive(A + part.gram, part.slope), axis=1)
        level = np.sqrt(np.maximum(square / part.count, 1.0))
        over = replace(part, square=square).log_likelihood(level) - 0.5 * (log_det(A + part.gram) - log_det(A))
        pick = int(np.argmax(over))
        return float(over[pick]) + _peak(over, pick, table.kick_count), pick, float(level[pick])

    def _over(
        self, part: NormalEquations, H0: np.ndarray, g0: np.ndarray, c: np.ndarray, level: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """(S,) evidence at every noise of one run's table, given the sums of the other runs, and (S,) its level."""
        levels = np.full(len(part.square), level)
        for k in range(self._rounds + 1):
            H = part.gram / levels[:, None, None] ** 2 + H0
            d, added = self._prior.only(c).unbounded_change(H, part.slope / levels[:, None] ** 2 + g0)
            if k < self._rounds:
                own = part.square - 2.0 * np.sum(part.slope * d, axis=1)
                own += np.sum(d * (part.gram @ d[:, :, None])[:, :, 0], axis=1)
                levels = np.sqrt(np.maximum(own / part.count, 1.0))
        return part.log_likelihood(levels) - 0.5 * added - freedom_nats(H, self._typical[c]), levels


def _peak(value: np.ndarray, best: int, kicks: int) -> float:
    """Height of a parabola through the best of (S,) values and its neighbours along the kicks, above that value."""
    k = best % kicks
    if not 0 < k < kicks - 1:
        return 0.0
    a, b, c = value[best - 1 : best + 2]
    bend = 2.0 * b - a - c
    return float((c - a) ** 2 / (8.0 * bend)) if bend > 0.0 else 0.0
