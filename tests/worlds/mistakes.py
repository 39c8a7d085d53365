"""What people do by mistake to sound recordings, with the right answer to each.

A mistake counts only where it is a fair question: it changes what rigid bodies say of the torques by `TOLD` at least.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from armdyn.run import Channel, Run

from .dry_swing import G
from .plant import Plant
from .sound_recordings import Gravity, Sound, arm

TOLD = 0.6  # of the root mean square of a joint's torque, by which a mistake changes what is expected of it
LOADED = 0.06  # of the effort limit: torque of a joint of whose sign or unit one can speak
SMALLEST, LARGEST = {"N": 0.1, "N m": 1.0, "m": 0.005, "rad": 0.01}, {"N": 50.0, "N m": 50.0, "m": 0.5, "rad": 6.3}
"""How far off, by unit: evenly drawn over the logarithm between the two."""


@dataclass(frozen=True, eq=False)
class Mistake:
    """A recording with a mistake, and what is to be said of it."""

    name: str  # of the mistake
    run: Run  # as a user has it
    kind: str  # of the contract; of several that are right all, with a space between
    channels: tuple[str, ...] = ()  # one of which the answer must name; empty where any will do
    urdf: tuple[float, float] = (1.0, 1.0)  # factors of masses and lengths of the description
    undone: bool = True  # whether a correction can undo it

    @property
    def kinds(self) -> frozenset[str]:
        """Any of which is right."""
        return frozenset(self.kind.split())


def changed(run: Run, names: Sequence[str], to: Callable[[Channel], Channel]) -> Run:
    """A run with some of its channels made to others."""
    return replace(run, channels={n: to(c) if n in names else c for n, c in run.channels.items()})


def scaled(run: Run, names: Sequence[str], factor: float) -> Run:
    """Channels times a factor."""
    return changed(run, names, lambda c: Channel(c.time, factor * c.value, c.unit))


def moved(run: Run, name: str, offset: float) -> Run:
    """A channel plus an offset."""
    return changed(run, [name], lambda c: Channel(c.time, c.value + offset, c.unit))


def late(run: Run, names: Sequence[str], seconds: float) -> Run:
    """Channels stamped too late."""
    return changed(run, names, lambda c: Channel(c.time + seconds, c.value, c.unit))


def valued(run: Run, name: str, value: np.ndarray) -> Run:
    """A channel with other values."""
    return changed(run, [name], lambda c: Channel(c.time, value, c.unit))


def without(run: Run, begin: float, end: float) -> Run:
    """Without the samples between."""

    def cut(c: Channel) -> Channel:
        kept = (c.time < begin) | (c.time > end)
        return Channel(c.time[kept], c.value[kept], c.unit)

    return changed(run, tuple(run.channels), cut)


def sticky(run: Run, name: str, place: float, width: float, caught_up: float = 0.03) -> Run:
    """A position that is held at a place until its drive is `width` away, and then catches up in `caught_up` s."""
    c = run.channels[name]
    value, behind, holds = c.value.copy(), 0.0, False
    for k in range(1, len(value)):
        holds = holds or (behind == 0.0 and (c.value[k - 1] - place) * (c.value[k] - place) < 0.0)
        if holds and abs(c.value[k] - place) < width:
            value[k] = place
            continue
        behind = place - c.value[k] if holds else behind * np.exp(-(c.time[k] - c.time[k - 1]) / caught_up)
        behind, holds = (behind if abs(behind) > 1e-3 * width else 0.0), False
        value[k] = c.value[k] + behind
    return valued(run, name, value)


def renamed(run: Run, order: Mapping[str, str], kinds: Sequence[str]) -> Run:
    """Channels of the joints `order` under the names that it gives."""
    new = {
        f"{kind}.{b}": run.channels[f"{kind}.{a}"]
        for kind in kinds
        for a, b in order.items()
        if f"{kind}.{a}" in run.channels
    }
    return replace(run, channels={**run.channels, **new})


def spoilt(run: Run, channels: Iterable[str], share: float, seed: int) -> Run:
    """The run with this share of the samples of some channels off by anything, as a sensor or a bus spoils them."""
    rng, spoilt = np.random.default_rng(seed), dict(run.channels)
    for name in channels:
        channel = run.channels[name]
        value, bad = channel.value.copy(), rng.random(len(channel)) < share
        low, high = np.log([SMALLEST[channel.unit], LARGEST[channel.unit]])
        value[bad] += rng.choice([-1.0, 1.0], bad.sum()) * np.exp(rng.uniform(low, high, bad.sum()))
        spoilt[name] = Channel(channel.time, value, channel.unit)
    return replace(run, channels=spoilt)


def of_signals(sound: Sound, rng: np.random.Generator) -> list[Mistake]:
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
        Mistake("gap", without(run, c.time[0] + 0.4 * span, c.time[0] + 0.4 * span + 1.2), "gap"),
        Mistake("frozen", valued(run, name, stuck), "frozen", (name,)),
        Mistake("repeated", valued(run, name, held), "repeated_samples", (name,)),
        Mistake("glitches", valued(run, name, spiky), "glitch", (name,)),
        Mistake("saturated", valued(run, name, np.minimum(c.value, top)), "saturated", (name,)),
        Mistake("noise", replace(run, noise={name: 1e-3 * float(np.std(c.value)) / 300}), "noise_misstated", (name,)),
    ]
    jitter = np.sort(c.time + 0.8 * np.median(np.diff(c.time)) * rng.uniform(-0.5, 0.5, n))
    shaken = {k: Channel(jitter, x.value, x.unit) for k, x in run.channels.items() if len(x.time) == n}
    found.append(Mistake("jitter", replace(run, channels={**run.channels, **shaken}), "rate"))
    if q:
        lost = run.channels[q].value.copy()
        lost[begin:] += 0.06
        found.append(Mistake("counts lost", valued(run, q, lost), "counts_lost", (q,)))
        still = {
            k: Channel(x.time, np.full(n, x.value[0]) + 1e-5 * rng.standard_normal(n), x.unit)
            for k, x in run.channels.items() if k[:2] in ("q.", "v.") or k in ("swing_angle", "swing_rate", "gripper_x")
        }  # fmt: skip
        found.append(Mistake("no motion", replace(run, channels={**run.channels, **still}), "no_motion"))
    return found


def of_arms(sound: Sound, seed: int) -> list[Mistake]:
    """Mistakes that the physics of an arm shows."""
    rng = np.random.default_rng([seed, 3])
    run, plant = sound.run, Plant(sound.model)
    joints = list(plant.joints)
    tau, q, v = ([f"{kind}.{j}" for j in joints] for kind in ("tau", "q", "v"))
    loaded = [j for j in joints if sound.told[f"tau.{j}"] > LOADED]
    one = str(rng.choice(loaded))
    found = [
        Mistake("all in degrees", scaled(run, q + v, 180 / np.pi), "angle_unit", tuple(q)),
        Mistake("rates in degrees", scaled(run, v, 180 / np.pi), "angle_unit", tuple(v)),
        Mistake("rates in rpm", scaled(run, v, 30 / np.pi), "angle_unit", tuple(v)),
        Mistake("mN m", scaled(run, tau, 1e3), "torque_unit", tuple(tau)),
        Mistake("N cm", scaled(run, tau, 1e2), "torque_unit", tuple(tau)),
        Mistake("ft lb", scaled(run, tau, 1 / 1.3558179483), "torque_unit", tuple(tau)),
        Mistake("one in mN m", scaled(run, [f"tau.{one}"], 1e3), "torque_unit", (f"tau.{one}",)),
        Mistake("all torques negated", scaled(run, tau, -1.0), "torque_sign", tuple(tau)),
        Mistake("one torque negated", scaled(run, [f"tau.{one}"], -1.0), "torque_sign", (f"tau.{one}",)),
        Mistake("rate negated", scaled(run, [f"v.{one}"], -1.0), "position_sign", (f"v.{one}",)),
        Mistake("torques late", late(run, tau, 0.2), "clock_shift", tuple(tau)),
        Mistake("torques early", late(run, tau, -0.15), "clock_shift", tuple(tau)),
        Mistake("rates late", late(run, v, 0.1), "clock_shift", tuple(v)),
        Mistake("description in g", run, "scale", (), (1e3, 1.0)),
        Mistake("description in mm", run, "scale", (), (1.0, 1e3)),
    ]
    currents = run
    for name, k in zip(tau, rng.uniform(5.0, 60.0, len(tau)), strict=True):
        currents = scaled(currents, [name], 1.0 / k)
    exchanged = renamed(run, {joints[0]: joints[1], joints[1]: joints[0]}, ["v"])
    found += [
        Mistake("ampere", currents, "torque_unit", tuple(tau)),
        Mistake("rates of other joints", exchanged, "joints_swapped", tuple(v[:2])),
        Mistake("rates too slow", scaled(run, v, 0.6), "rate", tuple(v)),
    ]

    def fair(kind: str, name: str, wrong: Run, channels: Sequence[str]) -> bool:
        shows = tells(plant, run, wrong)
        if shows:
            found.append(Mistake(name, wrong, kind, tuple(channels)))
        return shows

    for _ in range(8):
        j = str(rng.choice(joints))
        if fair("position_sign", "one position negated", scaled(run, [f"q.{j}", f"v.{j}"], -1.0), [f"q.{j}"]):
            break
    fair("position_sign", "all positions negated", scaled(run, q + v, -1.0), q)
    for size, name in ((np.pi / 2, "a quarter turn"), (-np.pi / 2, "minus a quarter turn"), (np.pi, "half a turn")):
        for _ in range(8):
            j = str(rng.choice(joints))
            if fair("position_offset", name, moved(run, f"q.{j}", size), [f"q.{j}"]):
                break
    for kinds, name in (
        (["tau"], "torques exchanged"),
        (["q", "v"], "positions exchanged"),
        (["q", "v", "tau"], "joints exchanged"),
    ):
        for _ in range(20):
            a, b = (str(x) for x in rng.choice(joints, 2, replace=False))
            swapped = [f"{kinds[0]}.{a}", f"{kinds[0]}.{b}"]
            if fair("joints_swapped", name, renamed(run, {a: b, b: a}, kinds), swapped):
                break
    orders = {
        "reversed": dict(zip(joints, joints[::-1], strict=True)),
        "shifted": dict(zip(joints, joints[1:] + joints[:1], strict=True)),
    }
    for name, order in orders.items():
        for kinds in (["tau"], ["q", "v", "tau"]):
            told = f"{name} {'torques' if len(kinds) == 1 else 'joints'}"
            fair("joints_swapped", told, renamed(run, order, kinds), [f"{kinds[0]}.{j}" for j in joints])
    return found


def mounted(robot: str, real: str, seed: int) -> list[Mistake]:
    """Arms that hang elsewhere than described, and torques without gravity."""
    tau = tuple(f"tau.{j}" for j in Plant(robot).joints)
    slope = (0.0, G * float(np.sin(0.8)), -G * float(np.cos(0.8)))
    places: Mapping[str, Gravity] = {
        "ceiling": (0.0, 0.0, G), "wall": (-G, 0.0, 0.0), "other wall": (0.0, G, 0.0), "slope": slope,
        "gravity taken out": (0.0, 0.0, 0.0),
    }  # fmt: skip
    found = []
    for name, gravity in places.items():
        kind = "gravity_direction" if any(gravity) else "without_gravity"
        found.append(Mistake(name, arm(robot, real, seed, gravity=gravity).run, kind, tau))
    return found


def of_pendulums(sound: Sound, seed: int) -> list[Mistake]:
    """Mistakes that the physics of a pendulum shows."""
    del seed
    run, found = sound.run, list[Mistake]()
    has = set(run.channels)
    if "swing_angle" in has:
        a = ("swing_angle",)
        found += [
            Mistake("angle in degrees", scaled(run, a, 180 / np.pi), "angle_unit", a),
            Mistake("zero half a turn off", moved(run, a[0], np.pi), "position_offset", a),
            Mistake("zero a quarter turn off", moved(run, a[0], np.pi / 2), "position_offset", a),
        ]
        if "gripper_x" in has:
            both = [*a, *(["swing_rate"] if "swing_rate" in has else [])]
            found += [
                Mistake("angle's sign", scaled(run, both, -1.0), "position_sign", (*a, "gripper_x")),
                Mistake("angle late", late(run, [*both, *({"load_force"} & has)], 0.15), "clock_shift"),
                Mistake("gripper in mm", scaled(run, ["gripper_x"], 1e3), "scale", ("gripper_x",)),
                Mistake("gripper in cm", scaled(run, ["gripper_x"], 1e2), "scale", ("gripper_x",)),
            ]
    if "swing_rate" in has:
        r = ("swing_rate",)
        found.append(Mistake("rate in degrees", scaled(run, r, 180 / np.pi), "angle_unit", r))
        if "swing_angle" in has:
            found += [
                Mistake("rate's sign", scaled(run, r, -1.0), "position_sign", r),
                Mistake("rate late", late(run, r, 0.1), "clock_shift", r),
                Mistake("rate too slow", scaled(run, r, 0.6), "rate", r),
            ]
    if "load_force" in has:
        f = ("load_force",)
        found += [
            Mistake("force in mN", scaled(run, f, 1e3), "torque_unit", f),
            Mistake("force in gram-force", scaled(run, f, 1e3 / 9.80665), "torque_unit", f),
            Mistake("force's sign", scaled(run, f, -1.0), "torque_sign", f),
        ]
        if "swing_angle" in has:
            found.append(Mistake("force late", late(run, f, 0.15), "clock_shift", f))
    return found


def tells(plant: Plant, right: Run, wrong: Run) -> bool:
    """Whether rigid bodies see a mistake, on a joint that has load."""
    moments = slice(100, None, 40)

    def weight(run: Run) -> np.ndarray:
        return plant.weight(np.column_stack([run.channels[f"q.{j}"].value[moments] for j in plant.joints]))

    expected, there = weight(right), weight(wrong)
    for i, joint in enumerate(plant.joints):
        tau, here = (run.channels[f"tau.{joint}"].value[moments] for run in (wrong, right))
        size = np.sqrt(np.mean(here**2))
        error = np.sqrt(np.mean((tau - there[:, i]) ** 2)) - np.sqrt(np.mean((here - expected[:, i]) ** 2))
        if size > LOADED * plant.effort[i] and error > TOLD * size:
            return True
    return False
