"""Output error of `dry_swing` against records: what the true structure reaches, started at the truth.

A fit only has to stay in the basin of the truth where it starts.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import least_squares

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
    adapts = ["length", *(["mass"] if any(r.channel == "load_force" for r in records) else []), *free]
    return _descended(pendulum, adapts, records, steps)


def predicted(pendulum: Pendulum, records: Sequence[Record], steps: int = 25) -> Fitted:
    """Records that took no part in a fit: only their starts are adapted."""
    return _descended(pendulum, (), records, steps)


def _descended(pendulum: Pendulum, adapts: Sequence[str], records: Sequence[Record], steps: int) -> Fitted:
    """Length and mass are adapted as shares of their own, effects in units of `accelerating`."""
    units = {"length": pendulum.length, "mass": pendulum.mass}
    units |= {name: accelerating(pendulum, name) for name in adapts if name not in units}
    begun = {"length": pendulum.length, "mass": pendulum.mass, **pendulum.effects}
    floor = [0.2 if name in ("length", "mass") else -np.inf if name in SIGNED else 0.0 for name in adapts]
    places = [record.thinned for record in records]
    valid = [int(np.count_nonzero(np.isfinite(record.value))) for record in records]

    def built(x: np.ndarray) -> Pendulum:
        values = begun | {name: value * units[name] for name, value in zip(adapts, x.tolist(), strict=False)}
        return Pendulum(values.pop("length"), values.pop("mass"), values)

    def residuals(x: np.ndarray) -> list[np.ndarray]:
        made, starts = built(x), x[len(adapts) :].reshape(-1, 2).tolist()
        weigh = [np.sqrt(n / len(at)) for n, at in zip(valid, places, strict=True)]  # thinned runs keep their weight
        return [
            (record.value[at] - _read(made, (start[0], start[1]), record, at)) / record.noise * weight
            for record, at, start, weight in zip(records, places, starts, weigh, strict=True)
        ]

    begin = np.array([begun.get(name, 0.0) / units[name] for name in adapts] + [x for r in records for x in r.start])
    own = block_diag(*(np.ones((len(at), 2)) for at in places))  # what belongs to one run changes that run alone
    ended = begin if steps == 0 else least_squares(
        lambda x: np.concatenate(residuals(x)), begin, bounds=(floor + [-np.inf] * 2 * len(records), np.inf),
        x_scale="jac", jac_sparsity=np.hstack([np.ones((len(own), len(adapts))), own]), ftol=1e-5, max_nfev=steps,
    ).x  # fmt: skip
    left = [float(np.linalg.norm(run)) / np.sqrt(n) for run, n in zip(residuals(ended), valid, strict=True)]
    rmse = tuple(record.noise * one for record, one in zip(records, left, strict=True))
    starts = tuple((a, b) for a, b in ended[len(adapts) :].reshape(-1, 2).tolist())
    return Fitted(built(ended), starts, rmse, tuple(valid))


def _read(pendulum: Pendulum, start: tuple[float, float], record: Record, at: np.ndarray) -> np.ndarray:
    time = record.time[at]
    if at[0] > 0:  # a start belongs to the first stamp
        time = np.r_[record.time[0], time]
        return reading(pendulum.effects, record.channel, swing(pendulum, start, record.push, time))[1:]
    return reading(pendulum.effects, record.channel, swing(pendulum, start, record.push, time))


def sizes(pendulum: Pendulum, effects: Mapping[str, float]) -> dict[str, float]:
    """Sizes in units of `accelerating`, in which an angle sees them whatever the mass is."""
    return {effect: size / accelerating(pendulum, effect) for effect, size in effects.items()}
