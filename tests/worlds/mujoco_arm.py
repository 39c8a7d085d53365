"""Arms that MuJoCo simulates under a controller, with friction, rotors, loads and offsets that their description lacks.

The truth is MuJoCo's own, see `mujoco_plant`; of armdyn there is only the container of a recording, of `urdf` the
mended description. An arm has two training runs, one held out and an exam with faster motion. `KINDS` says what else a
kind of arms has. Sizes are relative to each joint's *typical torque*, the root mean square of what its rigid bodies ask
of it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from xml.etree import ElementTree as ET

import mujoco
import numpy as np

import urdf
from armdyn.run import Run
from urdf.find import distribution_file

from . import coloured
from .mujoco_plant import STEP, Hidden, Log, Path, Unknown, bare, compiled, rigid_torques, simulated, with_links_off

ROBOTS: Mapping[str, str] = {
    "z1": "z1_description/urdf/z1.urdf", "xarm7": "xarm_description/urdf/xarm7.urdf",
    "ur5": "ur_description/urdf/ur5_robot.urdf", "panda": "panda_description/urdf/panda.urdf",
    "kinova": "kinova_description/robots/kinova.urdf", "ur10": "ur_description/urdf/ur10_robot.urdf",
}  # fmt: skip
"""Files in example-robot-data; the seeds take the robots in turn."""
KINDS = ("ordinary", "ar1", "quantised", "unknown")
"""Ordinary: every second arm's description is off. All others are as described but for what is hidden, and ar1 has
coloured torque noise, quantised positions in steps, unknown a force on one joint that no catalogue has."""
RATES = (50.0, 100.0, 125.0, 200.0, 250.0)  # samples per second of a log; divisors of 1 / STEP
SECONDS = (25.0, 22.0, 20.0, 20.0)  # of two training runs, the held-out run and the exam
ROLES = ("training 1", "training 2", "held out", "exam")
SLOW, FAST = (0.08, 0.5), (0.3, 0.8)  # frequencies of the motion, and those of the exam, Hz
LEAST_TYPICAL = 0.02  # of the effort limit: typical torque of a joint that carries hardly anything
GIVING: Mapping[bool, float] = {False: 0.3, True: 0.03}  # rad: how far typical torque pushes a soft, a stiff drive
VISCOUS, COULOMB, ON_JOINT = (0.04, 0.2), (0.05, 0.25), 0.9  # of the typical torque; share of joints with it
LIGHT = (0.01, 0.05)
"""Coulomb friction of kinds whose verdict counts: a joint with COULOMB sticks for up to .3 s where it turns round, and
what friction it has there is no noise to any model; with LIGHT that is below the torque noise."""
ROTOR, BIG, HEAVIEST = (0.02, 0.08), 2, 0.5  # the same; joints that may have one; largest over the joint's inertia
CARRIED, PLACE, CARRIES = (0.004, 0.012), 0.08, 0.5  # kg per N m of the largest effort limit; m; share of arms
OFFSET, WITH_OFFSET = (0.03, 0.12), 0.25  # of the typical torque; share of joints
TORQUE_NOISE, POSITION_NOISE = (0.005, 0.01), (5e-5, 1e-4)  # of the typical torque; rad
CORRELATION = 0.6  # of the torque noise of one sample with that of the one before, for kind ar1
ENCODER = (2 * np.pi / 65536, 2 * np.pi / 16384, 1e-3)  # rad, steps of quantised positions
UNKNOWN, COGS = (0.5, 1.0), (5, 12)  # over all that is hidden on its joint; periods of a cogging per 2 pi
NOISES, SHARE = 3.0, 0.03
"""A hidden effect is visible if its torque has NOISES times the torque noise, or more than this noise and SHARE of its
joint's error of the model as described; all root mean squares in training."""


@dataclass(frozen=True)
class SimulatedArm:
    """One arm, what is hidden in it, and what it recorded."""

    seed: int
    kind: str
    robot: str
    joints: tuple[str, ...]
    exact: str  # URDF of the simulated links
    description: str  # URDF that its user has
    stiff: bool
    rate: float  # Hz
    resolution: float  # standard deviation of the positions' noise, or their steps for kind quantised, rad
    hidden: tuple[Hidden, ...]
    logs: tuple[Log, ...]  # without noise and offsets
    runs: tuple[Run, ...]  # by `ROLES`
    noise: np.ndarray  # (nj,) of the torques, N m
    misfit: np.ndarray  # (nj,) error of the model as described in training without noise, root mean square, N m
    unknown: tuple[str, float] | None  # joint with a force that no catalogue has, its share of the squared misfit there

    @property
    def off(self) -> bool:
        """Whether its description is off."""
        return self.description != self.exact


