r"""Periodic, band-limited motions of joints that start and end at rest.

A finite Fourier series per joint (Swevers, Ganseman, Tükel, De Schutter & Van Brussel, IEEE T-RA 13(5), 1997),

    q(t) = c + \sum_{h=1}^{H} a_h \sin(h w t) + b_h \cos(h w t),   w = 2 \pi / P,

of which \sum h a_h = 0 and \sum h^2 b_h = 0 make velocity and acceleration vanish where a period begins and ends: the
motion joins a rest with a continuous acceleration.
"""

from dataclasses import dataclass
from functools import cached_property
from math import ceil

import numpy as np
from scipy.linalg import null_space

BAND = 1.0
"""Hz, the highest frequency of a position: arms follow it, and it is far below the 10 Hz at which their links bend."""
FEWEST_HARMONICS = 4
"""Two of each kind are left where both conditions of rest are met; a very short motion then leaves the band."""
LONGEST_PERIOD = 20.0
"""s; a longer motion repeats one of at most this length, so that the number of unknowns stays the same."""


@dataclass(frozen=True, eq=False)
class Motions:
    """Positions and derivatives of all joints at some times; all (n, nj).

    Attributes:
        q: rad or m.
        v: per s.
        a: per s^2.
    """

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray


@dataclass(frozen=True)
class Series:
    """The functions of time of which a joint's position is made.

    Attributes:
        seconds: of the whole motion.
    """

    seconds: float

    @property
    def repeats(self) -> int:
        """How often the period is run through."""
        return ceil(self.seconds / LONGEST_PERIOD - 1e-9)

    @property
    def period(self) -> float:
        """P, s."""
        return self.seconds / self.repeats

    @property
    def harmonics(self) -> int:
        """H."""
        return max(FEWEST_HARMONICS, int(BAND * self.period + 1e-9))

    @property
    def size(self) -> int:
        """Coefficients of a joint: the centre, H - 1 of the sines, H - 1 of the cosines."""
        return 2 * self.harmonics - 1

    @cached_property
    def _free(self) -> tuple[np.ndarray, np.ndarray]:
        """(H, H - 1) sines and cosines that meet the conditions of rest; low frequencies come with large amplitudes."""
        h = np.arange(1.0, self.harmonics + 1)
        found = []
        for power in (1, 2):
            weight = 1.0 / h  # amplitudes of a motion whose speed is alike in all frequencies
            free = null_space((weight * h**power)[None])
            found.append(weight[:, None] * free)
        return found[0], found[1]

    def functions(self, time: np.ndarray, derivative: int = 0) -> np.ndarray:
        """(n, size) values at (n,) s of what the coefficients multiply, or of a derivative of it."""
        h = np.arange(1, self.harmonics + 1)
        w = 2.0 * np.pi * h / self.period
        phase = np.outer(time, w) + 0.5 * np.pi * derivative
        sines, cosines = self._free
        scale = w**derivative
        centre = np.full((len(time), 1), float(derivative == 0))
        return np.hstack([centre, (scale * np.sin(phase)) @ sines, (scale * np.cos(phase)) @ cosines])

    def motion(self, coefficients: np.ndarray, time: np.ndarray) -> Motions:
        """The motion at (n,) s of (nj, size) coefficients, rad or m."""
        return Motions(*(self.functions(time, k) @ coefficients.T for k in range(3)))

    def low(self, harmonics: int) -> np.ndarray:
        """(size, size) projection of coefficients onto series with so few harmonics; the centre stays."""
        kept = np.zeros((self.size, self.size))
        kept[0, 0] = 1.0
        h, m = np.arange(1.0, self.harmonics + 1), self.harmonics - 1
        for power, free, rows in zip((1, 2), self._free, (slice(1, m + 1), slice(m + 1, None)), strict=True):
            low = np.zeros((self.harmonics, harmonics - 1))
            low[:harmonics] = null_space((h**power)[None, :harmonics])
            inside = np.linalg.pinv(free) @ low
            basis, _ = np.linalg.qr(inside)
            kept[rows, rows] = basis @ basis.T
        return kept
