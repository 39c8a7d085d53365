"""A trial on a real arm: check everything, ask the operator, move to the start posture, and run the protocol."""

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
from pipeline.motion.feasibility import CheckSettings, box_and_table, check_joints, check_line
from pipeline.processes import request_real_time_priority
from pipeline.robot.drivers import Connect
from pipeline.robot.link import LinkStatistics
from pipeline.robot.protocol import RealRobot
from pipeline.trial.ending import Ending
from pipeline.trial.experiment import Progress
from pipeline.trial.flow import Trial, perform
from pipeline.trial.moves import Posture, approach, play, postures_along, rehearsal
from pipeline.trial.rig import Rig
from pipeline.trial.settings import ProtocolSettings

MAX_START_DISTANCE = 5e-3
"""Largest distance of a joint from the start posture at which no motion to it is needed [rad]."""
MAX_WEIGHT_ERROR = 0.2
"""Largest relative error of the load cell at rest: a larger one means another load, or calibration."""
CALM_NOISE_FACTOR = 2.0
"""Largest standard deviation of the force of a calm load, over that of one sample."""
CALM_SECONDS, CALM_PATIENCE = 2.0, 60.0
"""Time for which the load must hang still, and longest time to wait for that [s]."""
CELL_PATIENCE = 6.0
"""Longest time to the first sample of the load cell [s]: most boards restart when their port is opened."""


@dataclass(frozen=True)
class RobotLink:
    """Connection to a robot and its load cell.

    Attributes:
        address: address of the robot.
        connect: function that connects to the robot.
        arm: description of the arm.
        port: serial port of the load cell; None where there is none.
        calibration: calibration of the load cell; None where there is none.
    """

    address: str
    connect: Connect
    arm: urdf.Robot
    port: str | None = None
    calibration: Calibration | None = None


@dataclass(frozen=True)
class OperatorPrompts:
    """Messages and questions to the operator.

    Attributes:
        tell: shows a sentence.
        may_move: asks whether the arm may move now; the sentence describes the motion.
        landed: asks whether the load came to rest in the box.
    """

    tell: Callable[[str], None]
    may_move: Callable[[str], bool]
    landed: Callable[[], bool]


RealTrial = Trial[RealRobot]


@dataclass(frozen=True)
class _OperatorHooks:
    """`RigHooks` of a real robot: its operator tells whether the load landed, once the arm holds its posture."""

    robot: RealRobot
    settings: ProtocolSettings
    prompts: OperatorPrompts
    progress: Progress

    def landed(self) -> bool:
        return True

    def judged(self, ending: Ending) -> Ending:
        if ending.stopped:
            return ending
        success = self.prompts.landed()
        said = f"the load {'came to rest in' if success else 'missed'} the box (as the user said)"
        return replace(ending, success=success, message=said)

    def wait_until_calm(self) -> None:
        _wait_until_calm(self.robot, self.settings, self.progress)

    def announce(self, what: str) -> None:
        self.robot.announce(what)


def run_real(
    settings: ProtocolSettings, link: RobotLink, prompts: OperatorPrompts, out: Path | None, progress: Progress
) -> RealTrial:
    """Run one whole trial on a real robot.

    Raises:
        InputError: something is not in order before the first motion.
        TaskFailedError: the operator said no, or the arm did not reach the start posture.
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
        rig = Rig(robot, True, link.arm, table, limits, about, hooks, recorder=robot.recorder)
        experiment, result = perform(rig, c, out, progress)
        subtitle = f"{link.arm.name} on {link.address}, load {1e3 * c.mass:g} g"
        return Trial(subtitle, experiment, result, robot)


def rehearse(
    settings: ProtocolSettings, link: RobotLink, prompts: OperatorPrompts, progress: Progress
) -> tuple[LinkStatistics, float]:
    """Move slowly along the whole line without the load, as a rehearsal; nothing is learnt.

    Returns:
        Statistics of the connection, and the largest distance of a joint from its command [rad].

    Raises:
        InputError: something is not in order before the first motion.
        TaskFailedError: the operator said no, or the arm did not follow.
    """
    table = ik.default_table(link.arm, progress=lambda stage: progress(stage, 0.0))
    motion = rehearsal(table, settings.task.finish_x)
    check_line(table, link.arm, motion, CheckSettings()).require_feasible("the rehearsal")
    total, farthest = float(motion.time[-1]), 0.0
    with _connected(link, prompts) as robot:
        _go_to_start(robot, link.arm, table, settings, prompts, progress, "moves slowly along its whole line")

        def watched() -> Iterator[Posture]:
            nonlocal farthest
            for posture in postures_along(table, motion):
                farthest = max(farthest, float(np.max(np.abs(robot.newest_state().q - posture[0]))))
                yield posture

        play(robot, watched(), total, lambda share: progress("rehearsal", share))
        return robot.statistics, farthest


@contextmanager
def _connected(link: RobotLink, prompts: OperatorPrompts) -> Iterator[RealRobot]:
    """Connect the robot and its load cell, if any, with one clock, until the block ends."""
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
    weight, seen = STANDARD_GRAVITY * c.mass, _forces(robot, CALM_SECONDS, CELL_PATIENCE)
    if not len(seen):
        raise InputError(f"load cell: no sample within {CELL_PATIENCE:g} s: check cable and port")
    shown = float(np.median(seen))
    if abs(shown - weight) > MAX_WEIGHT_ERROR * weight:
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
    say: Progress,
    then: str = "swings the load",
) -> None:
    """Ask the operator, enable the arm, and move it from its present posture to the start posture."""
    here, goal = robot.newest_state().q, table.posture(0.0).q
    away = float(np.max(np.abs(goal - here)))
    motion = approach(arm, here, goal)
    obstacles = box_and_table(arm.line, c.task.box)
    if away > MAX_START_DISTANCE:
        checked = check_joints(arm, motion, CheckSettings(load_mass=c.mass, obstacles=obstacles))
        if not checked.feasible:
            raise InputError(
                f"the way to the start posture is not free: {checked.sentence} Move the arm by hand nearer to it"
            )
    first = f"goes to its start posture, {away:.2f} rad away, in {motion.time[-1]:.0f} s, then "
    first = first if away > MAX_START_DISTANCE else ""
    if not prompts.may_move(f"The arm now {first}{then}. Is its space free, and a hand on the emergency stop?"):
        raise TaskFailedError("nothing was moved")
    robot.prepare()
    here = robot.newest_state().q
    if np.max(np.abs(goal - here)) <= MAX_START_DISTANCE:
        return
    motion = approach(arm, here, goal)
    total = float(motion.time[-1])
    play(robot, zip(motion.q, motion.v, motion.a, strict=True), total, lambda share: say("to the start", 0.05 * share))
    robot.stop()
    robot.advance(0.5)


def _wait_until_calm(robot: RealRobot, c: ProtocolSettings, say: Progress) -> None:
    """Wait until the load hangs still, before anything is learnt from its motion."""
    end = robot.time + CALM_PATIENCE
    spread = np.inf
    while robot.time < end:
        say("waiting for the load to hang still", 0.0)
        seen = _forces(robot, CALM_SECONDS, CALM_SECONDS)
        if not len(seen):
            break
        spread = float(np.std(seen))
        if spread <= CALM_NOISE_FACTOR * c.force_noise:
            return
    raise TaskFailedError(
        f"the load does not hang still: the force varies by {1e3 * spread:.0f} mN, its noise is "
        f"{1e3 * c.force_noise:.0f} mN: hold it until it is calm, then start again"
    )
