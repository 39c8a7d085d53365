"""Fitting a pendulum to a load cell without armdyn: scipy's least squares, and Gauss-Newton on plain Runge-Kutta.

All of them minimise what armdyn minimises, sum (r/sigma)^2/2 plus the priors, over any of the parameters in `NAMES`.
Gauss-Newton stops, as armdyn does, when a step is shorter than a hundredth of a standard deviation.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from _pendulum import GRAVITY, Motion, Pendulum
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

NAMES = ("length", "mass", "drag", "bias", "delay")
TYPICAL = np.array([0.3, 0.1, 5e-3, 0.01, 0.01])
CONVERGED_STEP_STANDARD_DEVIATIONS = 1e-2
"""Step in standard deviations below which Gauss-Newton stops."""
INTEGRATOR = "DOP853"
"""Fastest integrator of scipy at the tolerance that finite differences need; RK45 takes three times as long."""


@dataclass(frozen=True, eq=False)
class Data:
    """Measurements, priors and start values of an estimation problem.

    Attributes:
        time: times of the load cell's samples (n,) [s]; gripper and load are at rest at 0.
        force: measured force (n,) [N].
        noise: standard deviation of one sample [N].
        motion: motion of the gripper.
        known: mean and standard deviation of the priors by parameter; a parameter neither here nor in `free` is fixed.
        free: names of the parameters to find.
        start: start values (5,) in the order of `NAMES`.
    """

    time: np.ndarray
    force: np.ndarray
    noise: float
    motion: Motion
    known: dict[str, tuple[float, float]]
    free: tuple[str, ...]
    start: np.ndarray

    @property
    def columns(self) -> list[int]:
        """Indices of the free parameters in `NAMES`."""
        return [NAMES.index(name) for name in self.free]

    def until(self, end: float) -> "Data":
        """The same problem with the samples up to `end` [s]."""
        n = int(np.searchsorted(self.time, end, side="right"))
        return replace(self, time=self.time[:n], force=self.force[:n])

    def with_start(self, values: np.ndarray) -> "Data":
        """The same problem with other start values of the free parameters."""
        start = self.start.copy()
        start[self.columns] = values
        return replace(self, start=start)

    def full(self, values: np.ndarray) -> np.ndarray:
        """All parameters, (5,) or (k, 5), from the free ones, (p,) or (k, p)."""
        theta = np.broadcast_to(self.start, (*np.shape(values)[:-1], 5)).copy()
        theta[..., self.columns] = values
        return theta

    def residual(self, predicted: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Residuals of samples and priors (n + priors,), in standard deviations."""
        beliefs = [
            (values[i] - self.known[k][0]) / self.known[k][1] for i, k in enumerate(self.free) if k in self.known
        ]
        return np.append((predicted - self.force) / self.noise, beliefs)


Number = float | np.ndarray
Fit = Callable[[Data], np.ndarray]
"""Function that finds the free parameters of least cost from the data's start values."""


def with_scipy(data: Data) -> np.ndarray:
    """Fit by `scipy.optimize.least_squares` on `scipy.integrate.solve_ivp`, scaled by the parameters' typical size."""
    start, scale = data.start[data.columns], TYPICAL[data.columns]

    def residual(scaled: np.ndarray) -> np.ndarray:
        values = start + scale * (scaled - 1.0)
        length, mass, drag, bias, delay = data.full(values).tolist()
        pendulum = Pendulum(length, mass, drag)
        time = np.maximum(data.time - delay, 0.0)
        solution = solve_ivp(
            lambda t, state: pendulum.derivative(state.tolist(), data.motion.v(t)),
            (0.0, float(data.time[-1])), [0.0, 0.0], INTEGRATOR, time, rtol=1e-8, atol=1e-8,
        )  # fmt: skip
        phi, p = solution.y
        force = pendulum.tension(phi, p, data.motion.v(time), data.motion.a(time)) + bias
        return data.residual(force, values)

    # A wider step than scipy's own: differences of 1e-8 drown in the integrator's error.
    solution = least_squares(residual, np.ones(len(start)), diff_step=1e-4, ftol=1e-7, xtol=1e-7)
    return start + scale * (solution.x - 1.0)


