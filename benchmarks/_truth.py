r"""A load on a string below a moving gripper, integrated by scipy from equations of its own: data for the benchmarks.

With the load at (x - l sin phi, -l cos phi), the swing rate seen from rest in space p = phi' - (v/l) cos phi, drag
-c times the load's velocity, and the string's tension T,

    phi' = p + (v/l) cos phi,      p' = (sin phi / l) (v phi' - g) - (c/m) p,
    T = m (g cos phi + l phi'^2 + a sin phi) + c v sin phi.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.integrate import solve_ivp

GRAVITY = 9.81
Signal = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Motion:
    """The gripper along its line: position m, velocity m/s, acceleration m/s^2, each a function of time, s."""

    x: Signal
    v: Signal
    a: Signal


@dataclass(frozen=True)
class Pendulum:
    """Parameters: m, kg, N s/m."""

    length: float
    mass: float
    drag: float = 0.0

    def momentum(self, angle: float, rate: float, v: float) -> float:
        """Canonical momentum of the angle, kg m^2/s."""
        return self.mass * self.length * (self.length * rate - v * np.cos(angle))

    def simulate(self, motion: Motion, times: np.ndarray, tolerance: float = 1e-11) -> tuple[np.ndarray, np.ndarray]:
        """Angle rad and tension N at `times` (n,), from a load at rest at time 0."""

        def derivative(t: float, state: np.ndarray) -> list[float]:
            phi, p = state
            v = motion.v(t)
            rate = p + v / self.length * np.cos(phi)
            return [rate, np.sin(phi) / self.length * (v * rate - GRAVITY) - self.drag / self.mass * p]

        solution = solve_ivp(
            derivative, (0.0, times[-1]), [0.0, 0.0], "DOP853", times, rtol=tolerance, atol=tolerance, max_step=0.05
        )
        phi, p = solution.y
        v, a = motion.v(times), motion.a(times)
        rate = p + v / self.length * np.cos(phi)
        pull = GRAVITY * np.cos(phi) + self.length * rate**2 + a * np.sin(phi)
        return phi, self.mass * pull + self.drag * v * np.sin(phi)

    def length_sensitivity(self, motion: Motion, times: np.ndarray, change: float = 1e-5) -> np.ndarray:
        """(n,) dT/dl, N/m, by central differences."""
        longer, shorter = (replace(self, length=self.length + sign * change) for sign in (1, -1))
        return (longer.simulate(motion, times)[1] - shorter.simulate(motion, times)[1]) / (2 * change)


def sum_of_cosines(amplitudes: tuple[float, ...], frequencies: tuple[float, ...]) -> Motion:
    """The motion x = sum A_i (1 - cos(2 pi f_i t)), m and Hz, which starts at rest."""
    A, w = np.array(amplitudes), 2 * np.pi * np.array(frequencies)

    def x(t: np.ndarray) -> np.ndarray:
        return (1 - np.cos(np.multiply.outer(t, w))) @ A

    def v(t: np.ndarray) -> np.ndarray:
        return np.sin(np.multiply.outer(t, w)) @ (A * w)

    def a(t: np.ndarray) -> np.ndarray:
        return np.cos(np.multiply.outer(t, w)) @ (A * w**2)

    return Motion(x, v, a)
