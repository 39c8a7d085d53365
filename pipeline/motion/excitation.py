"""Design of an arm's motion that determines chosen effects well, within all limits and free of collisions."""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

import urdf
from armdyn.errors import TaskFailedError
from armdyn.experiments.arm import ArmProblem
from armdyn.experiments.criteria import posterior_covariance
from armdyn.experiments.goal import MotionGoal
from armdyn.experiments.limits import MotionLimits
from armdyn.experiments.search import (
    COMPARED_EXCESS,
    ReportProgress,
    best_motion,
    optimise_motion,
    random_motions,
    scale_about_centre,
    shrink_within_limits,
)
from armdyn.experiments.series import AxisMotion, FourierSeries
from armdyn.run import Channel, Run
from armdyn.threads import one_thread
from pipeline.motion.feasibility import CheckSettings, FeasibilityReport, check_joints
from pipeline.motion.feasibility.clearance import MIN_CLEARANCE
from pipeline.motion.trajectory import JointTrajectory
from urdf.robot import Array

AMPLE_CLEARANCE = 0.1
"""m; links that are so much further apart than asked for are far from touching."""
DESIGN_CLEARANCE_FACTOR = 1.5
"""Times what the check asks for: a motion is designed on a grid, and checked in between."""
CACHED_POSTURES = 5000
"""Postures whose distances are kept: a motion is looked at twice, and meshes take milliseconds each time."""


class FreePostures:
    """The postures that the feasibility check allows with a required distance between links [m], for a search."""

    def __init__(self, robot: urdf.Robot, clearance: float) -> None:
        self.robot, self.clearance = robot, clearance
        self._collision = urdf.CollisionModel(robot)
        self._distance = lru_cache(CACHED_POSTURES)(
            lambda q: self._collision.clearance(np.frombuffer(q, dtype=np.float64).copy()).distance
        )

    def free(self, q: Array) -> bool:
        """Whether no links touch in a posture; always True where the URDF's meshes are missing."""
        return not self._collision.pairs or self._collision.touching(q) is None

    def margin(self, q: Array) -> float:
        """Distance between links beyond the required clearance, in units of `AMPLE_CLEARANCE`."""
        if not self._collision.pairs:
            return np.inf
        return (self._distance(q.tobytes()) - DESIGN_CLEARANCE_FACTOR * self.clearance) / AMPLE_CLEARANCE


MAX_REPAIRS = 4
"""How often a motion that breaks a limit between the instants of its design is designed again with less room."""
REPAIR_SHARE = 0.99
"""Share of the room that is kept beyond what a violation asks for."""
REDUCED_SIZES = (1.0, 0.95, 0.9, 0.8, 0.65, 0.5, 0.3)
"""Sizes that are tried at last."""


@dataclass(frozen=True, eq=False)
class Expectation:
    """Expected results from a recording of a motion.

    Attributes:
        coefficients: (nj, size) of the motion's series [rad or m].
        std: (W,) standard deviations of the wanted unknowns, in their units.
        separations: by hidden case of the goal, the smallest rise of chi2 after the rival is refitted.
    """

    coefficients: Array
    std: Array
    separations: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Excitation:
    """A designed motion, with the expected results of it and of other motions.

    Attributes:
        goal: which unknowns are wanted, or which effects are to be distinguished.
        series: basis functions that generate motions from coefficients.
        trajectory: sampled at the goal's rate.
        check: report on the motion's feasibility.
        expected: expected results of the motion.
        random: expected results of the best of some random motions; None where there was none.
        conditioned: expected results of the motion with the least condition number; None where it was not requested.
        tried: number of random motions.
        torque: (n, nj) of the motors along the trajectory [N m or N].
    """

    goal: MotionGoal
    series: FourierSeries
    trajectory: JointTrajectory
    check: FeasibilityReport
    expected: Expectation
    random: Expectation | None
    conditioned: Expectation | None
    tried: int
    torque: Array

    def __repr__(self) -> str:
        return f"Excitation: {self.motion}, {self.check.sentence}"

    @property
    def motion(self) -> Run:
        """The motion as a run, with q, v and a of every joint: write it with `write_run_csv`, play it, record it."""
        motion, units = self.trajectory, ["m" if slides else "rad" for slides in self.goal.columns.arm.slides]
        channels = {
            f"{kind}.{joint}": Channel(motion.time, column, unit + per)
            for kind, values, per in (("q", motion.q, ""), ("v", motion.v, "/s"), ("a", motion.a, "/s^2"))
            for joint, column, unit in zip(motion.joint_names, values.T, units, strict=True)
        }
        return Run("motion", channels)

    @property
    def energy(self) -> float:
        """Mechanical work of all motors, braking counted like driving [J]."""
        power = np.abs(self.torque * self.trajectory.v).sum(axis=1)
        return float(np.trapezoid(power, self.trajectory.time))


SINGLE_JOINT_CHECK = CheckSettings(singular_value=0.0)
"""Joints that are led one by one race for no tool."""


