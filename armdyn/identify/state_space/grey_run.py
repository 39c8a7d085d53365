"""One run, linearised around its measured motion, with kicks (process noise) between short pieces of it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from armdyn.estimation.equations import NormalEquations
from armdyn.estimation.solve import pseudo_inverses
from armdyn.identify.problem import Problem
from armdyn.identify.state_space.innovations import (
    ColouredNoise,
    LinearisedChannelSamples,
    PieceChain,
    WhitenedSums,
    add_channels,
    filter_run,
    memory_slices,
    smooth_run,
)
from armdyn.physics.pieces import LinearisedRun as LinearisedPieces
from armdyn.physics.pieces import MotionPieces
from armdyn.physics.simulated import as_simulated_model
from armdyn.recording.gaps import run_until
from armdyn.recording.noise import smallest_noise_std

PIECE_SWING_PERIODS = 0.5
"""Length of a piece of the motion, between two kicks, in periods of the swing. Within a piece the motion follows the
model, so friction keeps its sign, and a sensor error at twice the swing's frequency cannot be taken for a force. With
white process noise in place of kicks real recordings contain 10 to 1000 times less information."""
MAX_ERROR_GROWTH = 100.0
"""Factor by which an error of the state may grow within a piece; above it the piece is divided."""
LINEARISED_PRIOR_STD_TYPICAL_SIZES = 100.0
"""Prior width of the unknowns of a linearised run, in typical sizes; it only limits what the run does not identify."""
FIRST_ROUND_PIECES, PIECE_COUNT_FACTOR_PER_ROUND, MAX_SMOOTHER_STEPS_PER_ROUND = 2, 2, 2
"""Number of pieces over which a motion is first derived from a force, factor on this number from round to round, and
largest number of smoother steps in a round."""
MIN_GLITCH_INNOVATION_STDS = 4.0
"""Number of standard deviations of an innovation above which a sample is a glitch: one in 16,000 by chance."""
MAX_INFLUENTIAL_UNKNOWN_SHARE = 0.75
"""Share of the unknowns with influence above which the other unknowns are not left out, as this would save no time."""
MAX_GLITCH_SHARE = 0.1
"""Largest share of samples that can be glitches; with more of them, none is treated as a glitch."""


@dataclass(frozen=True)
class RunNoise:
    """Process noise and sensor noise of one run.

    Attributes:
        process_noise_std: standard deviation of the kicks (process noise), in typical sizes of the speeds.
        white_noise_ratios: by channel, standard deviation of the white sensor noise over the least possible one (see
            `quiet_noise`).
        coloured_noise: by channel, sensor error that is correlated in time.
    """

    process_noise_std: float
    white_noise_ratios: tuple[float, ...]
    coloured_noise: tuple[ColouredNoise, ...]


def scale_noise(noise: RunNoise, factor: float) -> RunNoise:
    """A copy of the noise with all standard deviations multiplied by a factor."""
    return RunNoise(
        noise.process_noise_std * factor,
        tuple(level * factor for level in noise.white_noise_ratios),
        noise.coloured_noise,
    )


class GreyBoxRun:
    """One run, divided into pieces, which can be linearised around a motion.

    Args:
        problem: the problem of the unknowns.
        index: index of the run in the problem.
        values: (P,) values, from which the period of the swing follows.
        share: length of a piece, between two kicks, in periods of the swing.
    """

    def __init__(self, problem: Problem, index: int, values: np.ndarray, share: float = PIECE_SWING_PERIODS) -> None:
        model, run = as_simulated_model(problem.model), problem.runs[index]
        self.problem, self.unknowns = problem, problem.unknowns_of_run(index)
        self.swing = model.oscillation_period(run, values[self.unknowns])
        self.run = run_until(run, model.time_of_rest(run, self.swing))
        self.pieces = MotionPieces(model, self.run, share * self.swing)
        self.channels = self.pieces.channels
        self.quiet = [smallest_noise_std(self.run.channels[c], problem.noise[self.run.name, c]) for c in self.channels]
        self._typical = np.array([model.parameters[name].typical for name in model.start_names])

    def initial_states(self, values: np.ndarray) -> np.ndarray:
        """(J, n) states at the beginning of the pieces, from the measured motion or derived from a measured force.

        A piece in which an error of the state grows too much, as near the upright position, is divided.

        Args:
            values: (P,) values of the unknowns.
        """
        theta = values[self.unknowns]
        while True:
            states = self._from_measured(values)
            found = self.pieces.linearise(theta, states, np.zeros(0, dtype=int))
            _, by_start = self.pieces.start_values(theta, states)
            size = by_start * self._typical
            grown = np.abs(pseudo_inverses(size) @ found.transition @ size).max(axis=(1, 2), initial=0.0)
            if not self.pieces.split_marked_pieces(~(grown < MAX_ERROR_GROWTH)):
                return states

    def _from_measured(self, values: np.ndarray) -> np.ndarray:
        theta = values[self.unknowns]
        begin = self.pieces.model.measured_motion(self.run, self.pieces.starts, theta, self.swing)
        return self._from_force(values) if begin is None else self.pieces.states(theta, begin)

    def _from_force(self, values: np.ndarray) -> np.ndarray:
        """(J, n) states that follow a measured force: simulated from the start, smoothed over a growing stretch.

        What the model lacks, such as friction, or a slightly wrong length, would grow to a different swing in a long
        simulation; kicks keep the difference small while the stretch grows.
        """
        theta, even = values[self.unknowns], [np.ones(len(self.run.channels[c].time)) for c in self.channels]
        states, known = self.pieces.rolled_out_states(theta), FIRST_ROUND_PIECES
        noise = self.problem.settings.noise
        none = np.zeros(len(values), dtype=bool)
        around = self.linearise(values, states, even, none)
        while (
            known < len(states) and not around.mean_squared_residual(FIRST_ROUND_PIECES, len(states)) < noise.gross_chi2
        ):
            begin, known = known, min(len(states), PIECE_COUNT_FACTOR_PER_ROUND * known)
            for _ in range(MAX_SMOOTHER_STEPS_PER_ROUND):
                if not around.finite or around.mean_squared_residual(begin, known) < noise.minimum_chi2:
                    break
                states = around.smooth_first_pieces(known)
                states[known:] = self.pieces.rolled_out_states(theta, known - 1, states[known - 1])[1:]
                around = self.linearise(values, states, even, none)
        return states

    def linearise(
        self, values: np.ndarray, states: np.ndarray, weights: Sequence[np.ndarray], wanted: np.ndarray
    ) -> "LinearisedRun":
        """Linearise the run at (P,) values of the unknowns and (J, n) states.

        Args:
            values: (P,) values of the unknowns.
            states: (J, n) states at the beginning of the pieces.
            weights: by channel, (N,) variance of each sample relative to that of ordinary ones; above 1 for suspected
                glitches.
            wanted: (P,) bool, unknowns with respect to which the run is linearised; the others are treated as known.
        """
        pieces, places = self._holding(values, wanted)
        theta, unknowns = values[places], np.flatnonzero(wanted)
        parameters = np.flatnonzero(wanted[places])
        columns = np.searchsorted(unknowns, places[parameters])
        found = pieces.linearise(theta, states, parameters)
        for column, unknown in enumerate(places[parameters]):
            if unknown in self.problem.jumps and values[unknown] == self.problem.null[unknown]:
                self._add_secant(found, pieces, theta, states, parameters, column, self.problem.jumps[unknown])
        # States are momenta; rates are what a parameter change keeps constant and what a kick changes.
        gap = found.end_states - np.append(states[1:], found.end_states[-1:], axis=0)
        by_unknown, definition = np.zeros((2, *states.shape, len(unknowns)))
        here, there = found.fixed_motion_derivatives
        by_unknown[:, :, columns], definition[:, :, columns] = found.by_theta + found.transition @ here - there, here
        begin, by_start, by_theta = pieces.start_state(theta)
        model = pieces.model
        forced = list(model.speed_states)
        kicked = by_start[:, forced] * self._typical[forced]
        free = np.abs(by_start).sum(axis=1) > 0.0
        start = np.zeros((states.shape[1], len(unknowns) + 1))
        start[~free, -1] = (begin - states[0])[~free]
        start[np.ix_(~free, columns)] = by_theta[np.ix_(~free, parameters)]
        wide = by_start * (LINEARISED_PRIOR_STD_TYPICAL_SIZES * self._typical)
        chain = PieceChain(found.transition, by_unknown, gap, start, wide @ wide.T, kicked @ kicked.T)
        given = zip(self.channels, self.quiet, weights, strict=True)
        rows = [
            LinearisedChannelSamples(found.samples.pop(c), len(states), columns, len(unknowns), quiet, weight, here)
            for c, quiet, weight in given
        ]
        return LinearisedRun(self, states, chain, rows, definition, wanted)

    def _add_secant(
        self,
        found: LinearisedPieces,
        pieces: MotionPieces,
        theta: np.ndarray,
        states: np.ndarray,
        parameters: np.ndarray,
        column: int,
        at: float,
    ) -> None:
        """Put the change up to the value `at`, over the difference, in place of a parameter's derivative of zero."""
        moved = theta.copy()
        moved[parameters[column]] = at
        there = pieces.linearise(moved, states, np.zeros(0, dtype=int))
        way = at - theta[parameters[column]]
        found.by_theta[:, :, column] = (there.end_states - found.end_states) / way
        for name, samples in found.samples.items():
            samples.by_theta[:, column] = (there.samples[name].predicted - samples.predicted) / way

    def _holding(self, values: np.ndarray, wanted: np.ndarray) -> tuple[MotionPieces, np.ndarray]:
        """The pieces of a model without effects that have no influence here, and the unknowns of its parameters.

        Effects that add states are kept, so that all sets of effects have the same states.
        """
        model = self.pieces.model
        lean, places = self.problem.reduced_model(
            self.problem.needed_effects(values, wanted) | model.effects_with_states
        )
        return self.pieces.for_model(as_simulated_model(lean)), self.unknowns[places]


