"""Smoothing and differentiation of noisy samples at any stamps, by splines whose noise level is estimated."""

from armdyn.smoothing.choice import (
    MAX_CUTOFF_SHARE,
    SPLINE_ORDERS,
    Choice,
    Rates,
    best_smoothing,
    derivative_noise,
    smoothed,
)
from armdyn.smoothing.spline import (
    MAX_UNDISTORTED_CUTOFF,
    MIN_SMOOTHED_SAMPLES,
    WHITE_RATE_SHARE,
    Curve,
    LowPass,
    Samples,
    basis_matrix,
    difference_penalty,
)  # fmt: skip

__all__ = [
    "MAX_CUTOFF_SHARE", "MAX_UNDISTORTED_CUTOFF", "MIN_SMOOTHED_SAMPLES", "SPLINE_ORDERS", "WHITE_RATE_SHARE",
    "Choice", "Curve", "LowPass", "Rates", "Samples", "basis_matrix", "best_smoothing", "derivative_noise",
    "difference_penalty", "smoothed",
]  # fmt: skip
