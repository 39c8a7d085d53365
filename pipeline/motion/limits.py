"""Limits along the line: largest speed and acceleration of the tool at each place."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from pipeline.motion.trajectory import LineState
from urdf.robot import Array, freeze_arrays

if TYPE_CHECKING:
    from ik import PathTable
    from ik.torque import JointTorque


LINE_JERK = 200.0
"""Jerk along the line [m/s^3]: below it the smoother can no longer follow the motions of SAC to 0.4 mm."""
TORQUE_SPEED_SHARES = np.linspace(-1.0, 1.0, 17)
"""Of the largest speed, at which torques are asked; they are parabolas of it, and pass the limit by 3e-4 in between."""
PLANNED_LIMIT_SHARE = 0.999
"""Share of the limits that planned motions use, so that they also hold between the checked instants."""
LIMIT_ROUNDING = 1e-10
"""What a planned motion may exceed a limit by [SI units]."""


@dataclass(frozen=True)
class LineLimits:
    """Limits along the line: the range, and speed and acceleration that depend on the place, linear between nodes.

    Attributes:
        s: nodes (n,), increasing, the ends being the ends of the line [m].
        speed: largest speed at each node (n,) [m/s].
        acceleration: largest acceleration at each node (n,) [m/s^2].
        jerk: largest jerk, everywhere [m/s^3].
        s_min: lower end of the line [m].
        s_max: upper end of the line [m].
        slowest: smallest speed limit of the line [m/s].
        fastest: largest speed limit of the line [m/s].
        weakest: smallest acceleration limit of the line [m/s^2].
        strongest: largest acceleration limit of the line [m/s^2].
    """

    s: Array
    speed: Array
    acceleration: Array
    jerk: float = LINE_JERK
    s_min: float = field(init=False)
    s_max: float = field(init=False)
    slowest: float = field(init=False)
    fastest: float = field(init=False)
    weakest: float = field(init=False)
    strongest: float = field(init=False)

    def __post_init__(self) -> None:
        freeze_arrays(self, "s", "speed", "acceleration")
        for values, least, largest in (
            (self.s, "s_min", "s_max"),
            (self.speed, "slowest", "fastest"),
            (self.acceleration, "weakest", "strongest"),
        ):
            object.__setattr__(self, least, float(values.min()))
            object.__setattr__(self, largest, float(values.max()))

    @classmethod
    def from_table(cls, table: PathTable, torque: JointTorque | None = None) -> LineLimits:
        """Limits along the path of a table, which contains the limits due to the joints.

        With the torque of the arm and its load, accelerations also respect the motors' limits at every allowed speed.
        Where the motors cannot hold the arm, the check of a motion reports it.
        """
        acceleration = table.acceleration_limit
        if torque is not None:
            acceleration = np.minimum(acceleration, _largest_by_torque(table, torque))
        return cls(table.s, table.speed_limit, acceleration)

    def scaled(self, speed: float, acceleration: float, strongest: float = np.inf) -> LineLimits:
        """Limits with shares [1] of this line's speed and acceleration, and no acceleration above a bound [m/s^2]."""
        return replace(
            self, speed=self.speed * speed, acceleration=np.minimum(self.acceleration * acceleration, strongest)
        )

    def tight(self) -> LineLimits:
        """The limits multiplied by `PLANNED_LIMIT_SHARE`, so that rounding cannot exceed them."""
        return self.scaled(PLANNED_LIMIT_SHARE, PLANNED_LIMIT_SHARE)

    def speed_at(self, s: ArrayLike) -> Array:
        """Largest speed at `s` [m/s]; beyond the ends, that of the end."""
        return np.interp(np.asarray(s, dtype=float), self.s, self.speed)

    def acceleration_at(self, s: ArrayLike) -> Array:
        """Largest acceleration at `s` [m/s^2]; beyond the ends, that of the end."""
        return np.interp(np.asarray(s, dtype=float), self.s, self.acceleration)

    def respected_by(self, s: Array, v: Array, a: Array, tolerance: float = 0.0) -> bool:
        """Whether samples (n,) each [m, m/s, m/s^2] are on the line and within its speed and acceleration."""
        return bool(
            s.min() >= self.s_min - tolerance
            and s.max() <= self.s_max + tolerance
            and np.all(np.abs(v) <= self.speed_at(s) + tolerance)
            and np.all(np.abs(a) <= self.acceleration_at(s) + tolerance)
        )

    def allow(self, state: LineState) -> bool:
        """Whether one state is within the limits, up to rounding; five times faster than `respected_by`."""
        s, v, a = state
        return (
            self.s_min - LIMIT_ROUNDING <= s <= self.s_max + LIMIT_ROUNDING
            and abs(v) <= self.lowest_speed(s, s) + LIMIT_ROUNDING
            and abs(a) <= self.lowest_acceleration(s, s) + LIMIT_ROUNDING
        )

    def lowest_speed(self, lower: float, upper: float) -> float:
        """Smallest speed limit anywhere in [lower, upper] [m/s]."""
        return self._lowest(self._lists[1], lower, upper)

    def lowest_acceleration(self, lower: float, upper: float) -> float:
        """Smallest acceleration limit anywhere in [lower, upper] [m/s^2]."""
        return self._lowest(self._lists[2], lower, upper)

    @cached_property
    def _lists(self) -> tuple[list[float], list[float], list[float]]:
        """The limits in lists, in which a look-up takes 1 µs instead of 5; a control cycle makes dozens."""
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


def _largest_by_torque(table: PathTable, torque: JointTorque) -> Array:
    """(m,) acceleration along the path within motor torques at every speed; infinite where they cannot hold the arm."""
    along, found = torque.path_terms(table.q, table.dq_ds, table.d2q_ds2), np.full(len(table.s), np.inf)
    for share in TORQUE_SPEED_SHARES:
        low, high = along.acceleration_range(table.limits.effort, share * table.speed_limit, springs=True)
        most = np.minimum(high, -low)
        found = np.where(most > 0.0, np.minimum(found, most), found)
    return found
