"""Design an arm's motion that determines the parameters of chosen effects, within all limits, without collisions."""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

import urdf
from armdyn.errors import TaskFailedError
from armdyn.estimation.posterior import posterior_covariance
from armdyn.experiments.arm import ArmProblem
from armdyn.experiments.goal import MotionGoal
from armdyn.experiments.limits import MotionLimits
from armdyn.experiments.search import (
    MAX_COMPARED_LIMIT_EXCESS_SHARE,
    ReportProgress,
    best_motion,
    optimise_motion,
    random_motions,
    scale_about_centre,
    shrink_within_limits,
)
from armdyn.experiments.series import AxisMotion, FourierSeries
from armdyn.run import Run
from armdyn.threads import one_thread
from pipeline.motion.feasibility import CheckSettings, FeasibilityReport, check_joints
from pipeline.motion.feasibility.as_modelled import ModelledArm
from pipeline.motion.feasibility.clearance import MIN_LINK_CLEARANCE
from pipeline.motion.trajectory import JointTrajectory
from urdf.robot import Array

CLEARANCE_UNIT_METRES = 0.1
"""Unit of the margin in the optimisation: an additional distance of links that is ample [m]."""
DESIGN_TO_CHECK_CLEARANCE_RATIO = 1.5
"""Distance of links in the design over that in the check, because the design uses fewer instants."""
CACHED_POSTURES = 5000
"""Number of postures whose distances are stored, because a posture is evaluated twice and takes milliseconds."""


class CollisionFreePostures:
    """Tells for a robot's postures whether they are free of collisions, and their distance from a collision.

    Attributes:
        robot: the robot.
        clearance: required distance between links [m].
    """

    def __init__(self, robot: urdf.Robot, clearance: float) -> None:
        self.robot, self.clearance = robot, clearance
        self._collision = urdf.CollisionModel(robot)
        self._distance = lru_cache(CACHED_POSTURES)(
            lambda q: self._collision.clearance(np.frombuffer(q, dtype=np.float64).copy()).distance
        )

    def free(self, q: Array) -> bool:
        """Whether a posture q (n,) [rad or m] has no collision; always True if the URDF's meshes are missing."""
        return not self._collision.pairs or self._collision.touching(q) is None

    def margin(self, q: Array) -> float:
        """Distance between links beyond the required one at a posture q (n,), in units of `CLEARANCE_UNIT_METRES`."""
        if not self._collision.pairs:
            return np.inf
        return (self._distance(q.tobytes()) - DESIGN_TO_CHECK_CLEARANCE_RATIO * self.clearance) / CLEARANCE_UNIT_METRES


MAX_REDESIGNS = 4
"""Largest number of times that a motion which violates a limit is designed again with narrower limits."""
LIMIT_NARROWING_FACTOR = 0.99
"""Factor by which a limit is narrowed in addition to the excess of a violation."""
REDUCED_AMPLITUDES = (1.0, 0.95, 0.9, 0.8, 0.65, 0.5, 0.3)
"""Factors on the amplitude of a motion that are tried when designing it again has failed."""


@dataclass(frozen=True, eq=False)
class ExpectedMotionInformation:
    """What a recording of a motion is expected to determine.

    Attributes:
        coefficients: coefficients of the motion's series for nj joints, (nj, size) [rad or m].
        std: standard deviations of the W wanted parameters, in their units, (W,).
        separations: for each case of two rival effects (one of them present, on one joint), the increase of chi-square
            when the other effect is fitted in its place.
    """

    coefficients: Array
    std: Array
    separations: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Excitation:
    """A designed motion, with what it and other motions are expected to determine.

    Attributes:
        goal: the parameters to determine, or the effects to distinguish.
        series: basis functions that generate motions from coefficients.
        trajectory: the motion, sampled at the goal's rate.
        feasibility: report on the motion's feasibility.
        expected: what the motion is expected to determine.
        random: what the best of the random motions is expected to determine; None without random motions.
        conditioned: what the motion with the smallest condition number is expected to determine; None if not computed.
        tried: number of random motions.
        torque: torques of the motors along the trajectory, (n, nj) [N m or N].
    """

    goal: MotionGoal
    series: FourierSeries
    trajectory: JointTrajectory
    feasibility: FeasibilityReport
    expected: ExpectedMotionInformation
    random: ExpectedMotionInformation | None
    conditioned: ExpectedMotionInformation | None
    random_count: int
    torque: Array

    def __repr__(self) -> str:
        return f"Excitation: {self.motion}, {self.feasibility.sentence}"

    @property
    def motion(self) -> Run:
        """The motion as a run with position q, velocity v and acceleration a of every joint."""
        units = ["m" if slides else "rad" for slides in self.goal.columns.arm.slides]
        return Run("motion", self.trajectory.channels(units))

    @property
    def energy(self) -> float:
        """Mechanical work of all motors during the motion, with braking counted as positive [J]."""
        power = np.abs(self.torque * self.trajectory.v).sum(axis=1)
        return float(np.trapezoid(power, self.trajectory.time))


SINGLE_JOINT_CHECK_SETTINGS = CheckSettings(min_singular_value=0.0)
"""Settings of the check for motions of single joints: singular postures are allowed."""


