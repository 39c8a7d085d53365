r"""A run's evidence about every unknown at once, where the model's own error is part of the model.

Between kicks, one for each piece of a motion, the motion is the model's own; sensors read it with white noise and with
an error that is correlated in time:

    ds_{j+1} = A_j ds_j + B_j dtheta + d_j + w_j,                w ~ N(0, kick^2) in the speeds,
    r_k = Phi_k ds_j + X_k dtheta + m_k + v_k,                   v ~ N(0, level^2), m ~ an Ornstein-Uhlenbeck process,

ds a change of the state at the beginning of piece j, d_j what the end of a piece lacks to the next beginning, r a
residual. Samples are whitened (Anderson & Moore, Optimal Filtering, 1979, §5.5), the states leave by a Kalman filter
whose measurements are whole pieces. It filters the residual and every column of X together; what comes out are sums
X'X, X'r, r'r and a log-determinant, from which the likelihood of any dtheta follows (Harvey, Forecasting, Structural
Time Series Models and the Kalman Filter, 1989, §3.4). The coloured error begins anew in every piece.

Sources: Kristensen, Madsen & Jorgensen, Automatica 40 (2004) 225; Comput. Chem. Eng. 28 (2004) 1431.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armdyn.physics.pieces import Linearised, Samples

MOST_ROWS = 100
"""Samples of a channel in one piece; where there are more, neighbours are averaged: half a swing has no more to say."""


@dataclass(frozen=True)
class Colour:
    """Correlated error of a sensor.

    Attributes:
        ratio: its variance over that of the white noise of one row.
        time: correlation time, s.
    """

    ratio: float = 0.0
    time: float = 1.0


@dataclass(frozen=True, eq=False)
class Gram:
    """Whitened sums of one channel by piece, in units of the white noise: columns states, unknowns, residual.

    Attributes:
        sums: (J, n + P + 1, n + P + 1).
        log_std: sum of the logarithms of the rows' standard deviations over that of the white noise.
        rows: number of rows.
    """

    sums: np.ndarray
    log_std: float
    rows: float


class Rows:
    """The samples of one channel around a motion, arranged by piece, ready to be whitened.

    Args:
        samples: of one channel.
        pieces: J.
        columns: (q,) unknown that each parameter of the model is.
        unknowns: P.
        noise: standard deviation of one sample.
        weight: (N,) variance of each sample over that; larger where a sample is not believed.
    """

    def __init__(
        self, samples: Samples, pieces: int, columns: np.ndarray, unknowns: int, noise: float, weight: np.ndarray
    ) -> None:
        n = samples.by_state.shape[1]
        N = len(samples.time)
        width = n + unknowns + 1
        self.n = n
        rows = np.zeros((N, width))
        rows[:, :n] = samples.by_state
        rows[:, n + columns] += samples.by_theta
        rows[:, -1] = samples.measured - samples.predicted
        counts = np.bincount(samples.piece, minlength=pieces)
        group = max(1, -(-int(counts.max(initial=1)) // MOST_ROWS))
        first = np.concatenate([[0], np.cumsum(counts)])[:-1]
        place = (np.arange(N) - first[samples.piece]) // group
        m = int(place.max(initial=0)) + 1
        key = samples.piece * m + place
        self._row = place, samples.piece
        share = 1.0 / weight
        total = np.bincount(key, weights=share, minlength=pieces * m)
        mean = np.bincount(key, weights=share * samples.time, minlength=pieces * m) / np.where(total > 0.0, total, 1.0)
        self.time = mean.reshape(pieces, m)
        self.value = np.zeros((m, pieces, width))
        order = np.flatnonzero(np.diff(key, prepend=-1))
        added = np.add.reduceat(rows * share[:, None], order, axis=0) if N else rows
        kept = key[order]
        self.value[kept % m, kept // m] = added / total[kept][:, None] / noise
        # A row's white variance is one where all of its samples are believed; averages of few samples have more.
        with np.errstate(divide="ignore"):
            self.white = (group / total).reshape(pieces, m).T
        self.there = (total > 0.0).reshape(pieces, m).T
        self.group = group
        self.noise = noise / np.sqrt(group)
        self.value *= np.sqrt(group)
        self.count = float(self.there.sum())

    def whitened(self, colours: Sequence[Colour]) -> list[Gram]:
        """Sums of the rows under white noise and each of several coloured errors."""
        rows, logs = self._scanned(colours, self.value, self.white)
        each = rows.transpose(1, 2, 0, 3)
        return [Gram(own.transpose(0, 2, 1) @ own, float(log), self.count) for own, log in zip(each, logs, strict=True)]

    def deviates(self, colour: Colour, level: float, moved: np.ndarray, change: np.ndarray) -> np.ndarray:
        """(N,) how far each sample's row is from what the ones before it in its piece let expect, in deviations.

        Args:
            colour: of the error.
            level: of the white noise.
            moved: (J, n) change of the states at the beginning of the pieces.
            change: (P,) of the unknowns.
        """
        left = self.value[:, :, -1] - np.einsum("mjn,jn->mj", self.value[:, :, : self.n], moved)
        left -= self.value[:, :, self.n : -1] @ change
        rows, _ = self._scanned([colour], left[:, :, None], np.where(self.there, 1.0, self.white))
        return np.abs(rows[:, 0, :, 0])[self._row] / level

    def _scanned(
        self, colours: Sequence[Colour], value: np.ndarray, white: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """(m, C, J, w) rows of which each has left what those before it say of it; (C,) sums of log deviations."""
        m, J, width = value.shape
        ratio, time = (np.array([getattr(c, part) for c in colours])[:, None] for part in ("ratio", "time"))
        rows = np.empty((m, len(colours), J, width))
        error, variance = np.zeros((len(colours), J, width)), np.repeat(ratio, J, axis=1)
        last, logs = self.time[:, 0], np.zeros(len(colours))
        for k in range(m):
            on = self.there[k]
            now = np.where(on, self.time[:, k], last)
            decay = np.exp((last - now) / time)
            error *= decay[:, :, None]
            variance = decay**2 * variance + (1.0 - decay**2) * ratio
            S = variance + np.where(on, white[k], 1.0)
            gap = value[k] - error
            np.multiply(np.where(on, 1.0 / np.sqrt(S), 0.0)[:, :, None], gap, out=rows[k])
            logs += 0.5 * np.sum(np.log(S[:, on]), axis=1)
            gain = np.where(on, variance / S, 0.0)
            error += gain[:, :, None] * gap
            variance *= 1.0 - gain
            last = now
        return rows, logs


def combined(grams: Sequence[Gram], levels: Sequence[float]) -> tuple[np.ndarray, float, float]:
    """(J, w, w) sums of several channels with levels of their white noise, the log-determinant's half, and the rows."""
    total = sum(gram.sums / level**2 for gram, level in zip(grams, levels, strict=True))
    logs = sum(gram.log_std + gram.rows * np.log(level) for gram, level in zip(grams, levels, strict=True))
    return np.asarray(total), float(logs), float(sum(gram.rows for gram in grams))


