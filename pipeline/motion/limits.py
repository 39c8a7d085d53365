"""How fast the tool may move where on its line."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from armdyn.errors import InputError
from urdf.robot import Array, read_only

if TYPE_CHECKING:
    from ik import PathTable


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
