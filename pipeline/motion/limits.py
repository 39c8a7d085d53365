"""Limits of the tool's motion along the line: largest speed and acceleration at each position, and jerk."""

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


MAX_LINE_JERK = 200.0
"""Largest jerk along the line [m/s^3]; with less, the smoother cannot follow the motions of SAC to 0.4 mm."""
SPEED_LIMIT_SHARES_FOR_TORQUES = np.linspace(-1.0, 1.0, 17)
"""Speeds at which torques are computed, as shares of the largest speed; between them the limit is exceeded by 3e-4."""
PLANNED_LIMIT_SHARE = 0.999
"""Share of the limits that planned motions use, so that the limits are also kept between the checked instants."""
LIMIT_ROUNDING_TOLERANCE = 1e-10
"""Amount by which a planned motion may exceed a limit because of rounding [m, m/s, m/s^2]."""


@dataclass(frozen=True)
class LineLimits:
    """Limits of the tool's motion along the line; limits of speed and acceleration are linear between nodes.

    Attributes:
        s: positions of the nodes, increasing from one end of the line to the other, (n,) [m].
        speed: largest speed at each node, (n,) [m/s].
        acceleration: largest acceleration at each node, (n,) [m/s^2].
        jerk: largest jerk, at every position [m/s^3].
        s_min: lower end of the line [m].
        s_max: upper end of the line [m].
        min_speed_limit: smallest speed limit of the line [m/s].
        max_speed_limit: largest speed limit of the line [m/s].
        min_acceleration_limit: smallest acceleration limit of the line [m/s^2].
        max_acceleration_limit: largest acceleration limit of the line [m/s^2].
    """

    s: Array
    speed: Array
    acceleration: Array
    jerk: float = MAX_LINE_JERK
    s_min: float = field(init=False)
    s_max: float = field(init=False)
    min_speed_limit: float = field(init=False)
    max_speed_limit: float = field(init=False)
    min_acceleration_limit: float = field(init=False)
    max_acceleration_limit: float = field(init=False)

    def __post_init__(self) -> None:
        freeze_arrays(self, "s", "speed", "acceleration")
        for values, least, largest in (
            (self.s, "s_min", "s_max"),
            (self.speed, "min_speed_limit", "max_speed_limit"),
            (self.acceleration, "min_acceleration_limit", "max_acceleration_limit"),
        ):
            object.__setattr__(self, least, float(values.min()))
            object.__setattr__(self, largest, float(values.max()))

    @classmethod
    def from_table(cls, table: PathTable, torque: JointTorque | None = None) -> LineLimits:
        """Compute the limits along the path of an IK table from the limits of the joints.

        Args:
            table: IK table of the path.
            torque: torque of the arm with its load; if given, accelerations are also within the motors' torque limits
                at every allowed speed. Positions at which the motors cannot hold the arm are ignored here.
        """
        acceleration = table.acceleration_limit
        if torque is not None:
            acceleration = np.minimum(acceleration, _largest_by_torque(table, torque))
        return cls(table.s, table.speed_limit, acceleration)

    def scaled(self, speed: float, acceleration: float, max_acceleration: float = np.inf) -> LineLimits:
        """Reduced limits.

        Args:
            speed: factor on the speed limits.
            acceleration: factor on the acceleration limits.
            max_acceleration: upper bound of the acceleration limits [m/s^2].
        """
        return replace(
            self, speed=self.speed * speed, acceleration=np.minimum(self.acceleration * acceleration, max_acceleration)
        )

    def limits_reduced_for_planning(self) -> LineLimits:
        """Limits of speed and acceleration multiplied by `PLANNED_LIMIT_SHARE`, for planning."""
        return self.scaled(PLANNED_LIMIT_SHARE, PLANNED_LIMIT_SHARE)

    def speed_at(self, s: ArrayLike) -> Array:
        """Largest speed at positions s [m]: [m/s], with the shape of s; beyond an end of the line, that of the end."""
        return np.interp(np.asarray(s, dtype=float), self.s, self.speed)

    def acceleration_at(self, s: ArrayLike) -> Array:
        """Largest acceleration at positions s [m]: [m/s^2], with the shape of s; beyond an end, that of the end."""
        return np.interp(np.asarray(s, dtype=float), self.s, self.acceleration)

    def respected_by(self, s: Array, v: Array, a: Array, tolerance: float = 0.0) -> bool:
        """Whether samples of a motion are on the line and within its limits of speed and acceleration.

        Args:
            s: positions, (n,) [m].
            v: speeds, (n,) [m/s].
            a: accelerations, (n,) [m/s^2].
            tolerance: allowed excess [m, m/s, m/s^2].
        """
        return bool(
            s.min() >= self.s_min - tolerance
            and s.max() <= self.s_max + tolerance
            and np.all(np.abs(v) <= self.speed_at(s) + tolerance)
            and np.all(np.abs(a) <= self.acceleration_at(s) + tolerance)
        )

    def allows(self, state: LineState) -> bool:
        """Whether one state is within the limits, except for rounding; five times faster than `respected_by`."""
        s, v, a = state
        return (
            self.s_min - LIMIT_ROUNDING_TOLERANCE <= s <= self.s_max + LIMIT_ROUNDING_TOLERANCE
            and abs(v) <= self.min_speed_between(s, s) + LIMIT_ROUNDING_TOLERANCE
            and abs(a) <= self.min_acceleration_between(s, s) + LIMIT_ROUNDING_TOLERANCE
        )

    def min_speed_between(self, lower: float, upper: float) -> float:
        """Smallest speed limit between two positions [m], in m/s."""
        return self._lowest(self._lists[1], lower, upper)

    def min_acceleration_between(self, lower: float, upper: float) -> float:
        """Smallest acceleration limit between two positions [m], in m/s^2."""
        return self._lowest(self._lists[2], lower, upper)

    @cached_property
    def _lists(self) -> tuple[list[float], list[float], list[float]]:
        """Nodes, speeds and accelerations as lists, in which a look-up takes 1 µs in place of 5 µs."""
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
    """Largest acceleration within the torque limits at every speed, (m,); infinite if motors cannot hold the arm."""
    along, found = torque.path_torque_terms(table.q, table.dq_ds, table.d2q_ds2), np.full(len(table.s), np.inf)
    for share in SPEED_LIMIT_SHARES_FOR_TORQUES:
        low, high = along.acceleration_range(table.limits.effort, share * table.speed_limit, springs=True)
        most = np.minimum(high, -low)
        found = np.where(most > 0.0, np.minimum(found, most), found)
    return found
