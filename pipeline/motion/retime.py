r"""Retime a path of an arm's joints: the same positions at the fastest speed within every limit.

Torques along a path are those of the model at the present speed, linear in the path's acceleration and squared speed
around it; the speed is found in rounds (see `fastest_speed`). Friction has the direction of the path. The jerk is
limited by a moving average of the path coordinate over time, which keeps the path and its ends: an acceleration that
jumps by d has the jerk d / T in the average of T s (Biagiotti & Melchiorri, Trajectory Planning for Automatic Machines
and Robots, 2008, §4.5). What is then left of an excess is removed by a slower clock.

An end at a given velocity keeps it for T / 2, in which the average still has samples beyond the end, where the law goes
on at this speed. A slower clock would change it: there the speed between the ends is reduced instead.
"""

from collections.abc import Callable

import numpy as np

from armdyn.errors import TaskFailedError
from ik.torque import JointTorque
from pipeline.motion.averaged import (
    RETIMED_RATE,
    AveragedMotion,
    JointPath,
    RetimingLimits,
    averaged_motions,
    given_speeds,
)
from pipeline.motion.fastest_speed import NoSpeedError, PathSpeed, fastest_speed
from pipeline.motion.feasibility.as_modelled import ModelledArm
from pipeline.motion.feasibility.check import CheckSettings, interpolated_samples
from pipeline.motion.trajectory import AT_REST, EndVelocities, JointTrajectory
from urdf.robot import Array, Robot

RETIMED_LIMIT_SHARE = 0.99
"""Share of each limit that a retimed motion uses, so that it is also kept between nodes and samples."""
MIN_NODES, MAX_NODES = 200, 500
"""Least and largest number of nodes of the path."""
LINEARISING_ROUNDS, LOCAL_ROUNDS, LOCAL_ROUNDS_IN_MOTION = 3, 8, 20
"""Rounds in which torques are linearised at the speed of the round before, and rounds after these at most, in which the
speed is reduced where a limit is exceeded between nodes or samples; the last number where no slower clock follows."""
MIN_SQUARED_SPEED = 1e-6
"""Least squared speed at which torques are linearised, in units of the largest [1]: friction has a direction there."""
SERVO_ROUNDS, LEAST_SLOWER = 20, 1.03
"""Most rounds in which a motion is made slower until servos, simulated in closed loop, ask for no more than their
limits, and by which factor at least."""
PATH_JERK_SHARE = 0.7
"""Share of the jerk limit that the bends of a path use at constant speed."""
CLOCK_STEPS, CLOCK_MARGIN = 40, 1e-3
"""Most steps to the clock that removes the last excess, and by how much each is slower than the step before needs;
where ends are in motion, the same for the speed between them."""

TorqueBand = Callable[[Array, Array, Array], tuple[Array, Array]]
"""Torques of positions, velocities and accelerations, and half the widths of their bands, (n, joints) each."""


def retimed_on_arm(robot: Robot, points: Array, ends: EndVelocities, settings: CheckSettings) -> JointTrajectory:
    """The fastest feasible motion of an arm through points; obstacles and the arm's own links do not limit it.

    Args:
        robot: the arm.
        points: positions of the joints, (n, joints) [rad or m].
        ends: velocities of the joints at both ends.
        settings: load, springs, or the arm as its model describes it.

    Raises:
        TaskFailedError: no speed is feasible; the message says why.
    """
    arm = settings.modelled
    if arm is not None:
        found = retimed(points, robot.joint_names, RetimingLimits(robot.limits, arm.limit), arm.torques, ends)
        return _for_servos(found, arm, ends.are_rest(robot.limits.velocity))
    torque = JointTorque(robot, settings.load_mass, settings.springs)

    def certain(q: Array, v: Array, a: Array) -> tuple[Array, Array]:
        return torque(q, v, a), np.zeros_like(q)

    return retimed(points, robot.joint_names, RetimingLimits(robot.limits, robot.limits.effort), certain, ends)


def _for_servos(motion: JointTrajectory, arm: ModelledArm, rests: bool) -> JointTrajectory:
    """The motion, slower where servos, simulated in closed loop, ask for more than their limits.

    Raises:
        TaskFailedError: they do so at any speed, or the motion does not rest at its ends.
    """
    if not rests and all(arm.model.servo(joint) is not None for joint in motion.joint_names):
        raise TaskFailedError("servos are simulated from rest: retime their motion without velocities at its ends")
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