@dataclass(frozen=True, eq=False)
class Chain:
    """How the pieces of a run follow one another.

    Attributes:
        transition: (J, n, n).
        by_unknown: (J, n, P).
        gap: (J, n) d; of the last piece it is not used.
        start: (n, P + 1) how the first state changes with the unknowns, and its own change.
        start_variance: (n, n) of what is free in the first state.
        kicked: (n, n) variance of a kick of size one.
    """

    transition: np.ndarray
    by_unknown: np.ndarray
    gap: np.ndarray
    start: np.ndarray
    start_variance: np.ndarray
    kicked: np.ndarray


def chained(found: Linearised, states: np.ndarray, columns: np.ndarray, unknowns: int) -> tuple[np.ndarray, np.ndarray]:
    """(J, n, P) derivatives by the unknowns and (J, n) gaps of a linearised run."""
    J, n, _ = found.by_theta.shape
    by_unknown = np.zeros((J, n, unknowns))
    by_unknown[:, :, columns] += found.by_theta
    gap = np.zeros((J, n))
    gap[:-1] = found.ends[:-1] - states[1:]
    return by_unknown, gap


@dataclass(frozen=True, eq=False)
class Innovations:
    """What a run says of the unknowns at S = C K noises: C colours, K sizes of the kicks with each.

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


@np.errstate(all="ignore")  # what a divergence has spoilt is no finite evidence
def filtered(sums: np.ndarray, log_std: np.ndarray, rows: float, chain: Chain, kicks: np.ndarray) -> Innovations:
    """Leave the states out of (C, J, w, w) sums with (C,) logarithms, at (K,) standard deviations of the kicks."""
    M, _, eta, after, logs = _forward(sums, chain, kicks)
    C, K, J, n, width = M.shape
    phi, cross = sums[:, None, :, :n, :n], sums[:, :, :n, n:]
    total = sums[:, :, n:, n:].sum(axis=1)[:, None]
    flat = (C, K, J * n, width)
    both = np.swapaxes(cross.reshape(C, 1, J * n, width), 2, 3) @ M.reshape(flat)
    own = np.swapaxes(M.reshape(flat), 2, 3) @ (phi @ M).reshape(flat)
    gone = np.swapaxes(eta.reshape(flat), 2, 3) @ (after @ eta).reshape(flat)
    whole = (total - both - np.swapaxes(both, 2, 3) + own - gone).reshape(C * K, width, width)
    every = (log_std[:, None] + logs).ravel()
    return Innovations(whole[:, :-1, :-1], whole[:, :-1, -1], whole[:, -1, -1], every, rows)


def _forward(
    sums: np.ndarray, chain: Chain, kicks: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The filter: (C, K, J, n, P+1) means and (C, K, J, n, n) variances before pieces, and what these say of them."""
    J, n = chain.gap.shape
    C, K, width = len(sums), len(kicks), sums.shape[-1] - n
    M, P = np.empty((C, K, J, n, width)), np.empty((C, K, J, n, n))
    eta, after = np.empty((C, K, J, n, width)), np.empty((C, K, J, n, n))
    # The columns' states fall by what the unknowns add to them: the residual is r - X dtheta.
    mean = np.broadcast_to(chain.start * np.append(-np.ones(width - 1), 1.0), (C, K, n, width))
    variance = np.broadcast_to(chain.start_variance, (C, K, n, n))
    noise = kicks[:, None, None] ** 2 * chain.kicked
    drive = np.concatenate([-chain.by_unknown, chain.gap[:, :, None]], axis=2)
    logs, one = np.zeros((C, K)), np.eye(n)
    for j in range(J):
        phi = sums[:, None, j, :n, :n]
        M[:, :, j], P[:, :, j] = mean, variance
        inverse, size = _inverse(one + variance @ phi)
        now = inverse @ variance
        now = (now + np.swapaxes(now, 2, 3)) / 2
        e = sums[:, None, j, :n, n:] - phi @ mean
        eta[:, :, j], after[:, :, j] = e, now
        logs += size
        T = chain.transition[j]
        mean = T @ (mean + now @ e) + drive[j]
        variance = T @ now @ T.T + noise
    return M, P, eta, after, 0.5 * logs


