"""Sound recordings of arms and pendulums, and what people do to them by mistake; with the right answer to each.

Arms are `plant.World`: imperfect everywhere, and some with a payload, a spring, a gain of a tenth, strong friction or a
base that is tilted by five degrees, none of which is a mistake. Pendulums are those of `dry_swing`. A mistake counts
only where it is a fair question: it changes what rigid bodies say of the torques by `TOLD` at least.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from armdyn.run import Channel, Run
from armdyn.units import Known

from .dominant import Hidden, Lump
from .dry_swing import G, Pendulum, Push, reading, swing
from .imperfections import Imperfections
from .motions import KINDS
from .plant import Plant, World

ROBOTS = ("baxter", "panda", "ur5", "talos_arm")
POSITION_NOISE = {"baxter": 4e-4, "panda": 1e-4, "ur5": 5e-5, "talos_arm": 1e-4}
PAYLOAD = {"baxter": 2.0, "panda": 2.5, "ur5": 4.0, "talos_arm": 1.5}
"""kg."""
SOUND = ("as described", "payload", "spring", "gain", "tilt", "friction", "offset")
TOLD = 0.6
"""Of the root mean square of a joint's torque, by which a mistake changes what is expected of it."""
LOADED = 0.06
"""Of the effort limit: torque of a joint of whose sign or unit one can speak."""
Gravity = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Sound:
    """A recording as it should be.

    Attributes:
        name: robot or pendulum, what is real in it, seed.
        model: robot, or ``"pendulum"``.
        run: as recorded.
        told: by channel, its root mean square over what its joint is made for.
    """

    name: str
    model: str
    run: Run
    told: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Mistaken:
    """A recording with a mistake, and what is to be said of it.

    Attributes:
        name: of the mistake.
        run: as a user has it.
        kind: of the contract.
        channels: one of which the answer must name; empty where any will do.
        urdf: factors of masses and lengths of the description.
    """

    name: str
    run: Run
    kind: str
    channels: tuple[str, ...] = ()
    urdf: tuple[float, float] = (1.0, 1.0)


# --- sound recordings -------------------------------------------------------------------------------------------------


@contextmanager
def _gravity(plant: Plant, gravity: Gravity | None):
    model = plant._model
    before = model.opt.gravity.copy()
    if gravity is not None:
        model.opt.gravity[:] = gravity
    try:
        yield
    finally:
        model.opt.gravity[:] = before


def arm(
    robot: str, real: str, seed: int, *, duration: float = 15.0, rate: float = 100.0, gravity: Gravity | None = None
) -> Sound:
    """A sound recording of an arm.

    Args:
        robot: of `ROBOTS`.
        real: of `SOUND`.
        seed: of everything that is random.
        duration: s.
        rate: Hz.
        gravity: in the frame of the base, m/s^2; downwards where None.
    """
    plant = Plant(robot)
    rng = np.random.default_rng([seed, ROBOTS.index(robot), SOUND.index(real)])
    kind = list(KINDS)[seed % len(KINDS)]
    room = plant.rooms(rng)[1]
    motion = KINDS[kind](rng, room, duration)
    stamps = np.arange(round(duration * rate)) / rate
    typical = np.sqrt(np.mean(np.square(plant.torques(motion.at(stamps[::20]), plant.described, {})), axis=0))
    drive = Imperfections.drawn(rng, np.maximum(typical, 0.02 * plant.effort), plant.effort, POSITION_NOISE[robot])
    if real == "friction":
        drive = replace(drive, viscous=0.08 * plant.effort, coulomb=0.05 * plant.effort)
    down = np.array([0.0, 0.0, -G]) if gravity is None else np.array(gravity)
    if real == "tilt":
        axis = np.append(rng.standard_normal(2), 0.0)
        down = Rotation.from_rotvec(np.deg2rad(5.0) * axis / np.linalg.norm(axis)).apply(down)
    world = World(plant, plant.described.off(rng), drive, motion, stamps)
    strongest = int(np.argmax(typical))
    truth: tuple[Hidden, ...] = ()
    if real == "payload":
        truth = (Hidden("payload", plant.joints[-1], lump=Lump(PAYLOAD[robot], (0.03, -0.02, 0.1), 0.004)),)
    elif real == "spring":
        size, phase = 0.8 * typical[strongest], rng.uniform(0.0, 2 * np.pi)
        truth = (
            Hidden(
                "gravity_spring", plant.joints[strongest], sine=float(size * np.sin(phase)),
                cosine=float(size * np.cos(phase)),
            ),
        )  # fmt: skip
    elif real == "gain":
        truth = tuple(Hidden("torque_gain", j, gain=1.0 + float(rng.choice([-0.1, 0.1]))) for j in plant.joints)
    elif real == "offset":
        sizes = 0.02 * plant.effort * rng.choice([-1.0, 1.0], len(plant.joints))
        truth = tuple(Hidden("torque_offset", j, offset=float(s)) for j, s in zip(plant.joints, sizes, strict=True))
    noise = rng.standard_normal((3, len(stamps), len(plant.joints)))
    with _gravity(plant, tuple(down)):
        run = world.recorded(truth, noise, f"{robot} {real} {seed}")
    channels = dict(run.channels)
    _, v, _ = motion.at(stamps - drive.late)
    for i, joint in enumerate(plant.joints):
        channels[f"v.{joint}"] = Channel(stamps, v[:, i] + 2e-3 * rng.standard_normal(len(stamps)), "rad/s")
    run = replace(run, channels=channels)
    told = {
        f"tau.{j}": float(np.sqrt(np.mean(run.channels[f"tau.{j}"].value ** 2)) / plant.effort[i])
        for i, j in enumerate(plant.joints)
    }
    return Sound(run.name, robot, run, told)