def retimed(
    points: Array,
    names: tuple[str, ...],
    given: RetimingLimits,
    torque: TorqueBand,
    ends: EndVelocities = AT_REST,
) -> JointTrajectory:
    """The fastest feasible motion through points.

    Args:
        points: positions of the joints, (n, joints) [rad or m].
        names: names of the joints.
        given: the limits.
        torque: torques with their bands, which are kept within the limits.
        ends: velocities of the joints at both ends.

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
    path = JointPath(points, limits.velocity, ends)
    s = np.linspace(0.0, path.length, int(np.clip(2 * path.count, MIN_NODES, MAX_NODES)) + 1)
    q, first, second, third = path.at(s)
    with np.errstate(divide="ignore"):
        most = (RETIMED_LIMIT_SHARE * limits.velocity / np.abs(first)).min(axis=1) ** 2
        if given.jerk:
            most = np.minimum(most, (PATH_JERK_SHARE * limits.jerk / np.abs(third)).min(axis=1) ** (2 / 3))
    speed, tried = PathSpeed(s, most * 0.25, np.zeros(len(s) - 1)), list[tuple[float, AveragedMotion]]()
    average, longest, moves = 0.0, np.inf, any(path.speeds)
    further = 1.0 + CLOCK_MARGIN if moves else 1.0
    for k in range(LINEARISING_ROUNDS + (LOCAL_ROUNDS_IN_MOTION if moves else LOCAL_ROUNDS)):
        rows = _torque_rows(torque, (q, first, second), speed.x, given.torque)
        if given.jerk:
            bound = np.broadcast_to(RETIMED_LIMIT_SHARE * limits.acceleration, first.shape)
            a, b, c = rows
            rows = np.hstack([a, first, -first]), np.hstack([b, second, -second]), np.hstack([c, bound, bound])
        while True:
            fixed = given_speeds(path, s, average)
            try:
                speed = fastest_speed(s, rows, np.fmax(most, fixed), fixed)
                break
            except NoSpeedError as at:
                if average < 1.0 / RETIMED_RATE:
                    raise TaskFailedError(_reason(torque, q, first, at.node, given.torque, names, moves)) from at
                average = longest = average / 2.0
        averaged, wanted = averaged_motions(path, speed, given, fixed)
        average = min(max(average, wanted), longest)
        if k < LINEARISING_ROUNDS - 1:
            continue
        measured = [(one, *_slowness(one.sampled(1.0, names), given, torque)) for one in averaged]
        motion, time, slower = min(measured, key=lambda one: one[0].seconds * max(1.0, float(one[2].max())))
        if not moves or slower.max() <= 1.0:
            tried.append((motion.seconds * max(1.0, float(slower.max())), motion))
        if slower.max() <= 1.0:
            break
        most = np.where(speed.x > 0.0, np.minimum(most, speed.x / motion.at_nodes(time, slower * further) ** 2), most)
    found = _slowed(min(tried, key=lambda one: one[0])[1], given, torque, names) if tried else None
    if found is None:
        raise TaskFailedError(_reason(torque, q, first, None, given.torque, names, moves))
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


def _slowed(
    motion: AveragedMotion, given: RetimingLimits, torque: TorqueBand, names: tuple[str, ...]
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
        return np.abs(np.diff(values, axis=0)) / np.diff(motion.time)[:, None]

    needed = [(time, np.abs(v) / limits.velocity), (middle, slopes(motion.q) / limits.velocity)]
    needed += [(time, np.sqrt((np.abs(found) + half) / given.torque))]
    if given.jerk:
        needed += [(time, np.sqrt(np.abs(a) / limits.acceleration))]
        needed += [(middle, np.sqrt(slopes(motion.v) / limits.acceleration))]
        needed += [(middle, np.cbrt(slopes(motion.a) / limits.jerk))]
    return np.concatenate([at for at, _ in needed]), np.concatenate([part.max(axis=1) for _, part in needed])


def _reason(
    torque: TorqueBand,
    q: Array,
    way: Array,
    node: int | None,
    largest: Array,
    names: tuple[str, ...],
    moves: bool,
) -> str:
    """Why no speed is feasible: a joint that cannot even creep, or an end that cannot be reached."""
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
    if moves:
        return f"no speed is feasible{at}: the limits do not allow the velocities that are given at its ends"
    return f"no speed is feasible{at}: a joint is too close to its torque limit to turn round or to stop there"
