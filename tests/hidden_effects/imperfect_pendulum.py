"""Pendulums as people record them, with videos, encoders, potentiometers, gyros and load cells, and a known truth.

`world` draws a pendulum with one or two effects hidden in it (`names`), with frictions hidden under clean sensors
(`fits`), or with nothing hidden and white noise (`clean`). Sizes and faults are those of real recordings: frictions of
multiarm_pendulum, freeswing_1khz and pend_* (b 0.01 to 0.3 1/s, c 0.01 to 1.8 rad/s^2, d 0.003 to 0.05 1/rad), skews
and distortions of phone videos, a potentiometer that reads some per cent too much.

A draw counts only where it is a fair question: without any one of the hidden effects, and with length, mass and starts
adapted, the error is at least `VISIBLE` times the noise. It comes from the derivatives of the true motion, so that it
is exact for small effects, which are the ones in question. Nothing here comes from armdyn's models.
"""

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from armdyn.run import Channel, Run
from armdyn.units import Known

from .dry_swing import G, Motion, Pendulum, Push, reading, swing
from .output_error import Derivatives, Record, accelerating, sizes

VISIBLE = 2.0
"""Error without an effect, over the noise, from which on it is fair to ask for it."""
BACKGROUND = 0.5
"""The same, at most, of all imperfections together that bear the name of an effect."""
ALIKE = 4.0
"""Root of the rise of chi2, were the noise white, when a rival takes the place of an effect, up to which either name is
right."""
AS_LARGE = 1.25
"""Of two effects, what either leaves alone, up to which either may be named first."""
ATTEMPTS = 60
MOST_SAMPLES = 30_000
"""Of one run."""
LOOKED_AT = 600
"""Samples of a run from which it is told what is visible."""

FRICTIONS = ("pivot_viscous_friction", "pivot_coulomb_friction", "quadratic_drag", "pivot_load_friction")
ANGLE = ("angle_offset", "angle_gain", "angle_skew", "angle_distortion")
GRIPPER = ("gripper_scale", "gripper_lag")
ROTATIONS = ("path_tilt", "wind")
"""What an offset of the angle cannot be told from while the pivot stands."""
EXCLUSIVE = ({"pivot_viscous_friction", "linear_drag"},)
"""Effects that are never hidden together."""
SIZES: Mapping[str, tuple[float, float]] = {
    "pivot_viscous_friction": (0.01, 0.3), "linear_drag": (0.01, 0.3), "pivot_coulomb_friction": (0.005, 1.5),
    "pivot_load_friction": (0.005, 1.5), "quadratic_drag": (0.003, 0.05), "pivot_stiffness": (0.2, 3.0),
    "angle_offset": (5e-3, 6e-2), "angle_gain": (0.02, 0.08), "angle_skew": (0.01, 0.06),
    "angle_distortion": (0.01, 0.08), "string_creep": (1e-5, 5e-4), "gripper_scale": (0.02, 0.1),
    "gripper_lag": (5e-3, 4e-2),
}  # fmt: skip
"""From and to, in units of `accelerating`; drawn evenly in the logarithm."""
SIGNED = {*ANGLE, "string_creep", "gripper_scale", "sensor_bias"}
"""Effects of either sign."""


@dataclass(frozen=True)
class Sensor:
    """What stands between a motion and its samples.

    Attributes:
        channel: of the contract.
        rate: Hz.
        white: std of one sample, SI.
        correlation: of the noise from sample to sample.
        quantum: steps of the stored value; 0 where they are fine.
        clusters: spells per minute of three times the noise, as of a tracker that nearly lost its marker.
        lost: share of samples that are missing, in clumps.
        jitter: of the stamps, as a share of their interval; a tenth of it is not written down.
        slips: counts lost per minute, each a step of the mean by one quantum.
    """

    channel: str
    rate: float
    white: float
    correlation: float = 0.0
    quantum: float = 0.0
    clusters: float = 0.0
    lost: float = 0.0
    jitter: float = 0.0
    slips: float = 0.0

    @property
    def std(self) -> float:
        """Of one sample, faults not counted."""
        return float(np.hypot(self.white, self.quantum / np.sqrt(12.0)))


