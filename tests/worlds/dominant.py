"""Effects so large that each alone outweighs all other errors of a robot, and what single effects explain."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .drive import Hidden, JointMotion, Lump, on_link, sliding
from .plant import World

RATIO = (2.4, 4.0)
"""Root mean square of a dominant torque over that of all other errors, over all joints and runs; 2.4 makes 85 %."""
GAIN = (0.2, 0.4)  # share by which a torque is read too large or too small
HEAVIER = (0.5, 1.0)  # mass that a link has too much, of its own
ELSEWHERE = (0.05, 0.12)  # how far from the link's centre that is, m
GYRATION = 0.03  # of such a mass, m
STEEP = 0.8  # how far the middle of a joint's motion is at most from where its spring changes fastest, rad
COARSE = 20  # samples of which one is enough to measure the size of an effect
THIN = 40  # samples of which one shows what a single effect explains
ARM = 0.1  # m from a link's frame to the point masses that span what its inertia may be
TINY = 1e-9  # of the largest singular value; smaller ones are those of numbers that cannot be seen
Atom = tuple[str, str]  # effect and joint


@dataclass(frozen=True)
class Joints:
    """What the size of an effect depends on."""

    worlds: Sequence[World]  # runs of one robot
    typical: np.ndarray  # (nj,) torques of its joints, N m
    background: float  # root mean square of all other errors over all joints together, N m

    def drawn(self, rng: np.random.Generator, effects: Sequence[str], growth: float = 1.0) -> tuple[Hidden, ...]:
        """These effects, each on a joint of its own and `growth` times `RATIO` as large as all other errors.

        A link's mass and a gain have sizes of their own; they are put where they are that large.
        """
        motions = [world.motor(world.load()) for world in self.worlds]
        q, v, a = (np.concatenate([motion[k] for motion in motions]) for k in range(3))
        motion = JointMotion(q, v, a, np.concatenate([world.load() for world in self.worlds]), sliding(v))
        found: list[Hidden] = []
        for effect in effects:
            wanted = growth * self.background * rng.uniform(*RATIO)
            if effect == "payload":
                found.append(self._payload(rng, wanted))
            elif effect == "link_inertia":
                found.append(self._link(rng))
            elif effect == "torque_gain":
                found.append(self._gain(rng, motion.load))
            else:
                found.append(self._drive(rng, effect, motion, {hidden.joint for hidden in found}, wanted))
        return tuple(found)

    def _drive(
        self, rng: np.random.Generator, effect: str, motion: JointMotion, taken: set[str], wanted: float
    ) -> Hidden:
        """An effect on a joint with a large drive, a spring on one with much to carry."""
        plant = self.worlds[0].plant
        size, share = (self.typical, 0.3) if effect == "gravity_spring" else (plant.effort, 0.5)
        possible = np.flatnonzero(size >= share * size.max()).tolist()
        j = int(rng.choice([k for k in possible if plant.joints[k] not in taken] or possible))
        own, sign = JointMotion(*(part[:, j] for part in motion)), float(rng.choice([-1.0, 1.0]))
        values = {
            "joint_coulomb_friction": {"torque": 1.0}, "joint_viscous_friction": {"coefficient": 1.0},
            "rotor_inertia": {"inertia": 1.0}, "torque_offset": {"torque": sign},
        }  # fmt: skip
        if effect == "gravity_spring":
            steepest = 0.5 * (own.q.min() + own.q.max()) + rng.uniform(-STEEP, STEEP)
            values[effect] = {"sine": sign * float(np.cos(steepest)), "cosine": -sign * float(np.sin(steepest))}
        unit = Hidden(effect, plant.joints[j], values[effect])
        return unit.times(wanted / _rms(unit.torque(own) + unit.reading("torque_offset")))

    def _added(self, joint: int, lump: Lump) -> float:
        """Root mean square over all joints together of what a lump on a link adds, N m."""
        coarse = [replace(world, stamps=world.stamps[::COARSE]) for world in self.worlds]
        hidden = (on_link("payload", self.worlds[0].plant.joints[joint], lump),)
        squares = [np.sum((world.load(hidden) - world.load()) ** 2, axis=1) for world in coarse]
        return float(np.sqrt(np.mean(squares)))

    def _payload(self, rng: np.random.Generator, wanted: float) -> Hidden:
        """A point mass on the last link."""
        x, y = rng.uniform(-0.05, 0.05, 2)
        lump = Lump(1.0, (float(x), float(y), float(rng.uniform(0.05, 0.15))))
        joints = self.worlds[0].plant.joints
        return on_link("payload", joints[-1], lump._replace(mass=wanted / self._added(len(joints) - 1, lump)))

    def _link(self, rng: np.random.Generator) -> Hidden:
        """More mass at another place of a link, not the last, where it is as large as it should be or nearly so."""
        plant, sizes, lumps = self.worlds[0].plant, [], []
        for j in range(1, len(plant.joints) - 1):
            mass, centre = plant.link(j)
            way = rng.standard_normal(3)
            place = centre + way / np.linalg.norm(way) * rng.uniform(*ELSEWHERE)
            more = mass * rng.uniform(*HEAVIER)
            lumps.append(Lump(more, (float(place[0]), float(place[1]), float(place[2])), more * GYRATION**2))
            sizes.append(self._added(j, lumps[-1]))
        chosen = self._large(rng, np.array(sizes))
        return on_link("link_inertia", plant.joints[1 + chosen], lumps[chosen])

    def _gain(self, rng: np.random.Generator, load: np.ndarray) -> Hidden:
        """A wrong gain on a joint with load enough."""
        error = float(rng.choice([-1.0, 1.0]) * rng.uniform(*GAIN))
        chosen = self._large(rng, np.array([_rms(error * column) for column in load.T]))
        return Hidden("torque_gain", self.worlds[0].plant.joints[chosen], {"error": error})

    def _large(self, rng: np.random.Generator, sizes: np.ndarray) -> int:
        """One that is as large as it should be, else the largest."""
        large = np.flatnonzero(sizes >= RATIO[0] * self.background)
        return int(rng.choice(large)) if len(large) else int(np.argmax(sizes))


class SingleEffects:
    """How much of a torque error each single effect on one joint explains, by plain least squares without noise.

    It tells which cases have a clear answer: nothing of armdyn takes part. Worlds are two training runs, the held-out
    run and the exam.
    """

    def __init__(self, worlds: Sequence[World]) -> None:
        terms = [_terms(world, slice(world.inner.start, world.inner.stop, THIN)) for world in worlds]
        self._terms: dict[Atom, list[np.ndarray]] = {atom: [term[atom] for term in terms] for atom in terms[0]}

    def left(self, misfits: Sequence[np.ndarray]) -> Mapping[Atom, np.ndarray]:
        """By effect and joint: (r,) share of each run's squared (k, nj) misfit that a fit to the training leaves."""
        errors = [misfit[::THIN].ravel() for misfit in misfits]
        found = {}
        for atom, terms in self._terms.items():
            values = np.linalg.lstsq(np.vstack(terms[:2]), np.concatenate(errors[:2]), rcond=TINY)[0]
            found[atom] = np.array(
                [np.sum((e - term @ values) ** 2) / np.sum(e**2) for e, term in zip(errors, terms, strict=True)]
            )
        return found


