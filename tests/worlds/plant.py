"""A robot whose links, joints and sensors may be imperfect, and what it records on a motion."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicSpline

import urdf
from armdyn.run import Channel, Run
from urdf import known_robots
from urdf.find import distribution_file

from . import bodies
from .bodies import Links
from .drive import Hidden, Imperfections, JointMotion, Lump
from .motions import KINDS, Derivatives, Motion, Room

FARTHEST = 1.4  # from the robot's home, rad
MARGIN = 0.05  # to position limits, rad
REGIONS, SWING = (0.3, 0.5, 0.7), 0.28
"""Centres of three regions, and how far motions go from them, in widths of a joint's range."""
SLOWED, FASTEST, BRISKEST = 0.6, 2.0, 12.0
"""Share of the velocity limits that is used, and no more than so many rad/s and rad/s^2."""
EDGE = 0.5
"""s at either end that errors are not measured on, where splines and filters have neighbours on one side only."""
LEAST_TYPICAL = 0.02  # of the effort limit: typical torque of a joint that has hardly any load


def source(robot: str) -> str:
    """What `urdf.load` takes for a robot known by name, or by its file in example-robot-data."""
    return robot if robot in known_robots() else str(distribution_file("example-robot-data", robot))


@lru_cache(maxsize=8)
class Plant:
    """A robot's rigid bodies, with a lump that can be put on each link."""

    def __init__(self, name: str) -> None:
        robot = urdf.load(name)
        self.joints = robot.joint_names
        self.effort = robot.limits.effort
        self.lower = np.maximum(robot.limits.lower + MARGIN, robot.home - FARTHEST)
        self.upper = np.minimum(robot.limits.upper - MARGIN, robot.home + FARTHEST)
        self.speed = np.minimum(SLOWED * robot.limits.velocity, FASTEST)
        self.acceleration = np.minimum(robot.limits.acceleration, BRISKEST)
        self._model = bodies.compiled(robot.urdf_xml, self.joints)
        # MuJoCo takes shortcuts for bodies whose centre is at their origin; here centres move.
        self._model.body_sameframe[:] = 0
        self._model.body_simple[:] = 0
        self._model.dof_simplenum[:] = 0
        self._lump = [self._model.body(f"lump on {joint}").id for joint in self.joints]
        self._model.body_mass[self._lump] = 0.0
        self._model.body_inertia[self._lump] = 0.0
        self._first_links = [int(self._model.jnt_bodyid[self._model.joint(joint).id]) for joint in self.joints]
        self.described = Links.of(self._model)

    def rooms(self, rng: np.random.Generator) -> list[Room]:
        """Three regions that overlap by about a half with the next, in another order for every joint."""
        width = self.upper - self.lower
        share = rng.permuted(np.tile(REGIONS, (len(self.joints), 1)), axis=1)
        return [Room(self.lower + width * share[:, k], SWING * width, self.speed, self.acceleration) for k in range(3)]

    def link(self, joint: int) -> tuple[float, np.ndarray]:
        """Mass [kg] and centre (3,) [m] of the link that a joint moves, without what is fixed to it."""
        body = self._first_links[joint]
        return float(self.described.mass[body]), self.described.centre[body]

    def heavier(self, ratio: np.ndarray) -> Links:
        """Links and what is fixed to them, with `ratio` (nj,) times the described masses and inertias."""
        factor = np.ones(self._model.nbody)
        for body in range(1, self._model.nbody):
            carrier = body
            while carrier and carrier not in self._first_links:
                carrier = int(self._model.body_parentid[carrier])
            if carrier:
                factor[body] = ratio[self._first_links.index(carrier)]
        mass, centre, inertia = self.described
        return Links(factor * mass, centre, factor[:, None] * inertia)

    @contextmanager
    def in_gravity(self, gravity: Sequence[float] | np.ndarray | None) -> Iterator[None]:
        """The robot in another gravity, in the frame of its base, m/s^2; downwards where None."""
        before = self._model.opt.gravity.copy()
        if gravity is not None:
            self._model.opt.gravity[:] = gravity
        try:
            yield
        finally:
            self._model.opt.gravity[:] = before

    def torques(self, motion: Derivatives, links: Links, lumps: Mapping[int, Lump]) -> np.ndarray:
        """(n, nj) N m at a motion (q, v, a) with these links and, by joint, lumps on them."""
        mass, centre, inertia = links.mass.copy(), links.centre.copy(), links.inertia.copy()
        for joint, lump in lumps.items():
            body = self._lump[joint]
            mass[body], centre[body], inertia[body] = lump.mass, lump.place, lump.inertia
        Links(mass, centre, inertia).into(self._model)
        return bodies.torques(self._model, self.joints, *motion)

    def weight(self, q: np.ndarray) -> np.ndarray:
        """(n, nj) N m that hold the arm as described at rest at positions (n, nj), rad."""
        return self.torques((q, np.zeros_like(q), np.zeros_like(q)), self.described, {})

    def typical(self, load: np.ndarray) -> np.ndarray:
        """(nj,) typical torques of (..., nj) loads, N m."""
        mean = np.mean(np.square(load), axis=tuple(range(load.ndim - 1)))
        return np.maximum(np.sqrt(mean), LEAST_TYPICAL * self.effort)


