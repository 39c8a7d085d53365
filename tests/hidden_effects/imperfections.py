"""What is wrong with a real arm everywhere and always, a little: none of it is the effect that is looked for.

Sizes follow a joint's *typical torque*, the root mean square of what its rigid bodies ask of it.
"""

from dataclasses import dataclass, replace

import mujoco
import numpy as np
from scipy.signal import butter, filtfilt

LINK_ERROR = (0.03, 0.08)
"""Share by which a link's mass, extents and centre are off; the centre's in distances of the link's size."""
FRICTION = (0.01, 0.015)
"""Viscous (at 1 rad/s) and Coulomb friction each, of the typical torque."""
DRIFT = 0.2
"""Largest share by which a joint's background friction differs between runs."""
COGGING = (0.01, 0.02)
"""Amplitude, of the typical torque."""
COGS = (8, 30)
"""Periods of the cogging per turn of the joint."""
DEFLECTION = (0.004, 0.015)
"""Of the joint's spring under the effort limit, rad."""
SMOOTHING = (5.0, 15.0)
"""Cut-off of the drive's zero-phase low-pass, Hz."""
LATENESS = (0.001, 0.005)
"""Of the torque's samples, s."""
NOISE = (0.001, 0.003)
"""Standard deviation of the torque's noise, of the joint's effort limit; 0.05 to 0.15 N m where that is 50 N m."""
ROUNDING = 0.1
"""Of that noise, what comes after the drive's low-pass."""
PRESLIDING = 0.003
"""Speed below which friction fades, rad/s: the joint's parts do not slide yet."""


@dataclass(frozen=True)
class Links:
    """Inertias of every body of a MuJoCo model: (nb,) kg, (nb, 3) m and (nb, 3) kg m^2 about its principal axes."""

    mass: np.ndarray
    centre: np.ndarray
    inertia: np.ndarray

    @classmethod
    def of(cls, model: mujoco.MjModel) -> "Links":
        """As they are."""
        return cls(model.body_mass.copy(), model.body_ipos.copy(), model.body_inertia.copy())

    def into(self, model: mujoco.MjModel) -> None:
        """Give them to the model."""
        model.body_mass[:], model.body_ipos[:], model.body_inertia[:] = self.mass, self.centre, self.inertia

    def off(self, rng: np.random.Generator) -> "Links":
        """Every body off by `LINK_ERROR`: its mass, its extent along each principal axis, its centre; still a body."""
        count = len(self.mass)
        mass = self.mass * (1.0 + _off(rng, count))
        extents = 0.5 * self.inertia.sum(axis=1, keepdims=True) - self.inertia  # integrals of x^2, y^2, z^2 over mass
        extents = extents * (1.0 + _off(rng, count))[:, None] * (1.0 + 0.5 * _off(rng, (count, 3)))
        has_mass = self.mass > 0.0
        gyration = np.sqrt(0.5 * self.inertia.sum(axis=1) / np.where(has_mass, self.mass, 1.0))
        size = np.where(has_mass, np.maximum(np.linalg.norm(self.centre, axis=1), gyration), 0.0)
        way = rng.standard_normal((count, 3))
        way = way / np.linalg.norm(way, axis=1, keepdims=True)
        centre = self.centre + way * (size * rng.uniform(*LINK_ERROR, count))[:, None]
        return Links(mass, centre, extents.sum(axis=1, keepdims=True) - extents)


def _off(rng: np.random.Generator, shape: int | tuple[int, ...]) -> np.ndarray:
    return rng.choice([-1.0, 1.0], shape) * rng.uniform(*LINK_ERROR, shape)


@dataclass(frozen=True)
class Imperfections:
    """Of the joints' drives and sensors; all (nj,) where not a single number.

    Attributes:
        viscous: N m s/rad.
        coulomb: N m.
        cogging: amplitude, N m.
        cogs: per turn.
        phase: of the cogging, rad.
        compliance: of the joint's spring between motor and link, rad/(N m).
        smoothing: cut-off of the drive's low-pass of its torque, Hz; infinite for none.
        late: how late torques are stamped, s.
        noise: of the torque before that low-pass, N m.
        position_noise: of the motor's encoder, rad.
        presliding: speed below which friction fades, rad/s.
    """

    viscous: np.ndarray
    coulomb: np.ndarray
    cogging: np.ndarray
    cogs: np.ndarray
    phase: np.ndarray
    compliance: np.ndarray
    smoothing: float
    late: float
    noise: np.ndarray
    position_noise: float
    presliding: float = PRESLIDING

    @classmethod
    def none(cls, count: int) -> "Imperfections":
        """A perfect drive with `count` joints."""
        zero = np.zeros(count)
        return cls(zero, zero, zero, zero, zero, zero, np.inf, 0.0, zero, 0.0)

    @classmethod
    def drawn(
        cls, rng: np.random.Generator, typical: np.ndarray, effort: np.ndarray, position_noise: float
    ) -> "Imperfections":
        """For joints with (nj,) typical torques and effort limits [N m]; torques are either smoothed or late."""
        count = len(typical)
        smoothed = rng.random() < 0.5
        cutoff, late = rng.uniform(*SMOOTHING), rng.uniform(*LATENESS)
        return cls(
            viscous=typical * rng.uniform(*FRICTION, count),
            coulomb=typical * rng.uniform(*FRICTION, count),
            cogging=typical * rng.uniform(*COGGING, count),
            cogs=rng.integers(COGS[0], COGS[1], count, endpoint=True).astype(float),
            phase=rng.uniform(0.0, 2.0 * np.pi, count),
            compliance=rng.uniform(*DEFLECTION, count) / effort,
            smoothing=cutoff if smoothed else np.inf,
            late=0.0 if smoothed else late,
            noise=effort * rng.uniform(*NOISE, count),
            position_noise=position_noise,
        )

    def drifted(self, rng: np.random.Generator) -> "Imperfections":
        """As in another run: with other friction."""
        count = len(self.viscous)
        viscous, coulomb = (1.0 + DRIFT * rng.uniform(-1.0, 1.0, (2, count))) * (self.viscous, self.coulomb)
        return replace(self, viscous=viscous, coulomb=coulomb)

    def torque(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(n, nj) N m that the drive gives besides what moves the link, at motor positions and velocities (n, nj)."""
        return self.viscous * v + self.coulomb * self.sliding(v) + self.cogging * np.sin(self.cogs * q + self.phase)

    def sliding(self, v: np.ndarray) -> np.ndarray:
        """Sign of the velocities [rad/s], fading below `presliding`."""
        return np.clip(v / self.presliding, -1.0, 1.0) if self.presliding > 0.0 else np.sign(v)

    def read(self, torque: np.ndarray, rate: float, noise: np.ndarray | None = None) -> np.ndarray:
        """(n, nj) what is recorded of torques [N m] at `rate` [Hz], with standard normal `noise` (2, n, nj)."""
        before, after = (0.0, 0.0) if noise is None else (self.noise * noise[0], ROUNDING * self.noise * noise[1])
        reading = torque + before
        if np.isfinite(self.smoothing):
            reading = filtfilt(*butter(2, self.smoothing / (0.5 * rate)), reading, axis=0)
        return reading + after


def sliding(v: np.ndarray) -> np.ndarray:
    """Sign of the velocities [rad/s], fading below `PRESLIDING`."""
    return np.clip(v / PRESLIDING, -1.0, 1.0)
