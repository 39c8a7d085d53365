"""How fast the tool may move where: limits along the line."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from armdyn.errors import InputError
from urdf.robot import Array, read_only

LINE_JERK = 200.0
"""Jerk along the line [m/s^3]: below it the smoother can no longer follow the motions of SAC to 0.4 mm."""


class LimitTable(Protocol):
    """What a table must offer to give limits along the line; `ik.LineTable` does."""

    @property
    def s(self) -> Array:
        """Nodes (n,) [m]."""

    @property
    def speed_limit(self) -> Array:
        """Largest speed along the line at each node (n,) [m/s]."""

    @property
    def acceleration_limit(self) -> Array:
        """Largest acceleration along the line at each node (n,) [m/s^2]."""


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
    def from_table(cls, table: LimitTable, jerk: float = LINE_JERK) -> LineLimits:
        """Limits of a line table.

        Args:
            table: anything with nodes, speed and acceleration limits, such as `ik.LineTable`.
            jerk: largest jerk [m/s^3].
        """
        return cls(table.s, table.speed_limit, table.acceleration_limit, jerk)

    @classmethod
    def constant(cls, s: Sequence[float], speed: float, acceleration: float, jerk: float = LINE_JERK) -> LineLimits:
        """Limits that do not depend on the place.

        Args:
            s: the two ends of the line [m].
            speed: largest speed [m/s].
            acceleration: largest acceleration [m/s^2].
            jerk: largest jerk [m/s^3].
        """
        return cls(np.array(s, float), np.full(2, speed), np.full(2, acceleration), jerk)

    @property
    def s_min(self) -> float:
        """Lower end of the line [m]."""
        return float(self.s[0])

    @property
    def s_max(self) -> float:
        """Upper end of the line [m]."""
        return float(self.s[-1])

    @property
    def lowest_speed(self) -> float:
        """Smallest speed limit of the line [m/s]."""
        return float(self.speed.min())

    def speed_at(self, s: ArrayLike) -> Array:
        """Largest speed at `s` [m/s]; beyond the ends, that of the end."""
        return np.interp(np.asarray(s, dtype=float), self.s, self.speed)

    def acceleration_at(self, s: ArrayLike) -> Array:
        """Largest acceleration at `s` [m/s^2]; beyond the ends, that of the end."""
        return np.interp(np.asarray(s, dtype=float), self.s, self.acceleration)

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


class LimitLookup:
    """The same numbers as `LineLimits`, in lists: a look-up takes 1 µs instead of 5, and a cycle makes dozens.

    Args:
        limits: along the line.
    """

    def __init__(self, limits: LineLimits) -> None:
        self.s_min, self.s_max, self.jerk = limits.s_min, limits.s_max, limits.jerk
        self._s: list[float] = limits.s.tolist()
        self._speed: list[float] = limits.speed.tolist()
        self._acceleration: list[float] = limits.acceleration.tolist()
        self.highest_speed, self.highest_acceleration = max(self._speed), max(self._acceleration)
        self.weakest_acceleration = min(self._acceleration)

    def speed(self, lower: float, upper: float) -> float:
        """Smallest speed limit anywhere in [lower, upper] [m/s]."""
        return self._lowest(self._speed, lower, upper)

    def acceleration(self, lower: float, upper: float) -> float:
        """Smallest acceleration limit anywhere in [lower, upper] [m/s^2]."""
        return self._lowest(self._acceleration, lower, upper)

    def _lowest(self, limit: Sequence[float], lower: float, upper: float) -> float:
        if lower == upper:
            return self._between(limit, lower)
        first, last = bisect_left(self._s, lower), bisect_right(self._s, upper)
        return min(self._between(limit, lower), self._between(limit, upper), *limit[first:last])

    def _between(self, limit: Sequence[float], s: float) -> float:
        k = bisect_right(self._s, s)
        if k == 0:
            return limit[0]
        if k == len(limit):
            return limit[-1]
        weight = (s - self._s[k - 1]) / (self._s[k] - self._s[k - 1])
        return limit[k - 1] + weight * (limit[k] - limit[k - 1])
