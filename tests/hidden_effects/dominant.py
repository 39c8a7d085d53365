"""Effects that are large: drawn so that each alone outweighs all other errors of the robot together."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from .imperfections import sliding

RATIO = (2.4, 4.0)
"""Root mean square of a dominant torque over that of all other errors, over all joints and runs; 2.4 makes 85 %."""
GAIN = (0.2, 0.4)
"""Share by which a torque is read too large or too small."""
HEAVIER = (0.5, 1.0)
"""Mass that a link has too much, of its own."""
ELSEWHERE = (0.05, 0.12)
"""How far from the link's centre that is, m."""
GYRATION = 0.03
"""Of such a mass, m."""
DRIFT = 0.05
"""Largest share by which a dominant friction differs between runs."""
STEEP = 0.8
"""How far the middle of a joint's motion is at most from where its spring changes fastest, rad."""
FIELDS = {
    "joint_viscous_friction": {"coefficient": "viscous"},
    "joint_coulomb_friction": {"torque": "coulomb"},
    "joint_asymmetric_friction": {"positive": "positive", "negative": "negative"},
    "joint_stribeck_friction": {"torque": "stribeck", "speed": "fading"},
    "joint_load_friction": {"coefficient": "per_load"},
    "rotor_inertia": {"inertia": "rotor"},
    "torque_offset": {"torque": "offset"},
    "torque_gain": {"error": "gain"},
    "torque_delay": {"time": "late"},
    "gravity_spring": {"sine": "sine", "cosine": "cosine"},
    "joint_spring": {"stiffness": "stiffness", "rest": "rest"},
}
"""Of `Hidden`, by effect and by the name that armdyn's models have for them; what loads a link stands in its lump."""
COUNT = {effect: len(fields) for effect, fields in FIELDS.items()} | {"payload": 4, "link_inertia": 10}
"""Numbers that describe an effect on one joint."""


@dataclass(frozen=True)
class Lump:
    """A mass on a link: kg, (3,) m in the frame of the joint that moves it, and kg m^2 about any axis."""

    mass: float
    place: tuple[float, float, float]
    inertia: float = 0.0


@dataclass(frozen=True)
class Hidden:
    """One dominant effect on one joint.

    Attributes:
        effect: its name in the catalogue.
        joint: on which.
        viscous: N m s/rad.
        coulomb: N m.
        positive: dry friction where the joint moves forwards, N m.
        negative: likewise backwards, N m.
        stribeck: dry friction that fades with the speed, N m.
        fading: speed at which 1/e of that is left, rad/s.
        per_load: dry friction per torque that the links ask for.
        rotor: kg m^2.
        sine: of the spring of zero free length, N m.
        cosine: of the same, N m.
        stiffness: of the linear spring, N m/rad.
        rest: where that does not pull, rad.
        late: of the reading, s.
        offset: of the reading, N m.
        gain: of the reading.
        lump: on the link that the joint moves.
    """

    effect: str
    joint: str
    viscous: float = 0.0
    coulomb: float = 0.0
    positive: float = 0.0
    negative: float = 0.0
    stribeck: float = 0.0
    fading: float = 0.1
    per_load: float = 0.0
    rotor: float = 0.0
    sine: float = 0.0
    cosine: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0
    late: float = 0.0
    offset: float = 0.0
    gain: float = 1.0
    lump: Lump | None = None

    @property
    def count(self) -> int:
        """Numbers that describe it."""
        return COUNT[self.effect]

    def torque(self, q: np.ndarray, v: np.ndarray, a: np.ndarray, load: np.ndarray, way: np.ndarray) -> np.ndarray:
        """(n,) N m that it adds to the drive of its joint at the motor's motion, `way` being the sign of v as dry
        friction has it, and `load` what the links ask for."""
        spring = self.sine * np.sin(q) + self.cosine * np.cos(q) + self.stiffness * (q - self.rest)
        dry = self.coulomb + self.stribeck * np.exp(-((v / self.fading) ** 2)) + self.per_load * np.abs(load)
        dry = dry + np.where(v > 0.0, self.positive, self.negative)
        return self.viscous * v + dry * way + self.rotor * a + spring

    @property
    def values(self) -> dict[str, float]:
        """Its numbers by the name that armdyn's models have for them."""
        if self.lump is not None:
            return dict(zip(("mass", "x", "y", "z"), (self.lump.mass, *self.lump.place), strict=True))
        found = {short: float(getattr(self, field)) for short, field in FIELDS[self.effect].items()}
        return {"error": self.gain - 1.0} if self.effect == "torque_gain" else found

    def changed(self, short: str, by: float) -> "Hidden":
        """With one of `values` larger by so much."""
        if self.lump is None:
            field = FIELDS[self.effect][short]
            return replace(self, **{field: getattr(self, field) + by})
        mass, *place = (value + by * (name == short) for name, value in self.values.items())
        return replace(self, lump=replace(self.lump, mass=mass, place=tuple(place)))

    def drifted(self, rng: np.random.Generator) -> "Hidden":
        """As in another run: friction is never twice the same."""
        viscous, coulomb = (1.0 + DRIFT * rng.uniform(-1.0, 1.0, 2)) * (self.viscous, self.coulomb)
        return replace(self, viscous=float(viscous), coulomb=float(coulomb))