@dataclass(frozen=True)
class World:
    """One run of one robot."""

    plant: Plant  # the robot
    links: Links  # its true ones
    drive: Imperfections  # of its joints, in this run
    motion: Motion  # of its links
    stamps: np.ndarray  # (n,) s
    # (n, nj) N m that its drives give besides, at its motors' motion
    further: Callable[[Derivatives], np.ndarray] | None = None

    @property
    def _rate(self) -> float:
        return 1.0 / float(self.stamps[1] - self.stamps[0])

    @property
    def inner(self) -> slice:
        """Samples without the ends."""
        edge = round(EDGE * self._rate)
        return slice(edge, len(self.stamps) - edge)

    _loads: dict[tuple[tuple[int, Lump], ...], np.ndarray] = field(default_factory=dict, init=False)
    _earlier: dict[float, "World"] = field(default_factory=dict, init=False)

    def load(self, truth: Sequence[Hidden] = ()) -> np.ndarray:
        """(n, nj) torques that the links, and what is on them, ask of the joints when the torques are taken, N m."""
        lumps = tuple((self.plant.joints.index(h.joint), h.lump) for h in truth if h.lump is not None)
        if lumps not in self._loads:
            motion = self.motion.at(self.stamps - self.drive.late)
            self._loads[lumps] = self.plant.torques(motion, self.links, dict(lumps))
        return self._loads[lumps]

    def motor(self, load: np.ndarray) -> Derivatives:
        """The motors' (n, nj) motion: the links', and how far the joints' springs give way under the load."""
        q, v, a = self.motion.at(self.stamps - self.drive.late)
        bent = CubicSpline(self.stamps, load * self.drive.compliance)
        return q + bent(self.stamps), v + bent(self.stamps, 1), a + bent(self.stamps, 2)

    def measured(self, truth: Sequence[Hidden]) -> tuple[np.ndarray, np.ndarray]:
        """(n, nj) motor positions [rad] at the stamps and torques [N m], without noise and smoothing."""
        q, torque = self._in_time(truth)
        delays = {hidden.joint: delay for hidden in truth if (delay := hidden.reading("torque_delay"))}
        for late in set(delays.values()):
            joints = [self.plant.joints.index(joint) for joint, delay in delays.items() if delay == late]
            if late not in self._earlier:
                self._earlier[late] = replace(self, stamps=self.stamps - late)
            torque[:, joints] = self._earlier[late]._in_time(truth)[1][:, joints]
        return q, torque

    def _in_time(self, truth: Sequence[Hidden]) -> tuple[np.ndarray, np.ndarray]:
        """See `measured`; readings of single joints are not late."""
        load = self.load(truth)
        q, v, a = self.motor(load)
        torque, way = load + self.drive.torque(q, v), self.drive.sliding(v)
        columns = [(hidden, self.plant.joints.index(hidden.joint)) for hidden in truth]
        for hidden, j in columns:
            torque[:, j] += hidden.torque(JointMotion(q[:, j], v[:, j], a[:, j], load[:, j], way[:, j]))
        if self.further is not None:
            torque += self.further((q, v, a))
        for hidden, j in columns:
            torque[:, j] *= 1.0 + hidden.reading("torque_gain")
        for hidden, j in columns:
            torque[:, j] += hidden.reading("torque_offset")
        if self.drive.late > 0.0:
            q = CubicSpline(self.stamps - self.drive.late, q)(self.stamps)
        return q, torque

    def misfit(self, truth: Sequence[Hidden]) -> np.ndarray:
        """(k, nj) torques minus those of the described links at the motors' motion, at inner samples, N m."""
        q, torque = self.measured(truth)
        curve = CubicSpline(self.stamps, q)
        motion = (q, curve(self.stamps, 1), curve(self.stamps, 2))
        return (self.drive.read(torque, self._rate) - self.plant.torques(motion, self.plant.described, {}))[self.inner]

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