def pendulum(real: str, seed: int, *, driven: bool, channels: Sequence[str], duration: float = 20.0) -> Sound:
    """A sound recording of a pendulum.

    Args:
        real: effect that acts on it; ``""`` for none but a little viscous friction.
        seed: of everything that is random.
        driven: whether the pivot moves, as recorded; else it swings freely.
        channels: that are recorded beside the pivot's.
        duration: s.
    """
    rng = np.random.default_rng([seed, 77, driven])
    length, mass = rng.uniform(0.25, 0.8), rng.uniform(0.05, 0.4)
    inertia = mass * length**2
    effects = {"pivot_viscous_friction": 0.03 * inertia}
    sizes = {
        "pivot_coulomb_friction": 0.05 * inertia, "quadratic_drag": 0.03 * mass / length, "angle_gain": 0.05,
        "angle_offset": 0.03, "angle_skew": 0.03, "gripper_scale": 0.05, "sensor_bias": 0.02,
    }  # fmt: skip
    effects |= {real: sizes[real]} if real else {}
    time = np.arange(0.0, duration, 0.01)
    w = 2 * np.pi * np.array([0.31, 0.53, 1.1]) * rng.uniform(0.9, 1.1, 3)
    amplitude = np.array([0.08, 0.05, 0.02]) * rng.choice([-1.0, 1.0], 3)

    def gripper(t: np.ndarray) -> np.ndarray:
        phase = np.multiply.outer(w, t)
        return np.array(
            [amplitude @ (1 - np.cos(phase)), (amplitude * w) @ np.sin(phase), (amplitude * w**2) @ np.cos(phase)]
        )

    push = Push(gripper if driven else None)
    start = (0.02, 0.0) if driven else (rng.uniform(0.4, 1.0), 0.0)
    moved = swing(Pendulum(length, mass, effects), start, push, time)
    noise = {"swing_angle": 1e-3, "swing_rate": 5e-3, "load_force": 3e-3}
    unit = {"swing_angle": "rad", "swing_rate": "rad/s", "load_force": "N"}
    found = {
        name: Channel(time, reading(effects, name, moved) + noise[name] * rng.standard_normal(len(time)), unit[name])
        for name in channels
    }
    if driven:
        found["gripper_x"] = Channel(time, gripper(time)[0] + 5e-5 * rng.standard_normal(len(time)), "m")
    known = {"length": Known(length, 0.01 * length, "m"), "mass": Known(mass, 0.01 * mass, "kg")}
    name = f"pendulum {'driven' if driven else 'free'} {'+'.join(channels)} {real} {seed}"
    return Sound(name, "pendulum", Run(name, found, known), dict.fromkeys(found, 1.0))


# --- mistakes ---------------------------------------------------------------------------------------------------------


def scaled(run: Run, names: Sequence[str], factor: float) -> Run:
    """Channels times a factor."""
    new = {n: Channel(c.time, factor * c.value, c.unit) for n, c in run.channels.items() if n in names}
    return replace(run, channels={**run.channels, **new})


