"""Detect two series recorded as one: a second publisher on a topic, whose messages are between those of the first."""

import numpy as np
import numpy.typing as npt

from armdyn.recording.channels import MIN_SAMPLES, FloatArray
from armdyn.smoothing.choice import resolution

MIN_TRACK_STEPS = 12.0
"""Distance of the other series, in usual steps from sample to sample; the fastest step of a swing is 1.6 times the
usual one."""
MIN_TRACK_DISTANCE = 0.01
"""Least distance of the other series, rad or m, and at least `MIN_TRACK_RESOLUTIONS` times the resolution: a coarse
encoder alternates by one."""
MIN_TRACK_RESOLUTIONS = 5.0
MAX_RETURN_SHORTFALL = 0.2
"""Share of the way to the other series and back that may be missing, because both series have moved on."""


def samples_of_second_series(values: FloatArray) -> npt.NDArray[np.bool_]:
    """(n, k) bool: samples that belong to a second series; all False where there is only one series.

    A second series is there where single samples leave and return, again and again, to values that follow each other.
    """
    one = np.zeros(len(values), dtype=bool)
    if len(values) < 3 * MIN_SAMPLES or not values.shape[1]:
        return one
    step = np.abs(np.diff(values, axis=0)).max(axis=1)
    over = np.abs(values[2:] - values[:-2]).max(axis=1)
    usual = float(np.median(np.minimum(np.minimum(step[1:], step[:-1]), over)))
    least = max(MIN_TRACK_STEPS * usual, MIN_TRACK_DISTANCE, MIN_TRACK_RESOLUTIONS * max(map(resolution, values.T)))
    away = 1 + np.flatnonzero((np.minimum(step[1:], step[:-1]) > least) & (over < MAX_RETURN_SHORTFALL * step[:-1]))
    if len(away) < MIN_SAMPLES:
        return one
    lags = [np.abs(values[away[3:]] - values[away[3 - lag : -lag]]).max(axis=1) for lag in (1, 2, 3)]
    if np.median(np.min(lags, axis=0)) > MAX_RETURN_SHORTFALL * np.median(step[away - 1]):
        return one  # independent faults of a sensor
    last = [values[away[0] - 1], values[away[0]]]
    for i, value in enumerate(values):
        one[i] = np.abs(value - last[1]).max() < np.abs(value - last[0]).max()
        last[int(one[i])] = value
    return one if 2 * one.sum() <= len(one) else ~one
