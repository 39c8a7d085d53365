"""How people record a pendulum: by video, encoder, potentiometer, gyro or load cell, swinging freely or driven.

Rates, noise, steps and faults are drawn from what real recordings have; see `imperfect_pendulum`. A run is made in
three steps: the true motion (`ideal`), what a sensor with faults stores of it (`recorded_run`),
a user's recording (`run_of`).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from armdyn.recording.units import KnownQuantity
from armdyn.run import Channel, Run

from . import coloured
from .dry_swing import G, Motion, Pendulum, Push, reading, swing
from .output_error import Record

FRICTIONS = ("pivot_viscous_friction", "pivot_coulomb_friction", "quadratic_drag", "pivot_load_friction")
ANGLE = ("angle_offset", "angle_gain", "angle_skew", "angle_distortion")
GRIPPER = ("gripper_scale", "gripper_lag")


@dataclass(frozen=True)
class Sensor:
    """What stands between a motion and its samples."""

    channel: str  # of the contract
    rate: float  # Hz
    white: float  # std of one sample, SI
    correlation: float = 0.0  # of the noise from sample to sample
    quantum: float = 0.0  # steps of the stored value; 0 where they are fine
    clusters: float = 0.0  # spells per minute of three times the noise, as of a tracker that nearly lost its marker
    lost: float = 0.0  # share of samples that are missing, in clumps
    jitter: float = 0.0  # of the stamps, as a share of their interval; a tenth of it is not written down
    slips: float = 0.0  # counts lost per minute, each a step of the mean by one quantum

    @property
    def std(self) -> float:
        """Of one sample, faults not counted."""
        return float(np.hypot(self.white, self.quantum / np.sqrt(12.0)))


@dataclass(frozen=True)
class Plan:
    """How one run is made: a release from an amplitude, or a drive to one."""

    role: str  # ``"run"``, ``"held out"`` or ``"exam"``
    driven: bool  # whether the gripper moves
    amplitude: float  # rad
    duration: float  # s


@dataclass(frozen=True)
class Kind:
    """A way to record a pendulum."""

    sensor: Callable[[np.random.Generator], Sensor]  # of the angle, the rate or the force
    plans: Callable[[np.random.Generator], list[Plan]]  # of a whole set of runs
    effects: tuple[str, ...]  # that may be hidden
    length: tuple[float, float] = (0.1, 1.5)  # range, m


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
_UNITS = {"swing_angle": "rad", "swing_rate": "rad/s", "load_force": "N"}


def ideal(rng: np.random.Generator, pendulum: Pendulum, sensor: Sensor, plan: Plan, k: int) -> Record | None:
    """A run without noise; None where a drive swings the load too far."""
    interval = 1.0 / sensor.rate
    time = np.arange(0.0, plan.duration, interval)
    time[1:] += sensor.jitter * interval * rng.uniform(-1.0, 1.0, len(time) - 1)
    push, start = Push(), (plan.amplitude * float(rng.choice([-1.0, 1.0])), 0.0)
    if plan.driven:
        start = (0.005 * rng.normal(), 0.01 * rng.normal())
        shape = _shape(rng, pendulum, plan.duration)
        scale = 0.03
        for _ in range(4):
            push = Push(_scaled(shape, scale))
            reached = float(np.max(np.abs(swing(pendulum, start, push, time).angle)))
            scale *= float(np.clip(plan.amplitude / reached, 0.2, 5.0))
        travel = np.max(np.abs(push.gripper(time)[0]))
        if not 0.5 * plan.amplitude < reached < 1.5 * plan.amplitude or not 2e-3 < travel < 0.6:
            return None
    motion = reading(pendulum.effects, sensor.channel, swing(pendulum, start, push, time))
    label = f"{plan.role.replace(' ', '_')}_{k}.csv"
    return Record(label, sensor.channel, time, motion, motion, start, push, sensor.std)


def _shape(rng: np.random.Generator, pendulum: Pendulum, duration: float) -> Motion:
    """A multisine, a chirp or a sine near the resonance, from rest and back to rest; x, v, a of about 1 m."""
    w0, kind = 2 * np.pi / pendulum.period, rng.integers(3)
    end = duration * float(rng.choice([0.7, 1.0]))
    ramp = min(1.5 * pendulum.period, 0.2 * duration)
    if kind == 0:
        w, sizes_, phases = w0 * rng.uniform(0.3, 1.6, 4), rng.uniform(0.3, 1.0, 4), rng.uniform(0, 2 * np.pi, 4)
    elif kind == 1:
        w, sizes_, phases = w0 * rng.uniform(0.9, 1.1, 1), np.ones(1), np.zeros(1)
    low, high = w0 * rng.uniform(0.3, 0.6), w0 * rng.uniform(1.4, 2.0)

    def carrier(t: np.ndarray) -> np.ndarray:
        if kind == 2:
            phase, rate = low * t + (high - low) / (2 * duration) * t**2, low + (high - low) / duration * t
            sine, cosine = np.sin(phase), np.cos(phase)
            return np.array([sine, rate * cosine, (high - low) / duration * cosine - rate**2 * sine])
        phase = np.multiply.outer(w, t) + phases[:, None]
        return np.array([sizes_ @ np.sin(phase), (sizes_ * w) @ np.cos(phase), -(sizes_ * w**2) @ np.sin(phase)])

    def window(t: np.ndarray) -> np.ndarray:
        up, down = (np.clip(s / ramp, 0.0, 1.0) for s in (t, end - t))
        (a, da, dda), (b, db, ddb) = (
            (
                u**4 * (35 - 84 * u + 70 * u**2 - 20 * u**3),
                140 * u**3 * (1 - u) ** 3 / ramp,
                420 * u**2 * (1 - u) ** 2 * (1 - 2 * u) / ramp**2,
            )
            for u in (up, down)
        )
        return np.array([a * b, da * b - a * db, dda * b - 2 * da * db + a * ddb])

    def motion(t: np.ndarray) -> np.ndarray:
        (x, v, a), (w_, dw, ddw) = carrier(t), window(t)
        return np.array([w_ * x, dw * x + w_ * v, ddw * x + 2 * dw * v + w_ * a])

    return motion


def _scaled(shape: Motion, scale: float) -> Motion:
    return lambda t: scale * shape(t)


def recorded_run(
    rng: np.random.Generator,
    pendulum: Pendulum,
    background: Mapping[str, float],
    ideal: Record,
    plan: Plan,
    sensor: Sensor,
    clean: bool,
) -> Record:
    """A run as the sensor stores it."""
    time = ideal.time
    if clean:
        noise = sensor.white * rng.normal(size=len(time))
        return replace(ideal, value=ideal.clean + noise, noise=float(np.sqrt(np.mean(noise**2))))
    real = replace(pendulum, effects={**background, **pendulum.effects})
    push = ideal.push
    if rng.uniform() < 0.5:
        push = replace(push, shake=_shake(rng, pendulum, ideal, sensor))
    if not plan.driven and plan.role != "exam" and rng.uniform() < 0.4:
        accelerates = rng.uniform(0.02, 0.1) * G / pendulum.length * min(plan.amplitude, 1.0)
        push = replace(push, hand=(accelerates * float(rng.choice([-1.0, 1.0])), rng.uniform(0.1, 0.3)))
    seen = time.copy()
    if sensor.jitter:  # frames are exposed a little before or after their stamp
        seen[1:-1] += 0.1 * sensor.jitter / sensor.rate * rng.normal(size=len(time) - 2)
    stamped = reading(real.effects, sensor.channel, swing(real, ideal.start, push, time))
    true = reading(real.effects, sensor.channel, swing(real, ideal.start, push, seen)) if sensor.jitter else stamped
    noise = coloured(rng.normal(size=len(time)), sensor.correlation)
    minutes = time[-1] / 60.0
    for begin in rng.uniform(0.0, time[-1], rng.poisson(sensor.clusters * minutes)):
        noise[(time >= begin) & (time < begin + rng.uniform(0.2, 1.0))] *= 3.0
    value = true + sensor.white * noise
    if sensor.quantum:
        value = sensor.quantum * np.round(value / sensor.quantum)
    if plan.role != "exam":
        for begin in rng.uniform(0.0, time[-1], rng.poisson(sensor.slips * minutes)):
            value[time >= begin] += sensor.quantum * rng.choice([-1, 1])
    if sensor.lost:
        count = rng.poisson(0.3 * sensor.lost * len(time))
        for begin in rng.integers(1, len(time) - 1, count):
            value[begin : min(begin + rng.geometric(0.3), len(time) - 1)] = np.nan
    return replace(ideal, value=value, noise=float(np.sqrt(np.nanmean((value - stamped) ** 2))))


def _shake(rng: np.random.Generator, pendulum: Pendulum, ideal: Record, sensor: Sensor) -> Motion:
    """A pivot that gives way: a sine beside the resonance, of an effect below the noise."""
    w, phase = 2 * np.pi / pendulum.period * rng.uniform(1.4, 3.5), rng.uniform(0.0, 2 * np.pi)

    def motion(t: np.ndarray, size: float = 1e-4) -> np.ndarray:
        sine, cosine = np.sin(w * t + phase), np.cos(w * t + phase)
        return size * np.array([sine, w * cosine, -(w**2) * sine])

    moved = swing(pendulum, ideal.start, replace(ideal.push, shake=motion), ideal.time)
    does = np.sqrt(np.mean((reading(pendulum.effects, sensor.channel, moved) - ideal.clean) ** 2))
    size = min(5e-4, 1e-4 * rng.uniform(0.2, 0.8) * sensor.std / max(does, 1e-12))
    return lambda t: motion(t, size)


def run_of(rng: np.random.Generator, record: Record, plan: Plan, sensor: Sensor, mass: float, clean: bool) -> Run:
    """The recording as a user has it."""
    kept = np.isfinite(record.value)
    channels = {sensor.channel: Channel(record.time[kept], record.value[kept], _UNITS[sensor.channel])}
    stated = {sensor.channel: sensor.std} if clean or rng.uniform() < 0.7 else {}
    if plan.driven:
        assert record.push.gripper is not None
        rate = max(sensor.rate, 100.0)
        time = np.arange(0.0, record.time[-1] + 1.0 / rate, 1.0 / rate)
        x, noise = record.push.gripper(time)[0], 0.0 if clean else float(rng.uniform(2e-5, 2e-4))
        channels["gripper_x"] = Channel(time, x + noise * rng.normal(size=len(time)), "m")
        if stated:
            stated["gripper_x"] = noise
    known = {}
    if sensor.channel == "load_force":
        known["mass"] = KnownQuantity(mass, 0.005 * mass, "kg")
    return Run(record.name, channels, known, stated)