def moved(run: Run, name: str, offset: float) -> Run:
    """A channel plus an offset."""
    c = run.channels[name]
    return replace(run, channels={**run.channels, name: Channel(c.time, c.value + offset, c.unit)})


def renamed(run: Run, order: Mapping[str, str], kinds: Sequence[str]) -> Run:
    """Channels of the joints `order` under the names that it gives."""
    new = {
        f"{kind}.{b}": run.channels[f"{kind}.{a}"]
        for kind in kinds
        for a, b in order.items()
        if f"{kind}.{a}" in run.channels
    }
    return replace(run, channels={**run.channels, **new})


def late(run: Run, names: Sequence[str], seconds: float) -> Run:
    """Channels stamped too late."""
    new = {n: Channel(c.time + seconds, c.value, c.unit) for n, c in run.channels.items() if n in names}
    return replace(run, channels={**run.channels, **new})


def without(run: Run, begin: float, end: float) -> Run:
    """Without the samples between."""
    keep = {n: (c.time < begin) | (c.time > end) for n, c in run.channels.items()}
    new = {n: Channel(c.time[keep[n]], c.value[keep[n]], c.unit) for n, c in run.channels.items()}
    return replace(run, channels=new)


def valued(run: Run, name: str, value: np.ndarray) -> Run:
    """A channel with other values."""
    c = run.channels[name]
    return replace(run, channels={**run.channels, name: Channel(c.time, value, c.unit)})


