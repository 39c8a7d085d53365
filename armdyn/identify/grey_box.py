"""Runs linear around their measured motion, and the noise at which a set of effects is most plausible.

The model's own error, as kicks of the speeds once in every half swing, and the sensors' coloured error are unknown;
what a set of effects is worth is its evidence at the noise that suits it best (type-II maximum likelihood: Bishop,
Pattern Recognition and Machine Learning, 2006, §3.5).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from armdyn.identify.estimator import until
from armdyn.identify.fit import independent
from armdyn.identify.innovations import Chain, Colour, Gram, Innovations, Rows, chained, combined, filtered, smoothed
from armdyn.identify.noise import quiet_noise
from armdyn.identify.problem import Problem
from armdyn.physics.pieces import Linearised, Pieces, Samples, pseudo_inverse
from armdyn.physics.simulated import SimulatedModel

HALF = 0.5
"""Of a swing, between two kicks: within it the motion is the model's own, so that friction keeps its sign and an error
of a sensor at twice the swing's frequency cannot be taken for a force. With white noise in place of kicks real
recordings say 10 to 1000 times less."""
KICKS = np.arange(-7.0, 10.1, 1.2)
"""Natural logarithms of the kicks that are tried, over what one piece tells of a speed."""
RATIOS = (0.0, 1.0, 6.0, 36.0, 216.0, 1296.0, 7776.0)
"""Variances of the coloured error that are tried, over that of the white noise of one row."""
TIMES = (0.02, 0.08, 1.0 / 3.0)
"""Correlation times that are tried, in swings: beyond a third it would be an offset."""
WORSE = 1.5
"""Times that squared innovations may grow in a step: kicks and motion are told a little differently there."""
UNSTABLE = 100.0
"""Times that an error may grow within a piece."""
LEVELS = (0.6, 1.6)
"""Factors on the level of one of several channels that are tried beside the present one."""
LOOSE = 100.0
"""Typical sizes: prior width of what is fitted to linear sums; it only keeps what is not told from running away."""
PULLED = float(np.log(100.0))
"""Nats that a value could gain beyond a bound from which on it is the bound that explains."""
UNSEEN = 1e-9
"""Information on an unknown of typical size, in squared deviations, that is none but rounding."""
ROUNDING = 1e-13
COARSE = (3, 3)
"""Every which of the colours, and of the kicks, is looked at first."""
ROUNDS = 3
"""In which the noises of several runs, and levels beside values, settle."""
SETTLED = 0.5
"""Nats that do not matter."""
SHRINK, TIED = 0.15, 1e-6
"""By which the kicks shrink from round to round, and the share of them that counts as nothing."""
UNBELIEVED = 4.0
"""Standard deviations of an innovation beyond which a sample is no noise: one in 16,000 by chance."""


MOST_UNBELIEVED = 0.1
"""Share of the samples that can be glitches; more are how the sensor is."""


@dataclass(frozen=True)
class Noise:
    """Of one run.

    Attributes:
        kick: standard deviation of the kicks, in typical sizes of the speeds.
        level: by channel, of the white noise over the quiet noise.
        colour: by channel.
    """

    kick: float
    level: tuple[float, ...]
    colour: tuple[Colour, ...]


class GreyRun:
    """One run around its motion.

    Args:
        problem: whose unknowns count.
        index: of the run.
        swing: period, s.
        share: of a swing between two kicks.
    """

    def __init__(self, problem: Problem, index: int, swing: float, share: float = HALF) -> None:
        model = problem.model
        assert isinstance(model, SimulatedModel)
        self.problem, self.index, self.swing = problem, index, swing
        self.run = until(problem.runs[index], model.comes_to_rest(problem.runs[index]))
        self.pieces = Pieces(model, self.run, share * swing)
        self.places = problem.places(index)
        self.channels = self.pieces.channels
        self.quiet = [quiet_noise(self.run.channels[c], problem.noise[self.run.name, c]) for c in self.channels]
        self.weight = {c: np.ones(len(self.run.channels[c].time)) for c in self.channels}
        self._typical = np.array([model.parameters[name].typical for name in model.start_names])

    def begun(self, theta: np.ndarray) -> np.ndarray:
        """(J, n) states from what was measured of the motion; else those of a simulation.

        A piece in which an error grows out of all proportion, as near the upright, is cut.
        """
        while True:
            states = self._begun(theta)
            found = self.pieces.linearised(theta, states)
            _, by_start = self.pieces.motion(theta, states)
            size = by_start * self._typical
            grown = np.abs(pseudo_inverse(size) @ found.transition @ size).max(axis=(1, 2))
            if not self.pieces.halve(~(grown < UNSTABLE)):
                return states

    def _begun(self, theta: np.ndarray) -> np.ndarray:
        model = self.pieces.model
        begin = model.measured_motion(self.run, self.pieces.starts, theta, self.swing)
        if begin is None:
            return self.pieces.rolled(theta)
        return self.pieces.states(theta, begin)

    def around(self, values: np.ndarray, states: np.ndarray) -> "Around":
        """The run linearised at (P,) values of the unknowns and (J, n) states."""
        theta = values[self.places]
        found = self.pieces.linearised(theta, states)
        P = len(values)
        by_unknown, gap = chained(found, states, self.places, P)
        # States are momenta; what stays while a parameter changes, and what is kicked, are their rates.
        edges = self.pieces.edges
        here, there = (
            self.pieces.by_definition(theta, s, at) if np.isfinite(s).all() else np.zeros_like(found.by_theta)
            for s, at in ((states, edges[:-1]), (found.ends, edges[1:]))
        )
        by_unknown[:, :, self.places] += found.transition @ here - there
        _, by_start, by_theta = self.pieces.beginning(theta)
        model = self.pieces.model
        kicked = by_start[:, model.kicked] * self._typical[model.kicked]
        free = np.abs(by_start).sum(axis=1) > 0.0
        start = np.zeros((states.shape[1], P + 1))
        begin, _, _ = self.pieces.beginning(theta)
        start[~free, -1] = (begin - states[0])[~free]
        held = np.zeros_like(by_theta)
        held[~free] = by_theta[~free]
        start[:, self.places] += held
        wide = by_start * (LOOSE * self._typical)
        chain = Chain(found.transition, by_unknown, gap, start, wide @ wide.T, kicked @ kicked.T)
        rows = [
            Rows(_at_rates(found.samples[c], here), len(states), self.places, P, quiet, self.weight[c])
            for c, quiet in zip(self.channels, self.quiet, strict=True)
        ]
        return Around(self, states, found, chain, rows, here)


def _at_rates(samples: Samples, here: np.ndarray) -> Samples:
    """Samples whose derivatives by parameters are those at constant rates; `here` (J, n, q) see `by_definition`."""
    more = np.einsum("Nn,Nnq->Nq", samples.by_state, here[samples.piece])
    return replace(samples, by_theta=samples.by_theta + more)


class Around:
    """A run linearised around a motion; whitened sums are kept by colour."""

    def __init__(
        self,
        run: GreyRun,
        states: np.ndarray,
        found: Linearised,
        chain: Chain,
        rows: Sequence[Rows],
        definition: np.ndarray,
    ) -> None:
        self.run, self.states, self.found, self.chain, self.rows = run, states, found, chain, rows
        self._definition = definition
        self._grams: dict[tuple[int, Colour], Gram] = {}
        direction = np.sqrt(np.diag(chain.kicked))
        n = states.shape[1]
        told = [
            np.einsum("i,jik,k->j", direction, self.gram(c, Colour()).sums[:, :n, :n], direction)
            for c in range(len(rows))
        ]
        self.sharpest = int(np.argmax([np.median(t) for t in told]))
        made = [chain.gap, chain.transition, chain.by_unknown]
        made += [x for s in found.samples.values() for x in (s.predicted, s.by_state, s.by_theta)]
        self.finite = all(bool(np.isfinite(x).all()) for x in made)
        self.kick_unit = float(1.0 / np.sqrt(max(np.median(told[self.sharpest]), 1e-300)))

    def gram(self, channel: int, colour: Colour) -> Gram:
        """Whitened sums of one channel."""
        key = channel, colour
        if key not in self._grams:
            self._grams[key] = self.rows[channel].whitened(colour)
        return self._grams[key]

    def innovations(self, noises: Sequence[Noise], kicks: np.ndarray) -> Innovations:
        """At the colours and levels of C noises, with (K,) sizes of the kicks each."""
        found = [
            combined([self.gram(c, colour) for c, colour in enumerate(noise.colour)], noise.level) for noise in noises
        ]
        sums, logs, rows = (list(part) for part in zip(*found, strict=True))
        return filtered(np.array(sums), np.array(logs), rows[0], self.chain, kicks)

    def smoothed(self, noise: Noise, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(J, n) states and (J, n) kicks after a (P,) change of the unknowns."""
        grams = [self.gram(c, colour) for c, colour in enumerate(noise.colour)]
        moved, kicks = smoothed(combined(grams, noise.level)[0], self.chain, noise.kick, change)
        return self.states + moved + self._definition @ change[self.run.places], kicks

    def weigh_down(self, noise: Noise, change: np.ndarray) -> None:
        """Believe samples less that no noise explains; `Samples` of the next linearisation know it."""
        grams = [self.gram(c, colour) for c, colour in enumerate(noise.colour)]
        moved, _ = smoothed(combined(grams, noise.level)[0], self.chain, noise.kick, change)
        for c, channel in enumerate(self.run.channels):
            z = self.rows[c].deviates(noise.colour[c], noise.level[c], moved, change)
            bad = z > UNBELIEVED
            few = bad.sum() < MOST_UNBELIEVED * len(bad)
            self.run.weight[channel][:] = np.where(bad & few, z**2, 1.0)


