"""Divided differences of samples at any stamps, which remove the smooth part of a signal."""

import numpy as np

NORMAL_MEDIAN = 0.6745
"""Median of |x| over the standard deviation, for normally distributed x."""
MIN_DIFFERENCES = 8
"""Least number of differences that determine the noise of a signal."""
MAX_DIFFERENCE_SPAN = 1.5
"""Span of a difference, in usual spans, beyond which there is a gap between its samples."""


def normalised_differences(
    time: np.ndarray,
    value: np.ndarray,
    order: int,
    longest_span: float = MAX_DIFFERENCE_SPAN,
    interval: float | None = None,
) -> np.ndarray:
    """(n - k, ...) divided differences of order k over the root of the sum of their squared weights; nan across a gap.

    They remove every polynomial of degree k - 1 and keep the standard deviation of white noise.

    Args:
        time: (n, ...) time stamps, s; every column is a series.
        value: (n, ...) samples, n > k.
        order: order k of the differences.
        longest_span: largest span of a difference without a gap, in usual spans.
        interval: usual interval between samples, s; by default their median.
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
    """Standard deviation of white noise on smooth samples, robust against glitches: from the median difference.

    Args:
        time: (n,) time stamps, s.
        value: (n,) samples.
        order: order of the differences (Gasser et al., Biometrika 73 (1986) 625).
        unknown: result where fewer than `MIN_DIFFERENCES` differences have no gap.

    Returns:
        The standard deviation, in the unit of `value`.
    """
    differences = normalised_differences(time, value, order) if len(value) > order else np.zeros(0)
    whole = differences[np.isfinite(differences)]
    return float(np.median(np.abs(whole)) / NORMAL_MEDIAN) if len(whole) >= MIN_DIFFERENCES else unknown
