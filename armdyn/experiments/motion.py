r"""Motions of the gripper that an experiment may make: windowed harmonics from rest to rest, within limits.

    x(t) = w(t) sum_i [a_i sin(2 pi f_i t) + b_i cos(2 pi f_i t)],      w = 0, w' = 0, w'' = 0 at both ends,

so that position, velocity and acceleration are exact, linear in the coefficients, and nothing jumps where the motion
begins and ends.
"""

from dataclasses import dataclass

import numpy as np

from armdyn.errors import InputError
from armdyn.pendulum.path import GripperPath

STEP = 0.01
"""s between the nodes of a motion."""
RAMP = 0.8
"""s in which the window opens and closes."""
FASTEST = 2.5
"""Hz; within 2 m/s^2 a faster motion is smaller than 8 mm, and hardly swings the load."""
MOST_FREQUENCIES = 24
SHORTEST = 3.0
"""s; a shorter motion holds no swing of a load on a usual string."""
LONGEST = 120.0
"""s."""
FEW = (2, 6)
"""Frequencies that a random motion has, at least and at most."""


@dataclass(frozen=True)
class Limits:
    """What a motion may need.

    Attributes:
        travel: largest distance of the gripper from its start, m.
        speed: of the gripper, m/s.
        acceleration: of the gripper, m/s^2.
        swing: largest angle of the load, rad.
    """

    travel: float = 0.15
    speed: float = 0.9
    acceleration: float = 2.0
    swing: float = 1.0

    def __post_init__(self) -> None:
        for name in ("travel", "speed", "acceleration", "swing"):
            if not getattr(self, name) > 0.0:
                raise InputError(f"limit of the {name} {getattr(self, name):g}: give a positive number")

    def vector(self) -> np.ndarray:
        """(3,) of position, velocity and acceleration."""
        return np.array([self.travel, self.speed, self.acceleration])


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion of the gripper from rest to rest.

    Attributes:
        time: (K,) s from 0.
        along: (3, K) position m, velocity m/s, acceleration m/s^2.
    """

    time: np.ndarray
    along: np.ndarray

    @property
    def step(self) -> float:
        """S between the nodes."""
        return float(self.time[1] - self.time[0])

    @property
    def path(self) -> GripperPath:
        """As the input of a simulation."""
        return GripperPath(0.0, self.step, *self.along)

    @property
    def seconds(self) -> float:
        """How long it takes."""
        return float(self.time[-1])

    @property
    def peaks(self) -> np.ndarray:
        """(3,) largest position, speed and acceleration."""
        return np.asarray(np.abs(self.along).max(axis=1))

    @property
    def effort(self) -> float:
        """Integral of the squared acceleration, m^2/s^3: what SAC and the planner call energy."""
        return float(np.sum(self.along[2] ** 2) * self.step)


class Harmonics:
    """All motions of one duration.

    Args:
        seconds: duration.
        limits: which scale the coefficients: each one alone at 1 reaches a limit.
        step: s between the nodes.

    Attributes:
        time: (K,) s.
        basis: (3, K, n) motion for each coefficient.
    """

    def __init__(self, seconds: float, limits: Limits, step: float = STEP) -> None:
        if not SHORTEST <= seconds <= LONGEST:
            raise InputError(f"a motion of {seconds:g} s: give {SHORTEST:g} to {LONGEST:g} s")
        self.limits, self.step = limits, step
        self.time = step * np.arange(round(seconds / step) + 1)
        t, T = self.time, self.time[-1]
        count = min(int(FASTEST * T), MOST_FREQUENCIES)
        self.frequencies = (
            np.linspace(1.0 / T, FASTEST, count) if count < int(FASTEST * T) else np.arange(1, count + 1) / T
        )
        window = _window(t, T)
        waves = []
        for f in self.frequencies:
            p, w = 2 * np.pi * f * t, 2 * np.pi * f
            waves.append((np.sin(p), w * np.cos(p), -(w**2) * np.sin(p)))
            waves.append((np.cos(p), -w * np.sin(p), -(w**2) * np.cos(p)))
        columns = []
        for wave in waves:
            x = window[0] * wave[0]
            v = window[1] * wave[0] + window[0] * wave[1]
            a = window[2] * wave[0] + 2 * window[1] * wave[1] + window[0] * wave[2]
            along = np.array([x, v, a])
            columns.append(along / np.max(np.abs(along).max(axis=1) / limits.vector()))
        self.basis = np.stack(columns, axis=-1)

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return int(self.basis.shape[-1])

    def motion(self, coefficients: np.ndarray) -> Motion:
        """The motion of (n,) coefficients."""
        return Motion(self.time, self.basis @ coefficients)

    def within(self, coefficients: np.ndarray) -> np.ndarray:
        """(n,) the coefficients, made smaller where the motion passes a limit of the gripper."""
        excess = float(np.max(self.motion(coefficients).peaks / self.limits.vector()))
        return coefficients / max(excess, 1.0)

    def random(self, rng: np.random.Generator) -> np.ndarray:
        """(n,) coefficients of a few harmonics that together just reach a limit of the gripper."""
        waves = np.zeros((len(self.frequencies), 2))
        some = rng.choice(len(waves), min(int(rng.integers(FEW[0], FEW[1] + 1)), len(waves)), replace=False)
        waves[some] = rng.standard_normal((len(some), 2))
        c = waves.ravel()
        return np.asarray(c / float(np.max(self.motion(c).peaks / self.limits.vector())))

    def excess(self, coefficients: np.ndarray) -> tuple[float, np.ndarray]:
        """Mean squared share by which a motion is beyond its limits, summed over them, and its gradient (n,)."""
        along = self.basis @ coefficients
        scaled = along / self.limits.vector()[:, None]
        beyond = np.maximum(np.abs(scaled) - 1.0, 0.0)
        slope = 2.0 * beyond * np.sign(scaled) / self.limits.vector()[:, None] / len(self.time)
        return float(np.sum(beyond**2)) / len(self.time), np.tensordot(slope, self.basis, axes=([0, 1], [0, 1]))


def _window(t: np.ndarray, T: float) -> np.ndarray:
    """(3, K) window and its first two derivatives: 10 u^3 - 15 u^4 + 6 u^5 at either end (Flash & Hogan 1985)."""
    u = np.clip(np.minimum(t, T - t) / RAMP, 0.0, 1.0)
    way = np.where(t < T / 2, 1.0, -1.0) / RAMP
    value = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    slope = 30.0 * u**2 * (1.0 - u) ** 2 * way
    bend = 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) * way**2
    return np.array([value, slope, bend])
