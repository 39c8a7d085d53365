r"""Smooth and differentiate noisy samples at any time stamps, without phase shift, and estimate their noise.

A curve x(t) of quintic B-splines minimises (Eilers & Marx, Statistical Science 11, 1996)

    sum_i (y_i - x(t_i))^2 + lambda |D^m c|^2,      D^m c = m-th differences of its coefficients.

Far from the ends this is a low-pass without phase shift, with the amplitude 1/(1 + (f/f_c)^2m). The cut-off f_c is the
one under which the samples are most probable (restricted maximum likelihood, with x a random walk in its derivative m -
1; Wahba, Annals of Statistics 13, 1985); the standard deviation of the noise is estimated at the same time. At f_c
signal and noise are equally strong. The order m can be chosen in the same way: a planned motion has a high order, a
motion that friction and servo disturb a low one.
"""

from copy import copy
from dataclasses import dataclass
from functools import cached_property
from math import comb

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.sparse import csr_matrix

from armdyn.errors import InputError

SPLINE_DEGREE = 5
PENALTY_ORDER = 4
"""Default order of the penalised differences: piecewise-constant jerk costs nothing."""
MIN_SMOOTHED_SAMPLES = 8
"""Least number of samples that can be smoothed."""
MAX_LAMBDA = 1e10
"""Largest weight lambda of the penalty: above it the equations lose too many digits."""
GAP_STIFFNESS_SHARE = 1e-13
"""Weight that pulls a coefficient in a gap towards the first sample, as a share of its own weight: a hundred times the
rounding error of the equations of order 6, and negligible up to 20 knots from the nearest sample."""
MIN_REFINED_PENALTY_LAMBDA = 1e4
"""Weight lambda of the penalty from which a solution is refined by one iteration."""
MAX_UNDISTORTED_CUTOFF_PER_KNOT = 0.125
"""Largest cut-off, per knot interval, at which differences of coefficients are as good as derivatives."""
WHITE_RATE_OVER_TWICE_CUTOFF = 0.896
"""Sampling rate over twice the cut-off at which white noise that was low-passed with order 4 is white again: there
|amplitude|^2 is 1/2."""


@dataclass(frozen=True, eq=False)
class SplineCurve:
    """One or more spline curves with the same knots.

    Attributes:
        start: first time, s.
        step: knot interval, s.
        coefficients: (N, m) coefficients of m curves.
    """

    start: float
    step: float
    coefficients: np.ndarray

    def __call__(self, time: np.ndarray, derivative: int = 0) -> np.ndarray:
        """Evaluate the curves: (n, m) values, or derivatives in 1/s^k, at (n,) times, s; end pieces extend."""
        return np.asarray(
            basis_matrix(time, self.start, self.step, len(self.coefficients), derivative) @ self.coefficients
        )


def basis_matrix(time: np.ndarray, start: float, step: float, size: int, derivative: int = 0) -> csr_matrix:
    """(n, size) values of uniform quintic B-splines, or of a derivative, at (n,) times."""
    position = (np.asarray(time, dtype=float) - start) / step
    first = np.clip(np.floor(position).astype(int), 0, size - SPLINE_DEGREE - 1)
    values = np.vander(position - first, SPLINE_DEGREE + 1, increasing=True) @ (_pieces(derivative) / step**derivative)
    columns = first[:, None] + np.arange(SPLINE_DEGREE + 1)
    pointer = np.arange(0, values.size + 1, SPLINE_DEGREE + 1)
    return csr_matrix((values.ravel(), columns.ravel(), pointer), shape=(len(position), size))


def _pieces(derivative: int) -> np.ndarray:
    """(6, 6) monomial coefficients, by row, of the six splines that are not zero on one interval of length 1."""
    pieces = np.array(
        [
            [1, 26, 66, 26, 1, 0],
            [-5, -50, 0, 50, 5, 0],
            [10, 20, -60, 20, 10, 0],
            [-10, 20, 0, -20, 10, 0],
            [5, -20, 30, -20, 5, 0],
            [-1, 5, -10, 10, -5, 1],
        ]
    ) / 120.0  # fmt: skip
    for _ in range(derivative):
        pieces = np.vstack([np.arange(1, SPLINE_DEGREE + 1)[:, None] * pieces[1:], np.zeros(SPLINE_DEGREE + 1)])
    return pieces


