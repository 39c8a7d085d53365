"""Detect two series that were recorded as one, as by two publishers on one topic."""

import numpy as np
import numpy.typing as npt

from armdyn.recording.channels import MIN_COMPARED_CHANNEL_SAMPLES, FloatArray
from armdyn.smoothing.choice import resolution

MIN_SECOND_SERIES_USUAL_STEPS = 12.0
"""Least distance between two series of samples recorded under one name, in usual steps from sample to sample."""
MIN_SECOND_SERIES_DISTANCE = 0.01
"""Least distance of a second series, rad or m; also `MIN_SECOND_SERIES_RESOLUTIONS` times the encoder's resolution."""
MIN_SECOND_SERIES_RESOLUTIONS = 5.0
MAX_SERIES_CHANGE_SHARE_OF_DISTANCE = 0.2
"""Largest change of a series between its samples, as a share of the distance to the second series."""


def samples_of_second_series(values: FloatArray) -> npt.NDArray[np.bool_]:
    """(n,) bool, whether each of (n, k) samples belongs to a second series; all False for a single series.

    A second series is there where single samples leave and return, again and again, to values that follow each other.
    """
    one = np.zeros(len(values), dtype=bool)
    if len(values) < 3 * MIN_COMPARED_CHANNEL_SAMPLES or not values.shape[1]:
        return one
    step = np.abs(np.diff(values, axis=0)).max(axis=1)
    over = np.abs(values[2:] - values[:-2]).max(axis=1)
    usual = float(np.median(np.minimum(np.minimum(step[1:], step[:-1]), over)))
    least = max(
        MIN_SECOND_SERIES_USUAL_STEPS * usual,
        MIN_SECOND_SERIES_DISTANCE,
        MIN_SECOND_SERIES_RESOLUTIONS * max(map(resolution, values.T)),
    )
    away = 1 + np.flatnonzero(
        (np.minimum(step[1:], step[:-1]) > least) & (over < MAX_SERIES_CHANGE_SHARE_OF_DISTANCE * step[:-1])
    )
    if len(away) < MIN_COMPARED_CHANNEL_SAMPLES:
        return one
    lags = [np.abs(values[away[3:]] - values[away[3 - lag : -lag]]).max(axis=1) for lag in (1, 2, 3)]
    if np.median(np.min(lags, axis=0)) > MAX_SERIES_CHANGE_SHARE_OF_DISTANCE * np.median(step[away - 1]):
        return one  # independent faults of a sensor
    last = [values[away[0] - 1], values[away[0]]]
    for i, value in enumerate(values):
        one[i] = np.abs(value - last[1]).max() < np.abs(value - last[0]).max()
        last[int(one[i])] = value
    return one if 2 * one.sum() <= len(one) else ~one
