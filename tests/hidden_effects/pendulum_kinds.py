"""How people record a pendulum: by video, encoder, potentiometer, gyro or load cell, swinging freely or driven.

Rates, noise, steps and faults are drawn from what real recordings have; see `imperfect_pendulum`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

FRICTIONS = ("pivot_viscous_friction", "pivot_coulomb_friction", "quadratic_drag", "pivot_load_friction")
ANGLE = ("angle_offset", "angle_gain", "angle_skew", "angle_distortion")
GRIPPER = ("gripper_scale", "gripper_lag")


@dataclass(frozen=True)
class Sensor:
    """What stands between a motion and its samples.

    Attributes:
        channel: of the contract.
        rate: Hz.
        white: std of one sample, SI.
        correlation: of the noise from sample to sample.
        quantum: steps of the stored value; 0 where they are fine.
        clusters: spells per minute of three times the noise, as of a tracker that nearly lost its marker.
        lost: share of samples that are missing, in clumps.
        jitter: of the stamps, as a share of their interval; a tenth of it is not written down.
        slips: counts lost per minute, each a step of the mean by one quantum.
    """

    channel: str
    rate: float
    white: float
    correlation: float = 0.0
    quantum: float = 0.0
    clusters: float = 0.0
    lost: float = 0.0
    jitter: float = 0.0
    slips: float = 0.0

    @property
    def std(self) -> float:
        """Of one sample, faults not counted."""
        return float(np.hypot(self.white, self.quantum / np.sqrt(12.0)))


@dataclass(frozen=True)
class Plan:
    """How one run is made: a release from an amplitude, or a drive to one.

    Attributes:
        role: ``"run"``, ``"held out"`` or ``"exam"``.
        driven: whether the gripper moves.
        amplitude: rad.
        duration: s.
    """

    role: str
    driven: bool
    amplitude: float
    duration: float


@dataclass(frozen=True)
class Kind:
    """A way to record a pendulum.

    Attributes:
        sensor: of the angle, the rate or the force.
        plans: of a whole set of runs.
        effects: that may be hidden.
        length: range, m.
    """

    sensor: Callable[[np.random.Generator], Sensor]
    plans: Callable[[np.random.Generator], list[Plan]]
    effects: tuple[str, ...]
    length: tuple[float, float] = (0.1, 1.5)


def _video(rng: np.random.Generator) -> Sensor:
    pixel = 1.0 / rng.uniform(300.0, 900.0)  # the string's length in pixels
    return Sensor(
        "swing_angle", float(rng.choice([15, 20, 24, 25, 30, 60])), rng.uniform(0.7e-3, 4e-3), rng.uniform(0.2, 0.7),
        quantum=float(pixel * rng.choice([0.0, 1.0])), clusters=rng.uniform(0.0, 2.0), lost=rng.uniform(0.0, 0.03),
        jitter=float(rng.choice([0.0, 0.05])),
    )  # fmt: skip


def _encoder(rng: np.random.Generator) -> Sensor:
    quantum = 2 * np.pi / float(rng.choice([1000, 2000, 4000, 4096, 10_000, 40_000]))
    rate = float(rng.choice([20, 50, 100, 200, 500, 1000]))
    return Sensor("swing_angle", rate, 0.1 * quantum, quantum=quantum, slips=float(rng.choice([0.0, 0.0, 2.0])))


def _potentiometer(rng: np.random.Generator) -> Sensor:
    bits = float(rng.choice([10, 12, 16]))
    rate = float(rng.choice([50, 100, 250, 500]))
    return Sensor("swing_angle", rate, rng.uniform(0.7e-3, 3e-3), quantum=6.0 / 2**bits)


def _gyro(rng: np.random.Generator) -> Sensor:
    return Sensor("swing_rate", float(rng.choice([50, 100, 200])), rng.uniform(3e-3, 15e-3), rng.uniform(0.0, 0.3))


def _load_cell(rng: np.random.Generator) -> Sensor:
    return Sensor("load_force", 100.0, rng.uniform(2e-3, 4e-3))  # N per 0.1 kg


def _any_angle(rng: np.random.Generator) -> Sensor:
    return (_video, _encoder, _potentiometer)[rng.integers(3)](rng)


def _amplitude(rng: np.random.Generator) -> float:
    """Small, large or nearly upside down, rad."""
    low, high = ((0.2, 0.8), (0.8, 1.6), (1.6, 2.96))[rng.choice(3, p=[0.45, 0.35, 0.2])]
    return float(rng.uniform(low, high))


def _decays(shortest: float, longest: float, largest: float = 3.0) -> Callable[[np.random.Generator], list[Plan]]:
    def plans(rng: np.random.Generator) -> list[Plan]:
        amplitude = min(_amplitude(rng), largest)
        duration = np.exp(rng.uniform(np.log(shortest), np.log(longest)))
        return [
            Plan("run", False, amplitude, duration),
            Plan("held out", False, amplitude * rng.uniform(0.3, 0.6), 0.6 * duration),
            Plan("exam", False, amplitude * rng.uniform(0.6, 0.85), 0.6 * duration),
        ]

    return plans


def _large_and_small(rng: np.random.Generator) -> list[Plan]:
    large, small = rng.uniform(1.0, 2.9), rng.uniform(0.15, 0.4)
    return [
        Plan("run", False, large, rng.uniform(15.0, 60.0)), Plan("run", False, small, rng.uniform(10.0, 40.0)),
        Plan("held out", False, 0.6 * large, 20.0), Plan("exam", False, 0.8 * large, 20.0),
    ]  # fmt: skip


def _driven(rng: np.random.Generator) -> list[Plan]:
    several = [Plan("run", True, rng.uniform(0.15, 0.8), rng.uniform(12.0, 40.0)) for _ in range(rng.integers(1, 3))]
    largest = max(plan.amplitude for plan in several)
    return [
        *several, Plan("held out", True, 0.6 * largest, 15.0), Plan("exam", True, 0.85 * largest, 15.0),
    ]  # fmt: skip


def _decay_and_driven(rng: np.random.Generator) -> list[Plan]:
    swings = rng.uniform(0.3, 1.4)
    return [
        Plan("run", False, swings, rng.uniform(12.0, 50.0)), Plan("run", True, rng.uniform(0.2, 0.8), 25.0),
        Plan("held out", False, 0.5 * swings, 15.0), Plan("exam", True, rng.uniform(0.2, 0.8), 20.0),
    ]  # fmt: skip


FREE = (*FRICTIONS, "pivot_stiffness", *ANGLE, "string_creep")
MOVED = (*FRICTIONS, "linear_drag", "pivot_stiffness", *ANGLE, *GRIPPER)
KINDS: Mapping[str, Kind] = {
    "decay by encoder": Kind(_encoder, _decays(10.0, 60.0), FREE, (0.1, 0.8)),
    "decay by video": Kind(_video, _decays(15.0, 140.0), FREE, (0.3, 1.5)),
    "driven by encoder": Kind(_encoder, _driven, MOVED, (0.15, 0.8)),
    "decay by gyro": Kind(_gyro, _decays(10.0, 60.0, 1.2), (*FRICTIONS, "pivot_stiffness", "sensor_bias"), (0.2, 1.0)),
    "large and small": Kind(_any_angle, _large_and_small, FREE),
    "decay and driven": Kind(_any_angle, _decay_and_driven, MOVED, (0.15, 1.2)),
    "decay by potentiometer": Kind(_potentiometer, _decays(10.0, 60.0), FREE, (0.1, 1.0)),
    "force": Kind(_load_cell, _driven, ("pivot_viscous_friction", "pivot_coulomb_friction", "quadratic_drag",
                                        "linear_drag", *GRIPPER, "sensor_bias"), (0.25, 0.6)),
}  # fmt: skip
FITTED = ("decay by encoder", "driven by encoder", "large and small", "decay and driven")
"""Kinds whose motions `fits` have."""
