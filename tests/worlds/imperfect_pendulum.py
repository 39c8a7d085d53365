"""Pendulums as people record them, with videos, encoders, potentiometers, gyros and load cells, and a known truth.

`world` draws a pendulum with one or two effects hidden in it (`names`), with frictions hidden under clean sensors
(`fits`), or with nothing hidden and white noise (`clean`). Sizes and faults are those of real recordings: frictions of
multiarm_pendulum, freeswing_1khz and pend_* (b 0.01 to 0.3 1/s, c 0.01 to 1.8 rad/s^2, d 0.003 to 0.05 1/rad), skews
and distortions of phone videos, a potentiometer that reads some per cent too much.

A draw counts only where it is a fair question: without any one of the hidden effects, and with length, mass and starts
adapted, the error is at least `VISIBLE` times the noise. Nothing here comes from armdyn's models.
"""

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from armdyn.run import Run

from . import squares_left
from .dry_swing import Pendulum
from .output_error import Derivatives, Record, accelerating, sizes
from .pendulum_sensors import ANGLE, FITTED, FRICTIONS, KINDS, Kind, Sensor, ideal, recorded_run, run_of

BACKGROUND = 0.5
"""Error without them over the noise, at most, of all imperfections together that bear the name of an effect."""
ATTEMPTS = 60
MOST_SAMPLES = 30_000  # of one run
LOOKED_AT = 600  # samples of a run from which it is told what is visible
EXCLUSIVE = ({"pivot_viscous_friction", "linear_drag"},)  # effects that are never hidden together
SIZES: Mapping[str, tuple[float, float]] = {
    "pivot_viscous_friction": (0.01, 0.3), "linear_drag": (0.01, 0.3), "pivot_coulomb_friction": (0.005, 1.5),
    "pivot_load_friction": (0.005, 1.5), "quadratic_drag": (0.003, 0.05), "pivot_stiffness": (0.2, 3.0),
    "angle_offset": (5e-3, 6e-2), "angle_gain": (0.02, 0.08), "angle_skew": (0.01, 0.06),
    "angle_distortion": (0.01, 0.08), "string_creep": (1e-5, 5e-4), "gripper_scale": (0.02, 0.1),
    "gripper_lag": (5e-3, 4e-2),
}  # fmt: skip
"""From and to, in units of `accelerating`; drawn evenly in the logarithm."""
VISIBLE = 2.0  # error without an effect, over the noise, from which on it is fair to ask for it
ALIKE = 4.0
"""Root of the rise of chi2, were the noise white, when a rival takes the place of an effect, up to which either name is
right."""
AS_LARGE = 1.25  # of two effects, what either leaves alone, up to which either may be named first
ROTATIONS = ("path_tilt", "wind")  # what an offset of the angle cannot be told from while the pivot stands
SIGNED = {*ANGLE, "string_creep", "gripper_scale", "sensor_bias"}  # effects of either sign


@dataclass(frozen=True, eq=False)
class World:
    """Recordings with the truth behind them."""

    name: str  # kind, seed and what is hidden
    kind: str  # of recording, of `KINDS`
    runs: tuple[Run, ...]  # for training
    held_out: tuple[Run, ...]  # of another amplitude
    exam: tuple[Run, ...]  # of a third one, without hands and slips
    hidden: Mapping[str, float]  # size by effect, SI
    background: Mapping[str, float]  # size by effect of imperfections that bear the name of an effect
    first: tuple[str, ...]  # effects that explain most; more than one where they explain about as much
    alike: Mapping[str, frozenset[str]]  # by hidden effect, others that these runs cannot tell from it
    visible: Mapping[str, float]  # by hidden effect, error without it over the noise
    noise: Mapping[str, float]  # std by channel of the sensor in the training runs, faults included
    pendulum: Pendulum  # length, mass and hidden effects
    records: Mapping[str, tuple[Record, ...]]  # by role, with the truth of every run
    guess: tuple[float, float]  # length and mass that a user starts from
    wrong: str = ""  # a friction that is not there; of `fits` only
    draws: int = 1  # how many were made until one was fair

    @property
    def length(self) -> float:
        """Pivot to centre of the load, m."""
        return self.pendulum.length

    @property
    def mass(self) -> float:
        """Of the load, kg."""
        return self.pendulum.mass