def _inverse(A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inverses of (..., n, n) matrices, and the logarithms of their determinants; two states are most frequent."""
    if A.shape[-1] != 2:
        return np.linalg.inv(A), np.linalg.slogdet(A)[1]
    a, b, c, d = A[..., 0, 0], A[..., 0, 1], A[..., 1, 0], A[..., 1, 1]
    size = a * d - b * c
    inverse = np.empty_like(A)
    inverse[..., 0, 0], inverse[..., 0, 1] = d / size, -b / size
    inverse[..., 1, 0], inverse[..., 1, 1] = -c / size, a / size
    return inverse, np.log(size)


@np.errstate(all="ignore")
def smoothed(sums: np.ndarray, chain: Chain, kick: float, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(J, n) most likely change of the states at the beginning of the pieces, and (J, n) the kicks there.

    The adjoint recursion needs no inverse of a variance, so that states without noise do no harm (Bryson & Frazier
    1963; Bierman, Factorization Methods for Discrete Sequential Estimation, 1977, §10.4).

    Args:
        sums: (J, w, w).
        chain: of the run.
        kick: standard deviation.
        change: (P,) of the unknowns.
    """
    M, P, eta, _, _ = _forward(sums[None], chain, np.array([kick]))
    weights = np.append(-change, 1.0)
    mean, e, variance = M[0, 0] @ weights, eta[0, 0] @ weights, P[0, 0]
    J, n = mean.shape
    pull, states, kicks = np.zeros(n), np.empty((J, n)), np.zeros((J, n))
    noise = kick**2 * chain.kicked
    for j in range(J - 1, -1, -1):
        if j < J - 1:
            kicks[j + 1] = noise @ pull
            pull = chain.transition[j].T @ pull
        pull = np.linalg.solve(np.eye(n) + sums[j, :n, :n] @ variance[j], pull + e[j])
        states[j] = mean[j] + variance[j] @ pull
    return states, kicks
