"""State of the tool on its line, and sampled motions of the tool along the line and of the joints."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from armdyn.errors import InputError
from armdyn.recording.channels import Channel
from urdf.robot import Array, freeze_arrays


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
        """Whether position, speed and acceleration are finite."""
        return math.isfinite(self.s) and math.isfinite(self.v) and math.isfinite(self.a)


@dataclass(frozen=True)
class LineTrajectory:
    """A sampled motion of the tool along the line.

    Attributes:
        time: increasing times, (n,) [s].
        s: positions along the line, (n,) [m].
        v: speeds, (n,) [m/s].
        a: accelerations, (n,) [m/s^2].

    Raises:
        InputError: the arrays have different lengths, are empty or not finite, or time does not increase.
    """

    time: Array
    s: Array
    v: Array
    a: Array

    def __post_init__(self) -> None:
        freeze_samples(self, "s", "v", "a")

    @property
    def end(self) -> LineState:
        """Last state of the motion."""
        return self[-1]

    def __len__(self) -> int:
        return int(self.time.size)

    def __getitem__(self, index: int) -> LineState:
        return LineState(float(self.s[index]), float(self.v[index]), float(self.a[index]))

    def __iter__(self) -> Iterator[LineState]:
        return (self[k] for k in range(len(self)))

    def followed_by(self, other: LineTrajectory) -> LineTrajectory:
        """This motion followed by another one, whose times count from the end of this one.

        A first sample of the other motion at time 0 is left out, because it equals the last one of this motion.
        """
        first = 1 if other.time[0] <= 0.0 else 0
        pairs = (self.time, self.time[-1] + other.time), (self.s, other.s), (self.v, other.v), (self.a, other.a)
        return LineTrajectory(*(np.concatenate([mine, its[first:]]) for mine, its in pairs))


REST_SPEED_SHARE = 0.01
"""Share of the speed limits up to which a velocity at an end is rest, as in a recording with noise."""


@dataclass(frozen=True, eq=False)
class EndVelocities:
    """Velocities of the joints at the ends of a path.

    Attributes:
        start: (joints,) [rad/s or m/s]; None for rest.
        end: likewise.
    """

    start: Array | None = None
    end: Array | None = None

    def moving(self, velocity: Array) -> tuple[Array | None, Array | None]:
        """The velocities that are no rest, with (joints,) speed limits [rad/s or m/s]."""
        start, end = (
            None if v is None or (np.abs(v) / velocity).max() <= REST_SPEED_SHARE else v for v in (self.start, self.end)
        )
        return start, end

    def are_rest(self, velocity: Array) -> bool:
        """Whether both ends are at rest; see `moving`."""
        return all(v is None for v in self.moving(velocity))


AT_REST = EndVelocities()


@dataclass(frozen=True)
class JointTrajectory:
    """A sampled motion of an arm's joints.

    Attributes:
        time: increasing times, (n,) [s].
        q: positions, (n, joints) [rad or m].
        v: velocities, (n, joints) [rad/s or m/s].
        a: accelerations, (n, joints) [rad/s^2 or m/s^2].
        joint_names: name of the joint of each column.

    Raises:
        InputError: the shapes do not agree, a number is not finite, or time does not increase.
    """

    time: Array
    q: Array
    v: Array
    a: Array
    joint_names: tuple[str, ...]

    def __post_init__(self) -> None:
        freeze_samples(self, "q", "v", "a", columns=len(self.joint_names))

    def __len__(self) -> int:
        return int(self.time.size)

    def channels(self, units: Sequence[str]) -> dict[str, Channel]:
        """Channels of positions, velocities and accelerations of every joint, as in a recording.

        Args:
            units: rad or m for each joint.
        """
        return {
            f"{kind}.{joint}": Channel(self.time, column, unit + per)
            for kind, values, per in (("q", self.q, ""), ("v", self.v, "/s"), ("a", self.a, "/s^2"))
            for joint, column, unit in zip(self.joint_names, values.T, units, strict=True)
        }


def freeze_samples(motion: Any, *names: str, columns: int | None = None) -> None:
    """Check the arrays of a sampled motion, and make them read-only.

    Args:
        motion: frozen dataclass with a field ``time``, (n,) [s].
        names: names of its other fields, arrays (n,) or (n, columns).
        columns: number of columns; None for arrays (n,).

    Raises:
        InputError: shapes differ, a number is not finite, or time does not increase; the message names the sample.
    """
    freeze_arrays(motion, "time", *names)
    time: Array = motion.time
    shape = (time.size,) if columns is None else (time.size, columns)
    if time.ndim != 1 or any(getattr(motion, name).shape != shape for name in names):
        of = "(samples,)" if columns is None else "(samples, joints)"
        raise InputError(f"trajectory: {', '.join(names)} must have the shape {shape} {of}")
    if time.size == 0:
        raise InputError("trajectory: it has no samples")
    for name in ("time", *names):
        bad = ~np.isfinite(getattr(motion, name).reshape(time.size, -1)).all(axis=1)
        if np.any(bad):
            k = int(np.argmax(bad))
            where = f" ({time[k]:.6g} s)" if name != "time" else ""
            raise InputError(f"trajectory: {name} is not a number in sample {k + 1}{where}")
    if np.any(np.diff(time) <= 0.0):
        k = int(np.argmax(np.diff(time) <= 0.0))
        raise InputError(
            f"trajectory: time does not increase from sample {k + 1} ({time[k]:.6g} s) "
            f"to {k + 2} ({time[k + 1]:.6g} s): sort the rows and drop repeated ones"
        )