@dataclass(frozen=True)
class Plan:
    """How one run is made: a release from an amplitude, or a drive to one.

    Attributes:
        role: ``"run"``, ``"held out"`` or ``"exam"``.
        driven: whether the gripper moves.
        amplitude: rad.
        duration: s.
    """

    role: str
    driven: bool
    amplitude: float
    duration: float


@dataclass(frozen=True, eq=False)
class World:
    """Recordings with the truth behind them.

    Attributes:
        name: kind, seed and what is hidden.
        kind: of recording, of `KINDS`.
        runs: for training.
        held_out: of another amplitude.
        exam: of a third one, without hands and slips.
        hidden: size by effect, SI.
        background: size by effect of imperfections that bear the name of an effect.
        first: effects that explain most; more than one where they explain about as much.
        alike: by hidden effect, others that these runs cannot tell from it.
        visible: by hidden effect, error without it over the noise.
        noise: std by channel of the sensor in the training runs, faults included.
        pendulum: length, mass and hidden effects.
        records: by role, with the truth of every run.
        guess: length and mass that a user starts from.
        wrong: a friction that is not there; of `fits` only.
        draws: how many were made until one was fair.
    """

    name: str
    kind: str
    runs: tuple[Run, ...]
    held_out: tuple[Run, ...]
    exam: tuple[Run, ...]
    hidden: Mapping[str, float]
    background: Mapping[str, float]
    first: tuple[str, ...]
    alike: Mapping[str, frozenset[str]]
    visible: Mapping[str, float]
    noise: Mapping[str, float]
    pendulum: Pendulum
    records: Mapping[str, tuple[Record, ...]]
    guess: tuple[float, float]
    wrong: str = ""
    draws: int = 1

    @property
    def length(self) -> float:
        """Pivot to centre of the load, m."""
        return self.pendulum.length

    @property
    def mass(self) -> float:
        """Of the load, kg."""
        return self.pendulum.mass


@dataclass(frozen=True)
class Kind:
    """A way to record a pendulum.

    Attributes:
        sensor: of the angle, the rate or the force.
        plans: of a whole set of runs.
        effects: that may be hidden.
        length: range, m.
    """

    sensor: Callable[[np.random.Generator], Sensor]
    plans: Callable[[np.random.Generator], list[Plan]]
    effects: tuple[str, ...]
    length: tuple[float, float] = (0.1, 1.5)


def _video(rng: np.random.Generator) -> Sensor:
    pixel = 1.0 / rng.uniform(300.0, 900.0)  # the string's length in pixels
    return Sensor(
        "swing_angle", float(rng.choice([15, 20, 24, 25, 30, 60])), rng.uniform(0.7e-3, 4e-3), rng.uniform(0.2, 0.7),
        quantum=float(pixel * rng.choice([0.0, 1.0])), clusters=rng.uniform(0.0, 2.0), lost=rng.uniform(0.0, 0.03),
        jitter=float(rng.choice([0.0, 0.05])),
    )  # fmt: skip


def _encoder(rng: np.random.Generator) -> Sensor:
    quantum = 2 * np.pi / float(rng.choice([1000, 2000, 4000, 4096, 10_000, 40_000]))
    rate = float(rng.choice([20, 50, 100, 200, 500, 1000]))
    return Sensor("swing_angle", rate, 0.1 * quantum, quantum=quantum, slips=float(rng.choice([0.0, 0.0, 2.0])))


def _potentiometer(rng: np.random.Generator) -> Sensor:
    bits = float(rng.choice([10, 12, 16]))
    rate = float(rng.choice([50, 100, 250, 500]))
    return Sensor("swing_angle", rate, rng.uniform(0.7e-3, 3e-3), quantum=6.0 / 2**bits)


def _gyro(rng: np.random.Generator) -> Sensor:
    return Sensor("swing_rate", float(rng.choice([50, 100, 200])), rng.uniform(3e-3, 15e-3), rng.uniform(0.0, 0.3))


def _load_cell(rng: np.random.Generator) -> Sensor:
    return Sensor("load_force", 100.0, rng.uniform(2e-3, 4e-3))  # N per 0.1 kg


