"""Find the samples of a recording with usable stamps, and the times at which they were taken.

A clock may be set while it runs, a stamp may be 0 or of another day, messages may arrive twice or in another order. The
largest set of samples with increasing stamps is kept. Where the clock was set, a new piece begins, which counts like a
loss of `MIN_PIECE_SAMPLES` samples. So a wrong stamp costs one sample, and a clock that was set costs only the samples
that are removed for a visible gap.
"""

from collections import Counter
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from armdyn.recording.channels import MIN_COMPARED_CHANNEL_SAMPLES, FloatArray
from armdyn.recording.gaps import longest_interval_without_gap

MIN_PIECE_SAMPLES = MIN_COMPARED_CHANNEL_SAMPLES
"""Smallest number of samples of a piece; shorter pieces are useless."""
MAX_MESSAGE_DELAY_SECONDS = 1.0
"""Largest delay of a message [s]: after a rosbridge has stalled for 1 s, it sends states that are up to 1 s old."""
MAX_PAUSE_TO_RECORDING_RATIO = 10.0
"""Longest pause between two samples, divided by the duration of the recording at its usual rate; a longer step of the
stamps means that the clock was set."""
MAX_RELATIVE_CLOCK_DRIFT = 1e-4
"""Largest relative difference between the rates of two computers' clocks, twice that of usual crystals."""
MIN_STEP_AFTER_CLOCK_RESET_SECONDS = 1e-6
"""Shortest time between two samples after a clock was set [s]."""
MAX_STAMP_DECIMALS = 7
"""Number of decimals from which on stamps do not count as rounded."""
REPEATED_STAMP, BACKWARD_STAMP, STAMP_AHEAD, STAMP_OF_ANOTHER_DAY, MISSING_STAMP, STAMP_BESIDE_RESET = (
    "whose stamp was there already", "whose stamp goes back", "whose stamp runs ahead",
    "whose stamp is far from all others", "without a stamp", "beside a step of the clock, so that the gap shows",
)  # fmt: skip
"""Reasons why samples are left out, each as the end of a sentence on these samples."""


@dataclass(frozen=True, eq=False)
class TimestampedSamples:
    """Samples of a recording with usable time stamps.

    Attributes:
        rows: indices of the used samples (k,), in their order of arrival.
        time: times of the used samples (k,) [s], strictly increasing.
        left_out: number of the other samples, by reason.
        steps: every step by which the clock was set [s].
        stamped: False where the times are those of arrival, because the stamps are unusable.
    """

    rows: npt.NDArray[np.intp]
    time: FloatArray
    left_out: Counter[str]
    steps: tuple[float, ...] = ()
    stamped: bool = True


def samples_with_valid_stamps(stamps: FloatArray, arrivals: FloatArray | None = None) -> TimestampedSamples:
    """Select the samples with usable stamps, and determine their times on the clock of the stamps.

    Args:
        stamps: stamps (n,) [s], nan where there is none.
        arrivals: times of arrival (n,) [s], not decreasing; None where they are unknown. They distinguish a pause from
            a clock that was set, are the times of samples without stamps, and give the length of a gap.
    """
    present = np.flatnonzero(np.isfinite(stamps))
    distinct = len(np.unique(stamps[present]))
    pieces = _pieces(stamps[present], None if arrivals is None else arrivals[present])
    kept = sum(map(len, pieces))
    if arrivals is not None and (
        2 * len(present) < len(stamps) or 2 * kept < distinct or distinct < MIN_COMPARED_CHANNEL_SAMPLES
    ):
        pieces = _pieces(arrivals, None)
        if 2 * sum(map(len, pieces)) > kept:
            rows, time, left = _laid(pieces, arrivals, None)
            return TimestampedSamples(rows, time, _reasons(arrivals, rows) + left, stamped=False)
        pieces = _pieces(stamps[present], arrivals[present])
    pieces = [present[piece] for piece in pieces]
    steps = tuple(float(stamps[b[0]] - stamps[a[-1]]) for a, b in pairwise(pieces))
    rows, time, left = _laid(pieces, stamps, arrivals)
    return TimestampedSamples(rows, time, _reasons(stamps, np.concatenate(pieces) if pieces else rows) + left, steps)


def without_rounding(stamps: FloatArray) -> tuple[FloatArray, float]:
    """Times of samples at a constant rate whose stamps were rounded to decimals, and the step of the rounding.

    A camera that takes a picture every 1/30 s has stamps of 0.033, 0.067 and so on. If all stamps (n,) agree with a
    constant rate within half of their last decimal, the constant rate is the most likely truth, and the rounding is an
    error of the stamps. Otherwise, or if all steps are the same, the stamps are returned as they are, with a step of 0.

    Args:
        stamps: stamps (n,) in the unit in which they were written, without gaps.
    """
    decimals = (
        k for k in range(MAX_STAMP_DECIMALS) if np.abs(stamps * 10.0**k - np.round(stamps * 10.0**k)).max() < 1e-3
    )
    digits, steps = next(decimals, None), np.diff(stamps)
    # Steps of a single last decimal may as well show lost samples.
    if digits is None or np.ptp(steps) < 0.5 * 10.0**-digits or steps.min() < 1.5 * 10.0**-digits:
        return stamps, 0.0
    index = np.arange(len(stamps))
    regular = np.polynomial.Polynomial.fit(index, stamps, 1)(index)
    # The line through n rounded stamps is itself off by their error over the root of n.
    largest = 0.5 * 10.0**-digits * (1.0 + 4.0 / np.sqrt(len(stamps)))
    return (regular, 10.0**-digits) if np.abs(stamps - regular).max() <= largest else (stamps, 0.0)


