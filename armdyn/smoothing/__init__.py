"""Smoothing and differentiation of noisy samples at any stamps, by splines whose noise level is estimated."""