@dataclass(frozen=True)
class Joints:
    """What the size of an effect depends on.

    Attributes:
        names: (nj,).
        q: (n, nj) motor positions in all runs, rad.
        v: (n, nj) rad/s.
        a: (n, nj) rad/s^2.
        load: (n, nj) N m.
        strong: joints with large drives.
        loaded: joints with much to carry.
        background: root mean square of all other errors over all joints together, N m.
        link: mass [kg] and centre [m] of the link that a joint moves.
        added: root mean square over all joints together of what a lump on a link adds, N m.
    """

    names: tuple[str, ...]
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    load: np.ndarray
    strong: tuple[int, ...]
    loaded: tuple[int, ...]
    background: float
    link: Callable[[int], tuple[float, np.ndarray]] = field(repr=False)
    added: Callable[[int, Lump], float] = field(repr=False)


def drawn(rng: np.random.Generator, effects: Sequence[str], joints: Joints, growth: float = 1.0) -> tuple[Hidden, ...]:
    """These effects, each on a joint of its own and `growth` times `RATIO` as large as everything else that is wrong.

    A link's mass and a gain have sizes of their own; they are put where they are that large.
    """
    found: list[Hidden] = []
    for effect in effects:
        taken = {joints.names.index(hidden.joint) for hidden in found}
        found.append(_drawn(rng, effect, joints, taken, growth))
    return tuple(found)


def _drawn(rng: np.random.Generator, effect: str, joints: Joints, taken: set[int], growth: float) -> Hidden:
    wanted = growth * joints.background * rng.uniform(*RATIO)
    if effect == "payload":
        return _payload(rng, joints, wanted)
    if effect == "link_inertia":
        return _link(rng, joints)
    if effect == "torque_gain":
        return _gain(rng, joints)
    possible = joints.loaded if effect == "gravity_spring" else joints.strong
    j = int(rng.choice([k for k in possible if k not in taken] or list(possible)))
    name, q, v, a = joints.names[j], joints.q[:, j], joints.v[:, j], joints.a[:, j]
    sign = float(rng.choice([-1.0, 1.0]))
    if effect == "gravity_spring":
        steepest = 0.5 * (q.min() + q.max()) + rng.uniform(-STEEP, STEEP)
        unit = Hidden(effect, name, sine=sign * float(np.cos(steepest)), cosine=-sign * float(np.sin(steepest)))
    else:
        unit = {
            "joint_coulomb_friction": Hidden(effect, name, coulomb=1.0),
            "joint_viscous_friction": Hidden(effect, name, viscous=1.0),
            "rotor_inertia": Hidden(effect, name, rotor=1.0),
            "torque_offset": Hidden(effect, name, offset=sign),
        }[effect]
    size = wanted / _rms(unit.torque(q, v, a, joints.load[:, j], sliding(v)) + unit.offset)
    scaled = {key: size * getattr(unit, key) for key in ("viscous", "coulomb", "rotor", "sine", "cosine", "offset")}
    return replace(unit, **scaled)


def _payload(rng: np.random.Generator, joints: Joints, wanted: float) -> Hidden:
    """A point mass on the last link."""
    last = len(joints.names) - 1
    x, y = rng.uniform(-0.05, 0.05, 2)
    lump = Lump(1.0, (float(x), float(y), float(rng.uniform(0.05, 0.15))))
    mass = wanted / joints.added(last, lump)
    return Hidden("payload", joints.names[last], lump=replace(lump, mass=mass))


def _link(rng: np.random.Generator, joints: Joints) -> Hidden:
    """More mass at another place of a link, not the last, where it is as large as it should be or nearly so."""
    sizes, lumps = [], []
    for j in range(1, len(joints.names) - 1):
        mass, centre = joints.link(j)
        way = rng.standard_normal(3)
        place = centre + way / np.linalg.norm(way) * rng.uniform(*ELSEWHERE)
        more = mass * rng.uniform(*HEAVIER)
        lumps.append(Lump(more, (float(place[0]), float(place[1]), float(place[2])), more * GYRATION**2))
        sizes.append(joints.added(j, lumps[-1]))
    large = np.flatnonzero(np.array(sizes) >= RATIO[0] * joints.background)
    chosen = int(rng.choice(large)) if len(large) else int(np.argmax(sizes))
    return Hidden("link_inertia", joints.names[1 + chosen], lump=lumps[chosen])


def _gain(rng: np.random.Generator, joints: Joints) -> Hidden:
    """A wrong gain on a joint with load enough."""
    error = float(rng.choice([-1.0, 1.0]) * rng.uniform(*GAIN))
    sizes = np.array([_rms(error * joints.load[:, j]) for j in range(len(joints.names))])
    large = np.flatnonzero(sizes >= RATIO[0] * joints.background)
    chosen = int(rng.choice(large)) if len(large) else int(np.argmax(sizes))
    return Hidden("torque_gain", joints.names[chosen], gain=1.0 + error)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
