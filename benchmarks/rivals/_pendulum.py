r"""A load on a string below a moving gripper, integrated by scipy from equations of its own: data for the benchmarks.

With the load at (x - l sin phi, -l cos phi), the swing rate seen from rest in space p = phi' - (v/l) cos phi, drag
-c times the load's velocity, and the string's tension T,

    phi' = p + (v/l) cos phi,      p' = (sin phi / l) (v phi' - g) - (c/m) p,
    T = m (g cos phi + l phi'^2 + a sin phi) + c v sin phi.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import cos, pi, sin

import numpy as np
from scipy.integrate import solve_ivp

GRAVITY = 9.81
Signal = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Motion:
    """Gripper on its line: position [m], velocity [m/s] and acceleration [m/s^2] as functions of time [s]."""

    x: Signal
    v: Signal
    a: Signal


@dataclass(frozen=True)
class Pendulum:
    """Load on a string: its length [m], mass [kg] and linear drag coefficient [N s/m]."""

    length: float
    mass: float
    drag: float = 0.0

    def momentum(self, angle: float, rate: float, v: float) -> float:
        """Canonical momentum of the angle [kg m^2/s]."""
        return self.mass * self.length * (self.length * rate - v * np.cos(angle))

    def derivative(self, state: Sequence[float], v: float) -> tuple[float, float]:
        """Time derivatives of the angle phi and its momentum p."""
        phi, p = state
        rate = p + v / self.length * cos(phi)
        return rate, sin(phi) / self.length * (v * rate - GRAVITY) - self.drag / self.mass * p

    def tension(self, phi: np.ndarray, p: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """String tension (n,) [N] from angle, momentum, and velocity and acceleration of the gripper, (n,) each."""
        rate = p + v / self.length * np.cos(phi)
        pull = GRAVITY * np.cos(phi) + self.length * rate**2 + a * np.sin(phi)
        return self.mass * pull + self.drag * v * np.sin(phi)

    def simulate(self, motion: Motion, times: np.ndarray, tolerance: float = 1e-11) -> tuple[np.ndarray, np.ndarray]:
        """Angle [rad] and tension [N] at `times` (n,) of a load that is at rest at time 0."""
        solution = solve_ivp(
            lambda t, state: self.derivative(state, float(motion.v(t))),
            (0.0, times[-1]), [0.0, 0.0], "DOP853", times, rtol=tolerance, atol=tolerance, max_step=0.05,
        )  # fmt: skip
        phi, p = solution.y
        return phi, self.tension(phi, p, motion.v(times), motion.a(times))

    def advance(self, state: tuple[float, float], v: float, a: float, dt: float) -> tuple[float, float]:
        """State (phi, p) after a time of constant acceleration, by two Runge-Kutta steps, accurate to 1e-9."""
        h = dt / 2
        for _ in range(2):
            k1 = self.derivative(state, v)
            k2 = self.derivative(_moved(state, h / 2, k1), v + h / 2 * a)
            k3 = self.derivative(_moved(state, h / 2, k2), v + h / 2 * a)
            v += h * a
            k4 = self.derivative(_moved(state, h, k3), v)
            mean = [(p + 2 * q + 2 * r + s) / 6 for p, q, r, s in zip(k1, k2, k3, k4, strict=True)]
            state = _moved(state, h, mean)
        return state

    def length_sensitivity(self, motion: Motion, times: np.ndarray, change: float = 1e-5) -> np.ndarray:
        """Derivative of the tension with respect to the length (n,) [N/m], by central differences."""
        longer, shorter = (replace(self, length=self.length + sign * change) for sign in (1, -1))
        return (longer.simulate(motion, times)[1] - shorter.simulate(motion, times)[1]) / (2 * change)


def _moved(state: Sequence[float], time: float, rate: Sequence[float]) -> tuple[float, float]:
    return state[0] + time * rate[0], state[1] + time * rate[1]


def sum_of_cosines(amplitudes: tuple[float, ...], frequencies: tuple[float, ...]) -> Motion:
    """Motion x = sum A_i (1 - cos(2 pi f_i t)) with amplitudes in m and frequencies in Hz; it starts at rest."""
    parts = [(A, 2 * pi * f) for A, f in zip(amplitudes, frequencies, strict=True)]

    def x(t: np.ndarray) -> np.ndarray:
        return sum(A * (1 - np.cos(w * t)) for A, w in parts)

    def v(t: np.ndarray) -> np.ndarray:
        sine = sin if isinstance(t, float) else np.sin  # four times as fast for the integrators of scipy
        return sum(A * w * sine(w * t) for A, w in parts)

    def a(t: np.ndarray) -> np.ndarray:
        return sum(A * w**2 * np.cos(w * t) for A, w in parts)

    return Motion(x, v, a)
