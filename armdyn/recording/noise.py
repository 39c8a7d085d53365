"""Estimate the noise of a signal by divided differences, which remove the smooth part of the signal."""

from collections.abc import Mapping

import numpy as np

from armdyn.recording.channels import Channel

ABS_NORMAL_MEDIAN_OVER_STD = 0.6745
"""Median of |x| over the standard deviation, for normally distributed x."""
MIN_DIFFERENCES_FOR_NOISE = 8
"""Least number of differences that determine the noise of a signal."""
MAX_DIFFERENCE_SPAN_RATIO = 1.5
"""Largest time span of a difference's samples, in usual spans; a longer one contains a gap."""
DIFFERENCE_ORDERS = tuple(range(3, 9))
"""Orders of the differences from which the noise is estimated."""
MAX_NOISE_RATIO_SHOWING_SIGNAL = 0.9
"""Ratio of the noise estimates of two successive orders below which the lower order contains the signal. For noise with
a correlation of 0.9 from sample to sample the ratio is 0.96; for a swing of 0.8 Hz at 20 Hz, a hundred times the noise,
it is 0.3."""
MIN_NOISE_SHARE_OF_STATED = 0.1
"""Least noise of a channel, as a share of its stated noise; an encoder at rest has samples without noise."""
NO_JUMP_TIMES = np.zeros(0)
NoiseByChannel = Mapping[tuple[str, str], float]
"""Standard deviation of a sample by run and channel, in the channel's unit."""


def normalised_differences(
    time: np.ndarray,
    value: np.ndarray,
    order: int,
    longest_span: float = MAX_DIFFERENCE_SPAN_RATIO,
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


def noise_std_from_differences(time: np.ndarray, value: np.ndarray, order: int = 3, *, unknown: float = 0.0) -> float:
    """Standard deviation of white noise on a smooth signal, from the median difference: glitches do not change it.

    Args:
        time: (n,) time stamps, s.
        value: (n,) samples.
        order: order of the differences (Gasser et al., Biometrika 73 (1986) 625).
        unknown: result where fewer than `MIN_DIFFERENCES_FOR_NOISE` differences have no gap.

    Returns:
        The standard deviation, in the unit of `value`.
    """
    differences = normalised_differences(time, value, order) if len(value) > order else np.zeros(0)
    whole = differences[np.isfinite(differences)]
    return (
        float(np.median(np.abs(whole)) / ABS_NORMAL_MEDIAN_OVER_STD)
        if len(whole) >= MIN_DIFFERENCES_FOR_NOISE
        else unknown
    )


def white_noise_std(time: np.ndarray, value: np.ndarray, jumps: np.ndarray = NO_JUMP_TIMES) -> float:
    """Standard deviation of white noise on a smooth signal, from differences of order 3 or higher.

    The divided difference of order k at any stamps removes every polynomial of lower degree; over sqrt(sum w^2) of its
    weights the variance of the result is that of the noise. A fast signal at a low rate is not a parabola over four
    samples: as long as the next order gives a clearly smaller value, the difference contains the signal. For coloured
    noise the result is too small.

    Args:
        time: (n,) time stamps, s.
        value: (n,) samples.
        jumps: (j,) times, s, ascending, at which the signal itself may jump: differences across them are left out,
            unless all are.

    Returns:
        The standard deviation, in the unit of `value`; 0 where there are fewer than eight samples without a gap.
    """
    lowest, *higher = (_difference_std(time, value, order, jumps) for order in DIFFERENCE_ORDERS)
    for std in higher:
        if std is None or lowest is None or std > MAX_NOISE_RATIO_SHOWING_SIGNAL * lowest:
            break
        lowest = std
    return lowest or 0.0


def _difference_std(time: np.ndarray, value: np.ndarray, order: int, jumps: np.ndarray) -> float | None:
    """Root mean square of the normalised differences of one order; None where there are fewer than five."""
    if len(value) < max(8, order + 5):
        return None
    differences = normalised_differences(time, value, order)
    whole, before = np.isfinite(differences), np.searchsorted(jumps, time, side="right")
    smooth = whole & (before[order:] == before[: len(before) - order])
    whole = differences[smooth if smooth.sum() >= 5 else whole]
    return float(np.sqrt(np.mean(whole**2))) if len(whole) >= 5 else None


def smallest_noise_std(channel: Channel, noise: float) -> float:
    """Smallest probable standard deviation of a channel's white noise, from its third differences.

    Args:
        channel: its samples.
        noise: standard deviation that is stated or otherwise estimated; an upper limit of the result.
    """
    return max(
        min(noise, noise_std_from_differences(channel.time, channel.value, unknown=noise)),
        MIN_NOISE_SHARE_OF_STATED * noise,
    )
