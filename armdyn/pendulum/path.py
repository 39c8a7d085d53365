"""The gripper's path: whole, still growing, or trailed by what hangs from it; in a run, recorded or being recorded."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, partial
from typing import Any

import numpy as np

from armdyn.pendulum.dynamics import OUTPUTS
from armdyn.physics.recorded import (
    COARSEST_GRID,
    FINEST_GRID,
    ORDER,
    best_strength,
    differentiated,
    grid_size,
    halfway,
    penalised,
    slope,
    smoothed_motion,
)
from armdyn.readout import lagged
from armdyn.run import Run

CHOOSE_EVERY, CHOOSE_FROM = 100, 300
"""Samples after which the strength for a growing path is chosen anew, and from how many of the last."""
SETTLED = 60
"""Samples after which a later one no longer changes the smoothed path noticeably."""


@dataclass(frozen=True, eq=False)
class GripperPath:
    """The gripper along its line on a uniform grid.

    Attributes:
        start: time of the first node, s.
        dt: grid step, s.
        x: (K,) m.
        v: (K,) m/s.
        a: (K,) m/s^2.
        height: (3, K) z m, its velocity m/s and acceleration m/s^2; None for a level line.
        elapsed: time since the recording began at the first node, s; 0 but in a later piece of it.
    """

    start: float
    dt: float
    x: np.ndarray
    v: np.ndarray
    a: np.ndarray
    height: np.ndarray | None = None
    elapsed: float = 0.0

    @cached_property
    def inputs(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows t since the recording began, x, v, a, z, vz, az at the nodes (7, K) and halfway between (7, K-1)."""
        t = self.elapsed + self.dt * np.arange(len(self.x))
        along = np.vstack([self.x, self.v, self.a])
        height = np.zeros_like(along) if self.height is None else self.height
        between = (
            halfway(along, self.dt),
            np.zeros((3, len(t) - 1)) if self.height is None else halfway(height, self.dt),
        )
        return np.vstack([t, along, height]), np.vstack([(t[:-1] + t[1:]) / 2, *between])

    def rows(self, *, with_jerk: bool) -> tuple[np.ndarray, np.ndarray]:
        """Inputs of a simulation, at the nodes and halfway between, with the jerk as the last row where asked."""
        if not with_jerk:
            return self.inputs
        return _with_jerk(*self.inputs, self.dt)


