"""A trial on a real arm: check load cell and motions, ask the operator, go to the start posture, run the protocol."""

import gc
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from time import monotonic

import numpy as np

import ik
import urdf
from armdyn.errors import InputError, TaskFailedError
from armdyn.pendulum.physics import STANDARD_GRAVITY
from pipeline.loadcell.calibration import Calibration
from pipeline.loadcell.cell import LoadCell
from pipeline.motion.feasibility import CheckSettings, box_and_table_obstacles, check_joints, check_line
from pipeline.processes import request_real_time_priority
from pipeline.robot.drivers import ConnectFunction
from pipeline.robot.link import LinkStatistics
from pipeline.robot.protocol import RealRobot
from pipeline.trial.ending import TrialEnding
from pipeline.trial.experiment import ProgressCallback
from pipeline.trial.flow import Trial, perform_trial
from pipeline.trial.moves import JointReference, approach_motion, play_motion, postures_along, rehearsal_motion
from pipeline.trial.rig import TrialRig
from pipeline.trial.settings import ProtocolSettings

MAX_ANGLE_TO_COUNT_AS_AT_START = 5e-3
"""Largest distance of a joint from the start posture at which no motion to it is needed [rad]."""
MAX_RELATIVE_WEIGHT_ERROR = 0.2
"""Largest relative difference between measured force at rest and weight of the load."""
MAX_STILL_FORCE_STD_TO_NOISE_RATIO = 2.0
"""Largest standard deviation of the force of a load at rest, divided by the noise of one sample."""
MIN_STILL_LOAD_SECONDS, STILL_LOAD_TIMEOUT_SECONDS = 2.0, 60.0
"""Time for which the load must hang still before a motion, and longest waiting time for that [s]."""
FIRST_SAMPLE_TIMEOUT_SECONDS = 6.0
"""Longest waiting time for the load cell's first sample [s]; most boards restart when their port is opened."""


@dataclass(frozen=True)
class RobotLink:
    """Connection to a robot and its load cell.

    Attributes:
        address: address of the robot.
        connect: function that connects to the robot.
        arm: description of the arm.
        port: serial port of the load cell; None for no load cell.
        calibration: calibration of the load cell; None for no load cell.
    """

    address: str
    connect: ConnectFunction
    arm: urdf.Robot
    port: str | None = None
    calibration: Calibration | None = None


@dataclass(frozen=True)
class OperatorPrompts:
    """Functions that show messages and questions to the operator of a real robot.

    Attributes:
        tell: shows a sentence.
        ask_permission_to_move: shows a sentence on a motion, and returns whether the operator allows it.
        landed: returns whether the load came to rest in the box, as the operator answers.
    """

    tell: Callable[[str], None]
    ask_permission_to_move: Callable[[str], bool]
    landed: Callable[[], bool]


RealTrial = Trial[RealRobot]


@dataclass(frozen=True)
class _OperatorHooks:
    """`RigHooks` of a real robot, whose operator is asked at the end whether the load is in the box."""

    robot: RealRobot
    settings: ProtocolSettings
    prompts: OperatorPrompts
    progress: ProgressCallback

    def load_landed(self) -> bool:
        return True

    def ending_judged_by_operator(self, ending: TrialEnding) -> TrialEnding:
        if ending.stopped:
            return ending
        success = self.prompts.landed()
        said = f"the load {'came to rest in' if success else 'missed'} the box (as the user said)"
        return replace(ending, success=success, message=said)

    def wait_until_calm(self) -> None:
        _wait_until_calm(self.robot, self.settings, self.progress)

    def announce_phase(self, what: str) -> None:
        self.robot.announce_phase(what)


def run_real_trial(
    settings: ProtocolSettings, link: RobotLink, prompts: OperatorPrompts, out: Path | None, progress: ProgressCallback
) -> RealTrial:
    """Run one whole trial on a real robot.

    Args:
        settings: settings of the protocol.
        link: connection to robot and load cell.
        prompts: messages and questions to the operator.
        out: directory for recordings and model; None to write no files.
        progress: called to report the progress.

    Raises:
        InputError: a check before the first motion failed.
        TaskFailedError: the operator did not allow a motion, or the arm did not reach the start posture.
    """
    if link.port is None or link.calibration is None:
        raise InputError("a trial needs the load cell: give --loadcell PORT, or rehearse without it (--rehearse)")
    c = replace(settings, force_noise=link.calibration.noise)
    table = ik.default_table(link.arm, progress=lambda stage: progress(stage, 0.0))
    with _connected(link, prompts) as robot:
        _require_force(robot, c)
        _go_to_start(robot, link.arm, table, c, prompts, progress)
        hooks = _OperatorHooks(robot, c, prompts, progress)
        hooks.wait_until_calm()
        about = f"{link.arm.name} and a load on a string"
        limits = link.calibration.force_limits
        rig = TrialRig(robot, True, link.arm, table, limits, about, hooks, recorder=robot.recorder)
        experiment, result = perform_trial(rig, c, out, progress)
        subtitle = f"{link.arm.name} on {link.address}, load {1e3 * c.mass:g} g"
        return Trial(subtitle, experiment, result, robot)


