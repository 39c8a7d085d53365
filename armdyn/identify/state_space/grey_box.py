"""All runs with process noise around their motion: fit values and noise, or reduce the process noise to nothing."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from armdyn.identify.fit import independent
from armdyn.identify.problem import Problem
from armdyn.identify.state_space.grey_run import PIECE_PERIODS, GreyRun, LinearisedRun, Noise, scaled
from armdyn.identify.state_space.innovations import Colour
from armdyn.identify.state_space.noise_evidence import LOG_KICKS, NoiseTable, Tables, at_one, everywhere, nearby
from armdyn.physics.pieces import pseudo_inverse

MAX_INNOVATION_GROWTH = 1.5
"""Largest growth of the squared innovations in one step: kicks and motion are estimated a little differently there."""
UNSEEN_INFORMATION = 1e-9
"""Information on an unknown, in inverse squared typical sizes, that is only rounding."""
CONVERGED_NATS = 0.5
"""Change of the log evidence, nats, that does not matter."""
Look = Callable[[LinearisedRun, Noise], NoiseTable]
"""Function that gives the innovations of a run at several noises, chosen near one noise or everywhere."""
NEARBY_LOOKS: Sequence[Look] = (nearby,) * 6
WIDE_FIRST_LOOKS: Sequence[Look] = (everywhere, *NEARBY_LOOKS[1:])
KICK_SHRINK_FACTOR, NO_KICK_SHARE = 0.03, 1e-6
"""Factor on the kicks from round to round, and the share of the kicks that counts as none."""


@dataclass(frozen=True, eq=False)
class NoiseAndMotion:
    """Point at which runs are linearised: values, motions, noise.

    Attributes:
        values: (P,) values of the unknowns.
        states: by run, (J, n) states at the beginning of the pieces.
        edges: by run, (J + 1,) edges of the pieces of these states; pieces may have been cut since.
        noises: noise by run.
        weights: by run and channel, (N,) variance of each sample over that of the others; larger for suspected
            glitches.
        evidence: evidence of the set of effects that was optimised at this point.
    """

    values: np.ndarray
    states: tuple[np.ndarray, ...]
    edges: tuple[np.ndarray, ...]
    noises: tuple[Noise, ...]
    weights: tuple[tuple[np.ndarray, ...], ...]
    evidence: float = -np.inf


class GreyBox:
    """All runs of a problem, linearised around their motions.

    Args:
        problem: model, runs and noise; the fitted runs come first.
        swings: period of the swing by run, s.
        training: number of runs that are fitted; the others are only predicted.
        removable: (P,) bool, unknowns of effects that are absent where they are not fitted.
        share: length of a piece, between two kicks, in periods of the swing.
    """

    def __init__(
        self,
        problem: Problem,
        swings: Sequence[float],
        training: int,
        removable: np.ndarray,
        share: float = PIECE_PERIODS,
    ) -> None:
        self.problem, self.training, self.removable = problem, training, removable
        self.runs = [GreyRun(problem, i, swing, share) for i, swing in enumerate(swings)]

    def begin(self, values: np.ndarray) -> NoiseAndMotion:
        """The first point: measured motions, or motions that follow a measured force, at (P,) values."""
        states = tuple(run.initial_states(values) for run in self.runs)
        quiet = tuple(Noise(1.0, (1.0,) * len(r.channels), (Colour(),) * len(r.channels)) for r in self.runs)
        even = tuple(tuple(np.ones(len(r.run.channels[c].time)) for c in r.channels) for r in self.runs)
        return NoiseAndMotion(values, states, self._edges, quiet, even)

    @property
    def _edges(self) -> tuple[np.ndarray, ...]:
        """Present edges of the pieces, by run."""
        return tuple(run.pieces.edges for run in self.runs)

    def is_cut(self, point: NoiseAndMotion) -> bool:
        """Whether pieces were cut since the point was computed: its evidence then has too few kicks."""
        return any(len(was) != len(now) for was, now in zip(point.edges, self._edges, strict=True))

    def around(self, point: NoiseAndMotion, free: np.ndarray | None = None) -> list[LinearisedRun]:
        """Linearise the runs at a point, by all unknowns, or by those that are (P,) `free` or return to null.

        Fewer unknowns are several times faster.
        """
        wanted = np.ones(len(point.values), dtype=bool)
        if free is not None:
            wanted = free | (self.removable & (point.values != self.problem.null))
        each = zip(self.runs, point.edges, point.states, point.weights, strict=True)
        with np.errstate(all="ignore"):  # divergence is detected by `LinearisedRun.finite`
            return [
                run.around(
                    point.values, run.pieces.states_after_cut(point.values[run.places], edges, states), weights, wanted
                )
                for run, edges, states, weights in each
            ]

    def largest_kick(self, point: NoiseAndMotion) -> float:
        """Largest kick of the training runs, relative to the accuracy with which one piece determines a speed."""
        arounds = self.around(point, np.zeros(len(point.values), dtype=bool))
        pairs = list(zip(arounds, point.noises, strict=True))[: self.training]
        return max(noise.kick / around.kick_unit for around, noise in pairs)

    def tables(self, arounds: Sequence[LinearisedRun], point: NoiseAndMotion, look: Look) -> Tables:
        """Innovations of all runs at a point and the noises that `look` chooses: they give every set's evidence."""
        found = [look(a, n) for a, n in zip(arounds, point.noises, strict=True)]
        return Tables(found, point.values, self.problem, self.training, self.removable)

    @np.errstate(all="ignore")  # sums of a diverging run are no finite evidence
    def settled(
        self, free: np.ndarray, point: NoiseAndMotion, looks: Sequence[Look] = WIDE_FIRST_LOOKS
    ) -> NoiseAndMotion:
        """Optimise values and noise: linearise, choose the noise, step and smooth, until the evidence no longer grows.

        Args:
            free: (P,) bool, unknowns that are fitted.
            point: start of the iteration.
            looks: choice of the noises in each round.
        """
        arounds: Sequence[LinearisedRun] = self.around(point, free)
        best = point
        for rounds_left, look in zip(reversed(range(len(looks))), looks, strict=True):
            tables = self.tables(arounds, point, look)
            found = tables.evidence(free)
            if not np.isfinite(found.value):
                break
            noises = tuple(
                scaled(t.noises[i], level) for t, i, level in zip(tables.tables, found.picks, found.levels, strict=True)
            )
            best = replace(point, noises=noises, evidence=found.value)
            if not rounds_left or abs(found.value - point.evidence) < CONVERGED_NATS:
                break
            weights = tuple(a.believed(noise, found.change) for a, noise in zip(arounds, noises, strict=True))
            begin = replace(best, weights=weights)
            picked = zip(tables.tables, found.picks, found.levels, strict=True)
            left = [float(t.square[i]) / level**2 for t, i, level in picked]
            point, arounds = self._moved(begin, sum(left[: self.training]), arounds, found.change, free)
            if point is begin:
                break
        return best

    def _moved(
        self,
        point: NoiseAndMotion,
        left: float,
        arounds: Sequence["LinearisedRun"],
        change: np.ndarray,
        free: np.ndarray,
    ) -> tuple[NoiseAndMotion, Sequence["LinearisedRun"]]:
        """The point after a (P,) change, or after a part of it that does not increase the squared innovations.

        It is linearised by the unknowns `free`. Where every part increases them, the given point is returned.
        """
        for share in (1.0, 0.5, 0.2, 0.05):
            values = np.clip(point.values + share * change, self.problem.lower, self.problem.upper)
            states = tuple(a.smoothed(n, values - point.values)[0] for a, n in zip(arounds, point.noises, strict=True))
            there = replace(point, values=values, states=states, edges=self._edges)
            if all(np.isfinite(s).all() for s in states):
                found = self.around(there, free)
                if all(a.finite for a in found) and self._left(there, found) < MAX_INNOVATION_GROWTH * left:
                    return there, found
        return point, arounds

    def _left(self, point: NoiseAndMotion, arounds: Sequence["LinearisedRun"]) -> float:
        """Squared innovations of the training runs at a point's values and noise."""
        pairs = list(zip(arounds, point.noises, strict=True))[: self.training]
        return float(sum(at_one(a, n).square[0] for a, n in pairs))

    def determined(self, point: NoiseAndMotion, wanted: np.ndarray) -> np.ndarray:
        """(P,) bool: unknowns of `wanted` that the runs and the priors identify beside all unknowns before them.

        Kicks are as large as allowed, so that an unknown which is visible only in an undisturbed motion does not count.
        """
        known = np.diag((self.problem.prior_weight * self.problem.typical) ** 2)
        return independent(known + self._kicked(point), wanted)

    def seen(self, point: NoiseAndMotion) -> np.ndarray:
        """(P,) bool: unknowns that change anything in the runs."""
        return np.diag(self._kicked(point)) > UNSEEN_INFORMATION

    def _kicked(self, point: NoiseAndMotion) -> np.ndarray:
        """(P, P) information of the runs, in typical sizes, with kicks as large as allowed."""
        typical = self.problem.typical
        gram = np.zeros((len(typical), len(typical)))
        for run in self.around(point):
            noise = Noise(run.kick_unit, (1.0,) * len(run.rows), (Colour(),) * len(run.rows))
            gram += run.innovations([noise], np.array([run.kick_unit])).gram[0] * np.outer(typical, typical)
        return gram

    def starts(self, free: np.ndarray, point: NoiseAndMotion) -> Iterator[np.ndarray]:
        """(P,) start values of output-error fits: those at a point, then those with ever smaller kicks, the last first.

        The kicks shrink from round to round, so that the motion changes from the measured to the simulated one without
        losing the measured swing.
        """
        yield self.with_starts(point)
        share, way = 1.0, list[np.ndarray]()
        white = tuple(replace(n, colour=(Colour(),) * len(n.colour)) for n in point.noises)
        arounds: Sequence[LinearisedRun] = self.around(point, free)
        while share > NO_KICK_SHARE:
            noises = tuple(
                replace(n, kick=share * float(np.clip(n.kick, *(a.kick_unit * np.exp(LOG_KICKS[[0, -1]])))))
                for n, a in zip(white, arounds, strict=True)
            )
            before = replace(point, noises=noises)
            tables = self.tables(arounds, before, at_one)
            found = tables.evidence(free)
            if not np.isfinite(found.value):
                break
            left = sum(float(t.square[0]) for t in tables.tables[: self.training])
            point, arounds = self._moved(before, left, arounds, found.change, free)
            if point is before:
                break
            way.append(self.with_starts(point))
            share *= KICK_SHRINK_FACTOR
        yield from reversed(way)

    def with_starts(self, point: NoiseAndMotion) -> np.ndarray:
        """(P,) values at a point, in which the unknown start of each run is that of its first state."""
        values = point.values.copy()
        for run, states in zip(self.runs, point.states, strict=True):
            model, theta = run.pieces.model, values[run.places].copy()
            starts = [model.names.index(name) for name in model.start_names]
            for _ in range(3):
                state, by_start, _ = run.pieces.start_state(theta)
                theta[starts] += pseudo_inverse(by_start) @ (states[0] - state)
            columns = run.places[starts]
            values[columns] = np.clip(theta[starts], self.problem.lower[columns], self.problem.upper[columns])
        return values