def with_floats(data: Data) -> np.ndarray:
    """Fit by Gauss-Newton, with the Runge-Kutta steps of one rollout after another in Python floats."""

    def predict(values: np.ndarray) -> np.ndarray:
        return np.stack([_force(data, theta, math.sin, math.cos) for theta in data.full(values)])

    return _gauss_newton(data, predict)


def with_arrays(data: Data) -> np.ndarray:
    """Fit by Gauss-Newton, with the rollouts of a finite difference side by side in numpy arrays."""

    def predict(values: np.ndarray) -> np.ndarray:
        return _force(data, data.full(values).T[..., None], np.sin, np.cos)

    return _gauss_newton(data, predict)


def over_windows(fit: Fit, data: Data, windows: Sequence[float]) -> np.ndarray:
    """Fit over growing windows, each from the last result, then over the whole recording."""
    for window in (*windows, np.inf):
        values = fit(data.until(window))
        data = data.with_start(values)
    return values


def _force(data: Data, theta: np.ndarray, sine: Callable, cosine: Callable) -> np.ndarray:
    """Predicted force: (n,) for parameters (5,) in floats, (k, n) for parameters (5, k, 1) in arrays."""
    length, mass, drag, bias, delay = theta
    nodes = np.maximum(np.insert(data.time, 0, 0.0) - delay, 0.0)  # (n+1,) or (k, n+1)
    v = data.motion.v(nodes)
    middle = data.motion.v((nodes[..., 1:] + nodes[..., :-1]) / 2)
    steps = (np.diff(nodes), v[..., :-1], middle, v[..., 1:])
    if theta.ndim == 1:
        rows = zip(*(step.tolist() for step in steps), strict=True)
        found = _integrate(float(length), float(drag / mass), rows, sine, cosine, 0.0)
    else:
        rows = zip(*(step.T for step in steps), strict=True)
        found = _integrate(length[:, 0], (drag / mass)[:, 0], rows, sine, cosine, np.zeros(len(length)))
    phi, p = np.moveaxis(np.array(found), 0, -1)
    return Pendulum(length, mass, drag).tension(phi, p, v[..., 1:], data.motion.a(nodes[..., 1:])) + bias


def _integrate(
    length: Number, decay: Number, rows: Iterable[tuple[Number, ...]], sine: Callable, cosine: Callable, zero: Number
) -> list[tuple[Number, Number]]:
    """States (phi, p) after every Runge-Kutta step of one rollout in floats or of several in arrays."""

    def rate(phi: Number, p: Number, v: Number) -> tuple[Number, Number]:
        swing = p + v / length * cosine(phi)
        return swing, sine(phi) / length * (v * swing - GRAVITY) - decay * p

    phi, p, found = zero, zero, []
    for h, v0, v1, v2 in rows:
        a1, b1 = rate(phi, p, v0)
        a2, b2 = rate(phi + h / 2 * a1, p + h / 2 * b1, v1)
        a3, b3 = rate(phi + h / 2 * a2, p + h / 2 * b2, v1)
        a4, b4 = rate(phi + h * a3, p + h * b3, v2)
        phi = phi + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        p = p + h / 6 * (b1 + 2 * b2 + 2 * b3 + b4)
        found.append((phi, p))
    return found


def _gauss_newton(data: Data, predict: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Free parameters by Gauss-Newton with forward differences; `predict` maps values (k, p) to forces (k, n)."""
    values = data.start[data.columns]
    change = 1e-6 * TYPICAL[data.columns]
    while True:
        tried = values + np.vstack([np.zeros(len(values)), np.diag(change)])
        residuals = np.stack([data.residual(f, v) for f, v in zip(predict(tried), tried, strict=True)])
        r, J = residuals[0], (residuals[1:] - residuals[0]).T / change
        step = -np.linalg.solve(J.T @ J, J.T @ r)
        if np.linalg.norm(J @ step) < CONVERGED_STEP_STANDARD_DEVIATIONS:
            return values
        size, cost = 1.0, r @ r
        while size > 1e-6:
            trial = values + size * step
            after = data.residual(predict(trial[None])[0], trial)
            if after @ after < cost:
                break
            size /= 2
        values = values + size * step
