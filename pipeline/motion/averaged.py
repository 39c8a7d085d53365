"""A path of an arm's joints, and its motions with a speed that is averaged over some time."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline, PPoly

from armdyn.errors import TaskFailedError
from pipeline.motion.fastest_speed import PathSpeed
from pipeline.motion.trajectory import AT_REST, EndVelocities, JointTrajectory
from urdf.robot import Array, Limits

MIN_ALONG_PATH = 0.9
"""Least cosine of the angle between a velocity at an end and the path."""
TRIED_AVERAGES = (0.35, 0.5, 0.7, 1.0)
"""Lengths of the moving average that are tried, in units of that which the jerk of full reversals needs."""
MIN_POINT_DISTANCE_SHARE = 2e-4
"""Distance between points of a path, as a share of its length, below which the second is left out: at rest recorded
positions differ by rounding, which has no direction."""
MIN_PATH_LENGTH = 1e-6
"""Length of a path, in units of the way of a joint at full speed in 1 s, below which it stands still."""
RETIMED_RATE = 200.0
"""Samples per second of a retimed trajectory."""


@dataclass(frozen=True, eq=False)
class RetimingLimits:
    """Limits of a retimed motion; each may be infinite, (joints,).

    Attributes:
        limits: limits of the joints.
        torque: largest torques [N m or N].
        jerk: whether jerk and acceleration are limited, besides speed and torque.
    """

    limits: Limits
    torque: Array
    jerk: bool = True


class JointPath:
    """A cubic spline through points, with a coordinate s of length 1 for the way of a joint at full speed in 1 s.

    At an end with a velocity it has the direction of this. `speeds` are those of s at the ends, 1/s.
    """

    def __init__(self, points: Array, velocity: Array, ends: EndVelocities = AT_REST) -> None:
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0) / velocity, axis=1))])
        if along[-1] < MIN_PATH_LENGTH:
            raise TaskFailedError("the path stands still: it has no speed")
        kept = [0]
        for i, at in enumerate(along.tolist()):
            if at - along[kept[-1]] > MIN_POINT_DISTANCE_SHARE * along[-1]:
                kept.append(i)
        if kept[-1] != len(along) - 1:
            kept = [*kept[: max(len(kept) - 1, 1)], len(along) - 1]
        points = points[kept]
        at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0) / velocity, axis=1))])
        natural = "natural" if len(points) > 2 else "not-a-knot"
        self.spline, moving = CubicSpline(at, points, bc_type=natural), ends.moving(velocity)
        self.speeds = tuple(0.0 if v is None else float(np.linalg.norm(v / velocity)) for v in moving)
        if any(self.speeds):
            self.spline = CubicSpline(at, points, bc_type=self._directions(moving, velocity))
        self.length, self.count = float(at[-1]), len(points)

    def _directions(self, moving: tuple[Array | None, Array | None], velocity: Array) -> list[tuple[int, Array]]:
        """Derivatives of the spline at both ends, each with its order."""
        found = []
        for v, speed, s, where in zip(moving, self.speeds, self.spline.x[[0, -1]], ("start", "end"), strict=True):
            way = self.spline(s, 1)
            if v is None:
                found.append((2, np.zeros_like(way)))
                continue
            along = (way / velocity) @ (v / velocity) / speed / float(np.linalg.norm(way / velocity))
            if along < MIN_ALONG_PATH:
                raise TaskFailedError(
                    f"the velocity at the {where} is not along the path (the cosine of their angle is {along:.2g}): "
                    "give one along the path, or none for rest"
                )
            found.append((1, v / speed))
        return found

    def at(self, s: Array) -> tuple[Array, ...]:
        """Positions and their first three derivatives by s, (n, joints) each."""
        return tuple(self.spline(s, k) for k in range(4))


def given_speeds(path: JointPath, s: Array, average: float) -> Array:
    """Squared speeds that are given at the nodes, (n,), nan elsewhere: at an end in motion for half an average."""
    start, end = path.speeds
    found = np.full(len(s), np.nan)
    # With a node more the speed is constant for the whole time.
    found[: np.searchsorted(s, start * average / 2.0) + 1] = start**2
    found[np.searchsorted(s, path.length - end * average / 2.0, side="right") - 1 :] = end**2
    return found


@dataclass(frozen=True, eq=False)
class AveragedMotion:
    """A path with a law s(t), averaged over some time.

    Attributes:
        path: the path.
        law: the law, from 0 to the path's length.
        average: length of the moving average [s].
    """

    path: JointPath
    law: PPoly
    average: float

    @property
    def seconds(self) -> float:
        """Duration: at an end at rest the average reaches beyond the law by its half."""
        return float(self.law.x[-1]) + sum(self.average / 2.0 for speed in self.path.speeds if not speed)

    def at(self, time: Array) -> tuple[Array, Array, Array]:
        """Positions, velocities and accelerations of the joints, (n, joints) each, at times (n,) [s]."""
        s, v, a = (part[:, None] for part in self._along(time))
        q, first, second, _ = self.path.at(np.clip(s[:, 0], 0.0, self.path.length))
        return q, first * v, second * v**2 + first * a

    def _along(self, time: Array) -> tuple[Array, Array, Array]:
        law, last, length = self.law, float(self.law.x[-1]), self.path.length
        rate = law.derivative()
        if not self.average:
            inside = np.clip(time, 0.0, last)
            return law(inside), rate(inside), rate.derivative()(inside)
        whole, (first, final) = law.antiderivative(), self.path.speeds
        end = time + (self.average / 2.0 if first else 0.0)
        edges = end - self.average, end
        before, beyond = ([np.maximum(sign * t + shift, 0.0) for t in edges] for sign, shift in ((-1, 0.0), (1, -last)))
        within = [np.clip(t, 0.0, last) for t in edges]
        ways, places, rates = list[Array](), list[Array](), list[Array]()
        for at, early, late in zip(within, before, beyond, strict=True):
            ways.append(whole(at) + first * early**2 / 2.0 + length * late + final * late**2 / 2.0)
            places.append(law(at) - first * early + final * late)
            rates.append(np.where(early > 0.0, first, np.where(late > 0.0, final, rate(at))))
        s, v, a = ((later - earlier) / self.average for earlier, later in (ways, places, rates))
        return s, v, a

    def at_nodes(self, time: Array, slower: Array) -> Array:
        """Factors at the nodes of the law, (n,): the largest of (m,) factors at (m,) times that its average reaches."""
        found, near = np.ones(len(self.law.x)), 2.0 / RETIMED_RATE
        time = time + (self.average / 2.0 if self.path.speeds[0] else 0.0)
        for at, factor in zip(time[slower > 1.0].tolist(), slower[slower > 1.0].tolist(), strict=True):
            low, high = np.searchsorted(self.law.x, [at - self.average - near, at + near])
            found[max(low - 1, 0) : high + 1] = np.maximum(found[max(low - 1, 0) : high + 1], factor)
        return found

    def sampled(self, clock: float, names: tuple[str, ...]) -> JointTrajectory:
        """The motion with another clock, which is slowed to end with a sample; in motion samples are closer instead."""
        count = max(int(np.ceil(self.seconds / clock * RETIMED_RATE)), 4)
        time = np.arange(count + 1) / RETIMED_RATE
        if any(self.path.speeds):
            time *= self.seconds / clock / time[-1]
        clock = self.seconds / time[-1]
        q, v, a = self.at(np.minimum(time * clock, self.seconds))
        return JointTrajectory(time, q, v * clock, a * clock**2, names)


def law_of(s: Array, x: Array) -> PPoly:
    """The path coordinate by time [s]: squared speeds x (n,) at nodes s (n,), constant accelerations between."""
    root, step = np.sqrt(x), np.diff(s)
    lasts = 2.0 * step / np.maximum(root[1:] + root[:-1], np.finfo(float).tiny)
    return PPoly(np.array([np.diff(x) / (4.0 * step), root[:-1], s[:-1]]), np.concatenate([[0.0], np.cumsum(lasts)]))


def averaged_motions(
    path: JointPath, speed: PathSpeed, given: RetimingLimits, fixed: Array, before: float
) -> tuple[list[AveragedMotion], float]:
    """Motions with a speed along a path, by the moving averages that are tried, and the longest that is wanted [s].

    An average is no longer than the speeds `fixed` (n,) at both ends allow, nan where they are not. The longest is not
    shorter than that of the round before: it would shrink with the accelerations, and their jerk remain.
    """
    law = law_of(speed.s, speed.x)
    if not given.jerk:
        return [AveragedMotion(path, law, 0.0)], 0.0
    pushed = np.abs(path.at(speed.s[:-1])[1] * speed.u[:, None]).max(axis=0)
    full = max(float((2.0 * pushed / given.limits.jerk).max()), before)
    free = np.flatnonzero(np.isnan(fixed))
    kept = float(law.x[free[0] - 1]), float(law.x[-1] - law.x[free[-1] + 1])
    most = min(2.0 * time if moving else np.inf for time, moving in zip(kept, path.speeds, strict=True))
    lengths = dict.fromkeys(min(share * full, most) for share in TRIED_AVERAGES)
    return [AveragedMotion(path, law, length) for length in lengths], full * TRIED_AVERAGES[-1]
