"""Sequential action control in plain Python and numpy, every derivative by hand, without armdyn's code.

The step-by-step forward pass is in Python floats, which are faster there than small arrays; the derivatives of all
steps are taken at once with numpy. State: x, v, phi, P (momentum), d phi/d l, d P/d l.
"""

from math import cos, sin
from typing import TypeVar

import numpy as np
from _pendulum import GRAVITY

from armdyn.control.sac import SacSettings

State = tuple[float, ...]
Number = TypeVar("Number", float, np.ndarray)


class NumpyControl:
    """Sequential action control of a pendulum with a length [m], a mass [kg] and no other effect."""

    def __init__(self, length: float, mass: float, settings: SacSettings) -> None:
        self.length, self.mass, self.settings = length, mass, settings

    def act(self, state: np.ndarray) -> tuple[float, float, float, np.ndarray, float]:
        """Acceleration, start, end, schedule and cost of the best action from an extended state (6,)."""
        c = self.settings
        free = np.zeros(c.steps)
        free_cost, gradient = self.gradient(free, state)
        slope = gradient / c.dt
        u2 = slope * c.desired_change * free_cost / (slope**2 + c.control_weight)
        u2 = np.clip(u2, -c.largest_acceleration, c.largest_acceleration)
        times = c.dt * (np.arange(c.steps) + 0.5)
        best = int(np.argmin(np.abs(u2) + u2 * slope + times**c.time_exponent))
        middle, size, duration = float(times[best]), float(u2[best]), c.first_duration
        edges = c.dt * np.arange(c.steps + 1)
        for _ in range(c.halvings + 1):
            start, end = max(0.0, middle - duration / 2), min(c.horizon, middle + duration / 2)
            share = np.clip(np.minimum(edges[1:], end) - np.maximum(edges[:-1], start), 0.0, c.dt) / c.dt
            schedule = self._within_speed(size * share, float(state[1]))
            cost = self._forward(schedule, state)[0]
            if cost < free_cost:
                return size, start, end, schedule, cost
            duration /= 2
        return 0.0, 0.0, 0.0, self._within_speed(free, float(state[1])), free_cost

    def gradient(self, schedule: np.ndarray, state: np.ndarray) -> tuple[float, np.ndarray]:
        """Cost of a schedule of accelerations (steps,) and its gradient (steps,)."""
        dt = self.settings.dt
        cost, stages = self._forward(schedule, state)
        visited = np.array(stages).reshape(len(schedule), 4, 6)
        A1, A2, A3, A4 = np.moveaxis(self._rate_jacobian(visited), 1, 0)
        unit, b = np.eye(6), np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
        K2 = A2 @ (unit + dt / 2 * A1)
        K3 = A3 @ (unit + dt / 2 * K2)
        K4 = A4 @ (unit + dt * K3)
        by_state = unit + dt / 6 * (A1 + 2 * K2 + 2 * K3 + K4)
        k2 = b + dt / 2 * A2 @ b
        k3 = b + dt / 2 * np.einsum("kij,kj->ki", A3, k2)
        k4 = b + dt * np.einsum("kij,kj->ki", A4, k3)
        by_control = dt / 6 * (b + 2 * k2 + 2 * k3 + k4)
        running_z, running_u = self._running_gradient(visited[:, 0], schedule)
        gradient, costate = dt * running_u, np.zeros(6)
        for k in reversed(range(len(schedule))):
            gradient[k] += by_control[k] @ costate
            costate = costate @ by_state[k] + dt * running_z[k]
        return cost, gradient

    def _forward(self, schedule: np.ndarray, state: np.ndarray) -> tuple[float, list[State]]:
        """Cost of a schedule, and the four points of every Runge-Kutta step."""
        dt, z, cost, stages = self.settings.dt, tuple(state.tolist()), 0.0, []
        for u in schedule.tolist():
            cost += dt * self._running(z, u)
            k1 = self._rate(z, u)
            z2 = tuple([a + dt / 2 * k for a, k in zip(z, k1, strict=True)])
            k2 = self._rate(z2, u)
            z3 = tuple([a + dt / 2 * k for a, k in zip(z, k2, strict=True)])
            k3 = self._rate(z3, u)
            z4 = tuple([a + dt * k for a, k in zip(z, k3, strict=True)])
            k4 = self._rate(z4, u)
            stages += (z, z2, z3, z4)
            z = tuple([a + dt / 6 * (p + 2 * q + 2 * r + s) for a, p, q, r, s in zip(z, k1, k2, k3, k4, strict=True)])
        return cost, stages

    def _rate(self, z: State, u: float) -> State:
        L, m = self.length, self.mass
        _, v, phi, P, psi1, psi2 = z
        s, c = sin(phi), cos(phi)
        rate, rate_l = self._swing(v, s, c, P, psi1, psi2)
        h = v * rate - GRAVITY
        return v, u, rate, m * L * s * h, rate_l, m * s * h + m * L * c * psi1 * h + m * L * s * v * rate_l

    def _swing(self, v: Number, s: Number, c: Number, P: Number, psi1: Number, psi2: Number) -> tuple[Number, Number]:
        """Swing rate and its derivative with respect to the length; s and c are sine and cosine of the angle."""
        L, i = self.length, 1 / (self.mass * self.length * self.length)
        return P * i + v * c / L, psi2 * i - 2 * P * i / L - v * c / (L * L) - v * s * psi1 / L

    def _running(self, z: State, u: float) -> float:
        w = self.settings
        x, v, phi, P, psi1, psi2 = z
        s, c = sin(phi), cos(phi)
        rate, rate_l = self._swing(v, s, c, P, psi1, psi2)
        gamma = self.mass * ((u * c - GRAVITY * s) * psi1 + rate**2 + 2 * self.length * rate * rate_l)
        floor, beyond = w.information_floor**2, max(0.0, abs(x) - w.barrier)
        return (
            floor / (gamma**2 + floor) + w.position_weight * x**2 + w.velocity_weight * v**2
            + w.barrier_weight * beyond**2
        )  # fmt: skip

    def _rate_jacobian(self, z: np.ndarray) -> np.ndarray:
        """Jacobians of `_rate` (..., 6, 6) at points (..., 6)."""
        L, m = self.length, self.mass
        v, phi, P, psi1, psi2 = np.moveaxis(z, -1, 0)[1:]
        s, c = np.sin(phi), np.cos(phi)
        a, b = self._swing(v, s, c, P, psi1, psi2)
        a_z, b_z = self._swing_gradients(v, s, c, psi1)
        h = v * a - GRAVITY
        h_z = v[..., None] * a_z
        h_z[..., 1] += a
        of_phi, of_psi1 = np.eye(6)[2], np.eye(6)[4]
        by_h = m * s + m * L * c * psi1
        J = np.zeros((*z.shape, 6))
        J[..., 0, 1] = 1.0
        J[..., 2, :] = a_z
        J[..., 3, :] = m * L * (s[..., None] * h_z + (c * h)[..., None] * of_phi)
        J[..., 4, :] = b_z
        J[..., 5, :] = (
            by_h[..., None] * h_z
            + (m * c * h - m * L * s * psi1 * h + m * L * c * v * b)[..., None] * of_phi
            + (m * L * c * h)[..., None] * of_psi1
            + (m * L * s * v)[..., None] * b_z
        )
        J[..., 5, 1] += m * L * s * b
        return J

    def _swing_gradients(
        self, v: np.ndarray, s: np.ndarray, c: np.ndarray, psi1: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Gradients of the two values of `_swing` with respect to the state, (..., 6) each."""
        L, i = self.length, 1 / (self.mass * self.length**2)
        a_z, b_z = np.zeros((*v.shape, 6)), np.zeros((*v.shape, 6))
        a_z[..., 1], a_z[..., 2], a_z[..., 3] = c / L, -v * s / L, i
        b_z[..., 1], b_z[..., 2] = -c / L**2 - s * psi1 / L, v * s / L**2 - v * c * psi1 / L
        b_z[..., 3], b_z[..., 4], b_z[..., 5] = -2 * i / L, -v * s / L, i
        return a_z, b_z

    def _running_gradient(self, z: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the running cost with respect to states (N, 6) and accelerations (N,)."""
        L, m, w = self.length, self.mass, self.settings
        x, v, phi, P, psi1, psi2 = z.T
        s, c = np.sin(phi), np.cos(phi)
        a, b = self._swing(v, s, c, P, psi1, psi2)
        a_z, b_z = self._swing_gradients(v, s, c, psi1)
        gamma = m * ((u * c - GRAVITY * s) * psi1 + a**2 + 2 * L * a * b)
        gamma_z = 2 * m * ((a + L * b)[:, None] * a_z + (L * a)[:, None] * b_z)
        gamma_z[:, 2] += m * (-u * s - GRAVITY * c) * psi1
        gamma_z[:, 4] += m * (u * c - GRAVITY * s)
        floor = w.information_floor**2
        by_gamma = -2 * floor * gamma / (gamma**2 + floor) ** 2
        by_z = by_gamma[:, None] * gamma_z
        by_z[:, 0] += 2 * w.position_weight * x
        by_z[:, 0] += 2 * w.barrier_weight * np.maximum(0, np.abs(x) - w.barrier) * np.sign(x)
        by_z[:, 1] += 2 * w.velocity_weight * v
        return by_z, by_gamma * m * c * psi1

    def _within_speed(self, schedule: np.ndarray, v: float) -> np.ndarray:
        limit, dt, kept = self.settings.largest_speed, self.settings.dt, []
        for a in schedule.tolist():
            low, high = (min(-limit, v) - v) / dt, (max(limit, v) - v) / dt
            kept.append(min(max(a, low), high))
            v += dt * kept[-1]
        return np.array(kept)