class SplineSamples:
    """Spline basis for samples at given time stamps.

    Args:
        time: (n,) time stamps, s, increasing.
        step: knot interval, s; None means the mean interval of the stamps, which is also the least.
        order: order of the penalised differences.

    Raises:
        InputError: fewer than `MIN_SMOOTHED_SAMPLES` stamps.
    """

    def __init__(self, time: np.ndarray, step: float | None = None, order: int = PENALTY_ORDER) -> None:
        if len(time) < MIN_SMOOTHED_SAMPLES:
            raise InputError(
                f"{len(time)} samples cannot be smoothed: {MIN_SMOOTHED_SAMPLES} or more are needed, record longer"
            )
        self.time, self.order = time, order
        self.interval = float((time[-1] - time[0]) / (len(time) - 1))
        self.start = float(time[0])
        self.step = self.interval if step is None else max(step, self.interval)
        self.size = int(np.ceil((time[-1] - time[0]) / self.step - 1e-9)) + SPLINE_DEGREE
        self.matrix = basis_matrix(time, self.start, self.step, self.size)

    def with_order(self, order: int) -> "SplineSamples":
        """A copy with another order of the penalised differences."""
        other, bands = copy(self), max(SPLINE_DEGREE, order) + 1
        other.order = order
        for known in ("penalty", "penalty_determinant"):
            other.__dict__.pop(known, None)
        other.__dict__["normal"] = np.vstack([self.normal, np.zeros((bands, self.size))])[:bands]
        return other

    @cached_property
    def normal(self) -> np.ndarray:
        """(b, N) lower bands of B' B, with the spline basis B at the samples."""
        return self.bands(self.matrix)

    @cached_property
    def penalty(self) -> np.ndarray:
        """(b, N) lower bands of the penalty D' D, slightly increased where no sample determines a coefficient.

        Across a gap of tens of knots the smoothest curve costs less than rounding, and the equations are singular.
        """
        bands = difference_penalty(self.size, self.order, len(self.normal))
        bands[0, self.normal[0] == 0.0] *= 1.0 + GAP_STIFFNESS_SHARE
        return bands

    @cached_property
    def penalty_determinant(self) -> float:
        """Logarithm of det(D D') of the penalty's differences D, in closed form (MacMahon 1916)."""
        i, j = np.arange(1, self.size - self.order + 1)[:, None], np.arange(1, self.order + 1)
        return float(np.sum(np.log1p(self.order / (i + j - 1))))

    def bands(self, matrix: csr_matrix) -> np.ndarray:
        """(b, N) lower bands of M' M, for M with six neighbouring entries per row."""
        values = matrix.data.reshape(-1, SPLINE_DEGREE + 1)
        first = matrix.indices[:: SPLINE_DEGREE + 1]
        bands = np.zeros((max(SPLINE_DEGREE, self.order) + 1, self.size))
        for a in range(SPLINE_DEGREE + 1):
            for b in range(a, SPLINE_DEGREE + 1):
                bands[b - a] += np.bincount(first + a, values[:, a] * values[:, b], self.size)
        return bands

    def penalty_weight(self, cutoff: float) -> float:
        """Weight lambda of the penalty that halves the amplitude at `cutoff`, Hz."""
        return float((2.0 * np.pi * cutoff * self.step) ** (-2 * self.order) * self.step / self.interval)

    @property
    def lowest_cutoff(self) -> float:
        """Lowest cut-off that is possible with these knots, Hz."""
        return float((MAX_LAMBDA * self.interval / self.step) ** (-0.5 / self.order) / (2.0 * np.pi * self.step))


