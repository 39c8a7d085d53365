r"""Compute what a run tells about all unknowns of a model with process noise, by a Kalman filter over pieces of motion.

The process noise consists of kicks, random changes of the speeds at the beginning of each piece of the motion; within a
piece the motion follows the model. Sensors measure it with white noise and with an error that is correlated in time:

    ds_{j+1} = A_j ds_j + B_j dtheta + d_j + w_j,                w ~ N(0, kick^2) in the speeds,
    r_k = Phi_k ds_j + X_k dtheta + m_k + v_k,                   v ~ N(0, level^2), m ~ an Ornstein-Uhlenbeck process,

where ds is a change of the state at the beginning of piece j, d_j the difference between the end of a piece and the
next beginning, r a residual. Samples are whitened (Anderson & Moore, Optimal Filtering, 1979, §5.5), and the states are
eliminated by a Kalman filter whose measurements are whole pieces. It filters the residual and every column of X
together; the results are sums X'X, X'r, r'r and a log-determinant, from which the likelihood of any dtheta follows
(Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, 1989, §3.4). The coloured error starts anew
in every piece.

Sources: Kristensen, Madsen & Jorgensen, Automatica 40 (2004) 225; Comput. Chem. Eng. 28 (2004) 1431.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from armdyn.estimation.equations import NormalEquations
from armdyn.identify.state_space.kalman import kalman_covariances, semidefinite_cholesky
from armdyn.physics.pieces import ChannelSamples

MAX_ROWS_PER_PIECE = 100
"""Largest number of samples of a channel in one piece; if there are more, neighbouring samples are averaged."""
NUMBERS_AT_ONCE = 2**20
"""Largest size of the arrays that are processed at once (8 MB), as a long run has thousands of pieces, evaluated at
hundreds of noise settings. Larger arrays would not be faster."""
ALL_PIECES = slice(None)
"""Slice of all pieces of a run."""


@dataclass(frozen=True)
class ColouredNoise:
    """Sensor error that is correlated in time (coloured noise): an Ornstein-Uhlenbeck process.

    Attributes:
        variance_ratio: variance of the error over that of the white noise; 0 for no such error.
        correlation_time: correlation time, s.
    """

    variance_ratio: float = 0.0
    correlation_time: float = 1.0


@dataclass(frozen=True, eq=False)
class WhitenedSums:
    """Sums of products of one channel's whitened samples, for each of J pieces, in units of the white noise.

    Attributes:
        sums: (J, n + P + 1, n + P + 1) products of the derivatives by n states and P unknowns, and of the residual.
        log_std: (J,) sum of the logarithms of the samples' standard deviations over that of the white noise.
        rows: (J,) number of samples, after averaging.
    """

    sums: np.ndarray
    log_std: np.ndarray
    rows: np.ndarray

    def of(self, pieces: slice) -> "WhitenedSums":
        """The sums of the pieces in a slice."""
        return WhitenedSums(self.sums[pieces], self.log_std[pieces], self.rows[pieces])


class LinearisedChannelSamples:
    """Linearised samples of one channel, averaged and arranged by piece (as "rows"), ready to be whitened.

    Args:
        samples: the linearised samples of one channel.
        pieces: number of pieces J.
        columns: (q,) index of the unknown that belongs to each of the model's parameters.
        unknowns: number of unknowns P.
        noise: standard deviation of one sample.
        weight: (N,) variance of each sample relative to `noise` squared; above 1 for suspected glitches.
        definition: (J, n, q) derivatives of the states at the beginning of the pieces with respect to the parameters,
            for a fixed motion; see `LinearisedRun.fixed_motion_derivatives`.
    """

    def __init__(
        self,
        samples: ChannelSamples,
        pieces: int,
        columns: np.ndarray,
        unknowns: int,
        noise: float,
        weight: np.ndarray,
        definition: np.ndarray,
    ) -> None:
        n = samples.by_state.shape[1]
        N = len(samples.time)
        self.n, self.width = n, n + unknowns + 1
        counts = np.bincount(samples.piece, minlength=pieces)
        group = max(1, -(-int(counts.max(initial=1)) // MAX_ROWS_PER_PIECE))
        begins = np.concatenate([[0], np.cumsum(counts)])
        place = (np.arange(N) - begins[samples.piece]) // group
        m = int(place.max(initial=0)) + 1
        key = samples.piece * m + place
        self._row = place, samples.piece
        share = 1.0 / weight
        total = np.bincount(key, weights=share, minlength=pieces * m)
        mean = np.bincount(key, weights=share * samples.time, minlength=pieces * m) / np.where(total > 0.0, total, 1.0)
        self.time = mean.reshape(pieces, m)
        self.value = np.zeros((m, pieces, self.width))
        for some in memory_slices(pieces, m * group * self.width):
            inside = slice(begins[some.start], begins[some.stop])
            by_state, residual = samples.by_state[inside], (samples.measured - samples.predicted)[inside]
            rows = np.zeros((len(residual), self.width))
            rows[:, :n], rows[:, -1] = by_state, residual
            # Derivatives by parameters are those at constant rates: a momentum is a mass times a rate.
            rows[:, n + columns] += samples.by_theta[inside]
            rows[:, n + columns] += np.einsum("Nn,Nnq->Nq", by_state, definition[samples.piece[inside]])
            rows *= share[inside, None]
            order = np.flatnonzero(np.diff(key[inside], prepend=-1))
            kept = key[inside][order]
            added = np.add.reduceat(rows, order, axis=0) if len(order) else rows
            self.value[kept % m, kept // m] = added * (np.sqrt(group) / (total[kept, None] * noise))
        # The white variance of a row is one where none of its samples is a glitch; averages of few samples have more.
        with np.errstate(divide="ignore"):
            self.white = (group / total).reshape(pieces, m).T
        self.there = (total > 0.0).reshape(pieces, m).T
        self.group = group
        self.noise = noise / np.sqrt(group)
        self.count = float(self.there.sum())

    def whitened(self, colours: Sequence[ColouredNoise], pieces: slice = ALL_PIECES) -> list[WhitenedSums]:
        """Whiten the rows of some pieces and sum their products, for each of several correlated sensor errors.

        Args:
            colours: the correlated errors.
            pieces: slice of the pieces.
        """
        m, J, width = self.value[:, pieces].shape
        sums, logs = np.empty((len(colours), J, width, width)), np.empty((len(colours), J))
        for some in memory_slices(J, len(colours) * m * width):
            here = slice(*np.arange(*pieces.indices(self.value.shape[1]))[some][[0, -1]] + [0, 1])
            rows, logs[:, some] = self._scanned(colours, self.value[:, here], self.white[:, here], here)
            each = rows.transpose(1, 2, 0, 3)
            sums[:, some] = each.transpose(0, 1, 3, 2) @ each
        count = self.there[:, pieces].sum(axis=0).astype(float)
        return [WhitenedSums(own, log, count) for own, log in zip(sums, logs, strict=True)]

    def deviates(self, colour: ColouredNoise, level: float, moved: np.ndarray, change: np.ndarray) -> np.ndarray:
        """(N,) innovations in standard deviations: of each sample's row, given the earlier rows of its piece.

        Args:
            colour: the correlated sensor error.
            level: standard deviation of the white noise over the assumed one.
            moved: (J, n) change of the states at the beginning of the pieces.
            change: (P,) change of the unknowns.
        """
        left = self.value[:, :, -1] - np.einsum("mjn,jn->mj", self.value[:, :, : self.n], moved)
        left -= self.value[:, :, self.n : -1] @ change
        rows, _ = self._scanned([colour], left[:, :, None], np.where(self.there, 1.0, self.white), ALL_PIECES)
        return np.abs(rows[:, 0, :, 0])[self._row] / level

    def _scanned(
        self, colours: Sequence[ColouredNoise], value: np.ndarray, white: np.ndarray, pieces: slice
    ) -> tuple[np.ndarray, np.ndarray]:
        """(m, C, J, w) innovations of the rows, given the rows before each; (C, J) sums of log standard deviations.

        Args:
            colours: C colours.
            value: (m, J, w) rows of the pieces.
            white: (m, J) white variance of the rows.
            pieces: the pieces of these rows.
        """
        m, J, width = value.shape
        stamps, there = self.time[pieces], self.there[:, pieces]
        if not any(c.variance_ratio for c in colours):  # no row depends on those before it
            share, logs = (np.where(there, own, 0.0) for own in (1.0 / np.sqrt(white), 0.5 * np.log(white)))
            rows = (share[:, :, None] * value)[:, None]
            return np.repeat(rows, len(colours), axis=1), np.repeat(logs.sum(axis=0)[None], len(colours), axis=0)
        ratio = np.array([c.variance_ratio for c in colours])[:, None]
        time = np.array([c.correlation_time for c in colours])[:, None]
        rows = np.empty((m, len(colours), J, width))
        error, variance = np.zeros((len(colours), J, width)), np.repeat(ratio, J, axis=1)
        last, logs = stamps[:, 0], np.zeros((len(colours), J))
        for k in range(m):
            on = there[k]
            now = np.where(on, stamps[:, k], last)
            decay = np.exp((last - now) / time)
            error *= decay[:, :, None]
            variance = decay**2 * variance + (1.0 - decay**2) * ratio
            S = variance + np.where(on, white[k], 1.0)
            gap = value[k] - error
            np.multiply(np.where(on, 1.0 / np.sqrt(S), 0.0)[:, :, None], gap, out=rows[k])
            logs += 0.5 * np.where(on, np.log(S), 0.0)
            gain = np.where(on, variance / S, 0.0)
            error += gain[:, :, None] * gap
            variance *= 1.0 - gain
            last = now
        return rows, logs


def memory_slices(count: int, each: int) -> Iterator[slice]:
    """Divide `count` items into slices to be processed together, so that memory is limited; see `NUMBERS_AT_ONCE`.

    Args:
        count: number of items.
        each: number of numbers in an item.
    """
    size = max(1, NUMBERS_AT_ONCE // max(each, 1))
    for first in range(0, count, size):
        yield slice(first, min(first + size, count))


def add_channels(grams: Sequence[WhitenedSums], levels: Sequence[float]) -> tuple[np.ndarray, float, float]:
    """Add the whitened sums of several channels.

    Args:
        grams: sums of each channel.
        levels: standard deviation of each channel's white noise, relative to that of its sums.

    Returns:
        (J, w, w) sums, the sum of the logarithms of all standard deviations, and the number of rows.
    """
    total = sum(gram.sums / level**2 for gram, level in zip(grams, levels, strict=True))
    logs = sum(np.sum(gram.log_std + gram.rows * np.log(level)) for gram, level in zip(grams, levels, strict=True))
    return np.asarray(total), float(logs), float(sum(np.sum(gram.rows) for gram in grams))


@dataclass(frozen=True, eq=False)
class PieceChain:
    """Linearised transitions of the state of a run from piece to piece; the module has their equation.

    Attributes:
        transition: (J, n, n) matrices A, derivatives of the end state of a piece with respect to its first state.
        end_state_by_unknowns: (J, n, P) matrices B, derivatives of the end state with respect to the unknowns.
        gap: (J, n) differences d between the end of a piece and the beginning of the next; the last one is not used.
        start: (n, P + 1) derivatives of the first state of the run with respect to the unknowns, and its own change.
        start_variance: (n, n) covariance of the free part of the first state.
        process_noise_covariance: (n, n) covariance of a kick of size one.
    """

    transition: np.ndarray
    end_state_by_unknowns: np.ndarray
    gap: np.ndarray
    start: np.ndarray
    start_variance: np.ndarray
    process_noise_covariance: np.ndarray

    def of(self, acting: np.ndarray) -> "PieceChain":
        """The transitions with derivatives by some of the unknowns only, given as (P,) bool."""
        start = self.start[:, np.append(acting, True)]
        return replace(self, end_state_by_unknowns=self.end_state_by_unknowns[:, :, acting], start=start)


@np.errstate(all="ignore")  # sums of a diverging run are not finite evidence
def filter_run(
    parts: Iterable[tuple[np.ndarray, np.ndarray, float]], chain: PieceChain, kicks: np.ndarray
) -> NormalEquations:
    """Filter a run by a Kalman filter over its pieces, which eliminates the states.

    Args:
        parts: for consecutive groups of b pieces, (C, b, w, w) sums at C sensor noises, (C,) sums of log standard
            deviations, and the number of rows; see `add_channels`.
        chain: transitions of the run.
        kicks: (K,) standard deviations of the kicks.

    Returns:
        Normal equations of the innovations (prediction errors), with a unit for each of C K noise settings.
    """
    filter_ = _Filter(chain, kicks)
    whole: np.ndarray | float = 0.0
    every: np.ndarray | float = 0.0
    rows = 0.0
    for sums, log_std, count in parts:
        M, eta, after, logs = filter_.advanced(sums)
        C, K, b, n, width = M.shape
        phi, cross = sums[:, None, :, :n, :n], sums[:, :, :n, n:]
        total = sums[:, :, n:, n:].sum(axis=1)[:, None]
        flat = (C, K, b * n, width)
        both = np.swapaxes(cross.reshape(C, 1, b * n, width), 2, 3) @ M.reshape(flat)
        own = np.swapaxes(M.reshape(flat), 2, 3) @ (phi @ M).reshape(flat)
        gone = np.swapaxes(eta.reshape(flat), 2, 3) @ (after @ eta).reshape(flat)
        whole = whole + (total - both - np.swapaxes(both, 2, 3) + own - gone).reshape(C * K, width, width)
        every = every + (log_std[:, None] + logs).ravel()
        rows += count
    found = np.asarray(whole)
    settings = np.full(len(found), float(rows))
    return NormalEquations(found[:, :-1, :-1], found[:, :-1, -1], found[:, -1, -1], settings, np.asarray(every))


class _Filter:
    """Kalman filter, advanced over consecutive pieces; see `filter_run`."""

    def __init__(self, chain: PieceChain, kicks: np.ndarray) -> None:
        self._chain, self._noise, self._next = chain, kicks[:, None, None] ** 2 * chain.process_noise_covariance, 0
        # The columns' states decrease by what the unknowns add to them: the residual is r - X dtheta.
        self._mean = chain.start * np.append(-np.ones(chain.start.shape[1] - 1), 1.0)
        self._variance = chain.start_variance

    def advanced(self, sums: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Advance over the next b pieces, whose sums are (C, b, w, w).

        Returns:
            (C, K, b, n, P+1) means before the pieces; the corrections by the pieces, and (C, K, b, n, n) variances
            after them; (C, K) the logarithm of the determinant.
        """
        chain, n, here = self._chain, self._chain.gap.shape[1], self._next
        C, b, K, width = len(sums), sums.shape[1], len(self._noise), sums.shape[-1] - n
        T, phi, cross = chain.transition[here : here + b], sums[:, None, :, :n, :n], sums[:, None, :, :n, n:]
        variance = np.broadcast_to(self._variance, (C, K, n, n)).reshape(C * K, n, n)
        told = np.repeat(semidefinite_cholesky(phi[:, 0]), K, axis=0)
        after, size, self._variance = kalman_covariances(variance, told, T, np.tile(self._noise, (C, 1, 1)))
        after = after.reshape(C, K, b, n, n)
        drive = np.concatenate(
            [-chain.end_state_by_unknowns[here : here + b], chain.gap[here : here + b, :, None]], axis=2
        )
        gain = T @ after
        keep, add = T - gain @ phi, gain @ cross + drive
        M, mean = np.empty((C, K, b, n, width)), np.broadcast_to(self._mean, (C, K, n, width))
        for j in range(b):
            M[:, :, j] = mean
            mean = keep[:, :, j] @ mean + add[:, :, j]
        self._variance, self._mean, self._next = self._variance.reshape(C, K, n, n), mean, here + b
        return M, cross - phi @ M, after, 0.5 * size.reshape(C, K)