@one_thread
def excitation(
    goal: MotionGoal,
    seconds: float,
    *,
    random: int = 100,
    compare: bool = True,
    seed: int = 0,
    say: ReportProgress = lambda _: None,
) -> Excitation:
    """Design a motion of some seconds that determines or distinguishes the effects of a goal as well as possible.

    It begins with so many random motions, and is compared with the best of them and, with `compare`, with the motion of
    the least condition number. `say` reports the progress.

    Raises:
        TaskFailedError: no feasible motion was found.
    """
    robot = goal.columns.arm.robot
    postures = FreePostures(robot, MIN_CLEARANCE)
    problem = ArmProblem(goal.columns, goal.criterion, FourierSeries(seconds), MotionLimits.of_robot(robot), postures)
    starts = random_motions(problem, random, np.random.default_rng(seed), say)
    if not starts:
        raise TaskFailedError(
            "no posture was found at which the arm is free and its torques suffice: choose other --joints, or mend the "
            "limits of its URDF"
        )
    informations = [problem.information(x) for x in starts]
    costs = [goal.criterion(information)[0] for information in informations]
    best = starts[int(np.argmin(costs))]
    x, trajectory, check = _feasible(problem, best_motion(problem, starts, costs, say), best, say)
    conditioned = None
    if compare:
        say("designing the motion with the least condition number")
        rival = replace(problem, criterion=goal.condition_number_criterion)
        other = best_motion(
            rival, starts, [goal.condition_number_criterion(information)[0] for information in informations], say
        )
        inside = shrink_within_limits(rival, other, COMPARED_EXCESS)
        conditioned = expectation(problem, goal, other if inside is None else inside)
    return Excitation(
        goal=goal,
        series=problem.series,
        trajectory=trajectory,
        check=check,
        expected=expectation(problem, goal, x),
        random=expectation(problem, goal, best),
        conditioned=conditioned,
        tried=len(starts),
        torque=problem.columns.described_torque(AxisMotion(trajectory.q, trajectory.v, trajectory.a)),
    )


def expectation(problem: ArmProblem, goal: MotionGoal, x: Array) -> Expectation:
    """Expected results from a recording of the motion with (nj, size) coefficients."""
    information, prior = problem.information(x), goal.columns.prior
    K = posterior_covariance(information, prior)
    std = np.sqrt(np.diag(K))[goal.wanted] * goal.columns.typical[goal.wanted]
    separations = tuple(case.separation(information, prior) for case in goal.separations)
    return Expectation(x, std, separations)


def sampled(problem: ArmProblem, x: Array) -> JointTrajectory:
    """The motion with (nj, size) coefficients, sampled at the rate of the recording."""
    seconds = problem.series.seconds
    time = np.linspace(0.0, seconds, round(seconds * problem.columns.rate) + 1)
    motion = problem.series.basis_at(time).motion(x)
    return JointTrajectory(time, motion.q, motion.v, motion.a, problem.columns.arm.joints)


def _feasible(
    problem: ArmProblem, x: Array, best: Array, say: ReportProgress
) -> tuple[Array, JointTrajectory, FeasibilityReport]:
    """The motion if the check passes, otherwise one designed again for narrower limits.

    Where that motion breaks a limit too, it or the `best` random motion is scaled down, whichever determines more.

    Raises:
        TaskFailedError: even the smaller motion breaks a limit.
    """

    def checked(x: Array) -> tuple[JointTrajectory, FeasibilityReport]:
        trajectory = sampled(problem, x)
        return trajectory, check_joints(problem.columns.arm.robot, trajectory, SINGLE_JOINT_CHECK)

    say("checking the motion on the whole arm")
    trajectory, check = checked(x)
    first = check
    for k in range(MAX_REPAIRS):
        if check.feasible:
            break
        problem = _with_less_room(problem, check)
        say(f"{k + 1} of {MAX_REPAIRS} repairs, as the {check.violations[0].broken}")
        x = optimise_motion(problem, x, first=len(problem.steps_per_round) - 2)
        say("checking the motion on the whole arm")
        trajectory, check = checked(x)
    if check.feasible:
        return x, trajectory, check
    smaller: list[tuple[float, tuple[Array, JointTrajectory, FeasibilityReport]]] = []
    for motion in (x, best):
        for small in (scale_about_centre(motion, size) for size in REDUCED_SIZES):
            trajectory, check = checked(small)
            if check.feasible:
                smaller.append((problem.cost(small), (small, trajectory, check)))
                break
    if smaller:
        return min(smaller, key=lambda found: found[0])[1]
    raise TaskFailedError(f"no feasible motion was found: {first.sentence} Choose other --joints or --seconds")


def _with_less_room(problem: ArmProblem, check: FeasibilityReport) -> ArmProblem:
    """A design with narrower limits where a check found a violation."""
    joints, postures = problem.columns.arm.joints, problem.postures
    assert isinstance(postures, FreePostures)
    for margin in check.margins:
        if margin.margin >= 0.0:
            continue
        if margin.limit in ("position", "velocity", "acceleration", "torque"):
            limits = problem.limits.reduced(margin.limit, joints.index(margin.joint), REPAIR_SHARE / margin.used)
            problem = replace(problem, limits=limits)
        elif margin.limit == "self_collision":
            postures = FreePostures(postures.robot, postures.clearance - 2.0 * margin.margin)
    return replace(problem, postures=postures)