@dataclass(frozen=True, eq=False)
class Table:
    """Innovations of one run at S noises.

    Attributes:
        noises: (S,).
        gram: (S, P, P).
        slope: (S, P).
        square: (S,).
        log_std: (S,).
        rows: of the run.
        kicks: number of kicks that follow one another in `noises`.
    """

    noises: tuple[Noise, ...]
    gram: np.ndarray
    slope: np.ndarray
    square: np.ndarray
    log_std: np.ndarray
    rows: float
    kicks: int


def tabled(around: Around, noises: Sequence[Noise], kicks: np.ndarray) -> Table:
    """Innovations at every one of `noises` with every size (K,) of the kicks."""
    found = around.innovations(noises, kicks)
    every = tuple(replace(noise, kick=float(kick)) for noise in noises for kick in kicks)
    return Table(every, found.gram, found.slope, found.square, found.log_std, found.rows, len(kicks))


def everywhere(around: Around, noise: Noise) -> Table:
    """Innovations over the whole range of kicks and of one channel's colours, the other channels' as in `noise`.

    The channel that says most about the motion is looked at; what the others are like shows beside it.
    """
    noise = scaled(noise, 1.0 / min(noise.level))
    swing, kicks = around.run.swing, around.kick_unit * np.exp(KICKS)
    colours = [Colour()] + [Colour(r, t * swing) for r, t in product(RATIOS[1:], TIMES)]
    k = around.sharpest
    noises = [replace(noise, colour=(*noise.colour[:k], colour, *noise.colour[k + 1 :])) for colour in colours]
    return tabled(around, noises, kicks)


