"""What users record: the situations in which a fit gets lost, on top of the equations in `pendulum`.

Each situation says how the gripper moves, how the load starts, what the sensors do to the samples, and what the user
wrote beside the recording. Nothing here comes from armdyn's models. Where only friction, drag or wind act on the load,
its equations are integrated in the angle, a hundred times faster than in space; a test holds one against the other.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import cos, sin, sqrt, tanh
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from armdyn.recording.units import KnownQuantity
from armdyn.run import Channel, Run

from . import pendulum

Motion = Callable[[np.ndarray | float], np.ndarray]
RAMP = 0.5
"""s in which a gripper that rested gets under way."""
USUAL_LENGTH, USUAL_MASS = 0.368, 0.08
"""m and kg of the load for which `pendulum.REALISTIC` says how large an effect is."""


IN_THE_ANGLE = {
    "pivot_viscous_friction", "pivot_coulomb_friction", "linear_drag", "quadratic_drag", "wind",
    "sensor_bias", "sensor_gain", "sensor_drift", "sensor_lag", "sensor_delay", "vertical_sensing_axis",
    "cross_axis_sensitivity", "sensor_nonlinearity", "angle_offset",
}  # fmt: skip
"""Effects that `swing` and `pendulum.sensor` have between them."""
STEP = 0.004
"""s, of the Runge-Kutta method in `swing`."""


@dataclass(frozen=True)
class Situation:
    """How a recording comes about.

    Attributes:
        gripper: ``"moves"`` from the first sample on; ``"rests"`` throughout, and has no channel; ``"late"`` after 3 s;
            ``"moving"`` is already under way at the first sample.
        amplitude: range of the angle at which the load is released, or swings where it is caught in mid-swing, rad.
        mid_swing: whether the first sample falls into any phase of the swing.
        duration: s.
        rate: of the samples, Hz.
        length: range, m.
        mass: range, kg.
        force_noise: of one sample, as a share of 3 mN per 0.1 kg.
        correlation: of the force noise from sample to sample.
        angle_noise: rad; None where there is no angle sensor.
        force: whether there is a load cell.
        jitter: of the stamps, as a share of their interval.
        gap: s that are lost in the middle.
        spikes: single samples per run that are wrong by 0.2 to 1 times the weight.
        clipped: reading at which the load cell's electronics end, in weights; None where they do not.
        bits: of the converter, over four times the weight; None where it is fine enough.
        stated: whether the noise stands beside the recording.
        weighed: whether mass and length do.
        masses: factors on the mass, one per run; each is weighed.
    """

    gripper: str = "moves"
    amplitude: tuple[float, float] = (0.0, 0.02)
    mid_swing: bool = False
    duration: float = 15.0
    rate: float = 100.0
    length: tuple[float, float] = (0.30, 0.45)
    mass: tuple[float, float] = (0.06, 0.12)
    force_noise: float = 1.0
    correlation: float = 0.0
    angle_noise: float | None = None
    force: bool = True
    jitter: float = 0.0
    gap: float = 0.0
    spikes: int = 0
    clipped: float | None = None
    bits: int | None = None
    stated: bool = True
    weighed: bool = True
    masses: tuple[float, ...] = (1.0, 1.0)


SITUATIONS: Mapping[str, Situation] = {
    "plain": Situation(),
    "pull_and_release": Situation(gripper="rests", amplitude=(0.25, 0.6), duration=20.0),
    "release_unweighed": Situation(gripper="rests", amplitude=(0.25, 0.6), duration=20.0, weighed=False),
    "release_2_rad": Situation(gripper="rests", amplitude=(1.8, 2.2)),
    "near_upright": Situation(amplitude=(2.7, 3.05), force=False, angle_noise=3e-3),
    "late_motion": Situation(gripper="late", amplitude=(0.3, 0.7)),
    "mid_swing": Situation(gripper="moving", amplitude=(0.3, 0.9), mid_swing=True),
    "gap_and_jitter": Situation(jitter=0.2, gap=2.0),
    "20_hz": Situation(rate=20.0),
    "large_swing": Situation(gripper="rests", amplitude=(1.1, 1.3), stated=False),
    "spikes": Situation(spikes=5),
    "clipped": Situation(clipped=1.02),
    "8_bit": Situation(bits=8, stated=False),
    "heavy": Situation(length=(1.9, 2.1), mass=(4.5, 5.5), amplitude=(0.1, 0.3)),
    "3_s": Situation(duration=3.0),
    "90_s": Situation(duration=90.0),
    "several_masses": Situation(masses=(0.6, 1.0, 1.6)),
    "noise_unstated": Situation(stated=False),
    "coloured": Situation(correlation=0.9),
}


@dataclass(frozen=True)
class Recorded:
    """Runs with the truth behind them.

    Attributes:
        runs: as a user has them.
        length: m.
        masses: of each run, kg.
        starts: angle and rate at the start of each run, rad and rad/s.
        noise: standard deviation of each run's force and angle, quantisation included.
    """

    runs: tuple[Run, ...]
    length: float
    masses: tuple[float, ...]
    starts: tuple[tuple[float, float], ...]
    noise: Mapping[str, float] = field(default_factory=dict)


def recorded(situation: Situation, hidden: Mapping[str, float], rng: np.random.Generator) -> Recorded:
    """Runs in a situation, with effects hidden in them."""
    length, mass = rng.uniform(*situation.length), rng.uniform(*situation.mass)
    measured = KnownQuantity(length + 1e-3 * rng.normal(), 1e-3, "m")
    runs, masses, starts, noise = [], [], [], {}
    for k, factor in enumerate(situation.masses):
        own = factor * mass
        if situation.weighed and len(set(situation.masses)) == 1 and k > 0:
            known = runs[0].known
        elif situation.weighed:
            known = {"mass": KnownQuantity(own * (1 + 0.005 * rng.normal()), 0.005 * own, "kg"), "length": measured}
        else:
            known = {}
        run, start, noise = _run(f"r{k}.csv", situation, hidden, length, own, known, rng)
        runs.append(run)
        masses.append(own)
        starts.append(start)
    return Recorded(tuple(runs), length, tuple(masses), tuple(starts), noise)


def realistic(effect: str, situation: Situation) -> dict[str, float]:
    """An effect in a size that does to this load what `pendulum.REALISTIC` does to the usual one."""
    length, mass = (float(np.mean(bounds)) for bounds in (situation.length, situation.mass))
    longer, heavier = length / USUAL_LENGTH, mass / USUAL_MASS
    grows = {
        "pivot_viscous_friction": heavier * longer**1.5, "pivot_coulomb_friction": heavier * longer,
        "linear_drag": heavier / longer**0.5, "quadratic_drag": heavier / longer, "sensor_bias": heavier,
        "sensor_drift": heavier, "wind": heavier,
    }  # fmt: skip
    return {effect: pendulum.REALISTIC[effect] * grows.get(effect, 1.0) if effect != "angle_offset" else 0.02}


def swing(setup: Any, motion: Motion, time: np.ndarray) -> dict[str, np.ndarray]:
    """True tension and angle at `time`, from the moments about the pivot; see `pendulum.simulate`."""
    h, m, length = setup.hidden, setup.mass, setup.length
    viscous, coulomb = h.get("pivot_viscous_friction", 0.0), h.get("pivot_coulomb_friction", 0.0)
    linear, quadratic, wind = (h.get(name, 0.0) for name in ("linear_drag", "quadratic_drag", "wind"))

    def force(angle: float, rate: float, v: float) -> tuple[float, float]:
        """Across the string, towards growing angle, and along it, away from the gripper; no weight, no string."""
        vx, vz = v - length * rate * cos(angle), length * rate * sin(angle)
        drag = linear + quadratic * sqrt(vx**2 + vz**2)
        fx, fz = wind - drag * vx, -drag * vz
        return fz * sin(angle) - fx * cos(angle), -fx * sin(angle) - fz * cos(angle)

    def turned(angle: float, rate: float, v: float, a: float) -> float:
        across = force(angle, rate, v)[0] + m * (a * cos(angle) - pendulum.G * sin(angle))
        return (across - (viscous * rate + coulomb * tanh(rate / 0.01)) / length) / (m * length)

    count = int(np.ceil(time[-1] / STEP)) + 1
    _, speed, push = motion(np.arange(2 * count + 1) * STEP / 2)
    states, (angle, rate) = np.empty((count, 3)), setup.start
    for k in range(count):
        (v0, v1, v2), (a0, a1, a2) = speed[2 * k : 2 * k + 3].tolist(), push[2 * k : 2 * k + 3].tolist()
        k1 = turned(angle, rate, v0, a0)
        states[k] = angle, rate, k1
        k2 = turned(angle + STEP / 2 * rate, rate + STEP / 2 * k1, v1, a1)
        k3 = turned(angle + STEP / 2 * rate + STEP**2 / 4 * k1, rate + STEP / 2 * k2, v1, a1)
        k4 = turned(angle + STEP * rate + STEP**2 / 2 * k2, rate + STEP * k3, v2, a2)
        angle += STEP * rate + STEP**2 / 6 * (k1 + k2 + k3)
        rate += STEP / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    grid = STEP * np.arange(count)
    angles = CubicHermiteSpline(grid, states[:, 0], states[:, 1])(time)
    rates = CubicHermiteSpline(grid, states[:, 1], states[:, 2])(time)
    _, v, a = motion(time)
    along = np.array([force(*state)[1] for state in zip(angles.tolist(), rates.tolist(), v.tolist(), strict=True)])
    tension = m * (pendulum.G * np.cos(angles) + length * rates**2 + a * np.sin(angles)) + along
    return {"tension": tension, "angle": angles, "side": np.sin(angles)}


def _run(
    name: str,
    situation: Situation,
    hidden: Mapping[str, float],
    length: float,
    mass: float,
    known: Mapping[str, KnownQuantity],
    rng: np.random.Generator,
) -> tuple[Run, tuple[float, float], dict[str, float]]:
    motion, start = _motion(situation, rng), _start(situation, length, rng)
    setup = pendulum.Setup(length=length, mass=mass, hidden=hidden, duration=situation.duration, start=start)
    time = _stamps(situation, rng)
    truth = (swing if hidden.keys() <= IN_THE_ANGLE else pendulum.simulate)(setup, motion, time)
    channels, stated, noise = {}, {}, {}
    if situation.gripper != "rests":
        channels["gripper_x"] = Channel(time, motion(time)[0], "m")
        stated["gripper_x"] = 0.0
    if situation.force:
        std = 3e-3 * situation.force_noise * mass / 0.1
        force = pendulum.sensor(setup, time, truth) + std * pendulum.correlated(len(time), situation.correlation, rng)
        force, spread = _electronics(situation, force, mass * pendulum.G, rng)
        noise["load_force"] = float(np.hypot(std, spread))
        channels["load_force"] = Channel(time, force, "N")
    if situation.angle_noise is not None:
        noise["swing_angle"] = situation.angle_noise
        angle = truth["angle"] + hidden.get("angle_offset", 0.0)
        channels["swing_angle"] = Channel(
            time, np.unwrap(angle) + situation.angle_noise * rng.normal(size=len(time)), "rad"
        )
    if situation.stated:
        stated |= noise
    return Run(name, channels, known, stated), start, noise


def _motion(situation: Situation, rng: np.random.Generator) -> Motion:
    moving = pendulum.gripper_motion(rng)
    if situation.gripper == "moves":
        return moving
    if situation.gripper == "rests":
        return lambda t: np.zeros((3, *np.shape(t)))
    if situation.gripper == "moving":
        caught = rng.uniform(2.0, 5.0)
        return lambda t: moving(t + caught)

    def late(t: np.ndarray | float) -> np.ndarray:
        since = np.asarray(t, dtype=float) - 3.0
        x, v, a = moving(since) if since.ndim else moving(float(since))
        u = np.clip(since / RAMP, 0.0, 1.0)
        blend = u**3 * (10 - 15 * u + 6 * u**2)
        speed = 30 * u**2 * (1 - u) ** 2 / RAMP
        turn = 60 * u * (1 - u) * (1 - 2 * u) / RAMP**2
        return np.array([blend * x, blend * v + speed * x, blend * a + 2 * speed * v + turn * x])

    return late


def _start(situation: Situation, length: float, rng: np.random.Generator) -> tuple[float, float]:
    """Angle and rate: at rest where it is released, anywhere on an orbit of that amplitude in mid-swing."""
    low, high = situation.amplitude
    if high <= 0.02:
        return 0.02 * rng.normal(), 0.04 * rng.normal()
    amplitude, side = rng.uniform(low, high), rng.choice([-1.0, 1.0])
    if not situation.mid_swing:
        return float(side * amplitude), 0.0
    angle = amplitude * np.sin(rng.uniform(-1.4, 1.4))
    rate = np.sqrt(2 * pendulum.G / length * (np.cos(angle) - np.cos(amplitude)))
    return float(side * angle), float(rate * rng.choice([-1.0, 1.0]))


def _stamps(situation: Situation, rng: np.random.Generator) -> np.ndarray:
    interval = 1.0 / situation.rate
    time = np.arange(0.0, situation.duration, interval)
    time[1:] += situation.jitter * interval * rng.uniform(-1.0, 1.0, len(time) - 1)
    middle = situation.duration / 2
    lost = (time > middle - situation.gap / 2) & (time < middle + situation.gap / 2)
    return time[~lost]


def _electronics(
    situation: Situation, force: np.ndarray, weight: float, rng: np.random.Generator
) -> tuple[np.ndarray, float]:
    """What is stored of a reading, and the standard deviation of the rounding."""
    force, spread = force.copy(), 0.0
    if situation.spikes:
        at = rng.choice(len(force), situation.spikes, replace=False)
        force[at] += weight * rng.uniform(0.2, 1.0, situation.spikes) * rng.choice([-1.0, 1.0], situation.spikes)
    if situation.clipped is not None:
        force = np.minimum(force, situation.clipped * weight)
    if situation.bits is not None:
        quantum = 4.0 * weight / 2**situation.bits
        force, spread = quantum * np.round(force / quantum), quantum / np.sqrt(12.0)
    return force, spread