def _any_angle(rng: np.random.Generator) -> Sensor:
    return (_video, _encoder, _potentiometer)[rng.integers(3)](rng)


def _amplitude(rng: np.random.Generator) -> float:
    """Small, large or nearly upside down, rad."""
    low, high = ((0.2, 0.8), (0.8, 1.6), (1.6, 2.96))[rng.choice(3, p=[0.45, 0.35, 0.2])]
    return float(rng.uniform(low, high))


def _decays(shortest: float, longest: float, largest: float = 3.0) -> Callable[[np.random.Generator], list[Plan]]:
    def plans(rng: np.random.Generator) -> list[Plan]:
        amplitude = min(_amplitude(rng), largest)
        duration = np.exp(rng.uniform(np.log(shortest), np.log(longest)))
        return [
            Plan("run", False, amplitude, duration),
            Plan("held out", False, amplitude * rng.uniform(0.3, 0.6), 0.6 * duration),
            Plan("exam", False, amplitude * rng.uniform(0.6, 0.85), 0.6 * duration),
        ]

    return plans


def _large_and_small(rng: np.random.Generator) -> list[Plan]:
    large, small = rng.uniform(1.0, 2.9), rng.uniform(0.15, 0.4)
    return [
        Plan("run", False, large, rng.uniform(15.0, 60.0)), Plan("run", False, small, rng.uniform(10.0, 40.0)),
        Plan("held out", False, 0.6 * large, 20.0), Plan("exam", False, 0.8 * large, 20.0),
    ]  # fmt: skip


def _driven(rng: np.random.Generator) -> list[Plan]:
    several = [Plan("run", True, rng.uniform(0.15, 0.8), rng.uniform(12.0, 40.0)) for _ in range(rng.integers(1, 3))]
    largest = max(plan.amplitude for plan in several)
    return [
        *several, Plan("held out", True, 0.6 * largest, 15.0), Plan("exam", True, 0.85 * largest, 15.0),
    ]  # fmt: skip


def _decay_and_driven(rng: np.random.Generator) -> list[Plan]:
    swings = rng.uniform(0.3, 1.4)
    return [
        Plan("run", False, swings, rng.uniform(12.0, 50.0)), Plan("run", True, rng.uniform(0.2, 0.8), 25.0),
        Plan("held out", False, 0.5 * swings, 15.0), Plan("exam", True, rng.uniform(0.2, 0.8), 20.0),
    ]  # fmt: skip


FREE = (*FRICTIONS, "pivot_stiffness", *ANGLE, "string_creep")
MOVED = (*FRICTIONS, "linear_drag", "pivot_stiffness", *ANGLE, *GRIPPER)
KINDS: Mapping[str, Kind] = {
    "decay by encoder": Kind(_encoder, _decays(10.0, 60.0), FREE, (0.1, 0.8)),
    "decay by video": Kind(_video, _decays(15.0, 140.0), FREE, (0.3, 1.5)),
    "driven by encoder": Kind(_encoder, _driven, MOVED, (0.15, 0.8)),
    "decay by gyro": Kind(_gyro, _decays(10.0, 60.0, 1.2), (*FRICTIONS, "pivot_stiffness", "sensor_bias"), (0.2, 1.0)),
    "large and small": Kind(_any_angle, _large_and_small, FREE),
    "decay and driven": Kind(_any_angle, _decay_and_driven, MOVED, (0.15, 1.2)),
    "decay by potentiometer": Kind(_potentiometer, _decays(10.0, 60.0), FREE, (0.1, 1.0)),
    "force": Kind(_load_cell, _driven, ("pivot_viscous_friction", "pivot_coulomb_friction", "quadratic_drag",
                                        "linear_drag", *GRIPPER, "sensor_bias"), (0.25, 0.6)),
}  # fmt: skip
FITTED = ("decay by encoder", "driven by encoder", "large and small", "decay and driven")
"""Kinds whose motions `fits` have."""