@np.errstate(all="ignore")
def smooth_run(sums: np.ndarray, chain: PieceChain, kick: float, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Smooth a run: find the most likely motion for given values of the unknowns.

    The adjoint recursion inverts no covariance, so states without noise are allowed (Bryson & Frazier 1963; Bierman,
    Factorization Methods for Discrete Sequential Estimation, 1977, §10.4).

    Args:
        sums: (J, w, w) whitened sums of the pieces.
        chain: transitions of the run.
        kick: standard deviation of the kicks.
        change: (P,) change of the unknowns from the point of linearisation.

    Returns:
        (J, n) change of the states at the beginning of the pieces, and (J, n) kicks there.
    """
    J, n = chain.gap.shape
    M, eta, after, _ = _Filter(chain, np.array([kick])).advanced(sums[None])
    weights, phi = np.append(-change, 1.0), sums[:, :n, :n]
    mean, e, now = M[0, 0] @ weights, eta[0, 0] @ weights, after[0, 0]
    back = np.swapaxes(chain.transition, 1, 2)
    pulls = np.zeros((J + 1, n))
    left = np.eye(n) - phi @ now
    through, own = left @ back, (left @ e[:, :, None])[:, :, 0]
    for j in range(J - 1, -1, -1):
        pulls[j] = through[j] @ pulls[j + 1] + own[j]
    pull = (back @ pulls[1:, :, None])[:, :, 0] + e
    moved = (now @ pull[:, :, None])[:, :, 0]
    kicks = pulls[:-1] @ (kick**2 * chain.process_noise_covariance)
    kicks[0] = 0.0
    return mean + moved, kicks
