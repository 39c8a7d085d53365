r"""Information of a run on all unknowns at once, where the model's own error is part of the model (process noise).

Kicks occur once for each piece of a motion; between them the motion is the model's own. Sensors measure it with white
noise and with an error that is correlated in time:

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

from armdyn.physics.pieces import ChannelSamples

MAX_ROWS_PER_PIECE = 100
"""Samples of a channel in one piece; where there are more, neighbours are averaged: half a swing contains no more
detail."""
NUMBERS_AT_ONCE = 2**20
"""Numbers of an array that are processed at once, 8 MB: a long run has thousands of pieces, evaluated at hundreds of
noises. A larger array is no faster."""
ROUNDING_INFORMATION_SHARE = 1e-14
"""Information of a piece on a state, as a share of that through other states, that is only rounding."""
ALL_PIECES = slice(None)


@dataclass(frozen=True)
class Colour:
    """Time-correlated error of a sensor.

    Attributes:
        ratio: variance of the error over that of the white noise of one row.
        time: correlation time, s.
    """

    ratio: float = 0.0
    time: float = 1.0


@dataclass(frozen=True, eq=False)
class Gram:
    """Whitened sums of one channel by piece, in units of the white noise; the columns are states, unknowns, residual.

    Attributes:
        sums: (J, n + P + 1, n + P + 1) products of the columns.
        log_std: (J,) sum of the logarithms of the rows' standard deviations over that of the white noise.
        rows: (J,) number of rows.
    """

    sums: np.ndarray
    log_std: np.ndarray
    rows: np.ndarray

    def of(self, pieces: slice) -> "Gram":
        """The sums of some pieces."""
        return Gram(self.sums[pieces], self.log_std[pieces], self.rows[pieces])


class Rows:
    """Samples of one channel around a motion, arranged by piece, ready to be whitened.

    Args:
        samples: the samples of one channel.
        pieces: number of pieces J.
        columns: (q,) index of the unknown of each parameter.
        unknowns: number of unknowns P.
        noise: standard deviation of one sample.
        weight: (N,) variance of each sample over that of the noise; larger for suspected glitches.
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
        for some in blocks(pieces, m * group * self.width):
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

    def whitened(self, colours: Sequence[Colour], pieces: slice = ALL_PIECES) -> list[Gram]:
        """Sums of the rows of some pieces under white noise and each of several coloured errors."""
        m, J, width = self.value[:, pieces].shape
        sums, logs = np.empty((len(colours), J, width, width)), np.empty((len(colours), J))
        for some in blocks(J, len(colours) * m * width):
            here = slice(*np.arange(*pieces.indices(self.value.shape[1]))[some][[0, -1]] + [0, 1])
            rows, logs[:, some] = self._scanned(colours, self.value[:, here], self.white[:, here], here)
            each = rows.transpose(1, 2, 0, 3)
            sums[:, some] = each.transpose(0, 1, 3, 2) @ each
        count = self.there[:, pieces].sum(axis=0).astype(float)
        return [Gram(own, log, count) for own, log in zip(sums, logs, strict=True)]

    def deviates(self, colour: Colour, level: float, moved: np.ndarray, change: np.ndarray) -> np.ndarray:
        """(N,) innovation of each sample's row in standard deviations, given the rows before it in its piece.

        Args:
            colour: the correlated error.
            level: standard deviation of the white noise over the assumed one.
            moved: (J, n) change of the states at the beginning of the pieces.
            change: (P,) change of the unknowns.
        """
        left = self.value[:, :, -1] - np.einsum("mjn,jn->mj", self.value[:, :, : self.n], moved)
        left -= self.value[:, :, self.n : -1] @ change
        rows, _ = self._scanned([colour], left[:, :, None], np.where(self.there, 1.0, self.white), ALL_PIECES)
        return np.abs(rows[:, 0, :, 0])[self._row] / level

    def _scanned(
        self, colours: Sequence[Colour], value: np.ndarray, white: np.ndarray, pieces: slice
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
        ratio, time = (np.array([getattr(c, part) for c in colours])[:, None] for part in ("ratio", "time"))
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


def blocks(count: int, each: int) -> Iterator[slice]:
    """Slices of `count` items of `each` numbers that are processed together; see `NUMBERS_AT_ONCE`."""
    size = max(1, NUMBERS_AT_ONCE // max(each, 1))
    for first in range(0, count, size):
        yield slice(first, min(first + size, count))


def combined(grams: Sequence[Gram], levels: Sequence[float]) -> tuple[np.ndarray, float, float]:
    """(J, w, w) sums of several channels at levels of their white noise, half the log-determinant, and the rows."""
    total = sum(gram.sums / level**2 for gram, level in zip(grams, levels, strict=True))
    logs = sum(np.sum(gram.log_std + gram.rows * np.log(level)) for gram, level in zip(grams, levels, strict=True))
    return np.asarray(total), float(logs), float(sum(np.sum(gram.rows) for gram in grams))


@dataclass(frozen=True, eq=False)
class PieceChain:
    """Transitions of the state between the pieces of a run.

    Attributes:
        transition: (J, n, n) A.
        by_unknown: (J, n, P) B.
        gap: (J, n) d; the last one is not used.
        start: (n, P + 1) derivatives of the first state with respect to the unknowns, and its own change.
        start_variance: (n, n) covariance of the free part of the first state.
        kicked: (n, n) covariance of a kick of size one.
    """

    transition: np.ndarray
    by_unknown: np.ndarray
    gap: np.ndarray
    start: np.ndarray
    start_variance: np.ndarray
    kicked: np.ndarray

    def of(self, acting: np.ndarray) -> "PieceChain":
        """The transitions for some of the unknowns, (P,) bool."""
        start = self.start[:, np.append(acting, True)]
        return replace(self, by_unknown=self.by_unknown[:, :, acting], start=start)


@dataclass(frozen=True, eq=False)
class Innovations:
    """Information of a run on the unknowns at S = C K noises: C colours, each with K sizes of the kicks.

    Attributes:
        gram: (S, P, P) X'X.
        slope: (S, P) X'r.
        square: (S,) r'r.
        log_std: (S,) sum of the logarithms of the innovations' standard deviations.
        rows: number of rows.
    """

    gram: np.ndarray
    slope: np.ndarray
    square: np.ndarray
    log_std: np.ndarray
    rows: float


@np.errstate(all="ignore")  # sums of a diverging run are no finite evidence
def filtered(
    parts: Iterable[tuple[np.ndarray, np.ndarray, float]], chain: PieceChain, kicks: np.ndarray
) -> Innovations:
    """Eliminate the states from sums, for (K,) standard deviations of the kicks.

    parts: for consecutive pieces (C, b, w, w) sums, (C,) log-determinants and the number of rows; see `combined`.
        chain: transitions of the run.
        kicks: (K,) standard deviations of the kicks.
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
    return Innovations(found[:, :-1, :-1], found[:, :-1, -1], found[:, -1, -1], np.asarray(every), rows)


class _Filter:
    """Kalman filter, advanced over consecutive pieces; see `filtered`."""

    def __init__(self, chain: PieceChain, kicks: np.ndarray) -> None:
        self._chain, self._noise, self._next = chain, kicks[:, None, None] ** 2 * chain.kicked, 0
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
        M = np.empty((C, K, b, n, width))
        eta, after = np.empty((C, K, b, n, width)), np.empty((C, K, b, n, n))
        mean, variance = np.broadcast_to(self._mean, (C, K, n, width)), np.broadcast_to(self._variance, (C, K, n, n))
        drive = np.concatenate([-chain.by_unknown[here : here + b], chain.gap[here : here + b, :, None]], axis=2)
        logs, told = np.zeros((C, K)), square_root(sums[:, :, :n, :n])[:, None]
        for j in range(b):
            M[:, :, j] = mean
            now, size = updated(variance, told[:, :, j])
            e = sums[:, None, j, :n, n:] - sums[:, None, j, :n, :n] @ mean
            eta[:, :, j], after[:, :, j] = e, now
            logs += size
            T = chain.transition[here + j]
            mean = T @ (mean + now @ e) + drive[j]
            variance = T @ now @ T.T + self._noise
        self._mean, self._variance, self._next = mean, variance, here + b
        return M, eta, after, 0.5 * logs


def square_root(matrices: np.ndarray) -> np.ndarray:
    """(..., n, n) L with L L' equal to (..., n, n) positive semidefinite matrices; rounding errors are set to 0."""
    left, found = matrices.copy(), np.zeros_like(matrices)
    for k in range(left.shape[-1]):
        pivot = left[..., k, k]
        # A pivot that is only rounding would be a measurement without information.
        pivot = np.where(pivot <= ROUNDING_INFORMATION_SHARE * matrices[..., k, k], np.inf, pivot)
        found[..., k:, k] = left[..., k:, k] / np.sqrt(pivot)[..., None]
        below = found[..., k + 1 :, k]
        left[..., k + 1 :, k + 1 :] -= below[..., :, None] * below[..., None, :]
    return found


def updated(variance: np.ndarray, told: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(..., n, n) variances P after information L L' on the states, and log-determinants of 1 + P L L'.

    The columns of L (..., n, n) are used one by one, each as the measurement of one number, with a square root of P: no
    matrix that may be singular is inverted, and a state that was unknown before is known to all digits afterwards
    (Potter's algorithm: Bierman, Factorization Methods for Discrete Sequential Estimation, 1977, §2).
    """
    root, size = square_root(variance), np.ones(variance.shape[:-2])
    for k in range(told.shape[-1]):
        seen = np.swapaxes(root, -1, -2) @ told[..., k, None]
        spread = 1.0 + np.swapaxes(seen, -1, -2) @ seen
        root = root - root @ seen * (np.swapaxes(seen, -1, -2) / (spread + np.sqrt(spread)))
        size = size * spread[..., 0, 0]
    return root @ np.swapaxes(root, -1, -2), np.log(size)


@np.errstate(all="ignore")
def smoothed(sums: np.ndarray, chain: PieceChain, kick: float, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(J, n) most likely change of the states at the beginning of the pieces, and (J, n) the kicks there.

    The adjoint recursion inverts no variance, so states without noise are allowed (Bryson & Frazier 1963; Bierman,
    Factorization Methods for Discrete Sequential Estimation, 1977, §10.4).

    Args:
        sums: (J, w, w) sums of the pieces.
        chain: transitions of the run.
        kick: standard deviation of the kicks.
        change: (P,) change of the unknowns.
    """
    M, eta, after, _ = _Filter(chain, np.array([kick])).advanced(sums[None])
    weights = np.append(-change, 1.0)
    mean, e, now = M[0, 0] @ weights, eta[0, 0] @ weights, after[0, 0]
    J, n = mean.shape
    pulls, moved, back = np.zeros((J + 1, n)), np.empty((J, n)), np.swapaxes(chain.transition, 1, 2)
    for j in range(J - 1, -1, -1):
        pull = back[j] @ pulls[j + 1] + e[j]
        moved[j] = now[j] @ pull
        pulls[j] = pull - sums[j, :n, :n] @ moved[j]
    kicks = pulls[:-1] @ (kick**2 * chain.kicked)
    kicks[0] = 0.0
    return mean + moved, kicks