def world(seed: int, what: str = "names", hidden: Sequence[str] | None = None) -> World:
    """One world.

    Args:
        seed: of everything that is random; it also goes through the kinds.
        what: ``"names"``, ``"clean"`` or ``"fits"``.
        hidden: names of effects to hide; drawn where not given.

    Raises:
        RuntimeError: none of `ATTEMPTS` draws is fair.
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
    """One draw; None where it is no fair question."""
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
    records = [_ideal(rng, true, sensor, plan, k) for k, plan in enumerate(plans)]
    if any(record is None for record in records):
        return None
    train = [r for r, plan in zip(records, plans, strict=True) if plan.role == "run"]
    derivatives = Derivatives(true, train, LOOKED_AT)
    samples = sum(len(record.time) for record in train)
    sight = _sight(derivatives, kind.effects, samples, driven=any(plan.driven for plan in plans))
    if sight is None:
        return None
    background = {} if clean else _background(rng, derivatives, sensor)
    recorded = [
        _recorded(rng, true, background, r, plan, sensor, clean) for r, plan in zip(records, plans, strict=True)
    ]
    runs = [_run(rng, r, plan, sensor, mass, clean) for r, plan in zip(recorded, plans, strict=True)]
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


def _ideal(rng: np.random.Generator, pendulum: Pendulum, sensor: Sensor, plan: Plan, k: int) -> Record | None:
    """A run without noise; None where a drive swings the load too far."""
    interval = 1.0 / sensor.rate
    time = np.arange(0.0, plan.duration, interval)
    time[1:] += sensor.jitter * interval * rng.uniform(-1.0, 1.0, len(time) - 1)
    push, start = Push(), (plan.amplitude * float(rng.choice([-1.0, 1.0])), 0.0)
    if plan.driven:
        start = (0.005 * rng.normal(), 0.01 * rng.normal())
        shape = _shape(rng, pendulum, plan.duration)
        scale = 0.03
        for _ in range(4):
            push = Push(_scaled(shape, scale))
            reached = float(np.max(np.abs(swing(pendulum, start, push, time).angle)))
            scale *= float(np.clip(plan.amplitude / reached, 0.2, 5.0))
        travel = np.max(np.abs(push.gripper(time)[0]))
        if not 0.5 * plan.amplitude < reached < 1.5 * plan.amplitude or not 2e-3 < travel < 0.6:
            return None
    motion = reading(pendulum.effects, sensor.channel, swing(pendulum, start, push, time))
    label = f"{plan.role.replace(' ', '_')}_{k}.csv"
    return Record(label, sensor.channel, time, motion, motion, start, push, sensor.std)


def _shape(rng: np.random.Generator, pendulum: Pendulum, duration: float) -> Motion:
    """A multisine, a chirp or a sine near the resonance, from rest and back to rest; x, v, a of about 1 m."""
    w0, kind = 2 * np.pi / pendulum.period, rng.integers(3)
    end = duration * float(rng.choice([0.7, 1.0]))
    ramp = min(1.5 * pendulum.period, 0.2 * duration)
    if kind == 0:
        w, sizes_, phases = w0 * rng.uniform(0.3, 1.6, 4), rng.uniform(0.3, 1.0, 4), rng.uniform(0, 2 * np.pi, 4)
    elif kind == 1:
        w, sizes_, phases = w0 * rng.uniform(0.9, 1.1, 1), np.ones(1), np.zeros(1)
    low, high = w0 * rng.uniform(0.3, 0.6), w0 * rng.uniform(1.4, 2.0)

    def carrier(t: np.ndarray) -> np.ndarray:
        if kind == 2:
            phase, rate = low * t + (high - low) / (2 * duration) * t**2, low + (high - low) / duration * t
            sine, cosine = np.sin(phase), np.cos(phase)
            return np.array([sine, rate * cosine, (high - low) / duration * cosine - rate**2 * sine])
        phase = np.multiply.outer(w, t) + phases[:, None]
        return np.array([sizes_ @ np.sin(phase), (sizes_ * w) @ np.cos(phase), -(sizes_ * w**2) @ np.sin(phase)])

    def window(t: np.ndarray) -> np.ndarray:
        up, down = (np.clip(s / ramp, 0.0, 1.0) for s in (t, end - t))
        (a, da, dda), (b, db, ddb) = (
            (
                u**4 * (35 - 84 * u + 70 * u**2 - 20 * u**3),
                140 * u**3 * (1 - u) ** 3 / ramp,
                420 * u**2 * (1 - u) ** 2 * (1 - 2 * u) / ramp**2,
            )
            for u in (up, down)
        )
        return np.array([a * b, da * b - a * db, dda * b - 2 * da * db + a * ddb])

    def motion(t: np.ndarray) -> np.ndarray:
        (x, v, a), (w_, dw, ddw) = carrier(t), window(t)
        return np.array([w_ * x, dw * x + w_ * v, ddw * x + 2 * dw * v + w_ * a])

    return motion


def _scaled(shape: Motion, scale: float) -> Motion:
    return lambda t: scale * shape(t)


@dataclass(frozen=True)
class Sight:
    """What training runs show of hidden effects; see `World`."""

    visible: Mapping[str, float]
    first: tuple[str, ...]
    alike: Mapping[str, frozenset[str]]


def _sight(found: Derivatives, rivals: Sequence[str], samples: int, *, driven: bool) -> Sight | None:
    """None where something hidden is not visible."""
    hidden, adapted = tuple(found.pendulum.effects), found.nuisances
    if not hidden:
        return Sight({}, (), {})
    true = {effect: found.by(effect) * size for effect, size in sizes(found.pendulum, found.pendulum.effects).items()}
    beside = {effect: [adapted, *(found.by(e) for e in hidden if e != effect)] for effect in hidden}
    visible = {effect: _left(true[effect], beside[effect]) for effect in hidden}
    if min(visible.values()) < VISIBLE:
        return None
    every = [r for r in dict.fromkeys([*rivals, *(() if driven else ("linear_drag",))]) if r not in hidden]
    close = ALIKE / np.sqrt(samples)
    alike = {
        effect: frozenset(
            [rival for rival in every if _left(true[effect], [*beside[effect], found.by(rival)]) < close]
            + ([*ROTATIONS] if effect == "angle_offset" and not driven else [])
        )
        for effect in hidden
    }
    total = np.sum([*true.values()], axis=0)
    alone = {effect: _left(total, [adapted, found.by(effect)]) for effect in hidden}
    least = max(min(alone.values()), close)
    return Sight(visible, tuple(effect for effect in hidden if alone[effect] <= AS_LARGE * least), alike)


def _left(target: np.ndarray, adapted: Sequence[np.ndarray]) -> float:
    """Root mean square that a linear combination of columns leaves of a target."""
    columns = np.column_stack(adapted)
    columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    rest = target - columns @ np.linalg.lstsq(columns, target, rcond=1e-9)[0]
    return float(np.sqrt(np.mean(rest**2)))


def _background(rng: np.random.Generator, found: Derivatives, sensor: Sensor) -> dict[str, float]:
    """Small errors of an angle sensor that bear the names of effects, where these are not hidden."""
    if sensor.channel != "swing_angle":
        return {}
    names = [effect for effect in ANGLE if effect not in found.pendulum.effects]
    drawn = {effect: float(rng.uniform(-0.5, 0.5)) * SIZES[effect][1] for effect in names}
    does = _left(np.sum([size * found.by(effect) for effect, size in drawn.items()], axis=0), [found.nuisances])
    share = min(1.0, BACKGROUND / max(does, 1e-9))
    return {effect: share * size for effect, size in drawn.items()}


def _recorded(
    rng: np.random.Generator,
    pendulum: Pendulum,
    background: Mapping[str, float],
    ideal: Record,
    plan: Plan,
    sensor: Sensor,
    clean: bool,
) -> Record:
    """A run as the sensor stores it."""
    time = ideal.time
    if clean:
        noise = sensor.white * rng.normal(size=len(time))
        return replace(ideal, value=ideal.clean + noise, noise=float(np.sqrt(np.mean(noise**2))))
    real = replace(pendulum, effects={**background, **pendulum.effects})
    push = ideal.push
    if rng.uniform() < 0.5:
        push = replace(push, shake=_shake(rng, pendulum, ideal, sensor))
    if not plan.driven and plan.role != "exam" and rng.uniform() < 0.4:
        accelerates = rng.uniform(0.02, 0.1) * G / pendulum.length * min(plan.amplitude, 1.0)
        push = replace(push, hand=(accelerates * float(rng.choice([-1.0, 1.0])), rng.uniform(0.1, 0.3)))
    seen = time.copy()
    if sensor.jitter:  # frames are exposed a little before or after their stamp
        seen[1:-1] += 0.1 * sensor.jitter / sensor.rate * rng.normal(size=len(time) - 2)
    stamped = reading(real.effects, sensor.channel, swing(real, ideal.start, push, time))
    true = reading(real.effects, sensor.channel, swing(real, ideal.start, push, seen)) if sensor.jitter else stamped
    noise = rng.normal(size=len(time))
    for i in range(1, len(noise)):
        noise[i] = sensor.correlation * noise[i - 1] + np.sqrt(1 - sensor.correlation**2) * noise[i]
    minutes = time[-1] / 60.0
    for begin in rng.uniform(0.0, time[-1], rng.poisson(sensor.clusters * minutes)):
        noise[(time >= begin) & (time < begin + rng.uniform(0.2, 1.0))] *= 3.0
    value = true + sensor.white * noise
    if sensor.quantum:
        value = sensor.quantum * np.round(value / sensor.quantum)
    if plan.role != "exam":
        for begin in rng.uniform(0.0, time[-1], rng.poisson(sensor.slips * minutes)):
            value[time >= begin] += sensor.quantum * rng.choice([-1, 1])
    if sensor.lost:
        count = rng.poisson(0.3 * sensor.lost * len(time))
        for begin in rng.integers(1, len(time) - 1, count):
            value[begin : min(begin + rng.geometric(0.3), len(time) - 1)] = np.nan
    return replace(ideal, value=value, noise=float(np.sqrt(np.nanmean((value - stamped) ** 2))))


def _shake(rng: np.random.Generator, pendulum: Pendulum, ideal: Record, sensor: Sensor) -> Motion:
    """A pivot that gives way: a sine beside the resonance, of an effect below the noise."""
    w, phase = 2 * np.pi / pendulum.period * rng.uniform(1.4, 3.5), rng.uniform(0.0, 2 * np.pi)

    def motion(t: np.ndarray, size: float = 1e-4) -> np.ndarray:
        sine, cosine = np.sin(w * t + phase), np.cos(w * t + phase)
        return size * np.array([sine, w * cosine, -(w**2) * sine])

    moved = swing(pendulum, ideal.start, replace(ideal.push, shake=motion), ideal.time)
    does = np.sqrt(np.mean((reading(pendulum.effects, sensor.channel, moved) - ideal.clean) ** 2))
    size = min(5e-4, 1e-4 * rng.uniform(0.2, 0.8) * sensor.std / max(does, 1e-12))
    return lambda t: motion(t, size)


def _run(rng: np.random.Generator, record: Record, plan: Plan, sensor: Sensor, mass: float, clean: bool) -> Run:
    """The recording as a user has it."""
    kept = np.isfinite(record.value)
    channels = {sensor.channel: Channel(record.time[kept], record.value[kept], _UNITS[sensor.channel])}
    stated = {sensor.channel: sensor.std} if clean or rng.uniform() < 0.7 else {}
    if plan.driven:
        assert record.push.gripper is not None
        rate = max(sensor.rate, 100.0)
        time = np.arange(0.0, record.time[-1] + 1.0 / rate, 1.0 / rate)
        x, noise = record.push.gripper(time)[0], 0.0 if clean else float(rng.uniform(2e-5, 2e-4))
        channels["gripper_x"] = Channel(time, x + noise * rng.normal(size=len(time)), "m")
        if stated:
            stated["gripper_x"] = noise
    known = {}
    if sensor.channel == "load_force":
        known["mass"] = Known(mass, 0.005 * mass, "kg")
    return Run(record.name, channels, known, stated)


_UNITS = {"swing_angle": "rad", "swing_rate": "rad/s", "load_force": "N"}
