"""The gripper's path: complete, still growing, or with a lag; in a run, recorded or being recorded."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from armdyn.object_cache import cached_with_first_argument
from armdyn.pendulum.dynamics import PENDULUM_OUTPUTS
from armdyn.physics.recorded import MAX_GRID_STEP, MIN_GRID_STEP, InputPath, elapsed, smoothed_input
from armdyn.readout import first_order_lag
from armdyn.run import Channel, Run
from armdyn.smoothing.even import (
    WHITTAKER_ORDER,
    best_strength,
    differentiated,
    grid_size,
    halfway,
    penalised,
    slope,
)  # fmt: skip

STRENGTH_INTERVAL_SAMPLES, STRENGTH_WINDOW_SAMPLES = 100, 300
"""Number of samples after which the smoothing strength of a growing path is chosen again, and of the last samples
used."""
SETTLED_SAMPLES = 60
"""Number of samples after which later ones no longer change the smoothed path noticeably."""


class GripperPath(InputPath):
    """Path of the gripper along its line on an even grid of K nodes.

    Its inputs are the time since the recording began, x, v, a along the line, z, vz, az of the height, and the jerk
    along the line.

    Args:
        start: time of the first node, s.
        dt: grid step, s.
        x: (K,) position, m.
        v: (K,) velocity, m/s.
        a: (K,) acceleration, m/s^2.
        height: (3, K) height m, its velocity m/s and acceleration m/s^2; by default a level line.
        elapsed: time from the beginning of the recording to the first node, s; 0 except in a later piece of a
            recording.
        extra: further recorded quantities, see `InputPath`.
    """

    def __init__(
        self,
        start: float,
        dt: float,
        x: np.ndarray,
        v: np.ndarray,
        a: np.ndarray,
        height: np.ndarray | None = None,
        elapsed: float = 0.0,
        extra: Mapping[str, Channel] | None = None,
    ) -> None:
        along = np.vstack([x, v, a])
        level = np.zeros_like(along) if height is None else height
        inputs = _inputs(elapsed + dt * np.arange(len(x)), along, level, dt)
        super().__init__(start, dt, *inputs, extra=extra or {})

    @property
    def x(self) -> np.ndarray:
        """(K,) position along the line, m."""
        return self.nodes[1]

    @property
    def v(self) -> np.ndarray:
        """(K,) velocity along the line, m/s."""
        return self.nodes[2]

    @property
    def a(self) -> np.ndarray:
        """(K,) acceleration along the line, m/s^2."""
        return self.nodes[3]

    @property
    def along(self) -> np.ndarray:
        """(3, K) position, velocity and acceleration along the line."""
        return self.nodes[1:4]

    @property
    def seconds(self) -> float:
        """Duration of the path, s."""
        return float(self.dt * (len(self.x) - 1))

    @property
    def peaks(self) -> np.ndarray:
        """(3,) largest absolute position, speed and acceleration."""
        return np.asarray(np.abs(self.along).max(axis=1))

    @property
    def effort(self) -> float:
        """Integral of the squared acceleration, m^2/s^3, which SAC and the planner call energy."""
        return float(np.sum(self.a**2) * self.dt)

    @property
    def height(self) -> np.ndarray:
        """(3, K) height m, its velocity m/s and acceleration m/s^2."""
        return self.nodes[4:7]


def _inputs(t: np.ndarray, along: np.ndarray, level: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Inputs at the nodes (8, K) and halfway between (8, K-1); the last row is the rate of the acceleration."""
    jerk = slope(along[2], dt)
    between = (t[:-1] + t[1:]) / 2, halfway(along, dt), halfway(level, dt), (jerk[:-1] + jerk[1:]) / 2
    return np.vstack([t, along, level, jerk]), np.vstack(between)


