"""Fit a model's values together with process noise, along the measured motion of all runs (grey-box identification).

A motion is divided into short pieces. Between two pieces a random change of the speeds, a "kick", stands for what the
model lacks; kicks are the process noise. Reducing them to nothing leads to a simulation of the whole run.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from armdyn.identify.fit import independent_columns
from armdyn.identify.problem import Problem
from armdyn.identify.state_space.grey_run import PIECE_SWING_PERIODS, GreyBoxRun, LinearisedRun, RunNoise, scale_noise
from armdyn.identify.state_space.innovations import ColouredNoise
from armdyn.identify.state_space.noise_evidence import (
    TRIED_LOG_KICK_SIZES,
    NoiseTable,
    RunNoiseTables,
    evaluate_all_noises,
    evaluate_nearby_noises,
    evaluate_one_noise,
)

MAX_INNOVATION_GROWTH = 1.5
"""Largest factor by which the squared innovations may grow in one step; they grow a little as the kicks change too."""
NEGLIGIBLE_INFORMATION = 1e-9
"""Information on an unknown, in inverse squared typical sizes, up to which it has no influence except by rounding."""
CONVERGED_NATS = 0.5
"""Change of the log evidence, nats, below which an optimisation has converged."""
NoiseEvaluation = Callable[[LinearisedRun, RunNoise], NoiseTable]
"""Function that evaluates a run at several noise settings, near a given one or over the whole range."""
NEARBY_EVALUATIONS: Sequence[NoiseEvaluation] = (evaluate_nearby_noises,) * 6
"""Noise settings of each round of an optimisation: always near the best ones of the round before."""
WIDE_FIRST_EVALUATIONS: Sequence[NoiseEvaluation] = (evaluate_all_noises, *NEARBY_EVALUATIONS[1:])
"""Noise settings of each round of an optimisation: over the whole range first, then near the best ones."""
KICK_SHRINK_FACTOR, NO_KICK_SHARE_OF_FIRST_KICKS = 0.03, 1e-6
"""Factor on the kicks from round to round, and the share of the first kicks that counts as no kick."""


@dataclass(frozen=True, eq=False)
class LinearisationPoint:
    """Point at which runs are linearised: the model's values, and the motion and noise of each run.

    Attributes:
        values: (P,) values of the unknowns.
        states: by run, (J, n) states at the beginning of the pieces.
        piece_edges: by run, (J + 1,) time limits, s, of the pieces to which these states belong.
        noises: process noise and sensor noise by run.
        sample_weights: by run and channel, (N,) variance of each sample relative to that of ordinary ones; above 1 for
            suspected glitches.
        evidence: log evidence, nats, of the set of effects that was optimised at this point.
    """

    values: np.ndarray
    states: tuple[np.ndarray, ...]
    piece_edges: tuple[np.ndarray, ...]
    noises: tuple[RunNoise, ...]
    sample_weights: tuple[tuple[np.ndarray, ...], ...]
    evidence: float = -np.inf


class GreyBox:
    """Optimises the values of a model together with process noise, for all runs of a problem.

    Args:
        problem: model, runs and noise; the fitted runs come first.
        values: (P,) values, from which the period of each run's swing follows.
        training: number of runs that are fitted; the others are only predicted.
        removable: (P,) bool, unknowns of effects that are absent (at their null values) where they are not fitted.
        share: length of a piece of the motion, between two kicks, in periods of the swing.
    """

    def __init__(
        self,
        problem: Problem,
        values: np.ndarray,
        training: int,
        removable: np.ndarray,
        share: float = PIECE_SWING_PERIODS,
    ) -> None:
        self.problem, self.training, self.removable = problem, training, removable
        self.runs = [GreyBoxRun(problem, i, values, share) for i in range(len(problem.runs))]

    def initial_point(self, values: np.ndarray) -> LinearisationPoint:
        """Point from which an optimisation starts, with (P,) values and the measured motions.

        Where only a force was measured, the motions are derived from it.
        """
        states = tuple(run.initial_states(values) for run in self.runs)
        quiet = tuple(RunNoise(1.0, (1.0,) * len(r.channels), (ColouredNoise(),) * len(r.channels)) for r in self.runs)
        even = tuple(tuple(np.ones(len(r.run.channels[c].time)) for c in r.channels) for r in self.runs)
        return LinearisationPoint(values, states, self._edges, quiet, even)

    @property
    def _edges(self) -> tuple[np.ndarray, ...]:
        """Present edges of the pieces, by run."""
        return tuple(run.pieces.edges for run in self.runs)

    def has_divided_pieces(self, point: LinearisationPoint) -> bool:
        """Whether pieces of the motion were divided since a point was computed, so that its evidence is out of date."""
        return any(len(was) != len(now) for was, now in zip(point.piece_edges, self._edges, strict=True))

    def linearise(self, point: LinearisationPoint, free: np.ndarray | None = None) -> list[LinearisedRun]:
        """Linearise all runs at a point.

        Args:
            point: the point.
            free: (P,) bool, unknowns with respect to which the runs are linearised, in addition to those of absent
                effects that are not at their null values; None means all. Fewer unknowns are several times faster.
        """
        wanted = np.ones(len(point.values), dtype=bool)
        if free is not None:
            wanted = free | (self.removable & (point.values != self.problem.null))
        each = zip(self.runs, point.piece_edges, point.states, point.sample_weights, strict=True)
        with np.errstate(all="ignore"):  # divergence is detected by `LinearisedRun.finite`
            return [
                run.linearise(
                    point.values,
                    run.pieces.states_after_cut(point.values[run.unknowns], edges, states),
                    weights,
                    wanted,
                )
                for run, edges, states, weights in each
            ]

    def max_process_noise_std(self, point: LinearisationPoint) -> float:
        """Largest standard deviation of the kicks in a training run.

        It is relative to the accuracy with which the samples of one piece determine a speed.
        """
        arounds = self.linearise(point, np.zeros(len(point.values), dtype=bool))
        pairs = list(zip(arounds, point.noises, strict=True))[: self.training]
        return max(noise.process_noise_std / around.kick_unit for around, noise in pairs)

    def evaluate_noises(
        self, arounds: Sequence[LinearisedRun], point: LinearisationPoint, look: NoiseEvaluation
    ) -> RunNoiseTables:
        """Evaluate linearised runs at several noise settings; the result gives the evidence of any set of effects.

        Args:
            arounds: the runs, linearised at `point`.
            point: the point.
            look: function that chooses the noise settings of a run and evaluates it there.
        """
        found = [look(a, n) for a, n in zip(arounds, point.noises, strict=True)]
        return RunNoiseTables(found, point.values, self.problem, self.training, self.removable)

    @np.errstate(all="ignore")  # sums of a diverging run are not finite evidence
    def optimise(
        self, free: np.ndarray, point: LinearisationPoint, looks: Sequence[NoiseEvaluation] = WIDE_FIRST_EVALUATIONS
    ) -> LinearisationPoint:
        """Optimise values, noise and motions in rounds until the evidence stops growing.

        Each round linearises the runs, chooses the noise, changes the values, and smooths the motions.

        Args:
            free: (P,) bool, unknowns that are fitted.
            point: point from which the optimisation starts.
            looks: for each round, the function that chooses the noise settings to evaluate.
        """
        arounds: Sequence[LinearisedRun] = self.linearise(point, free)
        best = point
        for rounds_left, look in zip(reversed(range(len(looks))), looks, strict=True):
            tables = self.evaluate_noises(arounds, point, look)
            found = tables.evidence(free)
            if not np.isfinite(found.log_evidence):
                break
            noises = tuple(
                scale_noise(t.noises[i], level)
                for t, i, level in zip(tables.tables, found.noise_indices, found.noise_factors, strict=True)
            )
            best = replace(point, noises=noises, evidence=found.log_evidence)
            if not rounds_left or abs(found.log_evidence - point.evidence) < CONVERGED_NATS:
                break
            weights = tuple(a.glitch_weights(noise, found.change) for a, noise in zip(arounds, noises, strict=True))
            begin = replace(best, sample_weights=weights)
            picked = zip(tables.tables, found.noise_indices, found.noise_factors, strict=True)
            left = [float(t.equations.square[i]) / level**2 for t, i, level in picked]
            point, arounds = self._moved(begin, sum(left[: self.training]), arounds, found.change, free)
            if point is begin:
                break
        return best

    def _moved(
        self,
        point: LinearisationPoint,
        left: float,
        arounds: Sequence["LinearisedRun"],
        change: np.ndarray,
        free: np.ndarray,
    ) -> tuple[LinearisationPoint, Sequence["LinearisedRun"]]:
        """The point after a (P,) change, or after a part of it that does not increase the squared innovations.

        It is linearised by the unknowns `free`. Where every part increases them, the given point is returned.
        """
        for share in (1.0, 0.5, 0.2, 0.05):
            values = np.clip(point.values + share * change, self.problem.lower, self.problem.upper)
            states = tuple(a.smooth(n, values - point.values)[0] for a, n in zip(arounds, point.noises, strict=True))
            there = replace(point, values=values, states=states, piece_edges=self._edges)
            if all(np.isfinite(s).all() for s in states):
                found = self.linearise(there, free)
                if all(a.finite for a in found) and self._left(there, found) < MAX_INNOVATION_GROWTH * left:
                    return there, found
        return point, arounds

    def _left(self, point: LinearisationPoint, arounds: Sequence["LinearisedRun"]) -> float:
        """Squared innovations of the training runs at a point's values and noise."""
        pairs = list(zip(arounds, point.noises, strict=True))[: self.training]
        return float(sum(evaluate_one_noise(a, n).equations.square[0] for a, n in pairs))

    def identifiable(self, point: LinearisationPoint, wanted: np.ndarray) -> np.ndarray:
        """Find the unknowns that runs and priors identify although the motion has kicks of the largest allowed size.

        Args:
            point: point at which the runs are linearised.
            wanted: (P,) bool, unknowns to choose from; earlier ones are preferred.

        Returns:
            (P,) bool.
        """
        known = np.diag((self.problem.prior_weight * self.problem.typical) ** 2)
        return independent_columns(known + self._kicked(point), wanted)

    def influential(self, point: LinearisationPoint, wanted: np.ndarray | None = None) -> np.ndarray:
        """(P,) bool: unknowns that have any influence on the runs at a point, of those `wanted`; None means of all."""
        return np.diag(self._kicked(point, wanted)) > NEGLIGIBLE_INFORMATION

    def _kicked(self, point: LinearisationPoint, wanted: np.ndarray | None = None) -> np.ndarray:
        """(P, P) information of the runs, in typical sizes, with kicks as large as allowed."""
        typical = self.problem.typical
        gram = np.zeros((len(typical), len(typical)))
        for run in self.linearise(point, wanted):
            noise = RunNoise(run.kick_unit, (1.0,) * len(run.rows), (ColouredNoise(),) * len(run.rows))
            gram += run.innovations([noise], np.array([run.kick_unit])).gram[0] * np.outer(typical, typical)
        return gram

    def start_values(self, free: np.ndarray, point: LinearisationPoint) -> Iterator[np.ndarray]:
        """(P,) start values for fits of whole simulated runs: those of a point, then others, the most likely first.

        The others are optimised with kicks that shrink from round to round to nothing, so that the motion changes
        gradually from the measured to the simulated one; those with the smallest kicks come first.

        Args:
            free: (P,) bool, unknowns that are fitted.
            point: optimised point.
        """
        yield self.values_with_start_states(point)
        share, way = 1.0, list[np.ndarray]()
        white = tuple(replace(n, coloured_noise=(ColouredNoise(),) * len(n.coloured_noise)) for n in point.noises)
        arounds: Sequence[LinearisedRun] = self.linearise(point, free)
        while share > NO_KICK_SHARE_OF_FIRST_KICKS:
            noises = tuple(
                replace(
                    n,
                    process_noise_std=share
                    * float(np.clip(n.process_noise_std, *(a.kick_unit * np.exp(TRIED_LOG_KICK_SIZES[[0, -1]])))),
                )
                for n, a in zip(white, arounds, strict=True)
            )
            before = replace(point, noises=noises)
            tables = self.evaluate_noises(arounds, before, evaluate_one_noise)
            found = tables.evidence(free)
            if not np.isfinite(found.log_evidence):
                break
            left = sum(float(t.equations.square[0]) for t in tables.tables[: self.training])
            point, arounds = self._moved(before, left, arounds, found.change, free)
            if point is before:
                break
            way.append(self.values_with_start_states(point))
            share *= KICK_SHRINK_FACTOR
        yield from reversed(way)

    def values_with_start_states(self, point: LinearisationPoint) -> np.ndarray:
        """(P,) values of a point, with start parameters of each run that agree with the first state of its motion."""
        values = point.values.copy()
        for run, states in zip(self.runs, point.states, strict=True):
            model, theta = run.pieces.model, values[run.unknowns]
            starts = [model.names.index(name) for name in model.start_names]
            (found,), _ = run.pieces.start_values(theta, states[:1], theta[None, starts])
            columns = run.unknowns[starts]
            values[columns] = np.clip(found, self.problem.lower[columns], self.problem.upper[columns])
        return values
