"""Which samples of a recording have a stamp that can be used, and when they were taken.

A clock is set while it runs, a stamp is 0 or of another day, packets come twice or overtake each other. The samples
that are kept are as many as there can be in the order of their stamps; a clock that was set begins a new piece, which
costs as much as `PIECE` samples. So one bad stamp costs one sample, and a clock that was set costs none but those that
show the gap.
"""

from collections import Counter
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from armdyn.recording.channels import MIN_SAMPLES, FloatArray
from armdyn.recording.gaps import shortest_gap

PIECE = MIN_SAMPLES
"""Samples that a piece holds at least: with fewer nothing can be done."""
DELAY = 1.0
"""s by which messages are late at most: when a rosbridge stalls for 1 s, states come up to 1 s old, and at once."""
FARTHEST = 10.0
"""Times a whole recording at its usual rate, beyond which a step forward is that of a clock, not of a pause."""
DRIFT = 1e-4
"""Largest rate at which two computers' clocks part [1]; crystals differ by less than half of that."""
LEAST_STEP = 1e-6
"""s between two samples after clocks were brought together."""
REPEATED, BACK, AHEAD, FAR, NONE, BESIDE = (
    "whose stamp was there already", "whose stamp goes back", "whose stamp runs ahead",
    "whose stamp is far from all others", "without a stamp", "beside a step of the clock, so that the gap shows",
)  # fmt: skip
"""Why samples are left out; for a sentence."""


@dataclass(frozen=True, eq=False)
class Dated:
    """What is kept of n samples in the order in which they came.

    Attributes:
        rows: (k,) indices of the samples that are kept.
        time: (k,) s, strictly increasing.
        left_out: how many are not kept, by reason.
        steps: s by which the clock was set, of each time that it was.
        stamped: False where the times are those of arrival, as the stamps could not be used.
    """

    rows: npt.NDArray[np.intp]
    time: FloatArray
    left_out: Counter[str]
    steps: tuple[float, ...] = ()
    stamped: bool = True


def dated(stamps: FloatArray, arrivals: FloatArray | None = None) -> Dated:
    """The samples that can be used, and their times on the clock of the stamps.

    Args:
        stamps: (n,) s, nan where there is none.
        arrivals: (n,) s, not decreasing; None where nobody knows when a sample came. They tell a pause from a clock
            that was set, date what has no stamps, and say how far apart the pieces of a clock that was set are.
    """
    present = np.flatnonzero(np.isfinite(stamps))
    distinct = len(np.unique(stamps[present]))
    pieces = _pieces(stamps[present], None if arrivals is None else arrivals[present])
    kept = sum(map(len, pieces))
    if arrivals is not None and (2 * len(present) < len(stamps) or 2 * kept < distinct or distinct < MIN_SAMPLES):
        pieces = _pieces(arrivals, None)
        if 2 * sum(map(len, pieces)) > kept:
            rows, time, left = _laid(pieces, arrivals, None)
            return Dated(rows, time, _reasons(arrivals, rows) + left, stamped=False)
        pieces = _pieces(stamps[present], arrivals[present])
    pieces = [present[piece] for piece in pieces]
    steps = tuple(float(stamps[b[0]] - stamps[a[-1]]) for a, b in pairwise(pieces))
    rows, time, left = _laid(pieces, stamps, arrivals)
    return Dated(rows, time, _reasons(stamps, np.concatenate(pieces) if pieces else rows) + left, steps)


def on_arrival_clock(time: FloatArray, arrivals: FloatArray) -> FloatArray:
    """(n,) times of another clock, s, on the clock of the arrivals: what was quickest was there at once.

    The offset between both clocks is the smallest difference seen around a sample, and is forgotten as slowly as
    clocks part; what is left is the quickest delay itself, 1 ms on a local network.
    """
    delay = arrivals - time
    before = np.minimum.accumulate(delay - DRIFT * arrivals) + DRIFT * arrivals
    after = np.minimum.accumulate((delay + DRIFT * arrivals)[::-1])[::-1] - DRIFT * arrivals
    found = time + np.minimum(before, after)
    apart = LEAST_STEP * np.arange(len(found))
    return np.asarray(np.maximum.accumulate(found - apart) + apart)