def trailing(path: InputPath, lag: float) -> InputPath:
    """The path of a body that follows a gripper with a lag, and its derivative with respect to the lag.

    It solves tau z' + z = x, from a start at constant acceleration: z(0) = x - tau v + tau^2 a. Position, velocity and
    acceleration pass the same lag, each exactly for the signal that is linear between the nodes.

    Args:
        path: recorded path, with the inputs of a `GripperPath`.
        lag: time constant tau, s.
    """
    (x, v, a), tau = path.nodes[1:4, 0], lag
    starts, slopes = (x - tau * v + tau**2 * a, v - tau * a, a), (2 * tau * a - v, -a, 0.0)
    along, by_lag = zip(
        *(
            first_order_lag(signal[:, None], tau, path.dt, start, by_lag)
            for signal, start, by_lag in zip(path.nodes[1:4], starts, slopes, strict=True)
        ),
        strict=True,
    )
    t, level = path.nodes[0], path.nodes[4:7]
    values = _inputs(t, np.hstack(along).T, level, path.dt)
    by = _inputs(0.0 * t, np.vstack(by_lag), 0.0 * level, path.dt)
    return InputPath(path.start, path.dt, *values, by_lag=by, extra=path.extra)


def fixed_path(
    start: float, end: float, dt: float, elapsed: float = 0.0, extra: Mapping[str, Channel] | None = None
) -> GripperPath:
    """Path of a pivot that does not move, from `start` to `end`, s; for the other arguments see `GripperPath`."""
    still = np.zeros(grid_size(start, end, dt))
    return GripperPath(start, dt, still, still, still, None, elapsed, extra)


class GrowingPath:
    """Smooths a path while it is measured: samples older than `SETTLED_SAMPLES` are smoothed once and cached.

    Args:
        dt: interval between samples, s.
    """

    def __init__(self, dt: float) -> None:
        self._dt = dt
        self._raw = np.empty(0)
        self._smooth = np.empty((3, 0))
        self._strength, self._chosen_at = 0.0, 0

    def extend(self, x: np.ndarray) -> np.ndarray:
        """Add new positions (k,), m; return position, velocity and acceleration of all so far, (3, n)."""
        kept = max(0, self._smooth.shape[1] - SETTLED_SAMPLES)
        self._raw = np.concatenate([self._raw, x])
        n = len(self._raw)
        if n < 2 * WHITTAKER_ORDER:
            return np.vstack([self._raw, np.zeros((2, n))])
        if n >= 2 * self._chosen_at or n >= self._chosen_at + STRENGTH_INTERVAL_SAMPLES:
            self._strength, self._chosen_at = best_strength(self._raw[-STRENGTH_WINDOW_SAMPLES:]), n
        first = max(0, kept - SETTLED_SAMPLES)
        smooth = penalised(self._raw[first:], self._strength)
        fresh = np.vstack([smooth, *differentiated(smooth, self._dt)])
        self._smooth = np.hstack([self._smooth[:, :kept], fresh[:, kept - first :]])
        return self._smooth


@dataclass(frozen=True, eq=False, repr=False)
class GrowingRun(Run):
    """A run that is still being recorded, with the gripper's path smoothed as it grew.

    Attributes:
        path: smoothed path, on a grid that starts at the first sample.
    """

    path: GripperPath = field(kw_only=True)


def run_path(run: Run) -> GripperPath:
    """The gripper's path in a run: smoothed where only positions were measured, at rest where there is no gripper."""
    return run.path if isinstance(run, GrowingRun) else _recorded_path(run)


@cached_with_first_argument
def _recorded_path(run: Run) -> GripperPath:
    x = run.channels.get("gripper_x")
    timed = [x] if x is not None else [c for name, c in run.channels.items() if name in PENDULUM_OUTPUTS]
    start, end = float(min(c.time[0] for c in timed)), float(max(c.time[-1] for c in timed))
    interval = min(float(np.median(np.diff(c.time))) for c in timed)
    dt, since = float(np.clip(interval, MIN_GRID_STEP, MAX_GRID_STEP)), elapsed(run, start)
    if x is None:
        return fixed_path(start, end, dt, since, run.extra)
    grid = start + dt * np.arange(grid_size(start, end, dt))
    given = [run.channels[n] for n in ("gripper_x", "gripper_v", "gripper_a") if n in run.channels]
    if len(given) == 3:
        motion = np.array([np.interp(grid, c.time, c.value) for c in given])
    else:
        motion = smoothed_input(run, "gripper_x", x.time, x.value, dt)
    height = None
    if "gripper_z" in run.channels:
        z = run.channels["gripper_z"]
        level = np.interp(grid, z.time, z.value)
        height = smoothed_input(run, "gripper_z", grid, level - level[0], dt)
    return GripperPath(start, dt, motion[0], motion[1], motion[2], height, since, run.extra)