class LowPass:
    """Low-pass filter without phase shift, with a fixed cut-off and fixed sample times.

    Args:
        samples: times of the samples.
        cutoff: frequency of half the amplitude, Hz.
    """

    def __init__(self, samples: SplineSamples, cutoff: float) -> None:
        self.samples, self.cutoff = samples, cutoff
        self.strength = samples.penalty_weight(cutoff)
        self.factor = cholesky_banded(samples.normal + self.strength * samples.penalty, lower=True, check_finite=False)

    def curve(self, values: np.ndarray) -> SplineCurve:
        """Smooth (n,) or (n, m) values; return the curves."""
        columns = values.reshape(len(values), -1)
        # Minus its first value a constant is exactly zero, and a position loses no digits to its offset.
        offset = columns[:1].copy()
        columns = columns - offset
        B, order = self.samples.matrix, self.samples.order
        c = self.solution(B.T @ columns)
        if self.needs_refinement:
            missing = B.T @ (columns - B @ c) - self.strength * _differences_transposed(
                np.diff(c, order, axis=0), order
            )
            c = c + self.solution(missing)
        return SplineCurve(self.samples.start, self.samples.step, c + offset)

    @property
    def needs_refinement(self) -> bool:
        """Whether rounding errors of the equations are large enough that `curve` refines their solution."""
        return self.strength > MIN_REFINED_PENALTY_LAMBDA

    def solution(self, right: np.ndarray) -> np.ndarray:
        """(N, m) coefficients c that solve (B' B + lambda D' D) c = (N, m) right-hand sides."""
        return np.asarray(cho_solve_banded((self.factor, True), right, check_finite=False))

    def noise_gain(self, time: np.ndarray) -> float:
        """Mean variance of smoothed white noise of unit variance at (k,) times, s, of which at most 50 are used."""
        chosen = time[:: max(1, len(time) // 50)]
        B = self.samples.matrix
        at = basis_matrix(chosen, self.samples.start, self.samples.step, self.samples.size)
        rows = B @ cho_solve_banded((self.factor, True), at.T.toarray(), check_finite=False)
        return float(np.mean(np.sum(rows**2, axis=0)))

    def evidence(self, values: np.ndarray, least_noise: float = 0.0) -> tuple[float, float]:
        """Likelihood of samples for this cut-off and order, and their noise.

        Args:
            values: (n,) samples.
            least_noise: least standard deviation of their noise, such as that of rounding.

        Returns:
            Minus twice the restricted log-likelihood, up to a constant, and the standard deviation of the noise.
        """
        samples, order = self.samples, self.samples.order
        c = self.curve(values).coefficients[:, 0]
        misfit, roughness = values - samples.matrix @ c, np.diff(c, order)
        total = float(misfit @ misfit + self.strength * (roughness @ roughness))
        known = len(values) - order
        determinant = 2.0 * float(np.sum(np.log(self.factor[0]))) - (samples.size - order) * np.log(self.strength)
        variance = max(total / known, least_noise**2, np.finfo(float).tiny)
        score = known * np.log(variance) + total / variance + determinant - samples.penalty_determinant
        return float(score), float(np.sqrt(variance))


def difference_penalty(size: int, order: int, bands: int) -> np.ndarray:
    """(bands, size) lower bands of D' D, where D is the matrix of differences of the given order."""
    stencil, rows = _stencil(order), size - order
    penalty = np.zeros((bands, size))
    for offset in range(order + 1):
        for j in range(order + 1 - offset):
            penalty[offset, j : j + rows] += stencil[j] * stencil[j + offset]
    return penalty


def _stencil(order: int) -> np.ndarray:
    return np.array([(-1.0) ** k * comb(order, k) for k in range(order + 1)])


def _differences_transposed(differences: np.ndarray, order: int) -> np.ndarray:
    """(N, m) D' d for (N - order, m) d."""
    result = np.zeros((len(differences) + order, differences.shape[1]))
    for j, weight in enumerate((-1.0) ** order * _stencil(order)):
        result[j : j + len(differences)] += weight * differences
    return result
