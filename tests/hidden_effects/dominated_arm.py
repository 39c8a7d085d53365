"""Arms of which one or two effects of the catalogue make nearly all of the error, and small ones of it the rest."""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace

import numpy as np

from armdyn.run import Run

from .dominant import Hidden, Lump
from .imperfect_arm import LEAST_TYPICAL, POSITION_NOISE, ROBOTS
from .imperfections import Imperfections
from .motions import KINDS as MOTIONS
from .plant import Plant, World
from .sound_recordings import gravity_of

KINDS = ("gain", "spring", "payload", "tilt")
SHARE = (0.95, 0.99)
"""Of the squared error of the model as described, that is the dominant effects'."""
SMALL = (0.02, 0.06)
"""Of a joint's typical torque: each friction, and the torque of a rotor."""
NOISE = (0.0005, 0.002)
"""Of a torque sensor, of the effort limit."""


def dominants(rng: np.random.Generator, kind: str, plant: Plant, loads: np.ndarray) -> list[Hidden]:
    """The dominant effects of unit size, on joints that carry much."""
    heavy = np.argsort(-np.sqrt(np.mean(loads**2, axis=0)))[:2]
    first, second = (plant.joints[int(j)] for j in rng.permutation(heavy))
    if kind == "gain":
        return [Hidden("torque_gain", name, gain=1.0 + float(rng.choice([-1.0, 1.0]))) for name in (first, second)]
    if kind == "spring":
        angle = rng.uniform(0.0, 2.0 * np.pi)
        return [Hidden("gravity_spring", first, sine=float(np.cos(angle)), cosine=float(np.sin(angle)))]
    return [Hidden("payload", plant.joints[-1], lump=Lump(1.0, tuple(rng.uniform(-0.1, 0.1, 3))))]


def scaled(hidden: Hidden, size: float) -> Hidden:
    """An effect so many times as large."""
    if hidden.lump is not None:
        return replace(hidden, lump=replace(hidden.lump, mass=size * hidden.lump.mass))
    if hidden.effect == "torque_gain":
        return replace(hidden, gain=1.0 + size * (hidden.gain - 1.0))
    return replace(hidden, sine=size * hidden.sine, cosine=size * hidden.cosine)


@dataclass(frozen=True)
class Case:
    """Recordings of one robot.

    Attributes:
        train: one or two runs with one kind of motion.
        held_out: with another kind.
        exam: with a third.
        dominant: the effects that make nearly all of the error; empty where the base is tilted.
        share: of the squared error of the model as described, that they make.
    """

    train: tuple[Run, ...]
    held_out: Run
    exam: Run
    dominant: tuple[Hidden, ...]
    share: float


def generate(robot: str, kind: str, seed: int, *, duration: float = 20.0, rate: float = 100.0) -> Case:
    """One case.

    Args:
        robot: of `imperfect_arm.ROBOTS`.
        kind: of `KINDS`.
        seed: of everything that is random.
        duration: of every run, s.
        rate: samples per second.
    """
    plant = Plant(robot)
    rng = np.random.default_rng([seed, ROBOTS.index(robot), KINDS.index(kind)])
    order = rng.permutation(list(MOTIONS))
    kinds = [order[0]] * int(rng.integers(1, 3)) + [order[1], order[2]]
    rooms = dict(zip(MOTIONS, plant.rooms(rng), strict=True))
    motions = [MOTIONS[k](rng, rooms[k], duration) for k in kinds]
    stamps = np.arange(round(duration * rate)) / rate
    drive = replace(
        Imperfections.none(len(plant.joints)),
        noise=plant.effort * rng.uniform(*NOISE, len(plant.joints)),
        position_noise=POSITION_NOISE[robot],
    )
    links = plant.described.off(rng)
    worlds = [World(plant, links, drive, motion, stamps) for motion in motions]
    loads, moved = worlds[0].bare_load, worlds[0].motion.at(stamps)
    typical = np.maximum(np.sqrt(np.mean(loads**2, axis=0)), LEAST_TYPICAL * plant.effort)
    small = [
        Hidden(
            "", name,
            coulomb=typical[j] * rng.uniform(*SMALL),
            viscous=typical[j] * rng.uniform(*SMALL) / np.sqrt(np.mean(moved[1][:, j] ** 2)),
            rotor=typical[j] * rng.uniform(*SMALL) / np.sqrt(np.mean(moved[2][:, j] ** 2)),
        )
        for j, name in enumerate(plant.joints)
    ]  # fmt: skip
    rest = _squared([world.misfit(small) for world in worlds])
    share = rng.uniform(*SHARE)
    unit = dominants(rng, kind, plant, loads) if kind != "tilt" else []
    axis = rng.uniform(0.0, 2.0 * np.pi)
    low, high = 0.0, 1.0 if kind == "tilt" else 1e3
    for _ in range(40):  # the more, the larger the share
        size = 0.5 * (low + high)
        low, high = (
            (low, size) if 1.0 - rest / _squared(_misfits(worlds, small, unit, size, axis)) > share else (size, high)
        )
    with tilted(plant, size if kind == "tilt" else 0.0, axis):
        noise = rng.standard_normal((len(worlds), 3, len(stamps), len(plant.joints)))
        made = [replace(w) for w in worlds]  # what they remember was not tilted
        there = [*small, *(scaled(hidden, size) for hidden in unit)]
        runs = [world.recorded(there, noise[i], f"{kinds[i]} {i}") for i, world in enumerate(made)]
    large = tuple(scaled(hidden, size) for hidden in unit)
    return Case(tuple(runs[:-2]), runs[-2], runs[-1], large, share)


def _misfits(
    worlds: Sequence[World], small: list[Hidden], unit: list[Hidden], size: float, axis: float
) -> list[np.ndarray]:
    if unit:
        return [world.misfit([*small, *(scaled(hidden, size) for hidden in unit)]) for world in worlds]
    plain = [world.plant.torques(world.motion.at(world.stamps), world.plant.described, {}) for world in worlds]
    with tilted(worlds[0].plant, size, axis):
        there = [world.plant.torques(world.motion.at(world.stamps), world.plant.described, {}) for world in worlds]
    more = [t - p for t, p in zip(there, plain, strict=True)]
    return [world.misfit(small) + extra[world.inner] for world, extra in zip(worlds, more, strict=True)]


def _squared(misfits: Sequence[np.ndarray]) -> float:
    return float(np.mean([np.sum(np.mean(m**2, axis=0)) for m in misfits]))


def tilted(plant: Plant, angle: float, axis: float) -> AbstractContextManager[None]:
    """The robot on a base that is turned by so much about a horizontal axis, rad."""
    down = np.array([np.sin(angle) * np.cos(axis), np.sin(angle) * np.sin(axis), -np.cos(angle)])
    return gravity_of(plant, 9.81 * down)
