r"""Retime a path of an arm's joints: the same positions at the fastest speed within every limit.

Torques along a path are those of the model at the present speed, linear in the path's acceleration and squared speed
around it; the speed is found in rounds (see `fastest_speed`), after the first on nodes that are passed at even times:
evenly along the path they would be far apart in time where it begins and ends, and miss its bends there. Friction has
the direction of the path. The jerk of bends is limited at the nodes; that of changes of the path's acceleration by a
moving average of the path coordinate over time, which keeps the path and its ends: an acceleration that jumps by d has
the jerk d / T in the average of T s (Biagiotti & Melchiorri, Trajectory Planning for Automatic Machines and Robots,
2008, §4.5). What is then left of an excess is removed by a slower clock.

An end at a given velocity keeps it for T / 2, in which the average still has samples beyond the end, where the law goes
on at this speed. A slower clock would change it: there the speed between the ends is reduced instead.
"""

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
from pipeline.motion.path_nodes import MIN_SQUARED_SPEED, PathNodes, TorqueBand
from pipeline.motion.trajectory import AT_REST, EndVelocities, JointTrajectory
from urdf.robot import Array, Robot

MIN_NODES, MAX_NODES = 200, 500
"""Least and largest number of nodes of the path."""
LINEARISING_ROUNDS, LOCAL_ROUNDS, LOCAL_ROUNDS_IN_MOTION = 3, 8, 20
"""Rounds in which torques are linearised at the speed of the round before, and rounds after these at most, in which the
speed is reduced where a limit is exceeded between nodes or samples; the last number where no slower clock follows."""
LONGEST = 100.0
"""Longest duration of a motion, in units of that at full speed; at a node where it almost stands it would take days."""
SERVO_ROUNDS, LEAST_SLOWER = 20, 1.03
"""Most rounds in which a motion is made slower until servos, simulated in closed loop, ask for no more than their
limits, and by which factor at least."""
SAMPLE_STEPS, CLOCK_STEPS, CLOCK_MARGIN = 8, 40, 1e-3
"""Most steps to the clock that removes the last excess. The first add a sample each, because an excess within a sample
depends on where the samples fall; further ones are slower by this margin than the step before needs. Where ends are in
motion, the margin is one of the speed between them."""


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
    nodes = PathNodes.at(path, np.linspace(0.0, path.length, int(np.clip(2 * path.count, MIN_NODES, MAX_NODES)) + 1))
    most = nodes.largest(limits.velocity)
    speed, tried = PathSpeed(nodes.s, most, np.zeros(len(most) - 1)), list[tuple[float, AveragedMotion]]()
    average, longest, moves = 0.0, np.inf, any(path.speeds)
    further = 1.0 + CLOCK_MARGIN if moves else 1.0
    for k in range(LINEARISING_ROUNDS + (LOCAL_ROUNDS_IN_MOTION if moves else LOCAL_ROUNDS)):
        if k == 1 and given.jerk:  # else nothing smooths what nodes closer than samples allow
            nodes, speed = nodes.at_even_times(path, speed)
            most = nodes.largest(limits.velocity)
        # The first guess is far from the speeds of ends in motion.
        free = np.isnan(given_speeds(path, nodes.s, average)) & (k > 0 or not moves)
        rows = nodes.rows(speed.x, given, torque, free)
        while True:
            fixed = given_speeds(path, nodes.s, average)
            try:
                speed = fastest_speed(nodes.s, rows, np.fmax(most, fixed), fixed)
                break
            except NoSpeedError as at:
                if average < 1.0 / RETIMED_RATE:
                    raise TaskFailedError(_reason(torque, nodes, at.node, given.torque, names, moves)) from at
                average = longest = average / 2.0
        averaged, wanted = averaged_motions(path, speed, given, fixed, average)
        average = min(max(average, wanted), longest)
        if k < LINEARISING_ROUNDS - 1 or averaged[0].seconds > LONGEST * path.length:
            continue
        cost, motion, time, slower = _best(averaged, given, torque, names)
        if not moves or slower.max() <= 1.0:
            tried.append((cost, motion))
        if slower.max() <= (1.0 + CLOCK_MARGIN if given.jerk and not moves else 1.0):
            break
        most = np.where(speed.x > 0.0, np.minimum(most, speed.x / motion.at_nodes(time, slower * further) ** 2), most)
    found = _slowed(min(tried, key=lambda one: one[0])[1], given, torque, names) if tried else None
    if found is None:
        raise TaskFailedError(_reason(torque, nodes, None, given.torque, names, moves))
    return found


