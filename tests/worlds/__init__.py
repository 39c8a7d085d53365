"""Recordings with a known truth, of physics that shares nothing with armdyn unless a module says so."""

from collections.abc import Sequence

import numpy as np
from scipy.signal import lfilter


def squares_left(columns: Sequence[np.ndarray], target: np.ndarray) -> float:
    """Squares that (n, k) columns leave of an (n,) target."""
    if not columns:
        return float(target @ target)
    all_columns = np.hstack(columns)
    all_columns = all_columns / np.maximum(np.linalg.norm(all_columns, axis=0), np.finfo(float).tiny)
    rest = target - all_columns @ np.linalg.lstsq(all_columns, target, rcond=1e-9)[0]
    return float(rest @ rest)


def coloured(white: np.ndarray, correlation: float) -> np.ndarray:
    """(n, ...) of white noise of standard deviation 1: each sample has so much in common with the one before."""
    fresh = np.sqrt(1.0 - correlation**2)
    return lfilter([fresh], [1.0, -correlation], white, axis=0, zi=(1.0 - fresh) * white[:1])[0]
