"""Speeds and accelerations of positions that were recorded or written down with finite digits."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import UnivariateSpline, make_interp_spline
from scipy.special import binom

Array = NDArray[np.float64]

ORDER = 6
"""Difference that leaves the noise of a smooth motion: of a swing at 1 Hz, sampled at 100 Hz, 1e-7 is left."""

EVEN = 0.01
"""Unevenness of the sampling up to which differences still show noise [1]."""


class Motion(NamedTuple):
    """Positions with their derivatives, (n, k) each."""

    q: Array
    v: Array
    a: Array


def differentiated(time: Array, position: Array) -> Motion:
    """Speed and acceleration by a quintic smoothing spline that knows the noise of the positions.

    The noise is taken from sixth differences, so that rounding is smoothed away and a clean motion is left alone.

    Args:
        time: (n,), increasing [s].
        position: (n, k).

    Returns:
        Smoothed positions, speeds, accelerations.
    """
    columns = [_differentiated(time, column) for column in position.T]
    q, v, a = (np.column_stack([column[order] for column in columns]) for order in range(3))
    return Motion(q, v, a)


def noise(time: Array, position: Array) -> float:
    """Standard deviation of the noise of positions, 0 where it cannot be seen.

    Args:
        time: (n,) [s].
        position: (n,).

    Returns:
        In the unit of the positions. Source: robust difference estimator, Gasser et al., Biometrika 73 (1986) 625.
    """
    steps = np.diff(time)
    if time.size < 4 * ORDER or np.ptp(steps) > EVEN * np.mean(steps):
        return 0.0
    spread = np.sqrt(np.sum(binom(ORDER, np.arange(ORDER + 1)) ** 2))
    return float(np.median(np.abs(np.diff(position, ORDER))) / (0.6745 * spread))


def _differentiated(time: Array, column: Array) -> tuple[Array, Array, Array]:
    if np.ptp(column) == 0.0:
        return column, np.zeros_like(column), np.zeros_like(column)
    if time.size < ORDER:
        v = np.gradient(column, time)
        return column, v, np.gradient(v, time)
    std = noise(time, column)
    # Below this, what the differences show is rounding of floats, which a smoothing spline cannot follow.
    if std < 1e-10 * np.max(np.abs(column)):
        spline = make_interp_spline(time, column, k=5)
        return column, spline.derivative(1)(time), spline.derivative(2)(time)
    smooth = UnivariateSpline(time, column, k=5, s=time.size * std**2)
    return smooth(time), smooth.derivative(1)(time), smooth.derivative(2)(time)
