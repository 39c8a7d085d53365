"""Divided differences of samples at any stamps: what is left of a signal where no smooth curve reaches."""

import numpy as np

NORMAL_MEDIAN = 0.6745
"""Median of |x| over the standard deviation, for normal x."""
FEWEST = 8
"""Differences that show how noisy a signal is."""
LONGEST_SPAN = 1.5
"""Times the usual one, beyond which samples are no neighbours: there is a gap between them."""


def normalised_differences(
    time: np.ndarray, value: np.ndarray, order: int, longest_span: float = LONGEST_SPAN, interval: float | None = None
) -> np.ndarray:
    """(n - k, ...) divided differences of order k over the root of the sum of their squared weights; nan across a gap.

    They remove every polynomial of degree k - 1 and leave white noise its standard deviation.

    Args:
        time: (n, ...) s; every column is a series of its own.
        value: (n, ...), n > k.
        order: k.
        longest_span: of samples that are neighbours, in usual ones.
        interval: the usual one between samples, s; their median when not given.
    """
    n = len(value) - order
    stamps = [time[i : i + n] for i in range(order + 1)]
    span = stamps[-1] - stamps[0]
    total, squares = np.zeros(value[:n].shape), np.zeros(value[:n].shape)
    for i, here in enumerate(stamps):
        weight = np.ones(value[:n].shape)
        for j, there in enumerate(stamps):
            if j != i:
                weight /= (here - there) / span
        total += weight * (value[i : i + n] - value[:n])  # without its first value a large constant loses no digits
        squares += weight**2
    usual = np.median(np.diff(time, axis=0)) if interval is None else interval
    return np.where(span < longest_span * order * usual, total / np.sqrt(squares), np.nan)


def quiet_std(time: np.ndarray, value: np.ndarray, order: int = 3, *, unknown: float = 0.0) -> float:
    """Standard deviation of white noise on smooth samples, also with glitches: from the median of their differences.

    Args:
        time: (n,) s.
        value: (n,).
        order: of the differences; Gasser et al., Biometrika 73 (1986) 625.
        unknown: what is returned where fewer than `FEWEST` of them reach across no gap.

    Returns:
        In the unit of `value`.
    """
    differences = normalised_differences(time, value, order) if len(value) > order else np.zeros(0)
    whole = differences[np.isfinite(differences)]
    return float(np.median(np.abs(whole)) / NORMAL_MEDIAN) if len(whole) >= FEWEST else unknown
