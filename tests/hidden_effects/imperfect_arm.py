"""Recordings of imperfect robots, with one or two dominant effects that the model lacks, or with none.

Every robot has the errors of `imperfections` on all of its joints and links, always. A dominant effect is so large that
it makes most of the squared torque error of the model as described: `Case.dominance` says how much. Rigid bodies are
MuJoCo's, the joints are plain numpy; of armdyn there is nothing but the container of a recording.

A case has two training runs of one kind of motion, a held-out run of another and an exam of the third, each kind in
another region of the joints' range.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import permutations

import numpy as np
from scipy.interpolate import CubicSpline

import urdf
from armdyn.run import Channel, Run

from . import bodies, dominant
from .dominant import Hidden, Joints
from .imperfections import Imperfections, Links
from .motions import KINDS, Motion, Room

POSITION_NOISE: Mapping[str, float] = {"baxter": 4e-4, "ur5": 5e-5, "panda": 1e-4}
"""Of the encoders by robot, rad."""
ROBOTS = tuple(POSITION_NOISE)
NOTHING = "nothing"
CASES: Mapping[str, tuple[str, ...]] = {
    "gravity_spring": ("gravity_spring",),
    "coulomb": ("joint_coulomb_friction",),
    "viscous": ("joint_viscous_friction",),
    "payload": ("payload",),
    "offset": ("torque_offset",),
    "rotor": ("rotor_inertia",),
    "link": ("link_inertia",),
    "gain": ("torque_gain",),
    "spring_coulomb": ("gravity_spring", "joint_coulomb_friction"),
    "payload_viscous": ("payload", "joint_viscous_friction"),
    NOTHING: (),
}
"""Dominant effects by case, under the catalogue's names."""
ORDERS = tuple(permutations(KINDS))
FARTHEST = 1.4
"""From the robot's home, rad."""
REGIONS, SWING = (0.3, 0.5, 0.7), 0.28
"""Centres of the three kinds' regions, and how far motions go from them, in widths of a joint's range."""
SLOWED, FASTEST, BRISKEST = 0.6, 2.0, 12.0
"""Share of the velocity limits that is used, and no more than so many rad/s and rad/s^2."""
LEAST_TYPICAL = 0.02
"""Of the effort limit: typical torque of a joint that has hardly any load."""
DOMINANT = 0.8
"""Of the squared torque error of the model as described, that a dominant effect makes at least."""
ATTEMPTS, GROWTH = 30, 1.15
"""Draws of a dominant effect at most, and how much larger each is than the one before, where its size is free."""
COARSE = 20
"""Samples of which one is enough to measure the size of an effect."""
EDGE = 0.5
"""s at either end that errors are not measured on, where splines and filters have neighbours on one side only."""


@dataclass(frozen=True)
class Recording:
    """One run and what is known of it, (nj,) by joint, N m.

    Attributes:
        run: as recorded.
        kind: of its motion.
        as_given: root mean square of the torque minus that of the described rigid bodies, without noise.
        background: the same without the dominant effects.
    """

    run: Run
    kind: str
    as_given: np.ndarray
    background: np.ndarray


@dataclass(frozen=True)
class Case:
    """Recordings of one imperfect robot.

    Attributes:
        robot: its name for `urdf.load`.
        name: of the case, a key of `CASES`.
        seed: that it was drawn with.
        joints: of the arm.
        recordings: two for training, one held out, one exam.
        truth: the dominant effects.
        typical: (nj,) typical torques, N m.
    """

    robot: str
    name: str
    seed: int
    joints: tuple[str, ...]
    recordings: tuple[Recording, ...]
    truth: tuple[Hidden, ...]
    typical: np.ndarray

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
        return sum(hidden.count for hidden in self.truth)

    @property
    def dominates(self) -> bool:
        """Whether the dominant effects make `DOMINANT` of the squared error, in training and in all runs together."""
        shares = (self.dominance(joints, runs) for joints in (None, self.affected) for runs in (slice(None), slice(2)))
        return min(shares) >= DOMINANT

    @property
    def affected(self) -> tuple[str, ...]:
        """Joints whose torque the dominant effects change; all for a mass, as it loads every joint before it."""
        if any(hidden.lump is not None for hidden in self.truth):
            return self.joints
        return tuple(hidden.joint for hidden in self.truth)

    def dominance(self, joints: Sequence[str] | None = None, recordings: slice = slice(None)) -> float:
        """Share of the squared torque error of the model as described that goes with the dominant effects.

        Args:
            joints: on which; on all, in N m, by default.
            recordings: in which.
        """
        which = [self.joints.index(joint) for joint in joints or self.joints]
        chosen = self.recordings[recordings]
        left, given = (
            sum(float(np.sum(errors[which] ** 2)) for errors in many)
            for many in ([r.background for r in chosen], [r.as_given for r in chosen])
        )
        return 1.0 - left / given