def world(seed: int, what: str = "names", hidden: Sequence[str] | None = None) -> World:
    """One world of ``"names"``, ``"clean"`` or ``"fits"``; the seed also goes through the kinds.

    Effects to hide are drawn where they are not given.
    """
    rng = np.random.default_rng([seed, zlib.crc32(what.encode())])
    kinds = FITTED if what == "fits" else tuple(KINDS)
    kind = kinds[seed % len(kinds)]
    for draw in range(ATTEMPTS):
        found = _drawn(rng, kind, what, hidden)
        if found is not None:
            label = "+".join(found.hidden) or "nothing"
            return replace(found, name=f"{kind} {seed}: {label}", draws=draw + 1)
    raise RuntimeError(f"{what} {seed}, {kind}: none of {ATTEMPTS} draws is fair")


def _drawn(rng: np.random.Generator, name: str, what: str, asked: Sequence[str] | None) -> World | None:
    """One draw; None where it is not a fair question."""
    kind, clean = KINDS[name], what != "names"
    length = float(np.exp(rng.uniform(*np.log(kind.length))))
    mass = float(rng.uniform(0.06, 0.12) if name == "force" else np.exp(rng.uniform(*np.log([0.03, 2.0]))))
    bare = Pendulum(length, mass, {})
    sensor, plans = kind.sensor(rng), kind.plans(rng)
    if sensor.channel == "load_force":
        sensor = replace(sensor, white=sensor.white * mass / 0.1)
    if clean:
        white = sensor.white if sensor.channel != "swing_angle" else float(np.exp(rng.uniform(*np.log([1e-4, 2e-3]))))
        sensor = Sensor(sensor.channel, sensor.rate, white)
    names = _hidden_names(rng, kind, what, name) if asked is None else tuple(asked)
    hidden = {effect: _size(rng, effect, bare) for effect in names}
    true = Pendulum(length, mass, hidden)
    longest = max(plan.duration for plan in plans)
    sensor = replace(sensor, rate=min(sensor.rate, MOST_SAMPLES / longest))
    records = [ideal(rng, true, sensor, plan, k) for k, plan in enumerate(plans)]
    if any(record is None for record in records):
        return None
    train = [r for r, plan in zip(records, plans, strict=True) if plan.role == "run"]
    derivatives = Derivatives(true, train, LOOKED_AT)
    samples = sum(len(record.time) for record in train)
    sight = sight_of(derivatives, kind.effects, samples, driven=any(plan.driven for plan in plans))
    if sight is None:
        return None
    background = {} if clean else _background(rng, derivatives, sensor)
    recorded = [
        recorded_run(rng, true, background, r, plan, sensor, clean) for r, plan in zip(records, plans, strict=True)
    ]
    runs = [run_of(rng, r, plan, sensor, mass, clean) for r, plan in zip(recorded, plans, strict=True)]
    of = {
        role: [k for k, plan in enumerate(plans) if plan.role == role] for role in ("run", "held out", "exam")
    }  # fmt: skip
    noise = float(np.sqrt(np.mean([recorded[k].noise ** 2 for k in of["run"]])))
    wrong = ""
    if what == "fits":
        others = [e for e in FRICTIONS[:3] if e not in hidden and not any(e in sight.alike[h] for h in hidden)]
        wrong = str(rng.choice(others)) if others else ""
    guess = (0.95 * length, mass * float(np.exp(0.3 * rng.normal())) if name != "force" else 1.1 * mass)
    return World(
        name, name, *(tuple(runs[k] for k in places) for places in of.values()), hidden, background, sight.first,
        sight.alike, sight.visible, {sensor.channel: noise}, true,
        {role: tuple(recorded[k] for k in places) for role, places in of.items()}, guess, wrong,
    )  # fmt: skip


