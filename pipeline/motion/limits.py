"""How fast the tool may move where, and the gate before every cycle: nothing is sent that has not passed it."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from armdyn.errors import InputError
from pipeline.motion.trajectory import LineState
from urdf.robot import Array, read_only

if TYPE_CHECKING:
    import urdf
    from ik import LineTable, PathTable


LINE_JERK = 200.0
"""Jerk along the line [m/s^3]: below it the smoother can no longer follow the motions of SAC to 0.4 mm."""


@dataclass(frozen=True)
class LineLimits:
    """Limits along the line: the range, and speed and acceleration that depend on the place.

    Between nodes the limits are linear.

    Attributes:
        s: nodes (n,), increasing, the ends being the ends of the line [m].
        speed: largest speed at each node (n,) [m/s].
        acceleration: largest acceleration at each node (n,) [m/s^2].
        jerk: largest jerk, everywhere [m/s^3].

    Raises:
        InputError: if the shapes differ, the nodes do not increase or a limit is not positive and finite.
    """

    s: Array
    speed: Array
    acceleration: Array
    jerk: float = LINE_JERK

    def __post_init__(self) -> None:
        for name in ("s", "speed", "acceleration"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        if self.s.ndim != 1 or self.s.size < 2 or not self.s.shape == self.speed.shape == self.acceleration.shape:
            raise InputError("line limits: s, speed and acceleration must be one-dimensional and equally long (>= 2)")
        if not np.all(np.isfinite(self.s)) or np.any(np.diff(self.s) <= 0.0):
            raise InputError("line limits: the nodes s must be finite and increasing")
        positive = np.concatenate([self.speed, self.acceleration, [self.jerk]])
        if not np.all(np.isfinite(positive)) or np.any(positive <= 0.0):
            raise InputError("line limits: speed, acceleration and jerk must be finite and greater than 0")

    @classmethod
    def from_table(cls, table: PathTable) -> LineLimits:
        """Limits along the path of a table."""
        return cls(table.s, table.speed_limit, table.acceleration_limit)

    @cached_property
    def s_min(self) -> float:
        """Lower end of the line [m]."""
        return float(self.s[0])

    @cached_property
    def s_max(self) -> float:
        """Upper end of the line [m]."""
        return float(self.s[-1])

    @cached_property
    def slowest(self) -> float:
        """Smallest speed limit of the line [m/s]."""
        return float(self.speed.min())

    @cached_property
    def fastest(self) -> float:
        """Largest speed limit of the line [m/s]."""
        return float(self.speed.max())

    @cached_property
    def weakest(self) -> float:
        """Smallest acceleration limit of the line [m/s^2]."""
        return float(self.acceleration.min())

    @cached_property
    def strongest(self) -> float:
        """Largest acceleration limit of the line [m/s^2]."""
        return float(self.acceleration.max())

    def speed_at(self, s: ArrayLike) -> Array:
        """Largest speed at `s` [m/s]; beyond the ends, that of the end."""
        return np.interp(np.asarray(s, dtype=float), self.s, self.speed)

    def acceleration_at(self, s: ArrayLike) -> Array:
        """Largest acceleration at `s` [m/s^2]; beyond the ends, that of the end."""
        return np.interp(np.asarray(s, dtype=float), self.s, self.acceleration)

    def lowest_speed(self, lower: float, upper: float) -> float:
        """Smallest speed limit anywhere in [lower, upper] [m/s]."""
        return self._lowest(self._lists[1], lower, upper)

    def lowest_acceleration(self, lower: float, upper: float) -> float:
        """Smallest acceleration limit anywhere in [lower, upper] [m/s^2]."""
        return self._lowest(self._lists[2], lower, upper)

    @cached_property
    def _lists(self) -> tuple[list[float], list[float], list[float]]:
        """The same numbers in lists: a look-up takes 1 µs instead of 5, and a control cycle makes dozens."""
        return self.s.tolist(), self.speed.tolist(), self.acceleration.tolist()

    def _lowest(self, limit: list[float], lower: float, upper: float) -> float:
        if lower == upper:
            return self._between(limit, lower)
        nodes = self._lists[0]
        first, last = bisect_left(nodes, lower), bisect_right(nodes, upper)
        return min(self._between(limit, lower), self._between(limit, upper), *limit[first:last])

    def _between(self, limit: list[float], s: float) -> float:
        nodes = self._lists[0]
        k = bisect_right(nodes, s)
        if k == 0:
            return limit[0]
        if k == len(limit):
            return limit[-1]
        weight = (s - nodes[k - 1]) / (nodes[k] - nodes[k - 1])
        return limit[k - 1] + weight * (limit[k] - limit[k - 1])

    def scaled(self, speed: float = 1.0, acceleration: float = 1.0) -> LineLimits:
        """The same line with shares of its limits.

        Args:
            speed: factor on the speed limit [1].
            acceleration: factor on the acceleration limit [1].
        """
        return replace(self, speed=self.speed * speed, acceleration=self.acceleration * acceleration)

    def capped(self, acceleration: float) -> LineLimits:
        """The same line with no acceleration limit above a given one.

        Args:
            acceleration: cap [m/s^2].
        """
        return replace(self, acceleration=np.minimum(self.acceleration, acceleration))


class Refusal(Enum):
    """Why the gate refuses the next reference; the value is the sentence for a person."""

    NOT_A_NUMBER = "The reference holds a NaN or an infinity: stop, and look at the node that made it."
    OFF_THE_LINE = "The reference leaves the line that the table covers: stop, and move the target inwards."
    TOO_FAST = "The reference is faster along the line than the joints can follow there: smooth it."
    TOO_STRONG = "The reference accelerates more along the line than the joints can follow there: smooth it."
    JUMP = "The reference does not follow from the one before it: smooth it, or start it from where the arm is."
    JOINT_POSITION = "A joint would leave its range: the table does not belong to this robot; build it again."
    JOINT_VELOCITY = "A joint would be faster than its limit: slow the motion down."
    JOINT_ACCELERATION = "A joint would accelerate more than its limit: smooth the motion."
    NO_WAY_TO_REST = "The reference cannot be brought to rest within the limits: slow down earlier."
    ARM_ELSEWHERE = "The arm is not where the reference is: something holds it, or the motion starts elsewhere."


@dataclass(frozen=True)
class Gate:
    """Cheap check of the next reference, once per control cycle.

    Attributes:
        limits: along the line.
        table: from the line to the joints.
        joints: limits of the joints.
        dt: control cycle [s].
        tracking: farthest that any joint may be from its reference [rad]. Baxter's own server stops at 0.2.
        tolerance: share by which a limit may be exceeded, for rounding and for tables between nodes [1].
    """

    limits: LineLimits
    table: LineTable
    joints: urdf.Limits
    dt: float
    tracking: float = 0.2
    tolerance: float = 1e-3

    def check(
        self, reference: LineState, previous: LineState | None = None, measured: Array | None = None
    ) -> Refusal | None:
        """Judge the next reference.

        Args:
            reference: of the next cycle.
            previous: that of the cycle before, from which it must follow; None at the start of a motion.
            measured: joint positions now (n,); None where they are not watched [rad].

        Returns:
            The first limit that is broken; None where the reference may be sent.
        """
        if not reference.is_finite:
            return Refusal.NOT_A_NUMBER
        more = 1.0 + self.tolerance
        s, v, a = reference
        if not self.limits.s_min - 1e-9 <= s <= self.limits.s_max + 1e-9:
            return Refusal.OFF_THE_LINE
        if abs(v) > more * self.limits.speed_at(s):
            return Refusal.TOO_FAST
        if abs(a) > more * self.limits.acceleration_at(s):
            return Refusal.TOO_STRONG
        if previous is not None and not self._follows(reference, previous):
            return Refusal.JUMP
        return self._joints(reference, measured)

    def _follows(self, reference: LineState, previous: LineState) -> bool:
        """Whether two references belong to one motion whose jerk is bounded."""
        h, jerk = self.dt, (1.0 + self.tolerance) * self.limits.jerk
        s, v, a = (now - before for now, before in zip(reference, previous, strict=True))
        # Within one cycle of bounded jerk, from the Taylor series about its beginning.
        return (
            abs(a) <= jerk * h + 1e-9
            and abs(v - previous.a * h) <= jerk * h**2 / 2.0 + 1e-9
            and abs(s - previous.v * h - previous.a * h**2 / 2.0) <= jerk * h**3 / 6.0 + 1e-9
        )

    def _joints(self, reference: LineState, measured: Array | None) -> Refusal | None:
        s = min(max(reference.s, float(self.table.s[0])), float(self.table.s[-1]))
        q, v, a = self.table.joint_motion(s, reference.v, reference.a)
        more = 1.0 + self.tolerance
        if np.any((q < self.joints.lower) | (q > self.joints.upper)):
            return Refusal.JOINT_POSITION
        if np.any(np.abs(v) > more * self.joints.velocity):
            return Refusal.JOINT_VELOCITY
        if np.any(np.abs(a) > more * self.joints.acceleration):
            return Refusal.JOINT_ACCELERATION
        if measured is not None and not np.all(np.abs(measured - q) <= self.tracking):
            return Refusal.ARM_ELSEWHERE
        return None
