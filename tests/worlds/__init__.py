"""Recordings with a known truth, of physics that shares nothing with armdyn unless a module says so."""

from collections.abc import Sequence

import numpy as np


def squares_left(columns: Sequence[np.ndarray], target: np.ndarray) -> float:
    """Squares that (n, k) columns leave of an (n,) target."""
    if not columns:
        return float(target @ target)
    all_columns = np.hstack(columns)
    all_columns = all_columns / np.maximum(np.linalg.norm(all_columns, axis=0), np.finfo(float).tiny)
    rest = target - all_columns @ np.linalg.lstsq(all_columns, target, rcond=1e-9)[0]
    return float(rest @ rest)
