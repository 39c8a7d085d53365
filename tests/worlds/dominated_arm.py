"""Arms of which one or two effects of the catalogue make nearly all of the error, and small ones of it the rest."""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace

import numpy as np

from armdyn.run import Run

from .bodies import Links
from .drive import Hidden, Imperfections, Lump, on_link
from .imperfect_arm import POSITION_NOISE, ROBOTS
from .motions import KINDS as MOTIONS
from .plant import Plant, World

KINDS = ("gain", "spring", "payload", "tilt")
SHARE = (0.95, 0.99)
"""Of the squared error of the model as described, that is the dominant effects'; the small ones shrink until it is."""
GAIN, SPRING, PAYLOAD, TILT = (0.2, 0.4), (0.3, 0.6), (0.02, 0.1), (0.05, 0.2)
"""Of a reading; of the joint's typical torque; of the arm's mass; rad."""
STEPS = 12  # halvings of what the small effects are multiplied by
SMALL = (0.02, 0.06)  # of a joint's typical torque: each friction, and the torque of a rotor
NOISE = (0.0005, 0.002)  # of a torque sensor, of the effort limit


def dominants(rng: np.random.Generator, kind: str, plant: Plant, typical: np.ndarray) -> list[Hidden]:
    """The dominant effects, on joints that carry much, given (nj,) `typical` torques; none for a tilted base."""
    carrying = [plant.joints[j] for j in rng.permutation(np.argsort(-typical)[:2])]
    if kind == "gain":
        errors = rng.choice([-1.0, 1.0], 2) * rng.uniform(*GAIN, 2)
        return [Hidden("torque_gain", j, {"error": float(e)}) for j, e in zip(carrying, errors, strict=True)]
    if kind == "spring":
        angle, size = rng.uniform(0.0, 2.0 * np.pi), typical[plant.joints.index(carrying[0])] * rng.uniform(*SPRING)
        values = {"sine": size * float(np.cos(angle)), "cosine": size * float(np.sin(angle))}
        return [Hidden("gravity_spring", carrying[0], values)]
    if kind == "payload":
        mass = float(plant.described.mass.sum()) * rng.uniform(*PAYLOAD)
        return [on_link("payload", plant.joints[-1], Lump(mass, tuple(rng.uniform(-0.1, 0.1, 3))))]
    return []


@dataclass(frozen=True)
class Case:
    """Recordings of one robot."""

    train: tuple[Run, ...]  # one or two runs with one kind of motion
    held_out: Run  # with another kind
    exam: Run  # with a third
    dominant: tuple[Hidden, ...]  # the effects that make nearly all of the error; empty where the base is tilted
    share: float  # of the squared error of the model as described, that they make


def generate(robot: str, kind: str, seed: int, *, duration: float = 20.0, rate: float = 100.0) -> Case:
    """One case of a robot of `imperfect_arm.ROBOTS` and a kind of `KINDS`; every run lasts `duration` s."""
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
    first = World(plant, links, drive, motions[0], stamps)
    moved = first.motion.at(stamps)
    typical = plant.typical(first.load())
    small = []
    for j, name in enumerate(plant.joints):
        dry, damped, turned = (float(typical[j] * rng.uniform(*SMALL)) for _ in range(3))
        speed, acceleration = (float(np.sqrt(np.mean(part[:, j] ** 2))) for part in moved[1:])
        small += [
            Hidden("joint_coulomb_friction", name, {"torque": dry}),
            Hidden("joint_viscous_friction", name, {"coefficient": damped / speed}),
            Hidden("rotor_inertia", name, {"inertia": turned / acceleration}),
        ]
    large, wanted = dominants(rng, kind, plant, typical), rng.uniform(*SHARE)
    angle, axis = (rng.uniform(*TILT), rng.uniform(0.0, 2.0 * np.pi)) if kind == "tilt" else (0.0, 0.0)

    def rest(times: float) -> tuple[list[World], list[Hidden]]:
        """The robot with small effects so many times as large."""
        off = Links(*(d + times * (o - d) for d, o in zip(plant.described, links, strict=True)))
        return [World(plant, off, drive, motion, stamps) for motion in motions], [h.times(times) for h in small]

    def share(times: float) -> float:
        worlds, fewer = rest(times)
        alone = [world.misfit(fewer) for world in worlds]
        with tilted(plant, angle, axis):
            worlds, _ = rest(times)
            whole = [world.misfit([*fewer, *large]) for world in worlds]
        if kind == "tilt":  # the model as described stands upright
            whole = [w + t for w, t in zip(whole, _by_tilt(plant, worlds, angle, axis), strict=True)]
        return 1.0 - _squared(alone) / _squared(whole)

    low, high = 0.0, 1.0
    for _ in range(STEPS):  # the larger the rest, the smaller the share
        times = 0.5 * (low + high)
        low, high = (times, high) if share(times) > wanted else (low, times)
    found = share(times)
    with tilted(plant, angle, axis):
        worlds, fewer = rest(times)
        noise = rng.standard_normal((len(worlds), 3, len(stamps), len(plant.joints)))
        runs = [world.recorded([*fewer, *large], noise[i], f"{kinds[i]} {i}") for i, world in enumerate(worlds)]
    return Case(tuple(runs[:-2]), runs[-2], runs[-1], tuple(large), found)


def _by_tilt(plant: Plant, worlds: Sequence[World], angle: float, axis: float) -> list[np.ndarray]:
    """What the described links' torques change by where the base is turned."""
    found = []
    for world in worlds:
        motion = world.motion.at(world.stamps)
        with tilted(plant, angle, axis):
            there = plant.torques(motion, plant.described, {})
        found.append((there - plant.torques(motion, plant.described, {}))[world.inner])
    return found


def _squared(misfits: Sequence[np.ndarray]) -> float:
    return float(np.mean([np.sum(np.mean(m**2, axis=0)) for m in misfits]))


def tilted(plant: Plant, angle: float, axis: float) -> AbstractContextManager[None]:
    """The robot on a base that is turned by so much about a horizontal axis, rad."""
    down = np.array([np.sin(angle) * np.cos(axis), np.sin(angle) * np.sin(axis), -np.cos(angle)])
    return plant.in_gravity(9.81 * down)
