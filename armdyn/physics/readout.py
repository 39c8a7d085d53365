"""From the grid of the simulation to the samples of a sensor: lag, dead time, interpolation; with exact derivatives."""

from collections.abc import Iterable

import casadi as ca
import numpy as np
from scipy.signal import lfilter

from armdyn.physics.definition import Expression
from armdyn.physics.recorded import Path


def lagged(values: np.ndarray, time_constant: float, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """A first-order lag of a signal that is linear between samples, and its derivative.

    z_{k+1} = e z_k + b y_k + c y_{k+1}, e = exp(-dt/tau), c = 1 - (1 - e) tau/dt, b = (1 - e) tau/dt - e: exact for
    the interpolated signal, and regular at tau = 0, where z = y and dz/dtau = -(y_{k+1} - y_k)/dt.
    (Franklin, Powell & Workman, Digital Control, 3rd ed., §6.3, first-order hold.)

    Args:
        values: (K, m) uniform samples, columns filtered alike, starting in equilibrium.
        time_constant: tau, s, >= 0.
        dt: s.

    Returns:
        (K, m) filtered, and (K,) derivative of the first column with respect to tau.
    """
    e, b, c, de, db, dc = lag_coefficients(time_constant, dt)
    y = values
    z = lfilter([c, b], [1.0, -e], y, axis=0, zi=(1.0 - c) * y[:1])[0]
    previous_y, previous_z = (np.concatenate([s[:1, 0], s[:-1, 0]]) for s in (y, z))
    drive = de * previous_z + db * previous_y + dc * y[:, 0]
    drive[0] = 0.0
    return z, lfilter([1.0], [1.0, -e], drive)


def lag_coefficients(tau: float, dt: float) -> tuple[float, float, float, float, float, float]:
    """e, b, c of `lagged` and their derivatives with respect to tau."""
    if tau < 1e-3 * dt:  # e underflows to zero and every term but the linear one with it
        r = max(tau, 0.0) / dt
        return 0.0, r, 1.0 - r, 0.0, 1.0 / dt, -1.0 / dt
    e = float(np.exp(-dt / tau))
    r, de = tau / dt, e * dt / tau**2
    dr = (1.0 - e) / dt - r * de  # of (1 - e) tau / dt
    return e, (1.0 - e) * r - e, 1.0 - (1.0 - e) * r, de, dr - de, -dr


def sampled(grid_values: np.ndarray, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cubic interpolation of columns at fractional grid positions.

    Args:
        grid_values: (K, m), K >= 4.
        position: (n,) in grid steps; positions outside [0, K-1] take the end values.

    Returns:
        (n, m) values, and (n,) derivative of the first column per grid step.
    """
    K = len(grid_values)
    nearest = np.rint(position)
    if np.max(np.abs(position - nearest), initial=0.0) < 1e-9 and nearest[0] >= 0 and nearest[-1] <= K - 1:
        index = nearest.astype(int)
        first = grid_values[:, 0]
        return grid_values[index], np.gradient(first)[index]
    inside = np.clip(position, 0.0, K - 1.0)
    base = np.clip(inside.astype(int) - 1, 0, K - 4)
    u = inside - base  # 1 <= u <= 2 away from the ends
    weights = np.stack(
        [
            -(u - 1) * (u - 2) * (u - 3) / 6,
            u * (u - 2) * (u - 3) / 2,
            -u * (u - 1) * (u - 3) / 2,
            u * (u - 1) * (u - 2) / 6,
        ]
    )
    slopes = np.stack(
        [
            -(3 * u**2 - 12 * u + 11) / 6,
            (3 * u**2 - 10 * u + 6) / 2,
            -(3 * u**2 - 8 * u + 3) / 2,
            (3 * u**2 - 6 * u + 2) / 6,
        ]
    )
    values = sum(w[:, None] * grid_values[base + i] for i, w in enumerate(weights))
    slope = sum(w * grid_values[base + i, 0] for i, w in enumerate(slopes))
    return values, np.where(inside == position, slope, 0.0)


def differentiated_columns(values: np.ndarray, dt: float) -> np.ndarray:
    """(K, m) time derivative of columns on an even grid, by fourth-order differences; linear in the values."""
    if len(values) < 5:
        return np.gradient(values, dt, axis=0)
    slope = np.empty_like(values)
    slope[2:-2] = (values[:-4] - 8 * values[1:-3] + 8 * values[3:-1] - values[4:]) / (12 * dt)
    edge = np.array([[-25.0, 48.0, -36.0, 16.0, -3.0], [-3.0, -10.0, 18.0, -6.0, 1.0]]) / (12 * dt)
    slope[:2] = edge @ values[:5]
    slope[:-3:-1] = -edge @ values[:-6:-1]
    return slope


class SensorChain:
    """Lag, dead time and sampling of each output of a simulation, with exact derivatives.

    Args:
        outputs: names in the order of the rows of `timing`.
        timing: (outputs, 2) lag and delay, s, as expressions of `theta`.
        theta: (p,) symbols.
    """

    def __init__(self, outputs: Iterable[str], timing: Expression, theta: Expression) -> None:
        self._rows = {name: i for i, name in enumerate(outputs)}
        flat = ca.reshape(ca.densify(timing), -1, 1)
        self._timing = ca.Function("timing", [theta], [flat, ca.densify(ca.jacobian(flat, theta))])
        self._depends = [_dependent(flat[i], theta) for i in range(flat.numel())]
        self._there = [not flat[i].is_zero() for i in range(flat.numel())]

    def read(self, output: str, signal: np.ndarray, time: np.ndarray, path: Path, theta: np.ndarray) -> np.ndarray:
        """What a sensor says at the times of its samples.

        Args:
            output: its name.
            signal: (K, 1 + m) on the grid of `path`: the quantity and its derivatives, those by theta first.
            time: (n,) s.
            path: with `start` and `dt` of the grid.
            theta: (p,).

        Returns:
            (n, 1 + m).
        """
        at = self._rows[output], self._rows[output] + len(self._rows)
        lagging, late = (self._there[i] for i in at)
        if not (lagging or late):
            return sampled(signal, (time - path.start) / path.dt)[0]
        timing, derivative = (np.asarray(a) for a in self._timing(theta))
        lag, delay = (float(timing[i, 0]) for i in at)
        if lagging:
            signal, per_lag = lagged(signal, lag, path.dt)
            for column in self._depends[at[0]]:
                signal[:, 1 + column] += per_lag * derivative[at[0], column]
        block, per_step = sampled(signal, (time - delay - path.start) / path.dt)
        for column in self._depends[at[1]]:
            block[:, 1 + column] -= per_step / path.dt * derivative[at[1], column]
        return block


def _dependent(expression: Expression, theta: Expression) -> tuple[int, ...]:
    return tuple(i for i, depends in enumerate(ca.which_depends(expression, theta, 1, False)) if depends)
