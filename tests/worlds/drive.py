"""What drives and sensors do beside moving rigid bodies: small errors of every joint, and effects that are hidden.

Sizes of the small errors follow a joint's *typical torque*, the root mean square of what its rigid bodies ask of it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy.signal import butter, filtfilt

FRICTION = (0.01, 0.015)  # viscous (at 1 rad/s) and Coulomb friction each, of the typical torque
DRIFT = 0.2  # largest share by which a joint's background friction differs between runs
COGGING = (0.01, 0.02)  # amplitude, of the typical torque
COGS = (8, 30)  # periods of the cogging per turn of the joint
DEFLECTION = (0.004, 0.015)  # of the joint's spring under the effort limit, rad
SMOOTHING = (5.0, 15.0)  # cut-off of the drive's zero-phase low-pass, Hz
LATENESS = (0.001, 0.005)  # of the torque's samples, s
NOISE = (0.001, 0.003)
"""Standard deviation of the torque's noise, of the joint's effort limit; 0.05 to 0.15 N m where that is 50 N m."""
ROUNDING = 0.1  # of that noise, what comes after the drive's low-pass
PRESLIDING = 0.003  # speed below which friction fades, rad/s: the joint's parts do not slide yet
HIDDEN_DRIFT = 0.05  # largest share by which a hidden friction differs between runs


@dataclass(frozen=True)
class Imperfections:
    """Of the joints' drives and sensors; all (nj,) where not a single number."""

    viscous: np.ndarray  # N m s/rad
    coulomb: np.ndarray  # N m
    cogging: np.ndarray  # amplitude, N m
    cogs: np.ndarray  # per turn
    phase: np.ndarray  # of the cogging, rad
    compliance: np.ndarray  # of the joint's spring between motor and link, rad/(N m)
    smoothing: float  # cut-off of the drive's low-pass of its torque, Hz; infinite for none
    late: float  # how late torques are stamped, s
    noise: np.ndarray  # of the torque before that low-pass, N m
    position_noise: float  # of the motor's encoder, rad
    presliding: float = PRESLIDING  # speed below which friction fades, rad/s

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


class Lump(NamedTuple):
    """A mass on a link: kg, (3,) m in the frame of the joint that moves it, and kg m^2 about any axis."""

    mass: float
    place: tuple[float, float, float]
    inertia: float = 0.0


class JointMotion(NamedTuple):
    """(n,) of a joint's motor: rad, rad/s, rad/s^2, the links' load, N m, and the sign of v as friction has it."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    load: np.ndarray
    way: np.ndarray


LAWS: Mapping[str, Callable[[Mapping[str, float], JointMotion], np.ndarray]] = {
    "joint_viscous_friction": lambda x, at: x["coefficient"] * at.v,
    "joint_coulomb_friction": lambda x, at: x["torque"] * at.way,
    "joint_asymmetric_friction": lambda x, at: np.where(at.v > 0.0, x["positive"], x["negative"]) * at.way,
    "joint_stribeck_friction": lambda x, at: x["torque"] * np.exp(-((at.v / x["speed"]) ** 2)) * at.way,
    "joint_load_friction": lambda x, at: x["coefficient"] * np.abs(at.load) * at.way,
    "rotor_inertia": lambda x, at: x["inertia"] * at.a,
    "gravity_spring": lambda x, at: x["sine"] * np.sin(at.q) + x["cosine"] * np.cos(at.q),
    "joint_spring": lambda x, at: x["stiffness"] * (at.q - x["rest"]),
}
"""(n,) N m that an effect adds to the drive of its joint."""
SMALL: Mapping[str, Mapping[str, float]] = {
    "joint_viscous_friction": {"coefficient": 1e-6}, "joint_coulomb_friction": {"torque": 1e-6},
    "joint_asymmetric_friction": {"positive": 1e-6, "negative": 1e-6},
    "joint_stribeck_friction": {"torque": 1e-6, "speed": 0.1}, "joint_load_friction": {"coefficient": 1e-6},
    "rotor_inertia": {"inertia": 1e-6}, "torque_offset": {"torque": 1e-6}, "torque_gain": {"error": 0.0},
    "torque_delay": {"time": 1e-6}, "gravity_spring": {"sine": 1e-6, "cosine": 1e-6},
    "joint_spring": {"stiffness": 1.0, "rest": 1e-6},
}  # fmt: skip
"""Values that do next to nothing, by effect on one joint."""
COUNT = {effect: len(values) for effect, values in SMALL.items()} | {"payload": 4, "link_inertia": 10}
"""Numbers that describe an effect on one joint."""


@dataclass(frozen=True)
class Hidden:
    """One effect of armdyn's catalogue on one joint."""

    effect: str  # its name there
    joint: str  # on which
    # of its parameters by their names there; of a payload or a link's inertia those of a lump: ``mass`` [kg], ``x``,
    # ``y``, ``z`` [m], and ``about`` [kg m^2] where it is not a point
    values: Mapping[str, float] = field(hash=False)

    @property
    def lump(self) -> Lump | None:
        """On the link that the joint moves."""
        if self.effect not in ("payload", "link_inertia"):
            return None
        mass, x, y, z = (self.values[name] for name in ("mass", "x", "y", "z"))
        return Lump(mass, (x, y, z), self.values.get("about", 0.0))

    def torque(self, at: JointMotion) -> np.ndarray | float:
        """(n,) N m that it adds to the drive of its joint."""
        return LAWS[self.effect](self.values, at) if self.effect in LAWS else 0.0

    def reading(self, effect: str) -> float:
        """Of an error of the reading, its only value; 0 where it is another effect."""
        return next(iter(self.values.values())) if self.effect == effect else 0.0

    def changed(self, **more: float) -> "Hidden":
        """With some of its values larger by so much."""
        return replace(self, values={name: value + more.get(name, 0.0) for name, value in self.values.items()})

    def times(self, factor: float) -> "Hidden":
        """With all of its values so many times as large."""
        return replace(self, values={name: factor * value for name, value in self.values.items()})

    def drifted(self, rng: np.random.Generator) -> "Hidden":
        """As in another run: friction is never twice the same."""
        viscous, coulomb = 1.0 + HIDDEN_DRIFT * rng.uniform(-1.0, 1.0, 2)
        factors = {"joint_viscous_friction": float(viscous), "joint_coulomb_friction": float(coulomb)}
        return self.times(factors[self.effect]) if self.effect in factors else self


def on_link(effect: str, joint: str, lump: Lump) -> Hidden:
    """A lump as an effect."""
    values = dict(zip(("mass", "x", "y", "z"), (lump.mass, *lump.place), strict=True))
    return Hidden(effect, joint, values | ({"about": lump.inertia} if lump.inertia else {}))


def sliding(v: np.ndarray) -> np.ndarray:
    """Sign of the velocities [rad/s], fading below `PRESLIDING`."""
    return np.clip(v / PRESLIDING, -1.0, 1.0)