def nearby(around: Around, noise: Noise) -> Table:
    """Innovations around one noise."""
    noise = scaled(noise, 1.0 / min(noise.level))
    kicks = np.clip(noise.kick / around.kick_unit, np.exp(KICKS[0]), np.exp(KICKS[-1])) * around.kick_unit
    kicks = kicks * np.exp(np.array([-5.0, -3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0]))
    found = [noise]
    for c, colour in enumerate(noise.colour):
        for other in _neighbours(colour, around.run.swing):
            found.append(replace(noise, colour=(*noise.colour[:c], other, *noise.colour[c + 1 :])))
        for factor in LEVELS if len(noise.level) > 1 else ():
            found.append(replace(noise, level=(*noise.level[:c], factor * noise.level[c], *noise.level[c + 1 :])))
    return tabled(around, found, kicks)


def _neighbours(colour: Colour, swing: float) -> list[Colour]:
    """Colours next to one in the grid."""
    if colour.ratio == 0.0:
        return [Colour(RATIOS[1], t * swing) for t in TIMES[1::2]]
    r = RATIOS.index(min(RATIOS, key=lambda x: abs(x - colour.ratio)))
    t = int(np.argmin([abs(x * swing - colour.time) for x in TIMES]))
    found = [Colour()] if r == 1 else []
    for dr, dt in ((-1, 0), (1, 0), (0, -1), (0, 1), (2, 0), (-2, 0)):
        if 0 < r + dr < len(RATIOS) and 0 <= t + dt < len(TIMES):
            found.append(Colour(RATIOS[r + dr], TIMES[t + dt] * swing))
    return found