def _hidden_names(rng: np.random.Generator, kind: Kind, what: str, name: str) -> tuple[str, ...]:
    """One or two; a free swing nearly always has a friction."""
    if what == "clean":
        return ()
    count = int(rng.integers(1, 3))
    if what == "fits":
        return tuple(str(e) for e in rng.choice(FRICTIONS[:3], count, replace=False))
    while True:
        chosen = [str(e) for e in rng.choice(kind.effects, count, replace=False)]
        if name.startswith(("decay", "large")) and rng.uniform() < 0.8 and not set(chosen) & set(FRICTIONS):
            continue
        if not any(pair <= set(chosen) for pair in EXCLUSIVE):
            return tuple(chosen)


def _size(rng: np.random.Generator, effect: str, pendulum: Pendulum) -> float:
    if effect == "sensor_bias":  # of a gyro, rad/s; a load cell's is told by what is visible
        low, high = 0.02, 1.5
    else:
        low, high = SIZES[effect]
    size = float(np.exp(rng.uniform(np.log(low), np.log(high)))) * accelerating(pendulum, effect)
    return size * float(rng.choice([-1.0, 1.0])) if effect in SIGNED else size


def _background(rng: np.random.Generator, found: Derivatives, sensor: Sensor) -> dict[str, float]:
    """Small errors of an angle sensor that bear the names of effects, where these are not hidden."""
    if sensor.channel != "swing_angle":
        return {}
    names = [effect for effect in ANGLE if effect not in found.pendulum.effects]
    drawn = {effect: float(rng.uniform(-0.5, 0.5)) * SIZES[effect][1] for effect in names}
    does = left(np.sum([size * found.by(effect) for effect, size in drawn.items()], axis=0), [found.nuisances])
    share = min(1.0, BACKGROUND / max(does, 1e-9))
    return {effect: share * size for effect, size in drawn.items()}


@dataclass(frozen=True)
class Sight:
    """What training runs show of hidden effects; see `World`."""

    visible: Mapping[str, float]
    first: tuple[str, ...]
    alike: Mapping[str, frozenset[str]]


def sight_of(found: Derivatives, rivals: Sequence[str], samples: int, *, driven: bool) -> Sight | None:
    """None where something hidden is not visible."""
    hidden, adapted = tuple(found.pendulum.effects), found.nuisances
    if not hidden:
        return Sight({}, (), {})
    true = {effect: found.by(effect) * size for effect, size in sizes(found.pendulum, found.pendulum.effects).items()}
    beside = {effect: [adapted, *(found.by(e) for e in hidden if e != effect)] for effect in hidden}
    visible = {effect: left(true[effect], beside[effect]) for effect in hidden}
    if min(visible.values()) < VISIBLE:
        return None
    every = [r for r in dict.fromkeys([*rivals, *(() if driven else ("linear_drag",))]) if r not in hidden]
    close = ALIKE / np.sqrt(samples)
    alike = {
        effect: frozenset(
            [rival for rival in every if left(true[effect], [*beside[effect], found.by(rival)]) < close]
            + ([*ROTATIONS] if effect == "angle_offset" and not driven else [])
        )
        for effect in hidden
    }
    total = np.sum([*true.values()], axis=0)
    alone = {effect: left(total, [adapted, found.by(effect)]) for effect in hidden}
    least = max(min(alone.values()), close)
    return Sight(visible, tuple(effect for effect in hidden if alone[effect] <= AS_LARGE * least), alike)


def left(target: np.ndarray, adapted: Sequence[np.ndarray]) -> float:
    """Root mean square that a linear combination of columns leaves of a target."""
    return float(np.sqrt(squares_left([np.column_stack(adapted)], target) / len(target)))