def _with_jerk(nodes: np.ndarray, middle: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Inputs, and as one row more the rate of their fourth, the acceleration along the line."""
    rate = slope(nodes[3], dt)
    return np.vstack([nodes, rate]), np.vstack([middle, (rate[:-1] + rate[1:]) / 2])


@dataclass(frozen=True, eq=False)
class TrailingPath:
    """The path behind a first-order lag; make it with `trailing`.

    Attributes:
        start: time of the first node, s.
        dt: grid step, s.
        values: (8, K) and (8, K-1) as `GripperPath.rows` gives them with jerk.
        by_lag: their derivatives with respect to the lag.
    """

    start: float
    dt: float
    values: tuple[np.ndarray, np.ndarray]
    by_lag: tuple[np.ndarray, np.ndarray]

    def rows(self, *, with_jerk: bool) -> tuple[np.ndarray, np.ndarray]:
        """As of `GripperPath`, followed by their derivatives with respect to the lag."""
        last = None if with_jerk else -1
        nodes, middle = (np.vstack([v[:last], d[:last]]) for v, d in zip(self.values, self.by_lag, strict=True))
        return nodes, middle


def trailing(path: GripperPath, lag: float) -> TrailingPath:
    """The path of what follows a gripper with a lag, and its derivative with respect to the lag.

    tau z' + z = x, from a start at constant acceleration: z(0) = x - tau v + tau^2 a. Position, velocity and
    acceleration pass the same lag, each exactly for the signal that is linear between the nodes.

    Args:
        path: what the encoders say.
        lag: tau, s.
    """
    (x, v, a), tau = (path.x[0], path.v[0], path.a[0]), lag
    starts, slopes = (x - tau * v + tau**2 * a, v - tau * a, a), (2 * tau * a - v, -a, 0.0)
    pairs = [
        lagged(signal[:, None], tau, path.dt, start, by_lag)
        for signal, start, by_lag in zip((path.x, path.v, path.a), starts, slopes, strict=True)
    ]

    def inputs(rest: float, motion: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        nodes, middle = (
            np.vstack([rest * rows[:1], new, rest * rows[4:]])
            for rows, new in zip(path.inputs, (motion, halfway(motion, path.dt)), strict=True)
        )
        return _with_jerk(nodes, middle, path.dt)

    values = inputs(1.0, np.vstack([z[:, 0] for z, _ in pairs]))
    derivatives = inputs(0.0, np.vstack([by_lag for _, by_lag in pairs]))
    return TrailingPath(path.start, path.dt, values, derivatives)


def fixed_path(start: float, end: float, dt: float) -> GripperPath:
    """A pivot that does not move, from `start` to `end` s."""
    still = np.zeros(grid_size(start, end, dt))
    return GripperPath(start, dt, still, still, still)


def smoothed_path(time: np.ndarray, x: np.ndarray, dt: float, *, exact: bool = False) -> GripperPath:
    """Path through noisy positions; see `smoothed_motion` for the arguments."""
    return GripperPath(float(time[0]), dt, *smoothed_motion(time, x, dt, exact=exact))


class GrowingPath:
    """Smooths a path while it is being measured: what is older than `SETTLED` samples is smoothed once and kept.

    Args:
        dt: interval of the samples, s.
    """

    def __init__(self, dt: float) -> None:
        self._dt = dt
        self._raw = np.empty(0)
        self._smooth = np.empty((3, 0))
        self._strength, self._chosen_at = 0.0, 0

    def extend(self, x: np.ndarray) -> np.ndarray:
        """Take in new positions (k,), m; return x, v, a of all so far, (3, n)."""
        kept = max(0, self._smooth.shape[1] - SETTLED)
        self._raw = np.concatenate([self._raw, x])
        n = len(self._raw)
        if n < 2 * ORDER:
            return np.vstack([self._raw, np.zeros((2, n))])
        if n >= 2 * self._chosen_at or n >= self._chosen_at + CHOOSE_EVERY:
            self._strength, self._chosen_at = best_strength(self._raw[-CHOOSE_FROM:]), n
        first = max(0, kept - SETTLED)
        smooth = penalised(self._raw[first:], self._strength)
        fresh = np.vstack([smooth, *differentiated(smooth, self._dt)])
        self._smooth = np.hstack([self._smooth[:, :kept], fresh[:, kept - first :]])
        return self._smooth


@dataclass(frozen=True, eq=False, repr=False)
class GrowingRun(Run):
    """A run that is still being recorded, with the gripper's path smoothed as it grew.

    Attributes:
        path: on a grid that starts at the first sample.
    """

    path: GripperPath = field(kw_only=True)

    def __reduce__(self) -> tuple[Callable[..., Run], tuple[Any, ...]]:
        _make, arguments = super().__reduce__()
        return partial(GrowingRun, began=self.began, path=self.path, spread=dict(self.spread)), arguments


def run_path(run: Run) -> GripperPath:
    """The gripper's path in a run: smoothed where only positions were measured, at rest where there is no gripper."""
    return run.path if isinstance(run, GrowingRun) else _recorded_path(run)


@lru_cache(maxsize=64)
def _recorded_path(run: Run) -> GripperPath:
    path = _path_of(run)
    return path if run.began is None else replace(path, elapsed=path.start - run.began)


def _path_of(run: Run) -> GripperPath:
    ends = [(c.time[0], c.time[-1]) for name, c in run.channels.items() if name in OUTPUTS or name == "gripper_x"]
    start, end = min(e[0] for e in ends), max(e[1] for e in ends)
    if "gripper_x" not in run.channels:
        interval = min(float(np.median(np.diff(run.channels[n].time))) for n in OUTPUTS if n in run.channels)
        return fixed_path(start, end, float(np.clip(interval, FINEST_GRID, COARSEST_GRID)))
    x = run.channels["gripper_x"]
    dt = float(np.clip(np.median(np.diff(x.time)), FINEST_GRID, COARSEST_GRID))
    grid = x.time[0] + dt * np.arange(grid_size(x.time[0], x.time[-1], dt))
    height = None
    if "gripper_z" in run.channels:
        z = run.channels["gripper_z"]
        level = np.interp(grid, z.time, z.value)
        smooth = smoothed_path(grid, level - level[0], dt, exact=run.noise.get("gripper_z") == 0.0)
        height = np.vstack([smooth.x, smooth.v, smooth.a])
    given = [run.channels[n] for n in ("gripper_v", "gripper_a") if n in run.channels]
    if len(given) == 2:
        position, speed, acceleration = (np.interp(grid, c.time, c.value) for c in (x, *given))
        return GripperPath(float(grid[0]), dt, position, speed, acceleration, height)
    along = smoothed_path(x.time, x.value, dt, exact=run.noise.get("gripper_x") == 0.0)
    return GripperPath(along.start, dt, along.x, along.v, along.a, height)