def _pieces(stamps: FloatArray, arrivals: FloatArray | None) -> list[npt.NDArray[np.intp]]:
    """Indices of the samples that are kept, by piece: the most that there can be, less `PIECE` for each further one.

    Found by dynamic programming over where the kept samples before a sample end. Who skips more than two pieces' worth
    begins a new piece, so that no more predecessors need be tried.
    """
    n = len(stamps)
    if n == 0:
        return []
    lead = None if arrivals is None else stamps - arrivals
    step = np.diff(stamps)
    usual = float(np.median(step[step > 0.0])) if (step > 0.0).any() else 0.0
    farthest = FARTHEST * n * usual
    quick = (step > 0.0).all() and (
        (step <= farthest).all() if lead is None else (lead[1:] - np.maximum.accumulate(lead)[:-1] <= DELAY).all()
    )
    if quick:
        return [np.arange(n)]
    best, before, begins = np.ones(n), np.full(n, -1), np.ones(n, dtype=bool)
    most = np.array(stamps if lead is None else lead)  # of the piece so far
    record, holder = -np.inf, -1  # of all samples before
    for i in range(1, n):
        if best[i - 1] > record:
            record, holder = best[i - 1], i - 1
        first = max(i - 2 * PIECE - 1, 0)
        usable = stamps[first:i] < stamps[i]
        if lead is None:
            usable &= stamps[i] - stamps[first:i] <= farthest
        else:
            usable &= lead[i] - most[first:i] <= DELAY
        if record > PIECE:
            best[i], before[i] = 1.0 + record - PIECE, holder
        if usable.any():
            j = int(np.argmax(np.where(usable, best[first:i], -np.inf))) + first
            if 1.0 + best[j] >= best[i]:
                best[i], before[i], begins[i] = 1.0 + best[j], j, False
                most[i] = max(most[j], most[i])
    pieces: list[list[int]] = [[]]
    i = int(np.argmax(best))
    while i >= 0:
        pieces[-1].append(i)
        if begins[i]:
            pieces.append([])
        i = int(before[i])
    return [np.array(piece[::-1]) for piece in reversed(pieces) if piece]


def _laid(
    pieces: list[npt.NDArray[np.intp]], stamps: FloatArray, arrivals: FloatArray | None
) -> tuple[npt.NDArray[np.intp], FloatArray, Counter[str]]:
    """Rows and times of pieces after each other, a gap between them, and how many samples it took.

    The clock of the longest piece counts. Where arrivals are not known, nobody knows how long a gap was.
    """
    if not pieces:
        return np.empty(0, dtype=np.intp), np.empty(0), Counter()
    longest = max(pieces, key=len)
    gap = 1.01 * shortest_gap(stamps[longest])
    rows: list[npt.NDArray[np.intp]] = []
    times: list[FloatArray] = []
    left, end = Counter[str](), -np.inf
    for piece in pieces:
        time = stamps[piece]
        if arrivals is not None:
            time = time + ((arrivals[piece] - time).min() - (arrivals[longest] - stamps[longest]).min())
        elif rows and piece is not pieces[0]:
            time = time + (end + gap - time[0])
        apart = time >= end + gap
        left[BESIDE] += int(np.count_nonzero(~apart))
        rows.append(piece[apart])
        times.append(time[apart])
        end = max(end, float(time[-1]))
    return np.concatenate(rows), np.concatenate(times), +left


def _reasons(stamps: FloatArray, kept: npt.NDArray[np.intp]) -> Counter[str]:
    """Why samples are not among the (k,) rows that are kept."""
    out = np.setdiff1d(np.arange(len(stamps)), kept)
    found: Counter[str] = Counter()
    there = set(stamps[kept].tolist())
    for i, at in zip(out.tolist(), np.searchsorted(kept, out).tolist(), strict=True):
        if not np.isfinite(stamps[i]):
            found[NONE] += 1
        elif stamps[i] in there:
            found[REPEATED] += 1
        elif at == 0:
            found[FAR] += 1
        else:
            found[BACK if stamps[i] < stamps[kept[at - 1]] else AHEAD] += 1
    return found
