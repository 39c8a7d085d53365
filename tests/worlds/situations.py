"""What users record: the situations in which a fit gets lost, on top of the equations in `pendulum`.

Each situation says how the gripper moves, how the load starts, what the sensors do to the samples, and what the user
wrote beside the recording. Nothing here comes from armdyn's models.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from armdyn.recording.units import KnownQuantity
from armdyn.run import Channel, Run

from . import coloured, pendulum

Motion = Callable[[np.ndarray | float], np.ndarray]
RAMP = 0.5  # s in which a gripper that rested gets under way
USUAL_LENGTH, USUAL_MASS = 0.368, 0.08
"""m and kg of the load for which `pendulum.REALISTIC` says how large an effect is."""


@dataclass(frozen=True)
class Situation:
    """How a recording comes about."""

    # ``"moves"`` from the first sample on; ``"rests"`` throughout, and has no channel; ``"late"`` after 3 s;
    # ``"moving"`` is already under way at the first sample
    gripper: str = "moves"
    # range of the angle at which the load is released, or swings where it is caught in mid-swing, rad
    amplitude: tuple[float, float] = (0.0, 0.02)
    mid_swing: bool = False  # whether the first sample falls into any phase of the swing
    duration: float = 15.0  # s
    rate: float = 100.0  # of the samples, Hz
    length: tuple[float, float] = (0.30, 0.45)  # range, m
    mass: tuple[float, float] = (0.06, 0.12)  # range, kg
    force_noise: float = 1.0  # of one sample, as a share of 3 mN per 0.1 kg
    correlation: float = 0.0  # of the force noise from sample to sample
    angle_noise: float | None = None  # rad; None where there is no angle sensor
    force: bool = True  # whether there is a load cell
    jitter: float = 0.0  # of the stamps, as a share of their interval
    gap: float = 0.0  # s that are lost in the middle
    spikes: int = 0  # single samples per run that are wrong by 0.2 to 1 times the weight
    clipped: float | None = None  # reading at which the load cell's electronics end, in weights; None where they do not
    bits: int | None = None  # of the converter, over four times the weight; None where it is fine enough
    stated: bool = True  # whether the noise stands beside the recording
    weighed: bool = True  # whether mass and length do
    masses: tuple[float, ...] = (1.0, 1.0)  # factors on the mass, one per run; each is weighed


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
    """Runs with the truth behind them."""

    runs: tuple[Run, ...]  # as a user has them
    length: float  # m
    masses: tuple[float, ...]  # of each run, kg
    starts: tuple[tuple[float, float], ...]  # angle and rate at the start of each run, rad and rad/s
    # standard deviation of each run's force and angle, quantisation included
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
    truth = pendulum.simulate(setup, motion, time)
    channels, stated, noise = {}, {}, {}
    if situation.gripper != "rests":
        channels["gripper_x"] = Channel(time, motion(time)[0], "m")
        stated["gripper_x"] = 0.0
    if situation.force:
        std = 3e-3 * situation.force_noise * mass / 0.1
        force = pendulum.sensor(setup, time, truth) + std * coloured(rng.normal(size=len(time)), situation.correlation)
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
