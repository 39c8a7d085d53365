"""Limits at the nodes of a path, as rows a u + b x <= c in its acceleration u = s'' and its squared speed x = s'^2.

The bends of a path alone, that is without changes of u, give a joint the jerk ``3 q'' s' u + q''' s'^3``. Divided by s'
it is linear in u and x, and the limit becomes J / sqrt(x), which is convex: a speed that stays below its tangent at the
present x keeps it, and the next tangent is closer (Debrouwere et al., IEEE Trans. Robotics 29, 2013).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pipeline.motion.averaged import JointPath, RetimingLimits, law_of
from pipeline.motion.fastest_speed import PathSpeed
from urdf.robot import Array

RETIMED_LIMIT_SHARE = 0.99
"""Share of each limit that a retimed motion uses, so that it is also kept between nodes and samples."""
MIN_SQUARED_SPEED = 1e-6
"""Least squared speed at which rows are linearised, in units of the largest [1]: friction has a direction there."""
BENDS_JERK_SHARE = 0.7
"""Share of the jerk limit that the bends of a path use; the rest is for changes of its acceleration. With 0.5 motions
of the benchmark are 0.4 % longer in the mean; with 1 0.1 % shorter, but the last clock is up to 1.07, not 1.01."""
SLOWEST_SHARE = 1e-4
"""Least squared speed, in units of the largest, at which nodes are set at even times: a stop does not take them all."""

TorqueBand = Callable[[Array, Array, Array], tuple[Array, Array]]
"""Torques of positions, velocities and accelerations, and half the widths of their bands, (n, joints) each."""
Rows = tuple[Array, Array, Array]


@dataclass(frozen=True, eq=False)
class PathNodes:
    """Nodes of a path.

    Attributes:
        s: the nodes, (n,).
        q: positions of the joints, (n, joints).
        first: their derivatives by s; `second` and `third` are further ones.
    """

    s: Array
    q: Array
    first: Array
    second: Array
    third: Array

    @classmethod
    def at(cls, path: JointPath, s: Array) -> "PathNodes":
        """The nodes (n,) of a path."""
        return cls(s, *path.at(s))

    def at_even_times(self, path: JointPath, speed: PathSpeed) -> tuple["PathNodes", PathSpeed]:
        """As many nodes that a motion with this speed passes at even times, and the speed there."""
        x = speed.x.copy()
        x[1:-1] = np.maximum(x[1:-1], SLOWEST_SHARE * x.max())
        law = law_of(self.s, x)
        s = law(np.linspace(0.0, law.x[-1], len(x)))
        s[-1] = path.length
        return self.at(path, s), PathSpeed(s, np.interp(s, self.s, speed.x), np.zeros(len(s) - 1))

    def largest(self, velocity: Array) -> Array:
        """Largest squared speeds (n,) under limits of the joints' velocities."""
        with np.errstate(divide="ignore"):
            return np.asarray((RETIMED_LIMIT_SHARE * velocity / np.abs(self.first)).min(axis=1) ** 2)

    def rows(self, x: Array, given: RetimingLimits, torque: TorqueBand, free: npt.NDArray[np.bool_]) -> Rows:
        """Rows of all limits but velocities', around squared speeds x (n,); of jerk only where these are free (n,)."""
        rows = [self._torque_rows(x, given.torque, torque)]
        if given.jerk:
            bound = np.broadcast_to(RETIMED_LIMIT_SHARE * given.limits.acceleration, self.first.shape)
            rows += [(self.first, self.second, bound), (-self.first, -self.second, bound)]
            rows += self._jerk_rows(x, given.limits.jerk, free[:, None])
        a, b, c = (np.hstack(parts) for parts in zip(*rows, strict=True))
        return a, b, c

    def _torque_rows(self, x: Array, largest: Array, torque: TorqueBand) -> Rows:
        """Rows of the torques, exact at squared speeds x (n,) and almost at rest.

        The band is convex in the squared speed, so that it is at most what it is on the line between these two.
        """
        slow = np.full((len(x), 1), MIN_SQUARED_SPEED * x.max())
        fast = np.maximum(x[:, None], 2.0 * slow)
        states = [(slow, 0.0), (fast, 0.0), (fast, 1.0)]
        found, half = torque(
            np.vstack([self.q] * 3),
            np.vstack([self.first * np.sqrt(at) for at, _ in states]),
            np.vstack([self.second * at + self.first * u for at, u in states]),
        )
        still, moving, pushed = np.split(found, 3)
        least, wide, _ = np.split(RETIMED_LIMIT_SHARE * half, 3)
        a, b, wider = pushed - moving, (moving - still) / (fast - slow), (wide - least) / (fast - slow)
        room, still = RETIMED_LIMIT_SHARE * largest - least + wider * slow, still - b * slow
        return np.hstack([a, -a]), np.hstack([b + wider, wider - b]), np.hstack([room - still, room + still])

    def _jerk_rows(self, x: Array, largest: Array, free: npt.NDArray[np.bool_]) -> list[Rows]:
        """Rows of the bends' jerk, by tangents at squared speeds x (n,)."""
        limited = np.isfinite(largest)
        x = np.maximum(x, MIN_SQUARED_SPEED * x.max())[:, None]
        bound = BENDS_JERK_SHARE * largest[limited] / np.sqrt(x)
        a, b, fall = 3.0 * self.second[:, limited], self.third[:, limited], bound / (2.0 * x)
        return [(sign * a * free, (sign * b + fall) * free, 1.5 * bound) for sign in (1.0, -1.0)]
