r"""Retime a path of an arm's joints: the same positions at the fastest speed within every limit.

Torques along a path are those of the model at the present speed, linear in the path's acceleration and squared speed
around it; the speed is found in rounds (see `fastest_speed`). Friction has the direction of the path. The jerk is
limited by a moving average of the path coordinate over time, which keeps the path and its ends: an acceleration that
jumps by d has the jerk d / T in the average of T s (Biagiotti & Melchiorri, Trajectory Planning for Automatic Machines
and Robots, 2008, §4.5). What is then left of an excess is removed by a slower clock.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline, PPoly

from armdyn.errors import TaskFailedError
from ik.torque import JointTorque
from pipeline.motion.fastest_speed import NoSpeedError, PathSpeed, fastest_speed
from pipeline.motion.feasibility.as_modelled import ModelledArm
from pipeline.motion.feasibility.check import CheckSettings, interpolated_samples
from pipeline.motion.trajectory import JointTrajectory
from urdf.robot import Array, Limits, Robot

RETIMED_RATE = 200.0
"""Samples per second of a retimed trajectory."""
RETIMED_LIMIT_SHARE = 0.99
"""Share of each limit that a retimed motion uses, so that it is also kept between nodes and samples."""
MIN_NODES, MAX_NODES = 200, 500
"""Least and largest number of nodes of the path."""
LINEARISING_ROUNDS, LOCAL_ROUNDS = 3, 8
"""Rounds in which torques are linearised at the speed of the round before, and rounds after these at most, in which the
speed is reduced where a limit is exceeded between nodes or samples."""
MIN_SQUARED_SPEED = 1e-6
"""Least squared speed at which torques are linearised, in units of the largest [1]: friction has a direction there."""
SERVO_ROUNDS, LEAST_SLOWER = 20, 1.03
"""Most rounds in which a motion is made slower until servos, simulated in closed loop, ask for no more than their
limits, and by which factor at least."""
PATH_JERK_SHARE = 0.5
"""Share of the jerk limit that the bends of a path use at constant speed."""
TRIED_AVERAGES = (0.35, 0.5, 0.7, 1.0)
"""Lengths of the moving average that are tried, in units of that which the jerk of full reversals needs."""
CLOCK_STEPS, CLOCK_MARGIN = 40, 1e-3
"""Most steps to the clock that removes the last excess, and by how much each is slower than the step before needs."""
MIN_POINT_DISTANCE_SHARE = 2e-4
"""Distance between points of a path, as a share of its length, below which the second is left out: at rest recorded
positions differ by rounding, which has no direction."""
MIN_PATH_LENGTH = 1e-6
"""Length of a path, in units of the way of a joint at full speed in 1 s, below which it stands still."""

TorqueBand = Callable[[Array, Array, Array], tuple[Array, Array]]
"""Torques of positions, velocities and accelerations, and half the widths of their bands, (n, joints) each."""


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


def retimed_on_arm(robot: Robot, points: Array, settings: CheckSettings) -> JointTrajectory:
    """The fastest feasible motion of an arm through points; obstacles and the arm's own links do not limit it.

    Args:
        robot: the arm.
        points: positions of the joints, (n, joints) [rad or m].
        settings: load, springs, or the arm as its model describes it.

    Raises:
        TaskFailedError: no speed is feasible; the message says why.
    """
    arm = settings.modelled
    if arm is not None:
        return _for_servos(
            retimed(points, robot.joint_names, RetimingLimits(robot.limits, arm.limit), arm.torques), arm
        )
    torque = JointTorque(robot, settings.load_mass, settings.springs)

    def certain(q: Array, v: Array, a: Array) -> tuple[Array, Array]:
        return torque(q, v, a), np.zeros_like(q)

    return retimed(points, robot.joint_names, RetimingLimits(robot.limits, robot.limits.effort), certain)


def _for_servos(motion: JointTrajectory, arm: ModelledArm) -> JointTrajectory:
    """The motion, slower where servos, simulated in closed loop, ask for more than their limits.

    Raises:
        TaskFailedError: they do so at any speed.
    """
    used = np.zeros(len(motion.joint_names))
    for _ in range(SERVO_ROUNDS):
        followed = arm.followed(motion)
        used = np.zeros(1) if followed is None else (np.abs(followed.demanded) / followed.limit).max(axis=0)
        if used.max() <= 1.0:
            return motion
        slower = max(LEAST_SLOWER, float(np.sqrt(used.max())))
        motion = JointTrajectory(
            motion.time * slower, motion.q, motion.v / slower, motion.a / slower**2, motion.joint_names
        )
    raise TaskFailedError(
        f"no speed was found at which the drive of {motion.joint_names[int(used.argmax())]} stays within its limit"
    )


class _Path:
    """A cubic spline through points, with a coordinate s of length 1 for the way of a joint at full speed in 1 s."""

    def __init__(self, points: Array, velocity: Array) -> None:
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
        self.spline = CubicSpline(at, points, bc_type="natural" if len(points) > 2 else "not-a-knot")
        self.length, self.count = float(at[-1]), len(points)

    def at(self, s: Array) -> tuple[Array, ...]:
        """Positions and their first three derivatives by s, (n, joints) each."""
        return tuple(self.spline(s, k) for k in range(4))


def retimed(points: Array, names: tuple[str, ...], given: RetimingLimits, torque: TorqueBand) -> JointTrajectory:
    """The fastest feasible motion through points, from rest to rest.

    Args:
        points: positions of the joints, (n, joints) [rad or m].
        names: names of the joints.
        given: the limits.
        torque: torques with their bands, which are kept within the limits.

    Raises:
        TaskFailedError: no speed is feasible; the message says why.
    """
    limits = given.limits
    out = np.flatnonzero(((points < limits.lower) | (points > limits.upper)).any(axis=0))
    if len(out):
        j = int(out[0])
        beyond = points[:, j].min() if points[:, j].min() < limits.lower[j] else points[:, j].max()
        raise TaskFailedError(
            f"no speed is feasible: {names[j]} is told to go to {beyond:.4g}, outside {limits.lower[j]:.4g} to "
            f"{limits.upper[j]:.4g}"
        )
    path = _Path(points, limits.velocity)
    s = np.linspace(0.0, path.length, int(np.clip(2 * path.count, MIN_NODES, MAX_NODES)) + 1)
    q, first, second, third = path.at(s)
    with np.errstate(divide="ignore"):
        most = (RETIMED_LIMIT_SHARE * limits.velocity / np.abs(first)).min(axis=1) ** 2
        if given.jerk:
            most = np.minimum(most, (PATH_JERK_SHARE * limits.jerk / np.abs(third)).min(axis=1) ** (2 / 3))
    speed, tried = PathSpeed(s, most * 0.25, np.zeros(len(s) - 1)), list[tuple[float, _Averaged]]()
    for k in range(LINEARISING_ROUNDS + LOCAL_ROUNDS):
        rows = _torque_rows(torque, (q, first, second), speed.x, given.torque)
        if given.jerk:
            bound = np.broadcast_to(RETIMED_LIMIT_SHARE * limits.acceleration, first.shape)
            a, b, c = rows
            rows = np.hstack([a, first, -first]), np.hstack([b, second, -second]), np.hstack([c, bound, bound])
        try:
            speed = fastest_speed(s, rows, most)
        except NoSpeedError as at:
            raise TaskFailedError(_reason(torque, q, first, at.node, given.torque, names)) from at
        if k < LINEARISING_ROUNDS - 1:
            continue
        measured = [(one, *_slowness(one.sampled(1.0, names), given, torque)) for one in _averaged(path, speed, given)]
        motion, time, slower = min(measured, key=lambda one: one[0].seconds * max(1.0, float(one[2].max())))
        tried.append((motion.seconds * max(1.0, float(slower.max())), motion))
        if slower.max() <= 1.0:
            break
        most = np.where(speed.x > 0.0, np.minimum(most, speed.x / motion.at_nodes(time, slower) ** 2), most)
    found = _slowed(min(tried, key=lambda one: one[0])[1], given, torque, names)
    if found is None:
        raise TaskFailedError(_reason(torque, q, first, None, given.torque, names))
    return found


def _torque_rows(
    torque: TorqueBand, path: tuple[Array, Array, Array], x: Array, largest: Array
) -> tuple[Array, Array, Array]:
    """Rows a u + b x <= c of the torques, (n, 2 joints) each; exact at squared speeds x (n,) and almost at rest."""
    q, first, second = path
    slow = np.full((len(q), 1), MIN_SQUARED_SPEED * x.max())
    fast = np.maximum(x[:, None], 2.0 * slow)
    states = [(slow, 0.0), (fast, 0.0), (fast, 1.0)]
    found, half = torque(
        np.vstack([q] * 3),
        np.vstack([first * np.sqrt(at) for at, _ in states]),
        np.vstack([second * at + first * u for at, u in states]),
    )
    still, moving, pushed = np.split(found, 3)
    a, b = pushed - moving, (moving - still) / (fast - slow)
    room, still = RETIMED_LIMIT_SHARE * (largest - half[len(q) : 2 * len(q)]), still - b * slow
    return np.hstack([a, -a]), np.hstack([b, -b]), np.hstack([room - still, room + still])


@dataclass(frozen=True, eq=False)
class _Averaged:
    """A path with a law s(t), averaged over some time.

    Attributes:
        path: the path.
        law: the law, from 0 to the path's length.
        average: length of the moving average [s].
    """

    path: _Path
    law: PPoly
    average: float

    @property
    def seconds(self) -> float:
        """Duration."""
        return float(self.law.x[-1]) + self.average

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
        whole = law.antiderivative()
        begin, end = time - self.average, time
        ways = [whole(np.clip(t, 0.0, last)) + length * np.maximum(t - last, 0.0) for t in (begin, end)]
        places = [law(np.clip(t, 0.0, last)) for t in (begin, end)]
        rates = [np.where((t > 0.0) & (t < last), rate(np.clip(t, 0.0, last)), 0.0) for t in (begin, end)]
        s, v, a = ((later - earlier) / self.average for earlier, later in (ways, places, rates))
        return s, v, a

    def at_nodes(self, time: Array, slower: Array) -> Array:
        """Factors at the nodes of the law, (n,): the largest of (m,) factors at (m,) times that its average reaches."""
        found, near = np.ones(len(self.law.x)), 2.0 / RETIMED_RATE
        for at, factor in zip(time[slower > 1.0].tolist(), slower[slower > 1.0].tolist(), strict=True):
            low, high = np.searchsorted(self.law.x, [at - self.average - near, at + near])
            found[max(low - 1, 0) : high + 1] = np.maximum(found[max(low - 1, 0) : high + 1], factor)
        return found

    def sampled(self, clock: float, names: tuple[str, ...]) -> JointTrajectory:
        """The motion with another clock, which is slowed to end with a sample."""
        count = max(int(np.ceil(self.seconds / clock * RETIMED_RATE)), 4)
        time = np.arange(count + 1) / RETIMED_RATE
        clock = self.seconds / time[-1]
        q, v, a = self.at(np.minimum(time * clock, self.seconds))
        return JointTrajectory(time, q, v * clock, a * clock**2, names)


def _averaged(path: _Path, speed: PathSpeed, given: RetimingLimits) -> list[_Averaged]:
    """Motions with a speed along a path, by the moving averages that are tried."""
    root = np.sqrt(speed.x)
    lasts = 2.0 * np.diff(speed.s) / np.maximum(root[1:] + root[:-1], np.finfo(float).tiny)
    law = PPoly(np.array([speed.u / 2.0, root[:-1], speed.s[:-1]]), np.concatenate([[0.0], np.cumsum(lasts)]))
    if not given.jerk:
        return [_Averaged(path, law, 0.0)]
    pushed = np.abs(path.at(speed.s[:-1])[1] * speed.u[:, None]).max(axis=0)
    full = float((2.0 * pushed / given.limits.jerk).max())
    return [_Averaged(path, law, share * full) for share in TRIED_AVERAGES]


def _slowed(
    motion: _Averaged, given: RetimingLimits, torque: TorqueBand, names: tuple[str, ...]
) -> JointTrajectory | None:
    """A motion with the fastest clock that keeps the limits at and between its samples; None if there is none."""
    clock = 1.0
    for _ in range(CLOCK_STEPS):
        found = motion.sampled(clock, names)
        slower = float(_slowness(found, given, torque)[1].max())
        if slower <= 1.0:
            return found
        clock /= slower * (1.0 + CLOCK_MARGIN)
    return None


def _slowness(motion: JointTrajectory, given: RetimingLimits, torque: TorqueBand) -> tuple[Array, Array]:
    """Times (m,), and factors (m,) by which the motion must be slower there; at most 1 where it keeps all limits."""
    limits, (time, q, v, a) = given.limits, interpolated_samples(motion.time, motion.q, motion.v, motion.a)
    found, half = torque(q, v, a)
    middle = (motion.time[1:] + motion.time[:-1]) / 2.0

    def slopes(values: Array) -> Array:
        return np.abs(np.diff(values, axis=0)) * RETIMED_RATE

    needed = [(time, np.abs(v) / limits.velocity), (middle, slopes(motion.q) / limits.velocity)]
    needed += [(time, np.sqrt((np.abs(found) + half) / given.torque))]
    if given.jerk:
        needed += [(time, np.sqrt(np.abs(a) / limits.acceleration))]
        needed += [(middle, np.sqrt(slopes(motion.v) / limits.acceleration))]
        needed += [(middle, np.cbrt(slopes(motion.a) / limits.jerk))]
    return np.concatenate([at for at, _ in needed]), np.concatenate([part.max(axis=1) for _, part in needed])


def _reason(torque: TorqueBand, q: Array, way: Array, node: int | None, largest: Array, names: tuple[str, ...]) -> str:
    """Why no speed is feasible: a joint that cannot even creep, or an end that cannot be reached from rest."""
    slow = np.sqrt(MIN_SQUARED_SPEED) * way
    found, half = torque(q, slow, np.zeros_like(q))
    share = (np.abs(found) + half) / largest
    i, j = np.unravel_index(int(share.argmax()), share.shape)
    if share[i, j] > 1.0:
        return (
            f"no speed is feasible: {names[j]} needs {abs(found[i, j]):.4g} +- {half[i, j]:.2g} of {largest[j]:.4g} to "
            f"creep through {q[i, j]:.4g}, {100.0 * i / (len(q) - 1):.0f} % of the way"
        )
    at = "" if node is None else f" before {100.0 * node / (len(q) - 1):.0f} % of the way"
    return f"no speed is feasible{at}: a joint is too close to its torque limit to turn round or to stop there"