@dataclass(frozen=True, eq=False)
class Evidence:
    """What a set is worth at the noise that suits it best.

    Attributes:
        value: log evidence of the training runs, nats.
        predicted: log likelihood of the others, as predicted.
        occam: nats of `value` that the unknowns' freedom costs.
        change: (P,) of the unknowns.
        picks: by run, which of the table's noises; the level is not the table's.
        levels: by run, factor on the level.
        information: (P, P) of the training runs, levels counted in.
        inside: whether no effect does what it does by a value that the runs pull beyond a bound; one at which the
            effect is absent, and one from which they pull no more than by chance, is none.
    """

    value: float
    predicted: float
    occam: float
    change: np.ndarray
    picks: tuple[int, ...]
    levels: tuple[float, ...]
    information: np.ndarray
    inside: bool


def _without(table: Table, c: np.ndarray, gone: np.ndarray, away: np.ndarray) -> Table:
    """The table for unknowns c, after those that are `gone` have moved by `away`."""
    slope, square = table.slope[:, c], table.square
    if len(gone):
        X = table.gram[:, gone]
        slope = slope - X[:, :, c].transpose(0, 2, 1) @ away
        square = square - 2.0 * table.slope[:, gone] @ away + (X[:, :, gone] @ away) @ away
    return replace(table, gram=table.gram[:, c[:, None], c], slope=slope, square=square)


