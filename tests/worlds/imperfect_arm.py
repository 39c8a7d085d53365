"""Recordings of imperfect robots, with one or two dominant effects that the model lacks, or with none.

Every robot has the errors of `drive.Imperfections` on all of its joints and links. Dominant effects make at least
`DOMINANT` of the squared torque error of the model as described, and a plain least-squares fit without noise finds one
of them first (`dominant.SingleEffects`); where none is put in, no single effect explains more than `SPREAD` of the
error. Rigid bodies are MuJoCo's, the joints are plain numpy; of armdyn there is only the container of a recording.

A case has two training runs of one kind of motion, a held-out run of another and an exam of the third, each kind in
another region of the joints' range.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from armdyn.run import Run

from .dominant import COARSE, Atom, Joints, SingleEffects, score
from .drive import COUNT, Hidden, Imperfections
from .motions import KINDS
from .plant import Plant, World

POSITION_NOISE: Mapping[str, float] = {"baxter": 4e-4, "ur5": 5e-5, "panda": 1e-4}  # of the encoders by robot, rad
ROBOTS = tuple(POSITION_NOISE)
NOTHING = "nothing"
CASES: Mapping[str, tuple[str, ...]] = {
    "gravity_spring": ("gravity_spring",), "coulomb": ("joint_coulomb_friction",),
    "viscous": ("joint_viscous_friction",), "payload": ("payload",), "offset": ("torque_offset",),
    "rotor": ("rotor_inertia",), "link": ("link_inertia",), "gain": ("torque_gain",),
    "spring_coulomb": ("gravity_spring", "joint_coulomb_friction"),
    "payload_viscous": ("payload", "joint_viscous_friction"), NOTHING: (),
}  # fmt: skip
"""Dominant effects by case, under the catalogue's names."""
ORDERS = (*tuple(permutations(KINDS))[::2], *tuple(permutations(KINDS))[1::2])
"""Kinds of training, held-out and exam by seed; each kind trains in every third seed."""
DOMINANT = 0.8  # of the squared torque error of the model as described, that dominant effects make at least
VISIBLE = 0.5  # the same for the held-out run alone, on the joints that they act on
CLEARER = 0.9
"""Error that the clearest dominant effect leaves at most, over that of any other effect with no more numbers."""
SPREAD = 0.4
"""Of the squared error, in training or held out, that a single effect explains at most where none is dominant."""
ATTEMPTS, GROWTH = 100, 1.1
"""Draws at most, and how much larger each dominant effect is than the one before, where its size is free."""


@dataclass(frozen=True)
class Recording:
    """One run and what is known of it, (nj,) by joint, N m."""

    run: Run  # as recorded
    kind: str  # of its motion
    as_given: np.ndarray  # root mean square of the torque minus that of the described rigid bodies, without noise
    background: np.ndarray  # the same without the dominant effects


