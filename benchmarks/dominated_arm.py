"""One or two effects make nearly all of the error, friction and rotors and small links the rest: is all of it modelled?

    python benchmarks/dominated_arm.py --seeds 20 --first-seed 0 --processes 2

Recordings are those of `tests/hidden_effects/plant.py` with nothing that the catalogue lacks: Coulomb friction, viscous
friction and a rotor on every joint, links whose mass, centre and extents are off by 3 to 8 %, and the noise of encoders
and torque sensors. One or two effects (a gain of two joints, a spring, a payload, a tilted base) make 95 to 99 % of the
squared error of the model as described. Training is one or two runs with one kind of motion; another kind is held out
in every other case, a third is the exam.

What is counted:

- `led`: the first steps of the repair, as many as there are dominant effects, are those.
- `frictions`: every later name is one that was put in.
- `model`: error in the exam of the repaired model over that of the true structure, all effects that were put in on all
  joints, fitted to the same training runs, is at most 1.1.
"""

import time
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import replace

import _hidden_table as hidden_table
import numpy as np
from imperfect_arm import JOINT_EFFECTS, exam_error

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import CATALOGUE
from armdyn.effects.effect import Effect
from armdyn.identify.explained import RepairStep
from armdyn.identify.repair import add, repair
from armdyn.identify.study import Study

imperfect = hidden_table.generator("imperfect_arm")
plants = hidden_table.generator("plant")
dominant = hidden_table.generator("dominant")
imperfections = hidden_table.generator("imperfections")
sound = hidden_table.generator("sound_recordings")

KINDS = ("gain", "spring", "payload", "tilt")
SHARE = (0.95, 0.99)
"""Of the squared error of the model as described, that is the dominant effects'."""
SMALL = (0.02, 0.06)
"""Of a joint's typical torque: each friction, and the torque of a rotor."""
NOISE = (0.0005, 0.002)
"""Of a torque sensor, of the effort limit."""
DURATION, RATE = 20.0, 100.0
FRICTIONS = ("joint_coulomb_friction", "joint_viscous_friction", "rotor_inertia")
CLOSE = 1.1
TARGETS = {"led": 0.95, "frictions": 0.95, "model": 0.95}


def dominants(rng: np.random.Generator, kind: str, plant: object, loads: np.ndarray) -> list[object]:
    """The dominant effects of unit size, on joints that carry much."""
    heavy = np.argsort(-np.sqrt(np.mean(loads**2, axis=0)))[:2]
    first, second = (plant.joints[int(j)] for j in rng.permutation(heavy))
    if kind == "gain":
        return [
            dominant.Hidden("torque_gain", name, gain=1.0 + float(rng.choice([-1.0, 1.0]))) for name in (first, second)
        ]
    if kind == "spring":
        angle = rng.uniform(0.0, 2.0 * np.pi)
        return [dominant.Hidden("gravity_spring", first, sine=float(np.cos(angle)), cosine=float(np.sin(angle)))]
    return [dominant.Hidden("payload", plant.joints[-1], lump=dominant.Lump(1.0, tuple(rng.uniform(-0.1, 0.1, 3))))]


def scaled(hidden: object, size: float) -> object:
    """An effect so many times as large."""
    if hidden.lump is not None:
        return replace(hidden, lump=replace(hidden.lump, mass=size * hidden.lump.mass))
    if hidden.effect == "torque_gain":
        return replace(hidden, gain=1.0 + size * (hidden.gain - 1.0))
    return replace(hidden, sine=size * hidden.sine, cosine=size * hidden.cosine)


