"""Sound recordings of arms and pendulums: what a check of recordings must not complain of.

Arms are `plant.World`: imperfect everywhere, and some with a payload, a spring, a gain of a tenth, strong friction or a
base that is tilted by five degrees, none of which is a mistake. Pendulums are those of `dry_swing`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from armdyn.recording.units import KnownQuantity
from armdyn.run import Channel, Run

from .drive import Hidden, Imperfections, Lump, on_link
from .dry_swing import G, Pendulum, Push, reading, swing
from .motions import KINDS
from .plant import LEAST_TYPICAL, Plant, World

ROBOTS = ("baxter", "panda", "ur5", "talos_arm")
POSITION_NOISE = {"baxter": 4e-4, "panda": 1e-4, "ur5": 5e-5, "talos_arm": 1e-4}
PAYLOAD = {"baxter": 2.0, "panda": 2.5, "ur5": 4.0, "talos_arm": 1.5}  # kg
SOUND = ("as described", "payload", "spring", "gain", "tilt", "friction", "offset")
Gravity = tuple[float, float, float]
TORQUE_CONSTANTS = (0.55, 1.8)
"""Smallest and largest factor of torques whose constants are a guess, one factor for each joint."""
ELASTIC, VIBRATION, PITCH = 8.0, (0.1, 1.5), (8.0, 25.0)
"""Of series-elastic drives: how much softer their springs are than gears, and the vibration of torques, whose amplitude
is a multiple of the typical torque, at a frequency [Hz]."""
OWNED = ("series elastic", "torque constants", "payload", "spring")
"""What a robot of `owned` may have, any number of them at once."""


@dataclass(frozen=True, eq=False)
class Sound:
    """A recording as it should be."""

    name: str  # robot or pendulum, what is real in it, seed
    model: str  # robot, or ``"pendulum"``
    run: Run  # as recorded
    told: Mapping[str, float]  # by channel, its root mean square over what its joint is made for


def arm(
    robot: str, real: str, seed: int, *, duration: float = 15.0, rate: float = 100.0, gravity: Gravity | None = None
) -> Sound:
    """A sound recording of an arm of `ROBOTS` with what is real of `SOUND`; gravity is in the frame of the base."""
    plant = Plant(robot)
    rng = np.random.default_rng([seed, ROBOTS.index(robot), SOUND.index(real)])
    kind = list(KINDS)[seed % len(KINDS)]
    room = plant.rooms(rng)[1]
    motion = KINDS[kind](rng, room, duration)
    stamps = np.arange(round(duration * rate)) / rate
    typical = np.sqrt(np.mean(np.square(plant.torques(motion.at(stamps[::20]), plant.described, {})), axis=0))
    drive = Imperfections.drawn(
        rng, np.maximum(typical, LEAST_TYPICAL * plant.effort), plant.effort, POSITION_NOISE[robot]
    )
    if real == "friction":
        drive = replace(drive, viscous=0.08 * plant.effort, coulomb=0.05 * plant.effort)
    down = np.array([0.0, 0.0, -G]) if gravity is None else np.array(gravity)
    if real == "tilt":
        axis = np.append(rng.standard_normal(2), 0.0)
        down = Rotation.from_rotvec(np.deg2rad(5.0) * axis / np.linalg.norm(axis)).apply(down)
    world = World(plant, plant.described.off(rng), drive, motion, stamps)
    strongest = int(np.argmax(typical))
    truth: tuple[Hidden, ...] = ()
    if real == "payload":
        truth = (on_link("payload", plant.joints[-1], Lump(PAYLOAD[robot], (0.03, -0.02, 0.1), 0.004)),)
    elif real == "spring":
        size, phase = 0.8 * typical[strongest], rng.uniform(0.0, 2 * np.pi)
        values = {"sine": float(size * np.sin(phase)), "cosine": float(size * np.cos(phase))}
        truth = (Hidden("gravity_spring", plant.joints[strongest], values),)
    elif real == "gain":
        truth = tuple(Hidden("torque_gain", j, {"error": float(rng.choice([-0.1, 0.1]))}) for j in plant.joints)
    elif real == "offset":
        sizes = 0.02 * plant.effort * rng.choice([-1.0, 1.0], len(plant.joints))
        truth = tuple(
            Hidden("torque_offset", j, {"torque": float(s)}) for j, s in zip(plant.joints, sizes, strict=True)
        )
    noise = rng.standard_normal((3, len(stamps), len(plant.joints)))
    with plant.in_gravity(down):
        run = world.recorded(truth, noise, f"{robot} {real} {seed}")
    channels = dict(run.channels)
    _, v, _ = motion.at(stamps - drive.late)
    for i, joint in enumerate(plant.joints):
        channels[f"v.{joint}"] = Channel(stamps, v[:, i] + 2e-3 * rng.standard_normal(len(stamps)), "rad/s")
    run = replace(run, channels=channels)
    told = {
        f"tau.{j}": float(np.sqrt(np.mean(run.channels[f"tau.{j}"].value ** 2)) / plant.effort[i])
        for i, j in enumerate(plant.joints)
    }
    return Sound(run.name, robot, run, told)


def owned(robot: str, seed: int, *, count: int = 3, duration: float = 12.0, rate: float = 100.0) -> list[Sound]:
    """`count` sound recordings of one arm, imperfect everywhere, with any of `OWNED` at once."""
    plant, rng = Plant(robot), np.random.default_rng([seed, ROBOTS.index(robot), 99])
    real = [name for name in OWNED if rng.random() < 0.5]
    stamps = np.arange(round(duration * rate)) / rate
    kinds = rng.choice(list(KINDS), count)
    motions = [KINDS[kind](rng, room, duration) for kind, room in zip(kinds, plant.rooms(rng), strict=True)]
    load = np.array([plant.torques(motion.at(stamps[::20]), plant.described, {}) for motion in motions])
    typical = plant.typical(load)
    drive = Imperfections.drawn(rng, typical, plant.effort, POSITION_NOISE[robot])
    links, truth = plant.described.off(rng), list[Hidden]()
    if "series elastic" in real:
        drive = replace(drive, compliance=ELASTIC * drive.compliance, smoothing=np.inf, late=0.0)
    if "payload" in real:
        size = PAYLOAD[robot] * rng.uniform(0.3, 1.2)
        truth.append(on_link("payload", plant.joints[-1], Lump(size, (0.03, -0.02, 0.1), 0.004)))
    if "spring" in real:
        j, phase = int(np.argmax(typical)), rng.uniform(0.0, 2.0 * np.pi)
        size = rng.uniform(0.3, 1.0) * typical[j]
        values = {"sine": float(size * np.sin(phase)), "cosine": float(size * np.cos(phase))}
        truth.append(Hidden("gravity_spring", plant.joints[j], values))
    factors = np.ones(len(plant.joints))
    if "torque constants" in real:
        factors = np.exp(rng.uniform(*np.log(TORQUE_CONSTANTS), len(plant.joints)))
    found = []
    for k, (kind, motion) in enumerate(zip(kinds, motions, strict=True)):
        world = World(plant, links, drive.drifted(rng), motion, stamps)
        name = f"{robot} {'+'.join(real) or 'nothing'} {kind} {seed}.{k}"
        run = world.recorded(truth, rng.standard_normal((3, len(stamps), len(plant.joints))), name)
        channels = dict(run.channels)
        for i, joint in enumerate(plant.joints):
            tau = run.channels[f"tau.{joint}"].value
            if "series elastic" in real:
                tone = 2.0 * np.pi * rng.uniform(*PITCH) * stamps + np.cumsum(0.3 * rng.standard_normal(len(stamps)))
                tau = tau + rng.uniform(*VIBRATION) * typical[i] * np.sin(tone)
            channels[f"tau.{joint}"] = Channel(stamps, factors[i] * tau, "N m")
        told = {f"tau.{j}": float(typical[i] / plant.effort[i]) for i, j in enumerate(plant.joints)}
        found.append(Sound(name, robot, replace(run, channels=channels), told))
    return found


def pendulum(real: str, seed: int, *, driven: bool, channels: Sequence[str], duration: float = 20.0) -> Sound:
    """A sound recording of a pendulum with a little viscous friction and what is `real`; a `driven` pivot moves."""
    rng = np.random.default_rng([seed, 77, driven])
    length, mass = rng.uniform(0.25, 0.8), rng.uniform(0.05, 0.4)
    inertia = mass * length**2
    effects = {"pivot_viscous_friction": 0.03 * inertia}
    sizes = {
        "pivot_coulomb_friction": 0.05 * inertia, "quadratic_drag": 0.03 * mass / length, "angle_gain": 0.05,
        "angle_offset": 0.03, "angle_skew": 0.03, "gripper_scale": 0.05, "sensor_bias": 0.02,
    }  # fmt: skip
    effects |= {real: sizes[real]} if real else {}
    time = np.arange(0.0, duration, 0.01)
    w = 2 * np.pi * np.array([0.31, 0.53, 1.1]) * rng.uniform(0.9, 1.1, 3)
    amplitude = np.array([0.08, 0.05, 0.02]) * rng.choice([-1.0, 1.0], 3)

    def gripper(t: np.ndarray) -> np.ndarray:
        phase = np.multiply.outer(w, t)
        return np.array(
            [amplitude @ (1 - np.cos(phase)), (amplitude * w) @ np.sin(phase), (amplitude * w**2) @ np.cos(phase)]
        )

    push = Push(gripper if driven else None)
    start = (0.02, 0.0) if driven else (rng.uniform(0.4, 1.0), 0.0)
    moved = swing(Pendulum(length, mass, effects), start, push, time)
    noise = {"swing_angle": 1e-3, "swing_rate": 5e-3, "load_force": 3e-3}
    unit = {"swing_angle": "rad", "swing_rate": "rad/s", "load_force": "N"}
    found = {
        name: Channel(time, reading(effects, name, moved) + noise[name] * rng.standard_normal(len(time)), unit[name])
        for name in channels
    }
    if driven:
        found["gripper_x"] = Channel(time, gripper(time)[0] + 5e-5 * rng.standard_normal(len(time)), "m")
    known = {"length": KnownQuantity(length, 0.01 * length, "m"), "mass": KnownQuantity(mass, 0.01 * mass, "kg")}
    name = f"pendulum {'driven' if driven else 'free'} {'+'.join(channels)} {real} {seed}"
    return Sound(name, "pendulum", Run(name, found, known), dict.fromkeys(found, 1.0))