def shift_to_arrival_clock(time: FloatArray, arrivals: FloatArray) -> FloatArray:
    """Convert times of another clock (n,) [s] to the clock of the times of arrival (n,) [s].

    The offset of the clocks is the smallest difference seen around a sample, which grows by `MAX_RELATIVE_CLOCK_DRIFT`
    with the distance in time. The error is the shortest delay, 1 ms on a local network.
    """
    delay = arrivals - time
    before = np.minimum.accumulate(delay - MAX_RELATIVE_CLOCK_DRIFT * arrivals) + MAX_RELATIVE_CLOCK_DRIFT * arrivals
    after = (
        np.minimum.accumulate((delay + MAX_RELATIVE_CLOCK_DRIFT * arrivals)[::-1])[::-1]
        - MAX_RELATIVE_CLOCK_DRIFT * arrivals
    )
    found = time + np.minimum(before, after)
    apart = MIN_STEP_AFTER_CLOCK_RESET_SECONDS * np.arange(len(found))
    return np.asarray(np.maximum.accumulate(found - apart) + apart)


def _pieces(stamps: FloatArray, arrivals: FloatArray | None) -> list[npt.NDArray[np.intp]]:
    """Indices of the kept samples, by piece: most samples, less `MIN_PIECE_SAMPLES` for each further piece.

    A further piece costs one sample where the clock was certainly set back. Found by dynamic programming over the
    predecessor of each kept sample. A jump over more than two pieces' samples begins a new piece, so that no more
    predecessors need to be tried.
    """
    n = len(stamps)
    if n == 0:
        return []
    lead = None if arrivals is None else stamps - arrivals
    step = np.diff(stamps)
    usual = float(np.median(step[step > 0.0])) if (step > 0.0).any() else 0.0
    farthest = MAX_PAUSE_TO_RECORDING_RATIO * n * usual
    quick = (step > 0.0).all() and (
        (step <= farthest).all()
        if lead is None
        else (lead[1:] - np.maximum.accumulate(lead)[:-1] <= MAX_MESSAGE_DELAY_SECONDS).all()
    )
    if quick:
        return [np.arange(n)]
    was_set = np.zeros(n, dtype=bool) if lead is None else _was_set_back(lead, step, usual)
    best, before, begins = np.ones(n), np.full(n, -1), np.ones(n, dtype=bool)
    most = np.array(stamps if lead is None else lead)  # largest lead in the piece so far
    record, holder = -np.inf, -1  # best of all samples before
    for i in range(1, n):
        if best[i - 1] > record:
            record, holder = best[i - 1], i - 1
        first, lost = max(i - 2 * MIN_PIECE_SAMPLES - 1, 0), 1.0 if was_set[i] else float(MIN_PIECE_SAMPLES)
        usable = stamps[first:i] < stamps[i]
        if lead is None:
            usable &= stamps[i] - stamps[first:i] <= farthest
        else:
            usable &= lead[i] - most[first:i] <= MAX_MESSAGE_DELAY_SECONDS
        if record > lost:
            best[i], before[i] = 1.0 + record - lost, holder
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


def _was_set_back(lead: FloatArray, step: FloatArray, usual: float) -> npt.NDArray[np.bool_]:
    """(n,) whether each sample is the first after its clock was set back.

    Then its stamp, and how far all the next ones are ahead of their arrival, are less than before. Of messages that
    were overtaken, only the stamp is.
    """
    found = np.zeros(len(lead), dtype=bool)
    for i in np.flatnonzero(step <= 0.0) + 1:
        earlier, later = lead[max(i - MIN_PIECE_SAMPLES, 0) : i], lead[i : i + MIN_PIECE_SAMPLES]
        found[i] = len(later) == MIN_PIECE_SAMPLES and later.max() < earlier.max() - 0.5 * usual
    return found


def _laid(
    pieces: list[npt.NDArray[np.intp]], stamps: FloatArray, arrivals: FloatArray | None
) -> tuple[npt.NDArray[np.intp], FloatArray, Counter[str]]:
    """Rows and times of the pieces in succession on the clock of the longest one, and the samples lost to their gaps.

    Arrivals tell how long it took between two pieces. Without them this is unknown: the shortest time that is
    recognised as a gap.
    """
    if not pieces:
        return np.empty(0, dtype=np.intp), np.empty(0), Counter()
    longest = max(pieces, key=len)
    gap = (
        1.01 * longest_interval_without_gap(stamps[longest]) if arrivals is None else MIN_STEP_AFTER_CLOCK_RESET_SECONDS
    )
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
        left[STAMP_BESIDE_RESET] += int(np.count_nonzero(~apart))
        rows.append(piece[apart])
        times.append(time[apart])
        end = max(end, float(time[-1]))
    return np.concatenate(rows), np.concatenate(times), +left


def _reasons(stamps: FloatArray, kept: npt.NDArray[np.intp]) -> Counter[str]:
    """Number of samples outside the kept rows (k,), by reason."""
    out = np.setdiff1d(np.arange(len(stamps)), kept)
    found: Counter[str] = Counter()
    there = set(stamps[kept].tolist())
    for i, at in zip(out.tolist(), np.searchsorted(kept, out).tolist(), strict=True):
        if not np.isfinite(stamps[i]):
            found[MISSING_STAMP] += 1
        elif stamps[i] in there:
            found[REPEATED_STAMP] += 1
        elif at == 0:
            found[STAMP_OF_ANOTHER_DAY] += 1
        else:
            found[BACKWARD_STAMP if stamps[i] < stamps[kept[at - 1]] else STAMP_AHEAD] += 1
    return found
