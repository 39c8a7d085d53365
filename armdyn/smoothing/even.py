"""Smooth and differentiate positions on an even grid, for the inputs of a simulation.

Positions are smoothed with the most probable strength and differentiated without phase shift.
"""

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.linalg import solveh_banded

from armdyn.errors import InputError
from armdyn.smoothing.choice import best_smoothing, resolution, smooth_curve
from armdyn.smoothing.spline import MIN_SMOOTHED_SAMPLES, difference_penalty

WHITTAKER_ORDER = 4
"""Order of the penalised differences in the smoothing of positions on an even grid."""
MIN_SMOOTHING_STRENGTH = 1.0 / (2.0 * np.sin(0.1 * np.pi)) ** 8
"""Least smoothing strength, in samples^8: it halves a motion with a tenth of the sampling rate, the fastest of
grippers."""
SMOOTHING_STRENGTHS_TRIED = MIN_SMOOTHING_STRENGTH * np.logspace(0, 8, 17)
"""Smoothing strengths that are tried, in samples^8; neighbours are a factor of 3.2 apart."""


def smoothed_motion(
    time: np.ndarray, x: np.ndarray, dt: float, *, exact: bool = False, spread: float = 0.0
) -> np.ndarray:
    """(3, K) position, velocity and acceleration from noisy positions, on an even grid that starts at the first stamp.

    It is penalised least squares (Whittaker 1923; Eilers, Anal. Chem. 2003): the minimum of |y - x|^2 + lambda |D^4
    x|^2 with the strength that `best_strength` finds. Stamps that are not on the grid, such as slow or uneven ones, get
    the spline of `armdyn.smoothing`, which needs no grid.

    Args:
        time: (n,) increasing time stamps, s.
        x: (n,) positions.
        dt: grid step, s.
        exact: whether the positions have no noise.
        spread: variance of the stamps over which each position was averaged, s^2; see `Run.spread`.
    """
    if len(time) < WHITTAKER_ORDER + 2:
        raise InputError(f"a recorded motion has {len(time)} samples: {WHITTAKER_ORDER + 2} or more are needed")
    grid = time[0] + dt * np.arange(grid_size(time[0], time[-1], dt))
    if not (len(grid) == len(time) and np.allclose(grid, time, atol=1e-3 * dt, rtol=0)):
        motion = np.vstack(_off_grid(time, x, np.minimum(grid, time[-1]), exact=exact))
    else:
        smooth = x if exact else penalised_least_squares(x, best_strength(x))
        motion = np.vstack([smooth, *first_and_second_derivatives(smooth, dt)])
    if spread > 0.0:  # the mean of a curved stretch lies inside the curve
        jerk = first_derivative(motion[2], dt)
        motion = motion - spread / 2.0 * np.vstack([motion[2], jerk, first_derivative(jerk, dt)])
    return motion


def _off_grid(
    time: np.ndarray, x: np.ndarray, grid: np.ndarray, *, exact: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(3, K) position, velocity and acceleration at `grid`, (K,), from positions at any stamps."""
    if exact or len(time) < MIN_SMOOTHED_SAMPLES:
        spline = make_interp_spline(time, x, 5)
        return spline(grid), spline(grid, 1), spline(grid, 2)
    curve = smooth_curve(time, x, best_smoothing(time, x))
    return curve(grid)[:, 0], curve(grid, 1)[:, 0], curve(grid, 2)[:, 0]


def grid_size(start: float, end: float, dt: float) -> int:
    """Number of nodes of an even grid with step `dt` that covers the times from `start` to `end`, s."""
    return max(2, int(np.ceil((end - start) / dt - 1e-9)) + 1)


def motion_at_midpoints(motion: np.ndarray, dt: float) -> np.ndarray:
    """(3, K-1) position, velocity and acceleration halfway between nodes (3, K), by quintic Hermite interpolation."""
    (x0, v0, a0), (x1, v1, a1) = motion[:, :-1], motion[:, 1:]
    return np.vstack(
        [
            (x0 + x1) / 2 + dt * (v0 - v1) * 5 / 32 + dt**2 * (a0 + a1) / 64,
            15 / 8 * (x1 - x0) / dt - 7 / 16 * (v0 + v1) + dt * (a1 - a0) / 32,
            3 / 2 * (v1 - v0) / dt - (a0 + a1) / 4,
        ]
    )


def best_strength(y: np.ndarray) -> float:
    """Smoothing strength, in samples^8, under which samples are most probable (restricted likelihood; Wahba 1985).

    For smoothed samples x, q = |y - x|^2 + lambda |D^4 x|^2 and the eigenvalues e of D'D, minus twice its logarithm is
    (n - 4) log q + sum log(1 + 1 / (lambda e)). It needs no noise level. Cross-validation smooths less, with the same
    error of an arm's acceleration; but noise that it leaves there makes a pendulum's response to it look smaller at
    high frequencies, as behind a lag (of a simulated arm without one 15 ms, found with 15 nats; now 0 to 7 ms, 1 nat).
    """
    n = len(y)
    eigenvalues = (2.0 * np.sin(np.pi * np.arange(WHITTAKER_ORDER, n) / (2.0 * n))) ** (2 * WHITTAKER_ORDER)
    rounding = resolution(y) ** 2 / 12.0
    known = n - WHITTAKER_ORDER

    def deviance(strength: float) -> float:
        square = float(y @ (y - penalised_least_squares(y, strength)))
        variance = max(square / known, rounding, np.finfo(float).tiny)
        freedom = float(np.sum(np.log1p(1.0 / (strength * eigenvalues))))
        return known * np.log(variance) + square / variance + freedom

    best = 4 * int(np.argmin([deviance(strength) for strength in SMOOTHING_STRENGTHS_TRIED[::4]]))
    near = SMOOTHING_STRENGTHS_TRIED[max(0, best - 3) : best + 4]
    return float(near[int(np.argmin([deviance(strength) for strength in near]))])


def penalised_least_squares(y: np.ndarray, strength: float) -> np.ndarray:
    """(n,) smoothed samples x that minimise |y - x|^2 + strength |D^4 x|^2, with fourth differences D^4."""
    bands = strength * difference_penalty(len(y), WHITTAKER_ORDER, WHITTAKER_ORDER + 1)
    bands[0] += 1.0
    return solveh_banded(bands, y, lower=True, check_finite=False)


def first_and_second_derivatives(x: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """First and second derivatives of samples at even times, by differences of fourth order, third at the two ends."""
    padded = np.concatenate([_extrapolated(x[:5])[::-1], x, _extrapolated(x[:-6:-1])])
    m2, m1, c, p1, p2 = (padded[i : len(padded) - 4 + i] for i in range(5))
    return (m2 - 8 * m1 + 8 * p1 - p2) / (12 * dt), (-m2 + 16 * m1 - 30 * c + 16 * p1 - p2) / (12 * dt**2)


def first_derivative(x: np.ndarray, dt: float) -> np.ndarray:
    """First derivative of (n, ...) samples at even times with interval `dt`, s, by differences of fourth order.

    With fewer than five samples the differences are of second order.
    """
    return first_and_second_derivatives(x, dt)[0] if len(x) >= 5 else np.gradient(x, dt, axis=0)


def _extrapolated(near: np.ndarray) -> np.ndarray:
    """Two samples beyond the end, nearest first, on the quartic through the five samples `near` (nearest first)."""
    a, b, c, d, e = near
    first = 5 * a - 10 * b + 10 * c - 5 * d + e
    second = 5 * first - 10 * a + 10 * b - 5 * c + d
    return np.array([first, second])