def case(robot: str, kind: str, seed: int) -> tuple[list[object], list[object], list[object], float]:
    """Runs (training, held out, exam), dominant effects, small effects, and the share that the dominant ones make."""
    plant = plants.Plant(robot)
    rng = np.random.default_rng([seed, imperfect.ROBOTS.index(robot), KINDS.index(kind)])
    order = rng.permutation(list(plants.KINDS))
    kinds = [order[0]] * int(rng.integers(1, 3)) + [order[1], order[2]]
    rooms = dict(zip(plants.KINDS, plant.rooms(rng), strict=True))
    motions = [plants.KINDS[k](rng, rooms[k], DURATION) for k in kinds]
    stamps = np.arange(round(DURATION * RATE)) / RATE
    drive = replace(
        imperfections.Imperfections.none(len(plant.joints)),
        noise=plant.effort * rng.uniform(*NOISE, len(plant.joints)),
        position_noise=imperfect.POSITION_NOISE[robot],
    )
    links = plant.described.off(rng)
    worlds = [plants.World(plant, links, drive, motion, stamps) for motion in motions]
    loads, moved = worlds[0].bare_load, worlds[0].motion.at(stamps)
    typical = np.maximum(np.sqrt(np.mean(loads**2, axis=0)), imperfect.LEAST_TYPICAL * plant.effort)
    small = [
        dominant.Hidden(
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
    return runs, [scaled(hidden, size) for hidden in unit], small, share


def _misfits(
    worlds: Sequence[object], small: list[object], unit: list[object], size: float, axis: float
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


def tilted(plant: object, angle: float, axis: float) -> AbstractContextManager[None]:
    """The robot on a base that is turned by so much about a horizontal axis, rad."""
    down = np.array([np.sin(angle) * np.cos(axis), np.sin(angle) * np.sin(axis), -np.cos(angle)])
    return sound.gravity_of(plant, 9.81 * down)


def examine(robot: str, kind: str, seed: int) -> hidden_table.Row:
    """One case."""
    runs, big, _, share = case(robot, kind, seed)
    train, held_out, exam = runs[:-2], [runs[-2]] if seed % 2 else [], [runs[-1]]
    model = arm_model(robot=robot)
    begun = time.perf_counter()
    mended = repair(Study(model, train, held_out, JOINT_EFFECTS))
    seconds = time.perf_counter() - begun
    wanted: list[Effect] = [CATALOGUE["base_tilt"]] if kind == "tilt" else []
    names = {"base_tilt"} if kind == "tilt" else {hidden.effect for hidden in big}
    joints = {name: [h.joint for h in big if h.effect == name] for name in names if name != "base_tilt"}
    wanted += [CATALOGUE[name].on(*on) for name, on in joints.items()]
    every = [*wanted, *(CATALOGUE[name] for name in (*FRICTIONS, "link_inertia") if name not in names)]
    truth = add(Study(model, train, held_out, every), every)
    steps = mended.path[1:]
    named = [step for step in steps if step.added != ("background",)]
    told = {e for step in named for e in step.added}
    row: hidden_table.Row = {
        "what": f"{kind} {robot}", "kind": kind, "robot": robot, "seed": seed, "share": share, "seconds": seconds,
        "held_out": bool(held_out), "runs": len(train),
        "steps": [[list(step.added), list(step.joints)] for step in steps],
        "led": _lead(named, {(name, joint) for name in names for joint in joints.get(name, [""])}),
        "frictions": told <= names | {*FRICTIONS, "link_inertia"},
        "exam_error": exam_error(mended.model, exam), "exam_named": exam_error(mended.named, exam),
        "exam_true": exam_error(truth.model, exam),
    }  # fmt: skip
    row["exam"] = row["exam_error"] / row["exam_true"]
    return row | {"model": row["exam"] <= CLOSE, "told": sorted(told)}


def _lead(steps: Sequence[RepairStep], wanted: set[tuple[str, str]]) -> bool:
    """Whether these effects come first, and nothing with them."""
    left = set(wanted)
    for step in steps:
        here = {(effect, joint) for effect in step.added for joint in step.joints or ("",)}
        if not left or not here <= left:
            break
        left -= here
    return not left


def main() -> None:
    parser = hidden_table.parser(__doc__, "", 5)
    given = parser.parse_args()
    kinds = given.only.split(",") if given.only else list(KINDS)
    cases = [
        (robot, kind, seed) for seed in hidden_table.seeds_of(given) for robot in imperfect.ROBOTS for kind in kinds
    ]
    rows: list[hidden_table.Row] = []
    for row in hidden_table.answered(examine, cases, given.processes):
        rows.append(row)
        keys = ("what", "seed", "share", "runs", "held_out", "steps", "exam", "exam_named", "exam_true", "seconds")
        print({key: round(row[key], 3) if isinstance(row[key], float) else row[key] for key in keys}, flush=True)
    for key, target in TARGETS.items():
        print(f"{key} {100 * np.mean([row[key] for row in rows]):.1f} % of {len(rows)}, wanted {100 * target:.0f} %")
    exams = [row["exam"] for row in rows]
    print(f"exam over that of the truth: median {np.median(exams):.3f}, 95 % {np.percentile(exams, 95):.3f}")
    hidden_table.save(given.json, {"dominated": rows})


if __name__ == "__main__":
    main()