@lru_cache(maxsize=8)
def robot_of(name: str) -> urdf.Robot:
    """A robot as described, its inertias mended."""
    return urdf.load(distribution_file("example-robot-data", ROBOTS[name]), meshes=False)


def generate(
    seed: int, kind: str = "ordinary", *, sticking: bool = False, seconds: Sequence[float] = SECONDS
) -> SimulatedArm:
    """The arm of a seed; `sticking`: Coulomb friction as large for any kind as for ordinary arms."""
    rng = np.random.default_rng([seed, KINDS.index(kind), 60])
    name = list(ROBOTS)[seed % len(ROBOTS)]
    robot = robot_of(name)
    joints = robot.joint_names
    plain = bare(robot.urdf_xml, joints)
    exact = ET.tostring(plain, encoding="unicode")
    off = kind == "ordinary" and (seed // len(ROBOTS) + seed % len(ROBOTS) // 3) % 2 == 1
    description = ET.tostring(with_links_off(plain, rng), encoding="unicode") if off else exact
    stiff, rate = bool(rng.random() < 0.5), float(rng.choice(RATES))
    paths = [Path.drawn(rng, robot, FAST if k == 3 else SLOW, lasts) for k, lasts in enumerate(seconds)]
    coulomb = COULOMB if sticking or kind == "ordinary" else LIGHT
    hidden, typical = _drawn(rng, exact, robot, paths[0], coulomb)
    plant, bodies, every = compiled(exact, joints, hidden), compiled(exact, joints), round(1.0 / rate / STEP)
    further = _unknown(rng, plant, bodies, joints, paths[:2]) if kind == "unknown" else None
    noise = typical * rng.uniform(*TORQUE_NOISE, len(joints))
    giving = typical / GIVING[stiff]
    logs = tuple(simulated(plant, joints, path, every, giving, further) for path in paths)
    offset = np.zeros(len(joints))
    for one in hidden:
        if one.effect == "torque_offset":
            offset[joints.index(one.joint)] = one.values["torque"]
    encoder, jitter = float(rng.choice(ENCODER)), float(np.exp(rng.uniform(*np.log(POSITION_NOISE))))
    runs = []
    for role, log in zip(ROLES, logs, strict=True):
        white = rng.standard_normal((2, *log.q.shape))
        q = np.round(log.q / encoder) * encoder if kind == "quantised" else log.q + jitter * white[0]
        read = log.torque + offset + noise * (coloured(white[1], CORRELATION) if kind == "ar1" else white[1])
        runs.append(Run.from_arrays(np.arange(len(q)) / rate, {"q": q, "tau": read}, joints=joints, name=role))
    errors, sizes = _shown(hidden, exact, description, joints, logs[:2], offset)
    misfit = np.sqrt(np.mean(errors**2, axis=0))
    seen = [_judged(one, size, noise, misfit) for one, size in zip(hidden, sizes, strict=True)]
    unknown = None
    if further is not None:
        torque = np.vstack([log.unknown for log in logs[:2]])[:, further.joint]
        unknown = joints[further.joint], float(np.mean(torque**2) / misfit[further.joint] ** 2)
    return SimulatedArm(
        seed, kind, name, joints, exact, description, stiff, rate, encoder if kind == "quantised" else jitter,
        tuple(seen), logs, tuple(runs), noise, misfit, unknown,
    )  # fmt: skip


def _judged(one: Hidden, size: np.ndarray, noise: np.ndarray, misfit: np.ndarray) -> Hidden:
    """An effect with the (nj,) root mean square of its torque: its size, and whether it is visible."""
    visible = (size > NOISES * noise) | ((size > noise) & (size > SHARE * misfit))
    return replace(one, size=float(size[np.argmax(size / noise)]), visible=bool(np.any(visible)))


def _drawn(
    rng: np.random.Generator, exact: str, robot: urdf.Robot, path: Path, friction: tuple[float, float]
) -> tuple[tuple[Hidden, ...], np.ndarray]:
    """What is hidden, and the (nj,) typical torques, N m."""
    joints, model = robot.joint_names, compiled(exact, robot.joint_names)
    way = path.at(np.arange(0.0, path.seconds, 0.1))
    load = rigid_torques(model, joints, way)
    typical = np.maximum(np.sqrt(np.mean(load**2, axis=0)), LEAST_TYPICAL * robot.limits.effort)
    speed, brisk = (np.sqrt(np.mean(x**2, axis=0)) for x in way[1:])
    unit, still = np.eye(len(joints)), np.zeros((len(joints), len(joints)))
    at = np.tile(way[0].mean(axis=0), (len(joints), 1))
    moved, held = (rigid_torques(model, joints, (at, still, a)) for a in (unit, still))
    inertia = np.diag(moved - held)
    hidden = []
    for j, joint in enumerate(joints):
        viscous, coulomb, offset = (float(typical[j] * rng.uniform(*span)) for span in (VISCOUS, friction, OFFSET))
        chance, sign = rng.random(3), rng.choice([-1.0, 1.0])
        if chance[0] < ON_JOINT:
            hidden.append(Hidden("joint_viscous_friction", joint, {"coefficient": viscous / float(speed[j])}))
        if chance[1] < ON_JOINT:
            hidden.append(Hidden("joint_coulomb_friction", joint, {"torque": coulomb}))
        if chance[2] < WITH_OFFSET:
            hidden.append(Hidden("torque_offset", joint, {"torque": float(sign) * offset}))
    for j in sorted(np.argsort(typical)[-BIG:]):
        size = min(typical[j] * rng.uniform(*ROTOR) / brisk[j], HEAVIEST * inertia[j])
        if rng.random() < ON_JOINT:
            hidden.append(Hidden("rotor_inertia", joints[j], {"inertia": float(size)}))
    mass, place = robot.limits.effort.max() * rng.uniform(*CARRIED), rng.uniform(-PLACE, PLACE, 3)
    if rng.random() < CARRIES:
        values = {"mass": float(mass), **dict(zip("xyz", place.tolist(), strict=True))}
        hidden.append(Hidden("payload", joints[-1], values))
    return tuple(hidden), typical


def _unknown(
    rng: np.random.Generator,
    plant: mujoco.MjModel,
    bodies: mujoco.MjModel,
    joints: tuple[str, ...],
    paths: Sequence[Path],
) -> Unknown:
    """A force on one joint, as large as half of what is hidden there, or all of it."""
    joint = int(rng.integers(1, len(joints)))
    other = joint if rng.random() < 0.5 else joint - 1
    centre = float(np.mean([path.centre[joint] for path in paths]))
    trial = Unknown(joint, other, 1.0, float(rng.integers(*COGS, endpoint=True)), centre)
    each = [path.at(np.arange(0.0, path.seconds, 0.1)) for path in paths]
    way = tuple(np.vstack(parts) for parts in zip(*each, strict=True))
    asked, missing = (rigid_torques(model, joints, way)[:, joint] for model in (plant, bodies))
    size, error = (np.sqrt(np.mean(x**2)) for x in (trial.torque(*way[:2])[:, joint], asked - missing))
    return replace(trial, size=float(rng.uniform(*UNKNOWN) * error / size))


def _shown(
    hidden: tuple[Hidden, ...],
    exact: str,
    description: str,
    joints: tuple[str, ...],
    logs: tuple[Log, ...],
    offset: np.ndarray,
) -> tuple[np.ndarray, list[np.ndarray]]:
    """(n, nj) errors of the model as described, N m, and by hidden effect the (nj,) root mean square of its torque."""

    def asked(model: mujoco.MjModel) -> np.ndarray:
        return np.vstack([rigid_torques(model, joints, log) for log in logs])

    bodies = compiled(exact, joints)
    errors = np.vstack([log.torque for log in logs]) + offset - asked(compiled(description, joints))
    sizes = []
    for one in hidden:
        j, torque = joints.index(one.joint), np.zeros_like(errors)
        if one.effect == "joint_viscous_friction":
            torque[:, j] = one.values["coefficient"] * np.vstack([log.v for log in logs])[:, j]
        elif one.effect == "joint_coulomb_friction":
            torque[:, j] = np.vstack([log.friction for log in logs])[:, j]
        elif one.effect == "rotor_inertia":
            torque[:, j] = one.values["inertia"] * np.vstack([log.a for log in logs])[:, j]
        elif one.effect == "torque_offset":
            torque[:, j] = one.values["torque"]
        else:
            torque = asked(compiled(exact, joints, (one,))) - asked(bodies)
        sizes.append(np.sqrt(np.mean(torque**2, axis=0)))
    return errors, sizes
