r"""Periodic, band-limited motions from rest to rest, for the joints of an arm or a gripper on its line.

Each axis is a finite Fourier series (Swevers, Ganseman, Tükel, De Schutter & Van Brussel, IEEE T-RA 13(5), 1997),

    q(t) = c + \sum_{h=1}^{H} a_h \sin(h w t) + b_h \cos(h w t),   w = 2 \pi / P,

where \sum h a_h = 0 and \sum h^2 b_h = 0 make velocity and acceleration vanish at the beginning and end of a period:
the motion follows a rest with a continuous acceleration.
"""

from dataclasses import dataclass
from functools import cached_property
from math import ceil
from typing import NamedTuple

import numpy as np
from scipy.linalg import null_space

JOINT_MAX_FREQUENCY_HZ = 1.0
"""Highest frequency of a joint in a designed motion, Hz: arms follow it, and it is far below the 10 Hz at which their
links bend."""
MIN_HARMONICS = 4
"""Least number of harmonics of a designed motion, so that two free coefficients remain for the sines and for the
cosines. A very short motion then exceeds the highest frequency."""
JOINT_MAX_PERIOD_SECONDS = 20.0
"""Longest period of a joint's motion, s; a longer motion repeats a period, which limits the number of coefficients."""


class AxisMotion(NamedTuple):
    """Positions, velocities and accelerations of all axes at n times; all arrays are (n, axes).

    Attributes:
        q: position, rad or m.
        v: velocity, rad/s or m/s.
        a: acceleration, rad/s^2 or m/s^2.
    """

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray


@dataclass(frozen=True, eq=False)
class SeriesBasis:
    """Values of the basis functions of a Fourier series at n times; a motion is a linear combination of them.

    Attributes:
        time: (n,) instants, s.
        functions: (3, n, size) values for position, velocity and acceleration.
    """

    time: np.ndarray
    functions: np.ndarray

    def motion(self, x: np.ndarray) -> AxisMotion:
        """The motion with (axes, size) Fourier coefficients x."""
        return AxisMotion(*(functions @ x.T for functions in self.functions))

    def gradient(self, by_q: np.ndarray, by_v: np.ndarray, by_a: np.ndarray) -> np.ndarray:
        """(axes, size) derivatives of a number by the coefficients, from its (n, axes) derivatives by the motion."""
        first, second, third = self.functions
        return np.asarray(by_q.T @ first + by_v.T @ second + by_a.T @ third)


@dataclass(frozen=True)
class FourierSeries:
    """The Fourier series of which the position of an axis consists.

    Attributes:
        seconds: duration of the whole motion, s.
        max_frequency: highest frequency, Hz.
        longest_period: longest period, s; a longer motion repeats a period.
        relative_to_start_position: whether positions are relative to the start of the motion, which makes the centre
            unused.
    """

    seconds: float
    max_frequency: float = JOINT_MAX_FREQUENCY_HZ
    longest_period: float = JOINT_MAX_PERIOD_SECONDS
    relative_to_start_position: bool = False

    @property
    def repeats(self) -> int:
        """Number of periods in the motion."""
        return ceil(self.seconds / self.longest_period - 1e-9)

    @property
    def period(self) -> float:
        """Period P of the motion, s."""
        return self.seconds / self.repeats

    @property
    def harmonics(self) -> int:
        """Number H of harmonics in the series."""
        return max(MIN_HARMONICS, int(self.max_frequency * self.period + 1e-9))

    @property
    def coefficient_count(self) -> int:
        """Number of Fourier coefficients of an axis: the centre, H - 1 for sines and H - 1 for cosines."""
        return 2 * self.harmonics - 1

    @cached_property
    def _free(self) -> tuple[np.ndarray, np.ndarray]:
        """(H, H - 1) sines and cosines that meet the conditions of rest; amplitudes fall with frequency."""
        h = np.arange(1.0, self.harmonics + 1)
        weight = 1.0 / h  # amplitudes of a motion with the same speed at all frequencies
        sines, cosines = (weight[:, None] * null_space((weight * h**power)[None]) for power in (1, 2))
        return sines, cosines

    def functions(self, time: np.ndarray, derivative: int = 0) -> np.ndarray:
        """(n, size) values of the basis functions, or of their `derivative`-th derivatives, at (n,) times, s."""
        h = np.arange(1, self.harmonics + 1)
        w = 2.0 * np.pi * h / self.period
        phase = np.outer(time, w) + 0.5 * np.pi * derivative
        sines, cosines = self._free
        scale = w**derivative
        centre = np.full((len(time), 1), float(derivative == 0))
        values = np.hstack([centre, (scale * np.sin(phase)) @ sines, (scale * np.cos(phase)) @ cosines])
        if self.relative_to_start_position and derivative == 0:
            values -= np.concatenate([[1.0], np.zeros(sines.shape[1]), cosines.sum(axis=0)])
        return values

    def basis_at(self, time: np.ndarray) -> SeriesBasis:
        """The basis functions and their derivatives at (n,) times, s."""
        return SeriesBasis(time, np.stack([self.functions(time, k) for k in range(3)]))

    def low_harmonics_projection(self, harmonics: int) -> np.ndarray:
        """(size, size) matrix that projects coefficients onto the first `harmonics` harmonics and keeps the centre."""
        kept = np.zeros((self.coefficient_count, self.coefficient_count))
        kept[0, 0] = 1.0
        h, m = np.arange(1.0, self.harmonics + 1), self.harmonics - 1
        for power, free, rows in zip((1, 2), self._free, (slice(1, m + 1), slice(m + 1, None)), strict=True):
            low = np.zeros((self.harmonics, harmonics - 1))
            low[:harmonics] = null_space((h**power)[None, :harmonics])
            basis, _ = np.linalg.qr(np.linalg.pinv(free) @ low)
            kept[rows, rows] = basis @ basis.T
        return kept