def rehearse(
    settings: ProtocolSettings, link: RobotLink, prompts: OperatorPrompts, progress: ProgressCallback
) -> tuple[LinkStatistics, float]:
    """Move the arm slowly along its line without the load, to rehearse a trial.

    Args:
        settings: settings of the trial to rehearse.
        link: connection to the robot.
        prompts: messages and questions to the operator.
        progress: called to report the progress.

    Returns:
        Delays of the connection, and the largest difference between a commanded and a measured joint position [rad].

    Raises:
        InputError: a check before the first motion failed.
        TaskFailedError: the operator did not allow the motion, or the arm did not follow.
    """
    table = ik.default_table(link.arm, progress=lambda stage: progress(stage, 0.0))
    motion = rehearsal_motion(table, settings.task.finish_x)
    check_line(table, link.arm, motion, CheckSettings()).require_feasible("the rehearsal")
    total, farthest = float(motion.time[-1]), 0.0
    with _connected(link, prompts) as robot:
        _go_to_start(robot, link.arm, table, settings, prompts, progress, "moves slowly along its whole line")

        def watched() -> Iterator[JointReference]:
            nonlocal farthest
            for posture in postures_along(table, motion):
                farthest = max(farthest, float(np.max(np.abs(robot.newest_state().q - posture[0]))))
                yield posture

        play_motion(robot, watched(), total, lambda share: progress("rehearsal", share))
        return robot.statistics, farthest


@contextmanager
def _connected(link: RobotLink, prompts: OperatorPrompts) -> Iterator[RealRobot]:
    """Connect robot and load cell, if any, with a common clock, until the ``with`` block ends."""
    begun = monotonic()

    def clock() -> float:
        return monotonic() - begun

    with ExitStack() as stack:
        cell = None
        if link.port is not None and link.calibration is not None:
            cell = stack.enter_context(LoadCell(link.port, link.calibration, clock=clock))
        robot = stack.enter_context(link.connect(cell, clock))
        gc.collect()
        gc.freeze()  # loaded objects stay; the garbage collector would stop a motion for 50 ms to search them
        if not request_real_time_priority():
            prompts.tell("this program runs with ordinary priority: close others, or allow real time (docs/robot.md)")
        if robot.statistics.round_trip is not None:
            prompts.tell(f"round trip to the robot: median {robot.statistics.round_trip.milliseconds}")
        yield robot


def _require_force(robot: RealRobot, c: ProtocolSettings) -> None:
    weight, seen = STANDARD_GRAVITY * c.mass, _forces(robot, MIN_STILL_LOAD_SECONDS, FIRST_SAMPLE_TIMEOUT_SECONDS)
    if not len(seen):
        raise InputError(f"load cell: no sample within {FIRST_SAMPLE_TIMEOUT_SECONDS:g} s: check cable and port")
    shown = float(np.median(seen))
    if abs(shown - weight) > MAX_RELATIVE_WEIGHT_ERROR * weight:
        raise InputError(
            f"load cell: it shows {shown:.3f} N, and the load weighs {weight:.3f} N: hang the load, weigh it (--mass), "
            "or calibrate the cell"
        )


def _forces(robot: RealRobot, seconds: float, patience: float) -> np.ndarray:
    """Forces (n,) [N] during some seconds from the first sample; empty where no sample comes in time."""
    forces: list[float] = []
    end = robot.time + patience
    while robot.time < end:
        samples = robot.load_cell()
        if samples and not forces:
            end = robot.time + seconds
        forces += [sample.force for sample in samples]
        robot.advance(0.02)
    return np.array(forces)


def _go_to_start(
    robot: RealRobot,
    arm: urdf.Robot,
    table: ik.LineTable,
    c: ProtocolSettings,
    prompts: OperatorPrompts,
    say: ProgressCallback,
    then: str = "swings the load",
) -> None:
    """Ask the operator, enable the arm, and move it from its present posture to the start posture."""
    here, goal = robot.newest_state().q, table.posture(0.0).q
    away = float(np.max(np.abs(goal - here)))
    motion = approach_motion(arm, here, goal)
    obstacles = box_and_table_obstacles(arm.line, c.task.box)
    if away > MAX_ANGLE_TO_COUNT_AS_AT_START:
        checked = check_joints(arm, motion, CheckSettings(load_mass=c.mass, obstacles=obstacles))
        if not checked.feasible:
            raise InputError(
                f"the way to the start posture is not free: {checked.sentence} Move the arm by hand nearer to it"
            )
    first = f"goes to its start posture, {away:.2f} rad away, in {motion.time[-1]:.0f} s, then "
    first = first if away > MAX_ANGLE_TO_COUNT_AS_AT_START else ""
    if not prompts.ask_permission_to_move(
        f"The arm now {first}{then}. Is its space free, and a hand on the emergency stop?"
    ):
        raise TaskFailedError("nothing was moved")
    robot.prepare()
    here = robot.newest_state().q
    if np.max(np.abs(goal - here)) <= MAX_ANGLE_TO_COUNT_AS_AT_START:
        return
    motion = approach_motion(arm, here, goal)
    total = float(motion.time[-1])
    play_motion(
        robot, zip(motion.q, motion.v, motion.a, strict=True), total, lambda share: say("to the start", 0.05 * share)
    )
    robot.stop()
    robot.advance(0.5)


def _wait_until_calm(robot: RealRobot, c: ProtocolSettings, say: ProgressCallback) -> None:
    """Wait until the load hangs still."""
    end = robot.time + STILL_LOAD_TIMEOUT_SECONDS
    spread = np.inf
    while robot.time < end:
        say("waiting for the load to hang still", 0.0)
        seen = _forces(robot, MIN_STILL_LOAD_SECONDS, MIN_STILL_LOAD_SECONDS)
        if not len(seen):
            break
        spread = float(np.std(seen))
        if spread <= MAX_STILL_FORCE_STD_TO_NOISE_RATIO * c.force_noise:
            return
    raise TaskFailedError(
        f"the load does not hang still: the force varies by {1e3 * spread:.0f} mN, its noise is "
        f"{1e3 * c.force_noise:.0f} mN: hold it until it is calm, then start again"
    )
