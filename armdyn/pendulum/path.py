"""The gripper's path: whole, or still growing."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from armdyn.physics.motion import (
    ORDER,
    best_strength,
    differentiated,
    grid_size,
    halfway,
    penalised,
    slope,
    smoothed_motion,
)

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
        nodes, middle = zip(self.inputs, self.jerk, strict=True)
        return np.vstack(nodes), np.vstack(middle)

    @cached_property
    def jerk(self) -> tuple[np.ndarray, np.ndarray]:
        """Jerk along the line at the nodes (1, K) and halfway between them (1, K-1), m/s^3."""
        return jerk(self.a, self.dt)


def jerk(a: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Rate of an acceleration (K,) at its nodes (1, K) and halfway between them (1, K-1)."""
    rate = slope(a, dt)
    return rate[None], (rate[None, :-1] + rate[None, 1:]) / 2


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
