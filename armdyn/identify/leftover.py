"""What the best model there is leaves of each channel: how large it is, and how many independent samples it holds."""

from collections.abc import Mapping

import numpy as np

from armdyn.identify.noise import correlation_time
from armdyn.identify.sums import Sums


def level_of(sums: Sums, error: np.ndarray) -> np.ndarray:
    """(U,) variance of each channel, at least its noise's, from (U,) mean squared errors of the training units."""
    level = sums.noise**2
    for channel in range(len(sums.channels)):
        units = sums.channel == channel
        known = units & sums.training
        if known.any():
            level = np.where(units, np.maximum(level, np.average(error[known], weights=sums.count[known])), level)
    return level


def independent_samples(sums: Sums, left: Mapping[int, np.ndarray]) -> np.ndarray:
    """(U,) number of samples over their correlation time, from the residual of each training unit."""
    independent = sums.count.copy()
    for channel in range(len(sums.channels)):
        units = np.flatnonzero(sums.channel == channel)
        known = [unit for unit in units.tolist() if unit in left]
        if known:
            times = [correlation_time([left[unit]]) for unit in known]
            independent[units] /= np.average(times, weights=sums.count[known])
    return independent
