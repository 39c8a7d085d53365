"""Where the tool is on its line and how it moves there; motions sampled in time, of the tool and of the joints."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from armdyn.errors import InputError
from urdf.robot import Array, read_only


class LineState(NamedTuple):
    """State of the tool on the line.

    Attributes:
        s: position along the line [m].
        v: speed along the line [m/s].
        a: acceleration along the line [m/s^2].
    """

    s: float
    v: float = 0.0
    a: float = 0.0

    @property
    def is_finite(self) -> bool:
        """Whether all three numbers are finite."""
        return math.isfinite(self.s) and math.isfinite(self.v) and math.isfinite(self.a)


@dataclass(frozen=True)
class LineTrajectory:
    """A motion along the line, sampled.

    Attributes:
        time: (n,), increasing [s].
        s: positions along the line (n,) [m].
        v: speeds (n,) [m/s].
        a: accelerations (n,) [m/s^2].

    Raises:
        InputError: if the arrays are not equally long, are empty or not finite, or time does not increase.
    """

    time: Array
    s: Array
    v: Array
    a: Array

    def __post_init__(self) -> None:
        for name in ("time", "s", "v", "a"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        if self.time.ndim != 1 or not self.time.shape == self.s.shape == self.v.shape == self.a.shape:
            raise InputError("line trajectory: time, s, v and a must be one-dimensional and equally long")
        check_samples(self.time, {"s": self.s, "v": self.v, "a": self.a})

    @property
    def start(self) -> LineState:
        """First state."""
        return self[0]

    @property
    def end(self) -> LineState:
        """Last state."""
        return self[-1]

    def __len__(self) -> int:
        return int(self.time.size)

    def __getitem__(self, index: int) -> LineState:
        return LineState(float(self.s[index]), float(self.v[index]), float(self.a[index]))

    def __iter__(self) -> Iterator[LineState]:
        return (self[k] for k in range(len(self)))

    def then(self, other: LineTrajectory) -> LineTrajectory:
        """This motion, then another one whose time counts from this one's end.

        Args:
            other: its first sample is left out if it is at time 0: it is this one's last.
        """
        first = 1 if other.time[0] <= 0.0 else 0
        return LineTrajectory(
            np.concatenate([self.time, self.time[-1] + other.time[first:]]),
            np.concatenate([self.s, other.s[first:]]),
            np.concatenate([self.v, other.v[first:]]),
            np.concatenate([self.a, other.a[first:]]),
        )


@dataclass(frozen=True)
class JointTrajectory:
    """A motion of the joints, sampled.

    Attributes:
        time: (n,), increasing [s].
        q: positions (n, joints) [rad or m].
        v: speeds (n, joints) [rad/s or m/s].
        a: accelerations (n, joints) [rad/s^2 or m/s^2].
        joint_names: of the columns.

    Raises:
        InputError: if the shapes do not agree, something is not finite, or time does not increase.
    """

    time: Array
    q: Array
    v: Array
    a: Array
    joint_names: tuple[str, ...]

    def __post_init__(self) -> None:
        for name in ("time", "q", "v", "a"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        shape = (self.time.size, len(self.joint_names))
        if not self.q.shape == self.v.shape == self.a.shape == shape:
            raise InputError(f"joint trajectory: q, v and a must have the shape {shape} (samples, joints)")
        check_samples(self.time, {"q": self.q, "v": self.v, "a": self.a})

    def __len__(self) -> int:
        return int(self.time.size)


def check_samples(time: Array, values: dict[str, Array]) -> None:
    """Refuse what cannot be a trajectory.

    Args:
        time: (n,) [s].
        values: by name, the first axis being time.

    Raises:
        InputError: with the first row at fault, counted from 1.
    """
    if time.size == 0:
        raise InputError("trajectory: it has no samples")
    if not np.all(np.isfinite(time)):
        raise InputError(f"trajectory: time is not a number in sample {int(np.argmin(np.isfinite(time))) + 1}")
    steps = np.diff(time)
    if np.any(steps <= 0.0):
        k = int(np.argmax(steps <= 0.0))
        raise InputError(
            f"trajectory: time does not increase from sample {k + 1} ({time[k]:.6g} s) "
            f"to {k + 2} ({time[k + 1]:.6g} s): sort the rows and drop repeated ones"
        )
    for name, array in values.items():
        bad = ~np.isfinite(array.reshape(time.size, -1)).all(axis=1)
        if np.any(bad):
            k = int(np.argmax(bad))
            raise InputError(f"trajectory: {name} is not a number in sample {k + 1} ({time[k]:.6g} s)")
