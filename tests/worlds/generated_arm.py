"""Recordings of robots with three to seven effects at once that their description lacks, drawn from a seed.

Unlike those of `imperfect_arm`, these robots are as described but for what is hidden: all of it is in the catalogue and
all of it is to be found, at any rate, of any length, in one recording or several. See `showing` for what may be hidden.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from armdyn.run import Run

from . import squares_left
from .drive import COUNT, NOISE, PRESLIDING, SMALL, SMOOTHING, Hidden, Imperfections, JointMotion, Lump, on_link
from .motions import KINDS
from .plant import Plant, World, source

ROBOTS = ("panda", "ur_description/urdf/ur10_robot.urdf", "kinova_description/robots/kinova.urdf", "talos_arm")
"""Known by name, or by a file in example-robot-data."""
RATES = (100.0, 250.0, 500.0, 1000.0)  # samples per second
SECONDS, SHORTEST, MOST_RUNS = (12.0, 120.0), 6.0, 6  # in total; of a run; runs
EFFECTS = (*SMALL, "payload")
SEVERAL = (3, 7)  # effects at once, by name
ON_JOINTS = (1, 1, 2, 3)  # joints of an effect, each as likely
SHARE = (0.05, 0.3)  # root mean square of a friction, an offset, a rotor's torque over the joint's typical torque
SPRING = (0.2, 1.0)  # the same of a spring
GAIN, LATE, PER_LOAD, FADING = (0.05, 0.2), (0.004, 0.03), (0.03, 0.15), (0.03, 0.15)  # share, s, share, rad/s
CARRIED = (0.005, 0.03)  # kg per N m of the largest effort limit: 0.4 to 2.6 kg on a Panda
ENCODER = (3e-5, 3e-4)  # noise of positions, rad
LOW_PASSED = 0.25  # share of the robots whose torque is low-passed
SHOWN = 50.0  # nats that recordings must lose without an effect for it to be hidden: ten standard deviations
STILL = 0.01  # rad/s; what a joint reads below it is not evidence: a friction that holds may be anything
THINNED = 500  # samples of all runs that this is reckoned with
STEP = 1e-3  # of differences, in each number's unit


@dataclass(frozen=True)
class Robot:
    """One robot, what is hidden in it, and what it recorded."""

    name: str  # for `urdf.load`
    worlds: tuple[World, ...]  # one for each run
    truth: tuple[Hidden, ...]  # what is hidden, joint by joint
    held_out: bool  # whether the last run is for choosing only
    seed: int  # of everything that is random

    @property
    def values(self) -> dict[str, float]:
        """What is hidden, by the parameters' names in armdyn's models."""
        return {
            f"{hidden.effect}.{short}[{hidden.joint}]": value
            for hidden in self.truth
            for short, value in hidden.values.items()
        }

    def runs(self) -> list[Run]:
        """What it recorded."""
        rng = np.random.default_rng([self.seed, 1])
        shapes = [(3, len(world.stamps), len(world.plant.joints)) for world in self.worlds]
        return [
            world.recorded(self.truth, rng.standard_normal(shape), f"run {i}")
            for i, (world, shape) in enumerate(zip(self.worlds, shapes, strict=True))
        ]

    @property
    def rate(self) -> float:
        """Samples per second."""
        return 1.0 / float(self.worlds[0].stamps[1] - self.worlds[0].stamps[0])

    @property
    def length(self) -> float:
        """Of all runs, s."""
        return sum(len(world.stamps) for world in self.worlds) / self.rate

    def fresh(self) -> tuple[World, ...]:
        """Motions of each kind that it has not recorded."""
        rng, first = np.random.default_rng([self.seed, 2]), self.worlds[0]
        return _moved(rng, first.plant, first.drive, list(KINDS), SECONDS[0], RATES[0])

    def cut(self, rate: float, seconds: float, count: int) -> "Robot":
        """The same robot on the beginning of its first motion, recorded at another rate, in so many runs."""
        first, each = self.worlds[0], seconds / count
        stamps = [k * each + np.arange(round(each * rate)) / rate for k in range(count)]
        return replace(self, worlds=tuple(replace(first, stamps=mine) for mine in stamps), held_out=False)


def generate(seed: int, *, effects: Collection[str] = EFFECTS, story: bool = False) -> Robot:
    """One robot, in which some of `effects` are hidden; kinds of robots and rates follow the seed in turn.

    In a `story` it makes one motion as long as any, at the lowest rate, whose beginning shows what is hidden.
    """
    rng = np.random.default_rng([seed, 0])
    robot, rate = ROBOTS[seed % len(ROBOTS)], RATES[0 if story else seed // len(ROBOTS) % len(RATES)]
    name = source(robot)
    plant = Plant(name)
    total = SECONDS[1] if story else float(np.exp(rng.uniform(*np.log(SECONDS))))
    most = min(MOST_RUNS, int(total / SHORTEST))
    count = 1 if story else int(rng.choice([1, rng.integers(1, most, endpoint=True)]))
    kinds = [list(KINDS)[k] for k in rng.permuted(np.arange(count) % len(KINDS))]
    drive = replace(
        Imperfections.none(len(plant.joints)),
        noise=plant.effort * rng.uniform(*NOISE, len(plant.joints)),
        position_noise=rng.uniform(*ENCODER),
        smoothing=rng.uniform(*SMOOTHING) if rng.random() < LOW_PASSED else np.inf,
        presliding=np.random.default_rng([seed, 3]).uniform(0.0, PRESLIDING),
    )
    bare = Robot(name, (), (), bool(count > 2 and rng.random() < 0.5), seed)
    bare = replace(bare, worlds=_moved(rng, plant, drive, ["moves"] if story else kinds, total / count, rate))
    training = bare.cut(rate, SECONDS[0], 1).worlds if story else bare.worlds[: count - bare.held_out]
    while True:
        truth = showing(training, _drawn(rng, training, effects))
        if len({hidden.effect for hidden in truth}) >= SEVERAL[0]:
            return replace(bare, truth=truth)


def _moved(
    rng: np.random.Generator, plant: Plant, drive: Imperfections, kinds: Sequence[str], seconds: float, rate: float
) -> tuple[World, ...]:
    """A run of `seconds` for each kind of motion, in other regions one after the other."""
    rooms, stamps = plant.rooms(rng), np.arange(round(seconds * rate)) / rate
    motions = [KINDS[kind](rng, rooms[k % len(rooms)], seconds) for k, kind in enumerate(kinds)]
    return tuple(World(plant, plant.described, drive, motion, stamps) for motion in motions)


def showing(worlds: Sequence[World], truth: Sequence[Hidden]) -> tuple[Hidden, ...]:
    """Those of hidden effects that motions can show.

    At the truth, recordings must lose more than `SHOWN` nats where an effect on one joint is left out, whatever all
    the others then are and whichever single effect of the catalogue with no more numbers comes in its place.
    """
    thin = max(1, sum(len(world.stamps) for world in worlds) // THINNED)
    coarse = [replace(world, stamps=world.stamps[::thin]) for world in worlds]
    moving = np.vstack([np.abs(world.motion.at(world.stamps)[1]) > STILL for world in coarse])
    weigh = (np.sqrt(thin) / worlds[0].drive.noise * moving).ravel()

    def reading(hidden: Sequence[Hidden]) -> np.ndarray:
        return weigh * np.concatenate([world.measured(hidden)[1].ravel() for world in coarse])

    def slopes(of: Hidden, beside: Sequence[Hidden]) -> np.ndarray:
        here = reading((*beside, of))
        columns = [(reading((*beside, of.changed(**{short: STEP}))) - here) / STEP for short in of.values]
        return np.stack(columns, axis=1)

    left = list(truth)
    rivals = {(e, j): slopes(Hidden(e, j, x), left) for j in {h.joint for h in truth} for e, x in SMALL.items()}
    while left:
        here = reading(left)
        own = {hidden: slopes(hidden, [h for h in left if h is not hidden]) for hidden in left}
        nats = {}
        for hidden in left:
            rest = [h for h in left if h is not hidden]
            missing, beside = here - reading(rest), [own[h] for h in rest]
            there = {h.effect for h in left if h.joint == hidden.joint}
            instead = [e for e in SMALL if e not in there and COUNT[e] <= COUNT[hidden.effect]]
            places = [[], *([rivals[effect, hidden.joint]] for effect in instead)]
            nats[hidden] = min(0.5 * squares_left([*beside, *place], missing) for place in places)
        weakest = min(left, key=lambda hidden: nats[hidden])
        if nats[weakest] > SHOWN:
            break
        left.remove(weakest)
    return tuple(left)


def _drawn(rng: np.random.Generator, worlds: Sequence[World], effects: Collection[str]) -> list[Hidden]:
    """Some effects, each on some joints, in sizes that follow the joints' typical torque."""
    plant, thin = worlds[0].plant, max(1, sum(len(world.stamps) for world in worlds) // THINNED)
    coarse = [replace(world, stamps=world.stamps[::thin]) for world in worlds]
    motion = tuple(np.concatenate(part) for part in zip(*(w.motion.at(w.stamps) for w in coarse), strict=True))
    load = np.concatenate([world.load() for world in coarse])
    typical = plant.typical(load)
    names = rng.permutation(list(effects))[: rng.integers(*SEVERAL, endpoint=True)]
    found = []
    for effect in names:
        if effect == "payload":
            place = tuple(float(x) for x in rng.uniform((-0.05, -0.05, 0.05), (0.05, 0.05, 0.15)))
            mass = float(plant.effort.max() * rng.uniform(*CARRIED))
            found.append(on_link("payload", plant.joints[-1], Lump(mass, place)))
            continue
        for j in rng.choice(len(plant.joints), int(rng.choice(ON_JOINTS)), replace=False):
            own = JointMotion(*(part[:, j] for part in motion), load[:, j], np.sign(motion[1][:, j]))
            found.append(Hidden(str(effect), plant.joints[j], _sized(rng, str(effect), own, float(typical[j]))))
    return found


def _sized(rng: np.random.Generator, effect: str, at: JointMotion, typical: float) -> dict[str, float]:
    """An effect's values in the size that a real joint with this motion and typical torque has."""
    sign, size = float(rng.choice([-1.0, 1.0])), typical * float(rng.uniform(*SHARE))
    match effect:
        case "torque_gain":
            return {"error": sign * float(rng.uniform(*GAIN))}
        case "torque_delay":
            return {"time": float(rng.uniform(*LATE))}
        case "joint_load_friction":
            return {"coefficient": float(rng.uniform(*PER_LOAD))}
        case "torque_offset":
            return {"torque": sign * size}
        case "joint_asymmetric_friction":
            return {"positive": size, "negative": size * float(rng.uniform(0.3, 0.8))}
        case "joint_stribeck_friction":
            return {"torque": size, "speed": float(rng.uniform(*FADING))}
        case "gravity_spring":
            size, angle = typical * float(rng.uniform(*SPRING)), float(rng.uniform(-np.pi, np.pi))
            return {"sine": size * float(np.cos(angle)), "cosine": size * float(np.sin(angle))}
        case "joint_spring":
            rest = float(rng.uniform(at.q.min(), at.q.max()))
            size = typical * float(rng.uniform(*SPRING))
            return {"stiffness": size / float(np.sqrt(np.mean((at.q - rest) ** 2))), "rest": rest}
    (short,) = SMALL[effect]
    unit = Hidden(effect, "", {short: 1.0}).torque(at)
    return {short: size / float(np.sqrt(np.mean(np.square(unit))))}
