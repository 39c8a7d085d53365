"""A curve through a signal and its measured derivatives."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from armdyn.smoothing.choice import COARSER, Choice
from armdyn.smoothing.spline import UNDISTORTED, Curve, LowPass, Samples, basis_matrix


class Rates(NamedTuple):
    """Measured derivatives of a signal: (n,) times in s, (n,) values, and how often the signal is differentiated."""

    time: np.ndarray
    values: np.ndarray
    derivative: int


def smoothed(time: np.ndarray, values: np.ndarray, choice: Choice, rates: Sequence[Rates] = ()) -> Curve:
    """Curve through a noisy signal and its measured derivatives, each weighted by how well it agrees.

    The noise of a derivative is what its samples differ from the curve through the rest: one that is filtered or late
    in the recording gets little weight where it contradicts the signal itself.

    Args:
        time: (n,) s.
        values: (n,).
        choice: see `best_smoothing`.
        rates: of the signal.
    """
    # Measured derivatives resolve more than the cut-off of the signal alone.
    samples = Samples(time, None if rates else UNDISTORTED / choice.cutoff, choice.order)
    while samples.lowest > choice.cutoff:
        samples = Samples(time, COARSER * samples.step, choice.order)
    curve = LowPass(samples, choice.cutoff).curve(values)
    if not rates or choice.noise == 0.0:
        return curve
    offset = values[0]
    matrices = [basis_matrix(r.time, samples.start, samples.step, samples.size, r.derivative) for r in rates]
    for _ in range(3):  # the weights settle to a few per cent
        bands = samples.normal + samples.strength(choice.cutoff) * samples.penalty
        right = samples.matrix.T @ (values - offset)
        for rate, matrix in zip(rates, matrices, strict=True):
            deviation = max(float(np.std(rate.values - matrix @ curve.coefficients[:, 0])), 1e-9)
            weight = (choice.noise / deviation) ** 2
            bands = bands + weight * samples.bands(matrix)
            right = right + weight * (matrix.T @ rate.values)
        factor = cholesky_banded(bands, lower=True, check_finite=False)
        c = cho_solve_banded((factor, True), right, check_finite=False)
        curve = Curve(samples.start, samples.step, c[:, None] + offset)
    return curve
