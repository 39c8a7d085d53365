"""Output error of `dry_swing` against records: what the true structure reaches, started at the truth.

A Levenberg-Marquardt method with derivatives by differences; what belongs to one run changes that run alone. It only
has to stay in the basin of the truth where it starts.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from .dry_swing import G, Pendulum, Push, reading, swing

SIGNED = (
    "string_creep", "gripper_scale", "sensor_bias", "angle_offset", "angle_gain", "angle_skew", "angle_distortion",
    "pivot_stiffness",
)  # fmt: skip
"""Effects whose size may be negative."""
MOST_SAMPLES = 3000  # of one channel that a fit looks at; error is told of them too


@dataclass(frozen=True, eq=False)
class Record:
    """One channel of one run with its truth."""

    name: str  # of the run
    channel: str  # of the contract
    time: np.ndarray  # (n,) s
    value: np.ndarray  # (n,) as recorded, SI; nan where it was lost
    clean: np.ndarray  # (n,) as it would be without noise, hand and shake
    start: tuple[float, float]  # true angle and rate at `time[0]`
    push: Push  # what moves the pivot, as far as it is measured
    noise: float  # std of what was recorded

    @property
    def thinned(self) -> np.ndarray:
        """Places of the samples that a fit looks at."""
        seen = np.flatnonzero(np.isfinite(self.value))
        return seen[:: max(1, -(-len(seen) // MOST_SAMPLES))]


@dataclass(frozen=True)
class Fitted:
    """Where a fit ended."""

    pendulum: Pendulum  # with the sizes found
    starts: tuple[tuple[float, float], ...]  # of the records
    rmse: tuple[float, ...]  # of each record, in its unit
    samples: tuple[int, ...]  # of each record


def accelerating(pendulum: Pendulum, effect: str) -> float:
    """Size of an effect that does as much as 1 rad/s^2, or 1 1/s, or 1 1/rad, or 1 of a sensor's own unit."""
    inertia = pendulum.mass * pendulum.length**2
    return {
        "pivot_viscous_friction": inertia, "pivot_coulomb_friction": inertia, "pivot_stiffness": inertia,
        "pivot_load_friction": pendulum.length**2 / G, "quadratic_drag": pendulum.mass / pendulum.length,
        "linear_drag": pendulum.mass, "string_creep": pendulum.length,
    }.get(effect, 1.0)  # fmt: skip


