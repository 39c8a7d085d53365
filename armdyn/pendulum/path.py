"""The motion of the gripper: from a recording, smoothed while it is recorded, or of a body that lags behind it."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from armdyn.object_cache import cached_with_first_argument
from armdyn.pendulum.dynamics import PENDULUM_OUTPUTS
from armdyn.physics.recorded import (
    MAX_GRID_STEP_SECONDS,
    MIN_GRID_STEP_SECONDS,
    InputPath,
    smoothed_input,
    time_since_recording_began,
)
from armdyn.readout import first_order_lag
from armdyn.run import Channel, Run
from armdyn.smoothing.even import (
    WHITTAKER_ORDER,
    best_strength,
    first_and_second_derivatives,
    first_derivative,
    grid_size,
    motion_at_midpoints,
    penalised_least_squares,
)  # fmt: skip

SMOOTHING_CHOICE_INTERVAL_SAMPLES, SMOOTHING_CHOICE_WINDOW_SAMPLES = 100, 300
"""Number of samples after which the smoothing strength of a path in progress is chosen again, and number of the latest
samples that are used for this choice."""
SMOOTHING_DELAY_SAMPLES = 60
"""Number of later samples after which a smoothed position practically does not change any more."""


class GripperPath(InputPath):
    """Motion of the gripper along its line, on an even grid of K nodes.

    Its inputs are the time since the recording began, x, v, a along the line, z, vz, az of the height, and the jerk
    along the line.

    Args:
        start: time of the first node, s.
        dt: grid step, s.
        x: (K,) position, m.
        v: (K,) velocity, m/s.
        a: (K,) acceleration, m/s^2.
        height_motion: (3, K) height m, its velocity m/s and acceleration m/s^2; by default a level line.
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
    def motion_along_line(self) -> np.ndarray:
        """(3, K) position, velocity and acceleration along the line."""
        return self.nodes[1:4]

    @property
    def duration(self) -> float:
        """Duration of the path, s."""
        return float(self.dt * (len(self.x) - 1))

    def begun_at(self, elapsed: float) -> "GripperPath":
        """The same path, which begins `elapsed` s after the beginning of the recording."""
        return GripperPath(self.start, self.dt, self.x, self.v, self.a, self.height_motion, elapsed, self.extra)

    @property
    def peaks(self) -> np.ndarray:
        """(3,) largest absolute position, speed and acceleration."""
        return np.asarray(np.abs(self.motion_along_line).max(axis=1))

    @property
    def effort(self) -> float:
        """Integral of the squared acceleration, m^2/s^3: the control effort."""
        return float(np.sum(self.a**2) * self.dt)

    @property
    def height_motion(self) -> np.ndarray:
        """(3, K) height m, its velocity m/s and acceleration m/s^2."""
        return self.nodes[4:7]


def _inputs(t: np.ndarray, along: np.ndarray, level: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Inputs at the nodes (8, K) and halfway between (8, K-1); the last row is the rate of the acceleration."""
    jerk = first_derivative(along[2], dt)
    between = (
        (t[:-1] + t[1:]) / 2,
        motion_at_midpoints(along, dt),
        motion_at_midpoints(level, dt),
        (jerk[:-1] + jerk[1:]) / 2,
    )
    return np.vstack([t, along, level, jerk]), np.vstack(between)


def lagged_path(path: InputPath, lag: float) -> InputPath:
    """Path of a body that follows a gripper with a first-order lag, and its derivative with respect to the lag.

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
    return InputPath(path.start, path.dt, *values, lag_derivatives=by, extra=path.extra)


def fixed_pivot_path(
    start: float, end: float, dt: float, elapsed: float = 0.0, extra: Mapping[str, Channel] | None = None
) -> GripperPath:
    """Path of a gripper that does not move, from `start` to `end`, s; for the other arguments see `GripperPath`."""
    still = np.zeros(grid_size(start, end, dt))
    return GripperPath(start, dt, still, still, still, None, elapsed, extra)


class OnlinePathSmoother:
    """Smooths measured positions of a gripper while they arrive; old samples are smoothed once and cached.

    Args:
        dt: interval between samples, s.
    """

    def __init__(self, dt: float) -> None:
        self._dt = dt
        self._raw = np.empty(0)
        self._smooth = np.empty((3, 0))
        self._strength, self._chosen_at = 0.0, 0

    def extend(self, x: np.ndarray) -> np.ndarray:
        """Add new positions (k,), m; return (3, n) smoothed position, velocity and acceleration of all samples."""
        kept = max(0, self._smooth.shape[1] - SMOOTHING_DELAY_SAMPLES)
        self._raw = np.concatenate([self._raw, x])
        n = len(self._raw)
        if n < 2 * WHITTAKER_ORDER:
            return np.vstack([self._raw, np.zeros((2, n))])
        if n >= 2 * self._chosen_at or n >= self._chosen_at + SMOOTHING_CHOICE_INTERVAL_SAMPLES:
            self._strength, self._chosen_at = best_strength(self._raw[-SMOOTHING_CHOICE_WINDOW_SAMPLES:]), n
        first = max(0, kept - SMOOTHING_DELAY_SAMPLES)
        smooth = penalised_least_squares(self._raw[first:], self._strength)
        fresh = np.vstack([smooth, *first_and_second_derivatives(smooth, self._dt)])
        self._smooth = np.hstack([self._smooth[:, :kept], fresh[:, kept - first :]])
        return self._smooth


@dataclass(frozen=True, eq=False, repr=False)
class RunInProgress(Run):
    """A run that is still being recorded, with the gripper's path so far.

    Attributes:
        path: smoothed path, on a grid that starts at the first sample.
    """

    path: GripperPath = field(kw_only=True)


def gripper_path(run: Run) -> GripperPath:
    """Motion of the gripper in a run: smoothed if only positions were measured; at rest if no gripper was."""
    return run.path if isinstance(run, RunInProgress) else _recorded_path(run)


@cached_with_first_argument
def _recorded_path(run: Run) -> GripperPath:
    x = run.channels.get("gripper_x")
    timed = [x] if x is not None else [c for name, c in run.channels.items() if name in PENDULUM_OUTPUTS]
    start, end = float(min(c.time[0] for c in timed)), float(max(c.time[-1] for c in timed))
    interval = min(float(np.median(np.diff(c.time))) for c in timed)
    dt, since = (
        float(np.clip(interval, MIN_GRID_STEP_SECONDS, MAX_GRID_STEP_SECONDS)),
        time_since_recording_began(run, start),
    )
    if x is None:
        return fixed_pivot_path(start, end, dt, since, run.extra)
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