@dataclass(frozen=True)
class Case:
    """Recordings of one imperfect robot."""

    robot: str  # its name for `urdf.load`
    name: str  # of the case, a key of `CASES`
    seed: int  # that it was drawn with
    joints: tuple[str, ...]  # of the arm
    recordings: tuple[Recording, ...]  # two for training, one held out, one exam
    truth: tuple[Hidden, ...]  # the dominant effects
    typical: np.ndarray  # (nj,) typical torques, N m
    # by single effect and joint, (4,) share of each run's squared error that it leaves, fitted to the training
    left: Mapping[Atom, np.ndarray]
    draws: int  # how many were made until the case was clear
    exam_world: World  # the robot of the exam, on its motion
    exam_truth: tuple[Hidden, ...]  # the dominant effects as they are there

    @property
    def train(self) -> list[Run]:
        """Runs to fit."""
        return [recording.run for recording in self.recordings[:2]]

    @property
    def held_out(self) -> list[Run]:
        """Runs with another kind of motion."""
        return [self.recordings[2].run]

    @property
    def exam(self) -> list[Run]:
        """Runs that neither fit nor choice may see, with a third kind of motion."""
        return [self.recordings[3].run]

    @property
    def values(self) -> int:
        """How many numbers describe the dominant effects."""
        return sum(COUNT[hidden.effect] for hidden in self.truth)

    @property
    def affected(self) -> tuple[str, ...]:
        """Joints whose torque the dominant effects change; all for a mass, as it loads every joint before it."""
        if any(hidden.lump is not None for hidden in self.truth):
            return self.joints
        return tuple(hidden.joint for hidden in self.truth)

    def dominance(self, joints: Sequence[str] | None = None, recordings: slice = slice(None)) -> float:
        """Share of the squared torque error of the model as described, N m, that goes with the dominant effects."""
        which = [self.joints.index(joint) for joint in joints or self.joints]
        chosen = self.recordings[recordings]
        left, given = (
            sum(float(np.sum(errors[which] ** 2)) for errors in many)
            for many in ([r.background for r in chosen], [r.as_given for r in chosen])
        )
        return 1.0 - left / given

    @property
    def largest_single(self) -> float:
        """Share of the squared error that the best single effect explains, in training and in the held-out run each."""
        return max(min(1.0 - 0.5 * (left[0] + left[1]), 1.0 - left[2]) for left in self.left.values())

    @property
    def clear(self) -> bool:
        """Whether dominant effects dominate and one of them stands out; without any, whether no effect does."""
        if not self.truth:
            return self.largest_single <= SPREAD
        shares = (self.dominance(joints, runs) for joints in (None, self.affected) for runs in (slice(None), slice(2)))
        if min(shares) < DOMINANT or self.dominance(self.affected, slice(2, 3)) < VISIBLE:
            return False
        return any(self._stands_out(hidden) for hidden in self.truth)

    def _stands_out(self, hidden: Hidden) -> bool:
        mine = score(self.left[hidden.effect, hidden.joint]) - np.log(CLEARER)
        truth = {(h.effect, h.joint) for h in self.truth}
        rivals = (a for a in self.left if a not in truth and COUNT[a[0]] <= COUNT[hidden.effect])
        return all(mine <= score(self.left[rival]) for rival in rivals)


def generate(robot: str, name: str, seed: int, *, duration: float = 20.0, rate: float = 100.0) -> Case:
    """One case of a robot of `ROBOTS` and a name of `CASES`; every run lasts `duration` s."""
    plant = Plant(robot)
    rng = np.random.default_rng([seed, ROBOTS.index(robot), list(CASES).index(name)])
    order = ORDERS[seed % len(ORDERS)]
    kinds = (order[0], order[0], order[1], order[2])
    rooms = dict(zip(KINDS, plant.rooms(rng), strict=True))
    motions = [KINDS[kind](rng, rooms[kind], duration) for kind in kinds]
    stamps = np.arange(round(duration * rate)) / rate
    load = [plant.torques(motion.at(stamps[::COARSE]), plant.described, {}) for motion in motions]
    typical = plant.typical(np.array(load))

    def imperfect() -> list[World]:
        links = plant.described.off(rng)
        drive = Imperfections.drawn(rng, typical, plant.effort, POSITION_NOISE[robot])
        return [World(plant, links, drive.drifted(rng), motion, stamps) for motion in motions]

    worlds = imperfect()
    single = SingleEffects(worlds)
    background = [world.misfit(()) for world in worlds]
    for attempt in range(ATTEMPTS):
        if name == NOTHING and attempt > 0:
            worlds = imperfect()
            background = [world.misfit(()) for world in worlds]
        errors = float(np.sqrt(np.mean([np.sum(_rms(alone) ** 2) for alone in background])))
        truth = Joints(worlds, typical, errors).drawn(rng, CASES[name], GROWTH**attempt)
        present = [tuple(hidden.drifted(rng) for hidden in truth) for _ in worlds]
        misfits = [w.misfit(here) for w, here in zip(worlds, present, strict=True)] if truth else background
        noise = rng.standard_normal((len(worlds), 3, len(stamps), len(plant.joints)))
        recordings = tuple(
            Recording(world.recorded(present[i], noise[i], f"{kinds[i]} {i}"), kinds[i], _rms(misfits[i]), _rms(alone))
            for i, (world, alone) in enumerate(zip(worlds, background, strict=True))
        )
        case = Case(
            robot, name, seed, plant.joints, recordings, truth, typical, single.left(misfits), attempt + 1,
            worlds[-1], present[-1],
        )  # fmt: skip
        if case.clear:
            return case
    raise RuntimeError(f"case {name} of {robot}, seed {seed}: none of {ATTEMPTS} draws is clear")


def _rms(errors: np.ndarray) -> np.ndarray:
    """(nj,) of (k, nj)."""
    return np.sqrt(np.mean(errors**2, axis=0))
