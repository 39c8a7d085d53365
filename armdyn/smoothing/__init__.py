"""Smoothing and differentiation of noisy samples at any stamps, by splines whose noise level is estimated."""

from armdyn.smoothing.choice import HIGHEST, ORDERS, Choice, Rates, best_smoothing, derivative_noise, smoothed
from armdyn.smoothing.spline import (
    FEWEST,
    UNDISTORTED,
    WHITE,
    Curve,
    LowPass,
    Samples,
    basis_matrix,
    difference_penalty,
)  # fmt: skip

__all__ = [
    "FEWEST", "HIGHEST", "ORDERS", "UNDISTORTED", "WHITE", "Choice", "Curve", "LowPass", "Rates", "Samples",
    "basis_matrix", "best_smoothing", "derivative_noise", "difference_penalty", "smoothed",
]  # fmt: skip