def _best(
    motions: list[AveragedMotion], given: RetimingLimits, torque: TorqueBand, names: tuple[str, ...]
) -> tuple[float, AveragedMotion, Array, Array]:
    """The motion that a clock which keeps all limits leaves shortest: its duration [s], and its times and factors.

    Torques take longest to compute: only of motions that may still be the shortest.
    """
    known = [(motion, motion.sampled(1.0, names)) for motion in motions]
    least = [_clocked(motion, _slowness(samples, given)[1]) for motion, samples in known]
    found = list[tuple[float, AveragedMotion, Array, Array]]()
    for i in np.argsort(least).tolist():
        if not found or least[i] < min(cost for cost, *_ in found):
            motion, samples = known[i]
            time, slower = _slowness(samples, given, torque)
            found.append((_clocked(motion, slower), motion, time, slower))
    return min(found, key=lambda one: one[0])


def _clocked(motion: AveragedMotion, slower: Array) -> float:
    return motion.seconds * max(1.0, float(slower.max()))


def _slowed(
    motion: AveragedMotion, given: RetimingLimits, torque: TorqueBand, names: tuple[str, ...]
) -> JointTrajectory | None:
    """A motion with the fastest clock that keeps the limits at and between its samples; None if there is none."""
    clock = 1.0
    for k in range(CLOCK_STEPS):
        found = motion.sampled(clock, names)
        slower = float(_slowness(found, given, torque)[1].max())
        if slower <= 1.0:
            return found
        clock /= slower * (1.0 + CLOCK_MARGIN) if k >= SAMPLE_STEPS else 1.0 + 1.0 / (found.time[-1] * RETIMED_RATE)
    return None


def _slowness(motion: JointTrajectory, given: RetimingLimits, torque: TorqueBand | None = None) -> tuple[Array, Array]:
    """Times (m,), and factors (m,) by which the motion must be slower there; at most 1 where it keeps the limits.

    Without `torque` they are those of the other limits.
    """
    limits, (time, q, v, a) = given.limits, interpolated_samples(motion.time, motion.q, motion.v, motion.a)
    middle = (motion.time[1:] + motion.time[:-1]) / 2.0

    def slopes(values: Array) -> Array:
        return np.abs(np.diff(values, axis=0)) / np.diff(motion.time)[:, None]

    needed = [(time, np.abs(v) / limits.velocity), (middle, slopes(motion.q) / limits.velocity)]
    if torque is not None:
        found, half = torque(q, v, a)
        needed += [(time, np.sqrt((np.abs(found) + half) / given.torque))]
    if given.jerk:
        needed += [(time, np.sqrt(np.abs(a) / limits.acceleration))]
        needed += [(middle, np.sqrt(slopes(motion.v) / limits.acceleration))]
        needed += [(middle, np.cbrt(slopes(motion.a) / limits.jerk))]
    return np.concatenate([at for at, _ in needed]), np.concatenate([part.max(axis=1) for _, part in needed])


def _reason(
    torque: TorqueBand, nodes: PathNodes, node: int | None, largest: Array, names: tuple[str, ...], moves: bool
) -> str:
    """Why no speed is feasible: a joint that cannot even creep, or an end that cannot be reached."""
    q, slow = nodes.q, np.sqrt(MIN_SQUARED_SPEED) * nodes.first
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