@one_thread
def design_excitation(
    goal: MotionGoal,
    seconds: float,
    *,
    random: int = 100,
    compare: bool = True,
    seed: int = 0,
    say: ReportProgress = lambda _: None,
    modelled: ModelledArm | None = None,
) -> Excitation:
    """Design a motion that determines parameters, or distinguishes effects, as well as possible.

    Args:
        goal: the parameters to determine, or the effects to distinguish.
        seconds: duration of the motion [s].
        random: number of random motions from which the design starts.
        compare: whether to compute also the motion with the smallest condition number, for comparison.
        seed: seed of the random motions.
        say: function that is called with a sentence about the progress.
        modelled: the arm as its model describes it, which must be able to move so; None for its description alone.

    Raises:
        TaskFailedError: no feasible motion was found.
    """
    settings = replace(SINGLE_JOINT_CHECK_SETTINGS, modelled=modelled)
    robot = goal.columns.arm.robot
    postures = CollisionFreePostures(robot, MIN_LINK_CLEARANCE)
    problem = ArmProblem(goal.columns, goal.criterion, FourierSeries(seconds), MotionLimits.of_robot(robot), postures)
    starts = random_motions(problem, random, np.random.default_rng(seed), say)
    if not starts:
        raise TaskFailedError(
            "no posture was found at which the arm is free and its torques suffice: choose other --joints, or correct "
            "the limits of its URDF"
        )
    informations = [problem.information(x) for x in starts]
    costs = [goal.criterion(information)[0] for information in informations]
    best = starts[int(np.argmin(costs))]
    x, trajectory, check = _feasible(problem, best_motion(problem, starts, costs, say), best, settings, say)
    conditioned = None
    if compare:
        say("designing the motion with the least condition number")
        rival = replace(problem, criterion=goal.condition_number_criterion)
        other = best_motion(
            rival, starts, [goal.condition_number_criterion(information)[0] for information in informations], say
        )
        inside = shrink_within_limits(rival, other, MAX_COMPARED_LIMIT_EXCESS_SHARE)
        conditioned = expected_motion_information(problem, goal, other if inside is None else inside)
    return Excitation(
        goal=goal,
        series=problem.series,
        trajectory=trajectory,
        feasibility=check,
        expected=expected_motion_information(problem, goal, x),
        random=expected_motion_information(problem, goal, best),
        conditioned=conditioned,
        random_count=len(starts),
        torque=problem.columns.described_torque(AxisMotion(trajectory.q, trajectory.v, trajectory.a)),
    )


def expected_motion_information(problem: ArmProblem, goal: MotionGoal, x: Array) -> ExpectedMotionInformation:
    """Compute what a recording of a motion, given by its coefficients x (nj, size), is expected to determine."""
    information, prior = problem.information(x), goal.columns.prior
    K = posterior_covariance(information, prior)
    std = np.sqrt(np.diag(K))[goal.wanted] * goal.columns.typical[goal.wanted]
    separations = tuple(case.separation(information, prior) for case in goal.separations)
    return ExpectedMotionInformation(x, std, separations)


def sample_motion(problem: ArmProblem, x: Array) -> JointTrajectory:
    """Sample a motion, given by its coefficients x (nj, size), at the rate of the recording."""
    seconds = problem.series.seconds
    time = np.linspace(0.0, seconds, round(seconds * problem.columns.rate) + 1)
    motion = problem.series.basis_at(time).motion(x)
    return JointTrajectory(time, motion.q, motion.v, motion.a, problem.columns.arm.joints)


def _feasible(
    problem: ArmProblem, x: Array, best: Array, settings: CheckSettings, say: ReportProgress
) -> tuple[Array, JointTrajectory, FeasibilityReport]:
    """Make a motion feasible: design it again with narrower limits where the check finds violations.

    If this fails, this motion or the `best` random one is scaled down, whichever determines more.
    """

    def checked(x: Array) -> tuple[JointTrajectory, FeasibilityReport]:
        trajectory = sample_motion(problem, x)
        return trajectory, check_joints(problem.columns.arm.robot, trajectory, settings)

    say("checking the motion on the whole arm")
    trajectory, check = checked(x)
    first = check
    for k in range(MAX_REDESIGNS):
        if check.feasible:
            break
        problem = _with_less_room(problem, check)
        say(f"{k + 1} of {MAX_REDESIGNS} repairs, as the {check.violations[0].violation_text}")
        x = optimise_motion(problem, x, first=len(problem.steps_per_round) - 2)
        say("checking the motion on the whole arm")
        trajectory, check = checked(x)
    if check.feasible:
        return x, trajectory, check
    smaller: list[tuple[float, tuple[Array, JointTrajectory, FeasibilityReport]]] = []
    for motion in (x, best):
        for small in (scale_about_centre(motion, size) for size in REDUCED_AMPLITUDES):
            trajectory, check = checked(small)
            if check.feasible:
                smaller.append((problem.cost(small), (small, trajectory, check)))
                break
    if smaller:
        return min(smaller, key=lambda found: found[0])[1]
    raise TaskFailedError(f"no feasible motion was found: {first.sentence} Choose other --joints or --seconds")


def _with_less_room(problem: ArmProblem, check: FeasibilityReport) -> ArmProblem:
    """The problem with narrower limits where the check found a violation."""
    joints, postures = problem.columns.arm.joints, problem.postures
    assert isinstance(postures, CollisionFreePostures)
    for margin in check.margins:
        if margin.margin >= 0.0:
            continue
        if margin.limit in ("position", "velocity", "acceleration", "torque"):
            limits = problem.limits.reduced(
                margin.limit, joints.index(margin.joint), LIMIT_NARROWING_FACTOR / margin.used_share
            )
            problem = replace(problem, limits=limits)
        elif margin.limit == "self_collision":
            postures = CollisionFreePostures(postures.robot, postures.clearance - 2.0 * margin.margin)
    return replace(problem, postures=postures)