@lru_cache(maxsize=len(POSITION_NOISE))
class Plant:
    """A robot's rigid bodies, with a lump that can be put on each link.

    Args:
        name: of the robot.
    """

    def __init__(self, name: str) -> None:
        robot = urdf.load(name)
        self.joints = robot.joint_names
        self.effort = robot.limits.effort
        margin = 0.05
        self.lower = np.maximum(robot.limits.lower + margin, robot.home - FARTHEST)
        self.upper = np.minimum(robot.limits.upper - margin, robot.home + FARTHEST)
        self.speed = np.minimum(SLOWED * robot.limits.velocity, FASTEST)
        self.acceleration = np.minimum(robot.limits.acceleration, BRISKEST)
        lumps = [bodies.Attachment(f"lump on {joint}", joint) for joint in self.joints]
        self._model = bodies.compiled(robot.urdf_xml, lumps, self.joints)
        # MuJoCo takes shortcuts for bodies whose centre is at their origin; here centres move.
        self._model.body_sameframe[:] = 0
        self._model.body_simple[:] = 0
        self._model.dof_simplenum[:] = 0
        self._lump = [self._model.body(lump.name).id for lump in lumps]
        self._model.body_mass[self._lump] = 0.0
        self._model.body_inertia[self._lump] = 0.0
        self._first_links = [self._model.jnt_bodyid[self._model.joint(joint).id] for joint in self.joints]
        self.described = Links.of(self._model)

    def rooms(self, rng: np.random.Generator) -> list[Room]:
        """Three regions that overlap by about a third, in another order for every joint."""
        width = self.upper - self.lower
        share = rng.permuted(np.tile(REGIONS, (len(self.joints), 1)), axis=1)
        return [Room(self.lower + width * share[:, k], SWING * width, self.speed, self.acceleration) for k in range(3)]

    def link(self, joint: int) -> tuple[float, np.ndarray]:
        """Mass [kg] and centre (3,) [m] of the link that a joint moves, without what is fixed to it."""
        body = self._first_links[joint]
        return float(self.described.mass[body]), self.described.centre[body]

    def torques(
        self, motion: tuple[np.ndarray, np.ndarray, np.ndarray], links: Links, lumps: Mapping[int, dominant.Lump]
    ) -> np.ndarray:
        """(n, nj) N m at a motion (q, v, a) with these links and, by joint, lumps on them."""
        mass, centre, inertia = links.mass.copy(), links.centre.copy(), links.inertia.copy()
        for joint, lump in lumps.items():
            body = self._lump[joint]
            mass[body], centre[body], inertia[body] = lump.mass, lump.place, lump.inertia
        Links(mass, centre, inertia).into(self._model)
        return bodies.torques(self._model, self.joints, *motion)


def generate(robot: str, name: str, seed: int, *, duration: float = 20.0, rate: float = 100.0) -> Case:
    """One case.

    Args:
        robot: of `ROBOTS`.
        name: of `CASES`.
        seed: of everything that is random.
        duration: of every run, s.
        rate: samples per second.
    """
    plant = Plant(robot)
    rng = np.random.default_rng([seed, ROBOTS.index(robot), list(CASES).index(name)])
    order = ORDERS[seed % len(ORDERS)]
    rooms = dict(zip(KINDS, plant.rooms(rng), strict=True))
    kinds = (order[0], order[0], order[1], order[2])
    motions = [KINDS[kind](rng, rooms[kind], duration) for kind in kinds]
    links = plant.described.off(rng)
    stamps = np.arange(round(duration * rate)) / rate
    load = np.array([plant.torques(motion.at(stamps[::COARSE]), links, {}) for motion in motions])
    typical = np.maximum(np.sqrt(np.mean(load**2, axis=(0, 1))), LEAST_TYPICAL * plant.effort)
    drive = Imperfections.drawn(rng, typical, plant.effort, POSITION_NOISE[robot])
    worlds = [World(plant, links, drive.drifted(rng), motion, stamps) for motion in motions]
    background = [world.misfit(()) for world in worlds]
    joints = _joints(plant, worlds, typical, background)
    for attempt in range(ATTEMPTS):
        truth = dominant.drawn(rng, CASES[name], joints, GROWTH**attempt)
        present = [tuple(hidden.drifted(rng) for hidden in truth) for _ in worlds]
        as_given = [w.misfit(here) for w, here in zip(worlds, present, strict=True)] if truth else background
        noise = rng.standard_normal((len(worlds), 3, len(stamps), len(plant.joints)))
        recordings = tuple(
            Recording(world.recorded(here, noise[i], f"{kind} {i}"), kind, as_given[i], background[i])
            for i, (world, here, kind) in enumerate(zip(worlds, present, kinds, strict=True))
        )
        case = Case(robot, name, seed, plant.joints, recordings, truth, typical)
        # Errors of the links may happen to cancel much of an effect; another, larger one is drawn then.
        if not truth or case.dominates:
            return case
    raise RuntimeError(f"case {name} of {robot}, seed {seed}: no effect of {ATTEMPTS} dominates")


