"""One run of a pendulum: its true motion, what a sensor with faults stores of it, and the recording that a user has."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from armdyn.recording.units import Known
from armdyn.run import Channel, Run

from .dry_swing import G, Motion, Pendulum, Push, reading, swing
from .output_error import Record
from .pendulum import correlated
from .pendulum_kinds import Plan, Sensor

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
    noise = correlated(len(time), sensor.correlation, rng)
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
        known["mass"] = Known(mass, 0.005 * mass, "kg")
    return Run(record.name, channels, known, stated)