def score(left: np.ndarray) -> float:
    """Logarithm of what is left in training and in the held-out run, weighed alike; lower is better."""
    return 0.5 * float(np.log(0.5 * (left[0] + left[1])) + np.log(left[2]))


def _terms(world: World, rows: slice) -> dict[Atom, np.ndarray]:
    """(k nj, p) torque per number of each effect on each joint."""
    plant = world.plant
    motion = world.motion.at(world.stamps[rows])
    q, v, a = motion
    load = plant.torques(motion, plant.described, {})
    one = np.ones_like(q)
    own: Mapping[str, Sequence[np.ndarray]] = {
        "gravity_spring": (np.sin(q), np.cos(q)),
        "joint_coulomb_friction": (sliding(v),),
        "joint_asymmetric_friction": (sliding(v), one),
        "joint_viscous_friction": (v,),
        "torque_offset": (one,),
        "rotor_inertia": (a,),
        "torque_gain": (load,),
    }
    found: dict[Atom, np.ndarray] = {}
    for j, joint in enumerate(plant.joints):
        for effect, columns in own.items():
            term = np.zeros((*q.shape, len(columns)))
            term[:, j] = np.stack([column[:, j] for column in columns], axis=-1)
            found[effect, joint] = term.reshape(q.size, -1)
        points = [plant.torques(motion, plant.described, {j: Lump(1.0, place)}) - load for place in _PLACES]
        found["link_inertia", joint] = np.stack(points, axis=-1).reshape(q.size, -1)
    here, *around = np.moveaxis(found["link_inertia", plant.joints[-1]], -1, 0)[:7]
    first = [around[2 * k] - around[2 * k + 1] for k in range(3)]  # what is quadratic in the place cancels
    found["payload", plant.joints[-1]] = np.stack([here, *first], axis=-1)
    return found


# Point masses at ten places span all that masses, centres and inertias can be.
_PLACES = tuple(
    (ARM * x, ARM * y, ARM * z)
    for x, y, z in (
        (0, 0, 0), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1), (1, 1, 0), (0, 1, 1), (1, 0, 1),
    )
)  # fmt: skip


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