@dataclass(frozen=True)
class World:
    """One run of one robot.

    Attributes:
        plant: the robot.
        links: its true ones.
        drive: of its joints, in this run.
        motion: of its links.
        stamps: (n,) s.
    """

    plant: Plant
    links: Links
    drive: Imperfections
    motion: Motion
    stamps: np.ndarray

    @property
    def _rate(self) -> float:
        return 1.0 / float(self.stamps[1] - self.stamps[0])

    @cached_property
    def bare_load(self) -> np.ndarray:
        """(n, nj) torques that the links alone ask of the joints when the torques are taken, N m."""
        return self.plant.torques(self.motion.at(self.stamps - self.drive.late), self.links, {})

    def load(self, truth: Sequence[Hidden] = ()) -> np.ndarray:
        """(n, nj) torques that the links, and what is on them, ask of the joints when the torques are taken, N m."""
        if not any(hidden.lump for hidden in truth):
            return self.bare_load
        motion = self.motion.at(self.stamps - self.drive.late)
        lumps = {self.plant.joints.index(h.joint): h.lump for h in truth if h.lump is not None}
        return self.plant.torques(motion, self.links, lumps)

    def motor(self, load: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The motors' (n, nj) motion: the links', and how far the joints' springs give way under the load."""
        q, v, a = self.motion.at(self.stamps - self.drive.late)
        bent = CubicSpline(self.stamps, load * self.drive.compliance)
        return q + bent(self.stamps), v + bent(self.stamps, 1), a + bent(self.stamps, 2)

    def measured(self, truth: Sequence[Hidden]) -> tuple[np.ndarray, np.ndarray]:
        """(n, nj) motor positions [rad] at the stamps and torques [N m], without noise and smoothing."""
        load = self.load(truth)
        q, v, a = self.motor(load)
        torque = load + self.drive.torque(q, v)
        for hidden in truth:
            j = self.plant.joints.index(hidden.joint)
            torque[:, j] += hidden.torque(q[:, j], v[:, j], a[:, j])
        for hidden in truth:
            j = self.plant.joints.index(hidden.joint)
            torque[:, j] = hidden.gain * torque[:, j] + hidden.offset
        if self.drive.late > 0.0:
            q = CubicSpline(self.stamps - self.drive.late, q)(self.stamps)
        return q, torque

    def misfit(self, truth: Sequence[Hidden]) -> np.ndarray:
        """(nj,) root mean square of the torques minus those of the described links at the motors' motion, N m."""
        q, torque = self.measured(truth)
        curve = CubicSpline(self.stamps, q)
        motion = (q, curve(self.stamps, 1), curve(self.stamps, 2))
        inner = slice(round(EDGE * self._rate), -round(EDGE * self._rate))
        error = self.drive.read(torque, self._rate) - self.plant.torques(motion, self.plant.described, {})
        return np.sqrt(np.mean(error[inner] ** 2, axis=0))

    def recorded(self, truth: Sequence[Hidden], noise: np.ndarray, name: str) -> Run:
        """The recording, with (3, n, nj) standard normal noise for positions and, before and after smoothing, torques.

        It does not state its noise, as most do not.
        """
        q, torque = self.measured(truth)
        q = q + self.drive.position_noise * noise[0]
        effort = self.drive.read(torque, self._rate, noise[1:])
        channels = {f"q.{j}": Channel(self.stamps, q[:, i], "rad") for i, j in enumerate(self.plant.joints)}
        channels |= {f"tau.{j}": Channel(self.stamps, effort[:, i], "N m") for i, j in enumerate(self.plant.joints)}
        return Run(name, channels)


def perfect(robot: str, kind: str, seed: int, *, duration: float = 5.0, rate: float = 100.0) -> World:
    """A run of a robot that is as described."""
    plant, rng = Plant(robot), np.random.default_rng(seed)
    motion = KINDS[kind](rng, plant.rooms(rng)[0], duration)
    stamps = np.arange(round(duration * rate)) / rate
    return World(plant, plant.described, Imperfections.none(len(plant.joints)), motion, stamps)


def _joints(plant: Plant, worlds: Sequence[World], typical: np.ndarray, background: Sequence[np.ndarray]) -> Joints:
    """What the sizes of dominant effects depend on."""
    motions = [world.motor(world.bare_load) for world in worlds]
    q, v, a = (np.concatenate([motion[k] for motion in motions]) for k in range(3))
    coarse = [replace(world, stamps=world.stamps[::COARSE]) for world in worlds]

    def added(joint: int, lump: dominant.Lump) -> float:
        hidden = (Hidden("payload", plant.joints[joint], lump=lump),)
        squares = [np.sum((world.load(hidden) - world.bare_load) ** 2, axis=1) for world in coarse]
        return float(np.sqrt(np.mean(squares)))

    return Joints(
        names=plant.joints,
        q=q, v=v, a=a, load=np.concatenate([world.bare_load for world in worlds]),
        strong=tuple(np.flatnonzero(plant.effort >= 0.5 * plant.effort.max()).tolist()),
        loaded=tuple(np.flatnonzero(typical >= 0.3 * typical.max()).tolist()),
        background=float(np.sqrt(np.mean([np.sum(b**2) for b in background]))),
        link=plant.link,
        added=added,
    )  # fmt: skip