class Derivatives:
    """Derivatives of all readings of records, over their noise, at the truth; at most `most` samples of a record."""

    def __init__(self, pendulum: Pendulum, records: Sequence[Record], most: int) -> None:
        self.pendulum, self.records = pendulum, records
        self.places = [np.arange(0, len(r.time), max(1, len(r.time) // most)) for r in records]
        self.base = [self._read(pendulum, k) for k in range(len(records))]
        self._by_effect: dict[str, np.ndarray] = {}

    def _read(self, pendulum: Pendulum, k: int, start: tuple[float, float] | None = None) -> np.ndarray:
        record = self.records[k]
        return _read(pendulum, start or record.start, record, self.places[k]) / record.noise

    def by(self, effect: str) -> np.ndarray:
        """(n,) by the size of an effect, in units of `accelerating`."""
        if effect not in self._by_effect:
            size = self.pendulum.effects.get(effect, 0.0) + 1e-4 * accelerating(self.pendulum, effect)
            more = replace(self.pendulum, effects={**self.pendulum.effects, effect: size})
            self._by_effect[effect] = self._change(more) / 1e-4
        return self._by_effect[effect]

    def _change(self, other: Pendulum) -> np.ndarray:
        return np.concatenate([self._read(other, k) - here for k, here in enumerate(self.base)])

    @cached_property
    def nuisances(self) -> np.ndarray:
        """(n, 1 + 2 runs) by what every fit adapts: the length, the mass where a force is read, the starts."""
        pendulum, columns = self.pendulum, []
        columns.append(self._change(replace(pendulum, length=pendulum.length * (1 + 1e-6))))
        if any(record.channel == "load_force" for record in self.records):
            columns.append(self._change(replace(pendulum, mass=pendulum.mass * (1 + 1e-6))))
        begins = np.cumsum([0, *map(len, self.base)])
        for k, record in enumerate(self.records):
            angle, rate = record.start
            for start in ((angle + 1e-5, rate), (angle, rate + 1e-5)):
                column = np.zeros(begins[-1])
                column[begins[k] : begins[k + 1]] = self._read(pendulum, k, start) - self.base[k]
                columns.append(column)
        return np.array(columns).T


def fitted(pendulum: Pendulum, free: Sequence[str], records: Sequence[Record], steps: int = 25) -> Fitted:
    """Length, sizes of the effects `free` and starts that describe records best, from those given."""
    heavy = any(record.channel == "load_force" for record in records)
    shared = np.array([1.0, 1.0, *(pendulum.effects.get(e, 0.0) / accelerating(pendulum, e) for e in free)])
    adapts = np.array([True, heavy, *(True for _ in free)])
    floor = np.array([0.2, 0.2, *(-np.inf if e in SIGNED else 0.0 for e in free)])
    return _descended(pendulum, free, records, shared, adapts, floor, steps)


def predicted(pendulum: Pendulum, records: Sequence[Record], steps: int = 25) -> Fitted:
    """Records that took no part in a fit: only their starts are adapted."""
    shared = np.array([1.0, 1.0])
    return _descended(pendulum, (), records, shared, np.zeros(2, dtype=bool), np.zeros(2), steps)


def _descended(
    pendulum: Pendulum,
    free: Sequence[str],
    records: Sequence[Record],
    shared: np.ndarray,
    adapts: np.ndarray,
    floor: np.ndarray,
    steps: int,
) -> Fitted:
    units = {effect: accelerating(pendulum, effect) for effect in free}
    places = [record.thinned for record in records]
    valid = [int(np.count_nonzero(np.isfinite(record.value))) for record in records]
    starts = np.array([record.start for record in records])
    count, runs = len(shared), range(len(records))

    def built(x: np.ndarray) -> Pendulum:
        sizes = {e: v * units[e] for e, v in zip(free, x[2:].tolist(), strict=True)}
        return Pendulum(pendulum.length * x[0], pendulum.mass * x[1], {**pendulum.effects, **sizes})

    def residual(made: Pendulum, start: np.ndarray, k: int) -> np.ndarray:
        record, at = records[k], places[k]
        read = _read(made, (float(start[0]), float(start[1])), record, at)
        return (record.value[at] - read) / record.noise * np.sqrt(valid[k] / len(at))  # thinned runs keep their weight

    def residuals(x: np.ndarray, s: np.ndarray) -> list[np.ndarray]:
        made = built(x)
        return [residual(made, s[k], k) for k in runs]

    here = residuals(shared, starts)
    cost, damping = sum(float(r @ r) for r in here), 1e-6
    small = np.array([1e-6, 1e-6, *(1e-5 for _ in free)])
    which = np.flatnonzero(adapts)
    for _ in range(steps):
        normal = np.zeros((count + 2 * len(records),) * 2)
        slope = np.zeros(len(normal))
        changed = [
            residuals(shared + small * (np.arange(count) == j), starts) if adapts[j] else here for j in range(count)
        ]
        for k in runs:
            columns = np.zeros((len(here[k]), count + 2))
            for j in which:
                columns[:, j] = (changed[j][k] - here[k]) / small[j]
            for j in (0, 1):
                moved = starts[k] + 1e-6 * (np.arange(2) == j)
                columns[:, count + j] = (residual(built(shared), moved, k) - here[k]) / 1e-6
            at = np.r_[np.arange(count), count + 2 * k, count + 2 * k + 1]
            normal[np.ix_(at, at)] += columns.T @ columns
            slope[at] -= columns.T @ here[k]
        held = np.r_[~adapts | ((shared <= floor) & (slope[:count] < 0.0)), np.zeros(2 * len(records), dtype=bool)]
        move, gain = ~held, 0.0
        for _ in range(8):
            step = np.zeros(len(normal))
            part = normal[np.ix_(move, move)]
            step[move] = np.linalg.lstsq(part + damping * np.diag(np.diag(part) + 1e-12), slope[move], rcond=None)[0]
            x, s = np.maximum(shared + step[:count], floor), starts + step[count:].reshape(-1, 2)
            there = residuals(x, s)
            new = sum(float(r @ r) for r in there)
            if np.isfinite(new) and new < cost:
                gain, damping = cost - new, max(0.1 * damping, 1e-9)
                shared, starts, here, cost = x, s, there, new
                break
            damping = min(max(10 * damping, 1e-6) * 3, 1e6)
        if gain <= 1e-5 * cost:
            break
    rmse = tuple(
        record.noise * float(np.linalg.norm(r)) / np.sqrt(n) for record, r, n in zip(records, here, valid, strict=True)
    )
    return Fitted(built(shared), tuple((float(a), float(b)) for a, b in starts), rmse, tuple(valid))


def _read(pendulum: Pendulum, start: tuple[float, float], record: Record, at: np.ndarray) -> np.ndarray:
    time = record.time[at]
    if at[0] > 0:  # a start belongs to the first stamp
        time = np.r_[record.time[0], time]
        return reading(pendulum.effects, record.channel, swing(pendulum, start, record.push, time))[1:]
    return reading(pendulum.effects, record.channel, swing(pendulum, start, record.push, time))


def sizes(pendulum: Pendulum, effects: Mapping[str, float]) -> dict[str, float]:
    """Sizes in units of `accelerating`, in which an angle sees them whatever the mass is."""
    return {effect: size / accelerating(pendulum, effect) for effect, size in effects.items()}