class Tables:
    """Tables of several runs at one point, from which the evidence of every set follows.

    Args:
        tables: by run, those that are fitted first.
        values: (P,) the point.
        problem: whose unknowns these are.
        training: number of runs that are fitted; the others are predicted.
        removable: (P,) bool, unknowns that are at null where they are not fitted.
    """

    def __init__(
        self, tables: Sequence[Table], values: np.ndarray, problem: Problem, training: int, removable: np.ndarray
    ) -> None:
        self.tables, self.values, self.problem, self.training = tuple(tables), values, problem, training
        self._removable = removable
        self.is_effect = np.array([bool(c.parameter.effect) for c in problem.columns])
        self._owner = np.array([-1 if c.run is None else c.run for c in problem.columns])
        self.rows = sum(table.rows for table in tables[:training])
        typical = LOOSE * problem.typical
        with np.errstate(divide="ignore"):
            self._width = np.minimum(typical, 1.0 / problem.prior_weight)
        self._centre = np.where(problem.prior_weight > 0, problem.prior_mean - values, 0.0)

    def coarse(self) -> "Tables":
        """The same at fewer noises: enough to see which sets are worth a closer look."""
        thinned = []
        for table in self.tables:
            colours = len(table.noises) // table.kicks
            at = np.array(
                [c * table.kicks + k for c in range(0, colours, COARSE[0]) for k in range(0, table.kicks, COARSE[1])]
            )
            thinned.append(
                replace(
                    table, noises=tuple(table.noises[i] for i in at), gram=table.gram[at], slope=table.slope[at],
                    square=table.square[at], log_std=table.log_std[at], kicks=len(range(0, table.kicks, COARSE[1])),
                )
            )  # fmt: skip
        return Tables(thinned, self.values, self.problem, self.training, self._removable)

    def evidence(self, free: np.ndarray) -> Evidence:
        """The best evidence of a set.

        Args:
            free: (P,) bool, unknowns that are fitted; effects among the others return to null.
        """
        p = self.problem
        c = np.flatnonzero(free & ((self._owner < 0) | (self._owner < self.training)))
        gone = np.flatnonzero(~free & self._removable & (self.values != p.null))
        away = (p.null - self.values)[gone]
        parts = [_without(t, c, gone, away) for t in self.tables]
        R = self.training
        picks, levels, value = [len(t.square) // 2 for t in self.tables], [1.0] * len(parts), -np.inf
        H, g = np.zeros((len(c), len(c))), np.zeros(len(c))
        for _ in range(1 if R == 1 else ROUNDS):
            for r in range(R):
                others = [i for i in range(R) if i != r]
                H = sum((parts[i].gram[picks[i]] / levels[i] ** 2 for i in others), np.zeros((len(c), len(c))))
                g = sum((parts[i].slope[picks[i]] / levels[i] ** 2 for i in others), np.zeros(len(c)))
                over, level = self._over(parts[r], H, g, c, levels[r])
                over = over + sum(self._alone(parts[i], picks[i], levels[i]) for i in others)
                picks[r] = int(np.argmax(over))
                levels[r] = float(level[picks[r]])
                value = float(over[picks[r]]) + _peak(over, picks[r], self.tables[r].kicks)
        H = np.asarray(sum(parts[i].gram[picks[i]] / levels[i] ** 2 for i in range(R)))
        g = np.asarray(sum(parts[i].slope[picks[i]] / levels[i] ** 2 for i in range(R)))
        d, cost, pulled = self._bounded(H, g, c)
        value -= 0.5 * (cost - float(self._solved(H[None], g[None], c)[1][0]))
        change = np.zeros(len(self.values))
        change[c], change[gone] = d, away
        own = c[self.is_effect[c]]
        sizes = (self.values + change - p.null)[own] / p.typical[own]
        T = np.minimum(p.typical[c], self._width[c])
        occam = 0.5 * float(_log_det((np.eye(len(c)) + T[:, None] * H * T)[None])[0]) + float(
            np.sum(np.log1p(sizes**2))
        )
        predicted = 0.0
        for r in range(R, len(parts)):
            said, picks[r], levels[r] = self._predicted(r, change, c, H, np.flatnonzero(free & (self._owner == r)))
            predicted += said
        information = np.zeros((len(change), len(change)))
        information[np.ix_(c, c)] = H
        ends = (self.values + change)[c] != p.null[c]
        inside = not np.any((pulled > PULLED) & ends & self.is_effect[c])
        worth = value - float(np.sum(np.log1p(sizes**2)))
        return Evidence(worth, predicted, occam, change, tuple(picks), tuple(levels), information, inside)

    @staticmethod
    def _alone(part: "Table", pick: int, level: float) -> float:
        """What a run adds to the evidence beside the unknowns' share."""
        return float(-0.5 * part.square[pick] / level**2 - part.log_std[pick] - part.rows * np.log(level))

    def _predicted(
        self, r: int, change: np.ndarray, c: np.ndarray, known: np.ndarray, own: np.ndarray
    ) -> tuple[float, int, float]:
        """Log density of a run as the training runs predict it, at the noise that suits it best.

        What these leave uncertain of the values is integrated over, as are the unknowns that are its `own`: a length
        that is known to a micrometre may still be a swing too long or too short after a thousand of them.

        Args:
            r: which run.
            change: (P,) from the training runs.
            c: (k,) unknowns that they fitted.
            known: (k, k) what they say of these, in inverse squares.
            own: (m,) unknowns of the run alone.
        """
        t = self.tables[r]
        moved = np.flatnonzero(change)
        G = t.gram[:, moved[:, None], moved]
        d = change[moved]
        square = t.square - 2.0 * t.slope[:, moved] @ d + (G @ d) @ d
        loose = np.concatenate([c, own])
        prior = np.zeros((len(loose), len(loose)))
        prior[: len(c), : len(c)] = known + np.diag(self._width[c] ** -2.0)
        prior[range(len(c), len(loose)), range(len(c), len(loose))] = self.problem.typical[own] ** -2.0
        scale = 1.0 / np.sqrt(np.diag(prior))
        H = scale[:, None] * t.gram[:, loose[:, None], loose] * scale
        A = scale[:, None] * prior * scale + ROUNDING * np.eye(len(loose))
        g = scale * (t.slope[:, loose] - t.gram[:, loose[:, None], moved] @ d)
        square = square - np.sum(g * np.linalg.solve(A + H, g[:, :, None])[:, :, 0], axis=1)
        loss = 0.5 * (_log_det(A + H) - _log_det(A[None])[0])
        level = np.sqrt(np.maximum(square / t.rows, 1.0))
        over = -0.5 * square / level**2 - t.log_std - t.rows * np.log(level) - loss
        pick = int(np.argmax(over))
        return float(over[pick]) + _peak(over, pick, t.kicks), pick, float(level[pick])

    def _solved(self, H: np.ndarray, g: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(S, c) change that is best, and (S,) what is added to the squared error: negative where it falls."""
        t = self._width[c]
        A = t[:, None] * H * t
        A[:, np.arange(len(c)), np.arange(len(c))] += 1.0
        right = t * g + self._centre[c] / t
        # In units of the diagonal, a little off the singular: rounding may leave less than the one that was added.
        scale = np.sqrt(np.einsum("sii->si", A))
        A = A / (scale[:, :, None] * scale[:, None, :])
        A[:, np.arange(len(c)), np.arange(len(c))] += ROUNDING
        d = t / scale * np.linalg.solve(A, (right / scale)[:, :, None])[:, :, 0]
        off = (d - self._centre[c]) / t
        return d, np.sum(d * (H @ d[:, :, None])[:, :, 0], axis=1) - 2.0 * np.sum(g * d, axis=1) + np.sum(
            off**2, axis=1
        )

    def _over(
        self, part: "Table", H0: np.ndarray, g0: np.ndarray, c: np.ndarray, level: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """(S,) evidence at every noise of one run's table beside the sums of the others, and (S,) its level."""
        levels = np.full(len(part.square), level)
        T = np.minimum(self.problem.typical[c], self._width[c])
        for k in range(ROUNDS + 1):
            H = part.gram / levels[:, None, None] ** 2 + H0
            d, added = self._solved(H, part.slope / levels[:, None] ** 2 + g0, c)
            if k < ROUNDS:
                own = part.square - 2.0 * np.sum(part.slope * d, axis=1)
                own += np.sum(d * (part.gram @ d[:, :, None])[:, :, 0], axis=1)
                levels = np.sqrt(np.maximum(own / part.rows, 1.0))
        A = T[:, None] * H * T
        A[:, np.arange(len(c)), np.arange(len(c))] += 1.0
        alone = -0.5 * part.square / levels**2 - part.log_std - part.rows * np.log(levels)
        return alone - 0.5 * added - 0.5 * _log_det(A), levels

    def _bounded(self, H: np.ndarray, g: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
        """(c,) the best change within the bounds, what is added to the squared error, (c,) nats of pull beyond them."""
        p, t = self.problem, self._width[c]
        lower, upper = (p.lower - self.values)[c], (p.upper - self.values)[c]
        A, right = H + np.diag(t**-2.0), g + self._centre[c] / t**2
        d, held = np.zeros(len(c)), np.zeros(len(c), dtype=bool)
        for _ in range(len(c) + 1):
            f = np.flatnonzero(~held)
            scale = 1.0 / np.sqrt(np.diag(A)[f])
            scaled_A = scale[:, None] * A[np.ix_(f, f)] * scale + ROUNDING * np.eye(len(f))
            d[f] = scale * np.linalg.solve(scaled_A, scale * (right[f] - A[np.ix_(f, np.flatnonzero(held))] @ d[held]))
            out = ~held & ((d < lower - 1e-12) | (d > upper + 1e-12))
            if not out.any():
                break
            worst = np.flatnonzero(out)[np.argmax((np.maximum(lower - d, d - upper) / t)[out])]
            held[worst] = True
            d[worst] = np.clip(d[worst], lower[worst], upper[worst])
        off = (d - self._centre[c]) / t
        pulled = np.where(held, 0.5 * (right - A @ d) ** 2 / np.diag(A), 0.0)
        return d, float(d @ H @ d - 2.0 * g @ d + off @ off), pulled


def _log_det(A: np.ndarray) -> np.ndarray:
    """(S,) logarithms of determinants of (S, c, c) positive definite matrices, as far as rounding leaves them so."""
    diagonal = np.einsum("sii->si", A)
    scale = 1.0 / np.sqrt(diagonal)
    alike = scale[:, :, None] * A * scale[:, None, :] + ROUNDING * np.eye(A.shape[1])
    return np.asarray(np.sum(np.log(diagonal), axis=1) + np.linalg.slogdet(alike)[1])


def _peak(value: np.ndarray, best: int, kicks: int) -> float:
    """By how much a parabola through the best of (S,) values and its neighbours along the kicks is higher."""
    k = best % kicks
    if not 0 < k < kicks - 1:
        return 0.0
    a, b, c = value[best - 1 : best + 2]
    bend = 2.0 * b - a - c
    return float((c - a) ** 2 / (8.0 * bend)) if bend > 0.0 else 0.0


@dataclass(frozen=True, eq=False)
class Point:
    """Where runs are linear: values, motions, noise.

    Attributes:
        values: (P,).
        states: by run, (J, n).
        noises: by run.
        evidence: of the set that was settled there.
    """

    values: np.ndarray
    states: tuple[np.ndarray, ...]
    noises: tuple[Noise, ...]
    evidence: float = -np.inf


class GreyBox:
    """All runs of a problem around their motions.

    Args:
        problem: model, runs, noise; those that are fitted come first.
        swings: by run, period, s.
        training: number of runs that are fitted; the others are only followed.
        removable: (P,) bool, unknowns of effects that are absent where they are not fitted.
        share: of a swing between two kicks.
    """

    def __init__(
        self, problem: Problem, swings: Sequence[float], training: int, removable: np.ndarray, share: float = HALF
    ) -> None:
        self.problem, self.training, self.removable = problem, training, removable
        self.runs = [GreyRun(problem, i, swing, share) for i, swing in enumerate(swings)]

    def begin(self, values: np.ndarray) -> Point:
        """The measured motions, or those of a simulation at (P,) values."""
        states = tuple(run.begun(values[run.places]) for run in self.runs)
        quiet = tuple(Noise(1.0, (1.0,) * len(r.channels), (Colour(),) * len(r.channels)) for r in self.runs)
        return Point(values, states, quiet)

    def around(self, point: Point) -> list[Around]:
        """The runs linearised at a point."""
        with np.errstate(all="ignore"):  # a simulation that diverges shows: `Around.finite`
            return self._around(point)

    def _around(self, point: Point) -> list[Around]:
        return [run.around(point.values, states) for run, states in zip(self.runs, point.states, strict=True)]

    def tables(self, arounds: Sequence[Around], point: Point, *, wide: bool) -> "Tables":
        """Evidence of every set around a point, at every noise or at those near its own."""
        at = everywhere if wide else nearby
        found = [at(a, n) for a, n in zip(arounds, point.noises, strict=True)]
        return Tables(found, point.values, self.problem, self.training, self.removable)

    def settled(
        self, free: np.ndarray, point: Point, *, rounds: int = 6, wide: int = 1, coloured: bool = True
    ) -> Point:
        """Linearise, find the noise, step, smooth, until the evidence stays; the first rounds look at every noise.

        Args:
            free: (P,) bool, unknowns that are fitted.
            point: where to begin.
            rounds: at most.
            wide: rounds that look at every noise.
            coloured: whether sensors may have a coloured error.
        """
        arounds: Sequence[Around] = self.around(point)
        best = point
        for k in range(rounds):
            if coloured:
                tables = self.tables(arounds, point, wide=k < wide)
            else:
                kicked = [
                    tabled(a, [n], a.kick_unit * np.exp(KICKS)) for a, n in zip(arounds, point.noises, strict=True)
                ]
                tables = Tables(kicked, point.values, self.problem, self.training, self.removable)
            found = tables.evidence(free)
            if not np.isfinite(found.value):
                break
            noises = tuple(
                scaled(t.noises[i], level) for t, i, level in zip(tables.tables, found.picks, found.levels, strict=True)
            )
            best = replace(point, noises=noises, evidence=found.value)
            if k == rounds - 1 or abs(found.value - point.evidence) < SETTLED:
                break
            for a, noise in zip(arounds, noises, strict=True):
                a.weigh_down(noise, found.change)
            point, arounds = self._moved(best, arounds, found.change)
            if point is best:
                break
        return best

    def _moved(self, point: Point, arounds: Sequence["Around"], change: np.ndarray) -> tuple[Point, Sequence["Around"]]:
        """The point after a (P,) change, or after a part of it that leaves no more; linearised there.

        Where no part of it does, the point itself is returned.
        """
        before = self._left(point, arounds)
        for share in (1.0, 0.5, 0.2, 0.05):
            values = np.clip(point.values + share * change, self.problem.lower, self.problem.upper)
            states = tuple(a.smoothed(n, values - point.values)[0] for a, n in zip(arounds, point.noises, strict=True))
            there = replace(point, values=values, states=states)
            if all(np.isfinite(s).all() for s in states):
                found = self.around(there)
                if all(a.finite for a in found) and self._left(there, found) < WORSE * before:
                    return there, found
        return point, arounds

    def _left(self, point: Point, arounds: Sequence["Around"]) -> float:
        """Squared innovations of the training runs at a point's values and noise."""
        pairs = list(zip(arounds, point.noises, strict=True))[: self.training]
        return float(sum(tabled(a, [n], np.array([n.kick])).square[0] for a, n in pairs))

    def told(self, point: Point, wanted: np.ndarray) -> np.ndarray:
        """(P,) bool: those of `wanted` that the runs around their motion, with the priors, tell from those before them.

        Looked at with kicks as large as they may be: what shows only in a motion that nothing kicks is not lost then.
        """
        known = np.diag((self.problem.prior_weight * self.problem.typical) ** 2)
        return independent(known + self._kicked(point), wanted)

    def seen(self, point: Point) -> np.ndarray:
        """(P,) bool: unknowns that change anything in the runs."""
        return np.diag(self._kicked(point)) > UNSEEN

    def _kicked(self, point: Point) -> np.ndarray:
        """(P, P) what the runs tell, in typical sizes, with kicks as large as they may be."""
        typical = self.problem.typical
        gram = np.zeros((len(typical), len(typical)))
        for run in self.around(point):
            noise = Noise(run.kick_unit, (1.0,) * len(run.rows), (Colour(),) * len(run.rows))
            gram += run.innovations([noise], np.array([run.kick_unit])).gram[0] * np.outer(typical, typical)
        return gram

    def tied_down(self, free: np.ndarray, point: Point) -> list[np.ndarray]:
        """(P,) values while kicks shrink to nothing, and the motions become the model's own (output error).

        The kicks shrink from round to round, so that the motions go over from what was measured to what the model says
        without ever losing the measured swing.
        """
        p = self.problem
        share, found_values = 1.0, [self.begun(point)]
        white = tuple(replace(n, colour=(Colour(),) * len(n.colour)) for n in point.noises)
        arounds: Sequence[Around] = self.around(point)
        while share > TIED:
            noises = tuple(
                replace(n, kick=share * float(np.clip(n.kick, *(a.kick_unit * np.exp(KICKS[[0, -1]])))))
                for n, a in zip(white, arounds, strict=True)
            )
            tables = [tabled(a, [n], np.array([n.kick])) for n, a in zip(noises, arounds, strict=True)]
            found = Tables(tables, point.values, p, self.training, self.removable).evidence(free)
            if not np.isfinite(found.value):
                break
            before = replace(point, noises=noises)
            point, arounds = self._moved(before, arounds, found.change)
            if point is before:
                break
            found_values.append(self.begun(point))
            share *= SHRINK
        return found_values[::-1]

    def begun(self, point: Point) -> np.ndarray:
        """(P,) values at a point, those that say how a run begins as its first state does."""
        values = point.values.copy()
        for run, states in zip(self.runs, point.states, strict=True):
            model, theta = run.pieces.model, values[run.places].copy()
            starts = [model.names.index(name) for name in model.start_names]
            for _ in range(3):
                state, by_start, _ = run.pieces.beginning(theta)
                theta[starts] += pseudo_inverse(by_start) @ (states[0] - state)
            columns = run.places[starts]
            values[columns] = np.clip(theta[starts], self.problem.lower[columns], self.problem.upper[columns])
        return values


def scaled(noise: Noise, factor: float) -> Noise:
    """The noise with everything larger by a factor."""
    return Noise(noise.kick * factor, tuple(level * factor for level in noise.level), noise.colour)