def of_signals(sound: Sound, rng: np.random.Generator) -> list[Mistaken]:
    """Mistakes that show in a channel alone."""
    run = sound.run
    names = [n for n in run.channels if n.startswith(("tau.", "swing_", "load_")) and sound.told[n] > LOADED / 2]
    name = str(rng.choice(names))
    c = run.channels[name]
    n = len(c.value)
    begin = int(rng.integers(n // 4, n // 2))
    stuck = c.value.copy()
    stuck[begin : begin + n // 8] = stuck[begin]
    held = c.value[np.arange(n) // 8 * 8]
    spiky = c.value.copy()
    spiky[rng.choice(n, 6, replace=False)] += 8 * np.std(c.value) * rng.choice([-1.0, 1.0], 6)
    top = np.quantile(c.value, 0.9)
    span = c.time[-1] - c.time[0]
    q = next((x for x in run.channels if x.startswith("q.")), "swing_angle" if "swing_angle" in run.channels else "")
    found = [
        Mistaken("gap", without(run, c.time[0] + 0.4 * span, c.time[0] + 0.4 * span + 1.2), "gap"),
        Mistaken("frozen", valued(run, name, stuck), "frozen", (name,)),
        Mistaken("repeated", valued(run, name, held), "repeated_samples", (name,)),
        Mistaken("glitches", valued(run, name, spiky), "glitch", (name,)),
        Mistaken("saturated", valued(run, name, np.minimum(c.value, top)), "saturated", (name,)),
        Mistaken("noise", replace(run, noise={name: 1e-3 * float(np.std(c.value)) / 300}), "noise_misstated", (name,)),
    ]
    jitter = np.sort(c.time + 0.8 * np.median(np.diff(c.time)) * rng.uniform(-0.5, 0.5, n))
    shaken = {k: Channel(jitter, x.value, x.unit) for k, x in run.channels.items() if len(x.time) == n}
    found.append(Mistaken("jitter", replace(run, channels={**run.channels, **shaken}), "rate"))
    if q:
        lost = run.channels[q].value.copy()
        lost[begin:] += 0.06
        found.append(Mistaken("counts lost", valued(run, q, lost), "counts_lost", (q,)))
        still = {
            k: Channel(x.time, np.full(n, x.value[0]) + 1e-5 * rng.standard_normal(n), x.unit)
            for k, x in run.channels.items() if k[:2] in ("q.", "v.") or k in ("swing_angle", "swing_rate", "gripper_x")
        }  # fmt: skip
        found.append(Mistaken("no motion", replace(run, channels={**run.channels, **still}), "no_motion"))
    return found


def of_arms(sound: Sound, seed: int) -> list[Mistaken]:
    """Mistakes that the physics of an arm shows."""
    rng = np.random.default_rng([seed, 3])
    run, plant = sound.run, Plant(sound.model)
    joints = list(plant.joints)
    tau, q, v = ([f"{kind}.{j}" for j in joints] for kind in ("tau", "q", "v"))
    loaded = [j for j in joints if sound.told[f"tau.{j}"] > LOADED]
    one = str(rng.choice(loaded))
    found = [
        Mistaken("all in degrees", scaled(run, q + v, 180 / np.pi), "angle_unit", tuple(q)),
        Mistaken("rates in degrees", scaled(run, v, 180 / np.pi), "angle_unit", tuple(v)),
        Mistaken("rates in rpm", scaled(run, v, 30 / np.pi), "angle_unit", tuple(v)),
        Mistaken("mN m", scaled(run, tau, 1e3), "torque_unit", tuple(tau)),
        Mistaken("N cm", scaled(run, tau, 1e2), "torque_unit", tuple(tau)),
        Mistaken("ft lb", scaled(run, tau, 1 / 1.3558179483), "torque_unit", tuple(tau)),
        Mistaken("one in mN m", scaled(run, [f"tau.{one}"], 1e3), "torque_unit", (f"tau.{one}",)),
        Mistaken("all torques negated", scaled(run, tau, -1.0), "torque_sign", tuple(tau)),
        Mistaken("one torque negated", scaled(run, [f"tau.{one}"], -1.0), "torque_sign", (f"tau.{one}",)),
        Mistaken("rate negated", scaled(run, [f"v.{one}"], -1.0), "position_sign", (f"v.{one}",)),
        Mistaken("torques late", late(run, tau, 0.2), "clock_shift", tuple(tau)),
        Mistaken("torques early", late(run, tau, -0.15), "clock_shift", tuple(tau)),
        Mistaken("rates late", late(run, v, 0.1), "clock_shift", tuple(v)),
        Mistaken("description in g", run, "scale", (), (1e3, 1.0)),
        Mistaken("description in mm", run, "scale", (), (1.0, 1e3)),
    ]
    currents = run
    for name, k in zip(tau, rng.uniform(5.0, 60.0, len(tau)), strict=True):
        currents = scaled(currents, [name], 1.0 / k)
    found.append(Mistaken("ampere", currents, "torque_unit", tuple(tau)))
    found.append(
        Mistaken(
            "rates of other joints",
            renamed(run, {joints[0]: joints[1], joints[1]: joints[0]}, ["v"]),
            "joints_swapped",
            tuple(v[:2]),
        )
    )
    weak = scaled(run, v, 0.6)
    found.append(Mistaken("rates too slow", weak, "rate", tuple(v)))

    def fair(kind: str, name: str, changed: Run, channels: Sequence[str]) -> None:
        if _tells(plant, run, changed):
            found.append(Mistaken(name, changed, kind, tuple(channels)))

    for _ in range(8):
        j = str(rng.choice(joints))
        before = len(found)
        fair("position_sign", "one position negated", scaled(run, [f"q.{j}", f"v.{j}"], -1.0), [f"q.{j}"])
        if len(found) > before:
            break
    fair("position_sign", "all positions negated", scaled(run, q + v, -1.0), q)
    for size, name in ((np.pi / 2, "a quarter turn"), (-np.pi / 2, "minus a quarter turn"), (np.pi, "half a turn")):
        for _ in range(8):
            j = str(rng.choice(joints))
            before = len(found)
            fair("position_offset", name, moved(run, f"q.{j}", size), [f"q.{j}"])
            if len(found) > before:
                break
    for kinds, name in (
        (["tau"], "torques exchanged"),
        (["q", "v"], "positions exchanged"),
        (["q", "v", "tau"], "joints exchanged"),
    ):
        for _ in range(20):
            a, b = (str(x) for x in rng.choice(joints, 2, replace=False))
            before = len(found)
            fair("joints_swapped", name, renamed(run, {a: b, b: a}, kinds), [f"{kinds[0]}.{a}", f"{kinds[0]}.{b}"])
            if len(found) > before:
                break
    orders = {
        "reversed": dict(zip(joints, joints[::-1], strict=True)),
        "shifted": dict(zip(joints, joints[1:] + joints[:1], strict=True)),
    }
    for name, order in orders.items():
        for kinds in (["tau"], ["q", "v", "tau"]):
            fair(
                "joints_swapped",
                f"{name} {'torques' if len(kinds) == 1 else 'joints'}",
                renamed(run, order, kinds),
                [f"{kinds[0]}.{j}" for j in joints],
            )
    return found


def mounted(robot: str, real: str, seed: int) -> list[Mistaken]:
    """Arms that hang elsewhere than described, and torques without gravity."""
    tau = tuple(f"tau.{j}" for j in Plant(robot).joints)
    slope = (0.0, G * float(np.sin(0.8)), -G * float(np.cos(0.8)))
    places: Mapping[str, Gravity] = {
        "ceiling": (0.0, 0.0, G), "wall": (-G, 0.0, 0.0), "other wall": (0.0, G, 0.0), "slope": slope,
        "gravity taken out": (0.0, 0.0, 0.0),
    }  # fmt: skip
    return [
        Mistaken(name, arm(robot, real, seed, gravity=gravity).run, "gravity_direction", tau)
        for name, gravity in places.items()
    ]


def of_pendulums(sound: Sound, seed: int) -> list[Mistaken]:
    """Mistakes that the physics of a pendulum shows."""
    del seed
    run, found = sound.run, list[Mistaken]()
    has = set(run.channels)
    if "swing_angle" in has:
        a = ("swing_angle",)
        found += [
            Mistaken("angle in degrees", scaled(run, a, 180 / np.pi), "angle_unit", a),
            Mistaken("zero half a turn off", moved(run, a[0], np.pi), "position_offset", a),
            Mistaken("zero a quarter turn off", moved(run, a[0], np.pi / 2), "position_offset", a),
        ]
        if "gripper_x" in has:
            both = [*a, *(["swing_rate"] if "swing_rate" in has else [])]
            found += [
                Mistaken("angle's sign", scaled(run, both, -1.0), "position_sign", (*a, "gripper_x")),
                Mistaken(
                    "angle late",
                    late(run, [*both, *(["load_force"] if "load_force" in has else [])], 0.15),
                    "clock_shift",
                    (),
                ),
                Mistaken("gripper in mm", scaled(run, ["gripper_x"], 1e3), "scale", ("gripper_x",)),
                Mistaken("gripper in cm", scaled(run, ["gripper_x"], 1e2), "scale", ("gripper_x",)),
            ]
    if "swing_rate" in has:
        r = ("swing_rate",)
        found.append(Mistaken("rate in degrees", scaled(run, r, 180 / np.pi), "angle_unit", r))
        if "swing_angle" in has:
            found += [
                Mistaken("rate's sign", scaled(run, r, -1.0), "position_sign", r),
                Mistaken("rate late", late(run, r, 0.1), "clock_shift", r),
                Mistaken("rate too slow", scaled(run, r, 0.6), "rate", r),
            ]
    if "load_force" in has:
        f = ("load_force",)
        found += [
            Mistaken("force in mN", scaled(run, f, 1e3), "torque_unit", f),
            Mistaken("force in gram-force", scaled(run, f, 1e3 / 9.80665), "torque_unit", f),
            Mistaken("force's sign", scaled(run, f, -1.0), "torque_sign", f),
        ]
        if "swing_angle" in has:
            found.append(Mistaken("force late", late(run, f, 0.15), "clock_shift", f))
    return found


def _tells(plant: Plant, right: Run, wrong: Run) -> bool:
    """Whether rigid bodies see a mistake, on a joint that has load."""
    moments = slice(100, None, 40)
    expected = _expected(plant, right, moments)
    for i, joint in enumerate(plant.joints):
        tau = wrong.channels[f"tau.{joint}"].value[moments]
        there, here = _expected(plant, wrong, moments)[:, i], right.channels[f"tau.{joint}"].value[moments]
        size = np.sqrt(np.mean(here**2))
        error = np.sqrt(np.mean((tau - there) ** 2)) - np.sqrt(np.mean((here - expected[:, i]) ** 2))
        if size > LOADED * plant.effort[i] and error > TOLD * size:
            return True
    return False


def _expected(plant: Plant, run: Run, moments: slice) -> np.ndarray:
    q = np.column_stack([run.channels[f"q.{j}"].value[moments] for j in plant.joints])
    still = np.zeros_like(q)
    return plant.torques((q, still, still), plant.described, {})


Maker = Callable[[Sound, int], list[Mistaken]]