class LinearisedRun:
    """A run, linearised around a motion with respect to P' of the P unknowns.

    Args:
        run: the run.
        states: (J, n) states of the motion at the beginning of its pieces.
        chain: linearised transitions of the state from piece to piece.
        rows: linearised samples by channel.
        definition: (J, n, P') derivatives of the states with respect to the unknowns, for a fixed motion.
        wanted: (P,) bool, True for the P' unknowns.
    """

    def __init__(
        self,
        run: GreyBoxRun,
        states: np.ndarray,
        chain: PieceChain,
        rows: Sequence[LinearisedChannelSamples],
        definition: np.ndarray,
        wanted: np.ndarray,
    ) -> None:
        self.run, self.states, self.chain, self.rows = run, states, chain, rows
        self._definition, self._wanted = definition, wanted
        self._grams: dict[tuple[int, ColouredNoise], WhitenedSums] = {}
        direction = np.sqrt(np.diag(chain.process_noise_covariance))
        n = states.shape[1]
        told = [
            np.einsum("i,jik,k->j", direction, self.whitened_sums(c, ColouredNoise()).sums[:, :n, :n], direction)
            for c in range(len(rows))
        ]
        self.most_informative_channel = int(np.argmax([np.median(t) for t in told]))
        made = [chain.gap, chain.transition, chain.end_state_by_unknowns, *(one.value for one in rows)]
        self.finite = all(bool(np.isfinite(x).all()) for x in made)
        self.kick_unit = float(1.0 / np.sqrt(max(np.median(told[self.most_informative_channel]), 1e-300)))

    def whitened_sums(self, channel: int, colour: ColouredNoise) -> WhitenedSums:
        """Whitened sums of the channel with index `channel`, for one assumption on its correlated error; cached."""
        if (channel, colour) not in self._grams:
            (self._grams[channel, colour],) = self.rows[channel].whitened([colour])
        return self._grams[channel, colour]

    def innovations(self, noises: Sequence[RunNoise], kicks: np.ndarray) -> NormalEquations:
        """Sums of the innovations (prediction errors) of the run at several noise settings.

        Args:
            noises: C settings of the sensor noise.
            kicks: (K,) standard deviations of the kicks, each of which is combined with each sensor noise.

        Returns:
            Sums for C K settings and all P unknowns of the problem; 0 for those that are treated as known.
        """
        acting = self._acting
        if acting.all() and self._wanted.all():
            return filter_run(self._sums(noises, len(kicks)), self.chain, kicks)
        n, P = self.states.shape[1], len(acting)
        columns = np.concatenate([np.arange(n), n + np.flatnonzero(acting), [n + P]])
        parts = (
            (sums[:, :, columns[:, None], columns], logs, rows) for sums, logs, rows in self._sums(noises, len(kicks))
        )
        found = filter_run(parts, self.chain.of(acting), kicks)
        return found.among(np.flatnonzero(self._wanted)[acting], len(self._wanted))

    @cached_property
    def _acting(self) -> np.ndarray:
        """(P',) bool: unknowns with influence (the place of an absent force has none); all where most have it."""
        n = self.states.shape[1]
        acting = np.any(self.chain.end_state_by_unknowns != 0.0, axis=(0, 1)) | np.any(
            self.chain.start[:, :-1] != 0.0, axis=0
        )
        for rows in self.rows:
            acting = acting | np.any(rows.value[:, :, n:-1] != 0.0, axis=(0, 1))
        return np.asarray(
            acting if acting.sum() < MAX_INFLUENTIAL_UNKNOWN_SHARE * len(acting) else np.ones_like(acting)
        )

    def _sums(self, noises: Sequence[RunNoise], kicks: int) -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
        """Sums of consecutive pieces for C noises, as input of `filter_run` with `kicks` sizes of the kicks."""
        width = self.rows[0].width
        for pieces in memory_slices(
            len(self.states), len(noises) * width * max(width, 2 * len(self.states[0]) * kicks)
        ):
            grams = [
                self._whitened(c, list(dict.fromkeys(n.coloured_noise[c] for n in noises)), pieces)
                for c in self._channels
            ]
            found = [
                add_channels([grams[c][noise.coloured_noise[c]] for c in self._channels], noise.white_noise_ratios)
                for noise in noises
            ]
            sums, logs, rows = (list(part) for part in zip(*found, strict=True))
            yield np.array(sums), np.array(logs), rows[0]

    def _whitened(
        self, channel: int, colours: Sequence[ColouredNoise], pieces: slice
    ) -> dict[ColouredNoise, WhitenedSums]:
        """Sums of one channel over some pieces, by colour."""
        known = {c: self._grams[channel, c].of(pieces) for c in colours if (channel, c) in self._grams}
        new = [c for c in colours if c not in known]
        return known | dict(zip(new, self.rows[channel].whitened(new, pieces), strict=True)) if new else known

    @property
    def _channels(self) -> range:
        return range(len(self.rows))

    def smooth(self, noise: RunNoise, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Smooth the motion of the run after a change of the unknowns.

        Args:
            noise: process and sensor noise.
            change: (P,) change of the unknowns.

        Returns:
            (J, n) states at the beginning of the pieces, and (J, n) kicks there.
        """
        moved, kicks = smooth_run(self._at(noise), self.chain, noise.process_noise_std, change[self._wanted])
        return self.states + moved + self._definition @ change[self._wanted], kicks

    def mean_squared_residual(self, begin: int, end: int) -> float:
        """Mean squared residual over the noise variance, in the pieces with indices from `begin` up to `end`."""
        residuals = [rows.value[:, begin:end, -1] for rows in self.rows]
        return sum(float(np.sum(r**2)) for r in residuals) / max(sum(r.size for r in residuals), 1)

    def smooth_first_pieces(self, known: int) -> np.ndarray:
        """(J, n) states at the start of J pieces of a run, smoothed with the samples of the first `known` pieces alone.

        The process noise between two pieces is as large as the error with which one piece determines a speed.
        """
        channels = len(self.rows)
        sums = self._at(RunNoise(self.kick_unit, (1.0,) * channels, (ColouredNoise(),) * channels))
        sums[known:] = 0.0
        return self.states + smooth_run(sums, self.chain, self.kick_unit, np.zeros(int(self._wanted.sum())))[0]

    def _at(self, noise: RunNoise) -> np.ndarray:
        """(J, w, w) whitened sums of all channels for one noise."""
        return add_channels(
            [self.whitened_sums(c, colour) for c, colour in enumerate(noise.coloured_noise)], noise.white_noise_ratios
        )[0]

    def glitch_weights(self, noise: RunNoise, change: np.ndarray) -> tuple[np.ndarray, ...]:
        """Find glitches: samples that the noise does not explain.

        Args:
            noise: process and sensor noise.
            change: (P,) change of the unknowns from the point of linearisation.

        Returns:
            By channel, (N,) variance of each sample relative to that of ordinary ones; above 1 for a glitch.
        """
        change = change[self._wanted]
        moved, _ = smooth_run(self._at(noise), self.chain, noise.process_noise_std, change)
        found = []
        for rows, colour, level in zip(self.rows, noise.coloured_noise, noise.white_noise_ratios, strict=True):
            z = rows.deviates(colour, level, moved, change)
            bad = z > MIN_GLITCH_INNOVATION_STDS
            few = bad.sum() < MAX_GLITCH_SHARE * len(bad)
            found.append(np.where(bad & few, z**2, 1.0))
        return tuple(found)
