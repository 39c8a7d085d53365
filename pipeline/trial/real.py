"""A trial on an arm behind ROS: checks everything that can be checked, asks, moves there, and runs the protocol."""

import gc
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import ik
import urdf
from armdyn.errors import InputError, TaskFailedError
from pipeline.loadcell.calibration import Calibration
from pipeline.loadcell.cell import LoadCell
from pipeline.loadcell.faults import FaultLimits, implausible_repeats
from pipeline.loadcell.protocol import MAXIMUM_COUNTS, MINIMUM_COUNTS
from pipeline.motion.feasibility import CheckSettings, box_and_table, check_joints, check_line
from pipeline.nodes.measurement import GRAVITY
from pipeline.nodes.scheduler import RealClock
from pipeline.processes import ask_for_real_time
from pipeline.robot.ros import RosRobot
from pipeline.ros.master import Figures
from pipeline.ros.telemetry import PublishingRecorder, Telemetry
from pipeline.ros.topics import RosTopics
from pipeline.trial.ending import Ending
from pipeline.trial.experiment import Experiment, Progress
from pipeline.trial.folder import gathered
from pipeline.trial.investigation import SwingExperiment, after, ended_before, investigate, swing_of
from pipeline.trial.moves import Posture, along, approach, play, rehearsal
from pipeline.trial.result import TrialResult, kept, recording, result_of
from pipeline.trial.settings import ProtocolSettings

if TYPE_CHECKING:
    from armdyn.document import Document

THERE = 5e-3
"""How far from the start posture a joint may be to count as there [rad]."""
WEIGHT_ERROR = 0.2
"""Share of the load's weight by which the load cell may be off at rest: more means another load, or calibration."""
CALM = 2.0
"""Standard deviations of one sample that the force may vary by at rest, over `CALM_TIME`."""
CALM_TIME, CALM_PATIENCE = 2.0, 60.0
"""How long the load must hang still, and how long that is waited for [s]."""
OPEN_CELL = 6.0
"""Longest time to the first sample of the load cell [s]: most boards restart when their port is opened."""


@dataclass(frozen=True)
class Link:
    """How the robot is reached.

    Attributes:
        uri: of its rosbridge.
        arm: the arm behind it.
        topics: what it is called.
        port: serial port of the load cell; None where there is none.
        calibration: of the load cell; None where there is none.
    """

    uri: str
    arm: urdf.Robot
    topics: RosTopics
    port: str | None = None
    calibration: Calibration | None = None


@dataclass(frozen=True)
class Asking:
    """What a person is told and asked.

    Attributes:
        tell: show a sentence.
        may_move: whether the arm may move now; the sentence says how.
        landed: whether the load came to rest in the box.
    """

    tell: Callable[[str], None]
    may_move: Callable[[str], bool]
    landed: Callable[[], bool]


@dataclass(frozen=True)
class RealTrial:
    """A trial that has run on a robot.

    Attributes:
        settings: what it was given.
        link: how the robot was reached.
        experiment: the protocol, with everything that was planned and measured.
        result: what it came to.
        figures: jitter of the commands and ages of the joint states.
    """

    settings: ProtocolSettings
    link: Link
    experiment: Experiment
    result: TrialResult
    figures: Figures

    def report(self, command: str = "") -> "Document":
        """The report; where the load was, nobody knows."""
        from pipeline.trial.report import report_of

        c = self.settings
        subtitle = f"{self.link.arm.name} on {self.link.uri}, load {1e3 * c.mass:g} g"
        return report_of(self.experiment, self.result, subtitle, command)


def run_real(
    settings: ProtocolSettings, link: Link, asking: Asking, out: Path | None, progress: Progress | None = None
) -> RealTrial:
    """One whole trial on a robot.

    Raises:
        InputError: something is not in order before the first motion.
        TaskFailedError: the person said no, or the arm did not come to the start posture.
    """
    say = progress or (lambda _what, _share: None)
    if link.port is None or link.calibration is None:
        raise InputError("a trial needs the load cell: give --loadcell PORT, or rehearse without it (--rehearse)")
    c = replace(settings, force_noise=link.calibration.noise)
    clock = RealClock()
    table = ik.default_table(link.arm, progress=lambda stage: say(stage, 0.0))
    with ExitStack() as stack:
        cell = stack.enter_context(LoadCell(link.port, link.calibration, clock=lambda: clock.time))
        robot = stack.enter_context(RosRobot(link.uri, link.arm, link.topics, cell, lambda: clock.time))
        telemetry = Telemetry(robot.bridge, robot.joint_names)
        robot.telemetry = telemetry
        _be_punctual(asking)
        _tell_link(robot, asking)
        _require_force(robot, c)
        _go_to_start(robot, link.arm, table, c, asking, say)
        _wait_until_calm(robot, c, say)

        def show(what: str, share: float) -> None:
            telemetry.phase(what)
            say(what, share)

        folder = stack.enter_context(gathered(out))
        described = f"{link.arm.name} over ROS, load on a string"
        limits = _cell_limits(link.calibration)

        def swing(of: ProtocolSettings, number: int, place: float) -> tuple[SwingExperiment, Ending]:
            if number > 1:
                _wait_until_calm(robot, c, say)
            name = f"experiment_{number}"
            with recording(PublishingRecorder, folder, link.arm.joint_names, c, described, name) as kept_there:
                kept_there.telemetry = telemetry
                return swing_of(robot, clock, link.arm, table, kept_there, of, limits, show, place)

        found, of = None, c
        if c.investigate:
            found = investigate(c, swing, link.arm, table, c.investigate, lambda what: show(what, 0.0))
            of = after(c, found)
            if found.ending is None:
                _wait_until_calm(robot, c, say)
        with recording(PublishingRecorder, folder, link.arm.joint_names, c, described) as recorder:
            recorder.telemetry = telemetry
            experiment = Experiment(
                robot, clock, link.arm, table, recorder, of,
                cell=limits, landed=lambda: True, progress=show, begin=found.place if found is not None else 0.0,
            )  # fmt: skip
            ending = ended_before(experiment, found) or experiment.run()
            if not ending.stopped:
                success = asking.landed()
                said = f"the load {'came to rest in' if success else 'missed'} the box (as the user said)"
                ending = replace(ending, success=success, message=said)
        ending = kept(experiment, ending, recorder, folder)
        result = result_of(experiment, ending, None, out / recorder.path.name if out else None, found)
        return RealTrial(c, link, experiment, result, robot.figures)


def rehearse(
    settings: ProtocolSettings, link: Link, asking: Asking, progress: Progress | None = None
) -> tuple[Figures, float]:
    """Move along the whole line slowly, without the load; nothing is learnt.

    Returns:
        What was measured, and the farthest that a joint was from its command [rad].

    Raises:
        InputError: something is not in order before the first motion.
        TaskFailedError: the person said no, or the arm did not follow.
    """
    say = progress or (lambda _what, _share: None)
    clock = RealClock()
    table = ik.default_table(link.arm, progress=lambda stage: say(stage, 0.0))
    motion = rehearsal(table, settings.task.finish_x)
    check_line(table, link.arm, motion, CheckSettings()).require_feasible("the rehearsal")
    total, farthest = float(motion.time[-1]), 0.0
    with RosRobot(link.uri, link.arm, link.topics, None, lambda: clock.time) as robot:
        _be_punctual(asking)
        _tell_link(robot, asking)
        _go_to_start(robot, link.arm, table, settings, asking, say, "moves slowly along its whole line")

        def watched() -> Iterator[Posture]:
            nonlocal farthest
            for posture in along(table, motion):
                farthest = max(farthest, float(np.max(np.abs(robot.newest_state().q - posture[0]))))
                yield posture

        play(robot, watched(), total, lambda share: say("rehearsal", share))
        return robot.figures, farthest


def _be_punctual(asking: Asking) -> None:
    """This process serves a robot now: no pauses to look through what was loaded, and real-time priority if granted."""
    gc.collect()
    gc.freeze()  # what was loaded stays; looking through it again and again would stop a motion for 50 ms
    if not ask_for_real_time():
        asking.tell("this program runs with ordinary priority: close others, or allow real time (docs/robot.md)")


def _tell_link(robot: RosRobot, asking: Asking) -> None:
    assert robot.figures.round_trip is not None, "it is measured at the start"
    asking.tell(f"round trip to the robot's master: median {robot.figures.round_trip.milliseconds}")


def _require_force(robot: RosRobot, c: ProtocolSettings) -> None:
    """The load hangs on the load cell, and the load cell shows its weight."""
    weight, seen = GRAVITY * c.mass, _forces(robot, CALM_TIME, OPEN_CELL)
    if not len(seen):
        raise InputError(f"load cell: no sample within {OPEN_CELL:g} s: check cable and port")
    shown = float(np.median(seen))
    if abs(shown - weight) > WEIGHT_ERROR * weight:
        raise InputError(
            f"load cell: it shows {shown:.3f} N, and the load weighs {weight:.3f} N: hang the load, weigh it (--mass), "
            "or calibrate the cell"
        )


def _forces(robot: RosRobot, seconds: float, patience: float) -> np.ndarray:
    """(n,) forces of so many seconds from the first sample on [N]; empty where none comes in time [s]."""
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
    robot: RosRobot,
    arm: urdf.Robot,
    table: ik.LineTable,
    c: ProtocolSettings,
    asking: Asking,
    say: Progress,
    then: str = "swings the load",
) -> None:
    """Ask, enable the arm, and move it from where it is to the start posture."""
    here, goal = robot.newest_state().q, table.posture(0.0).q
    away = float(np.max(np.abs(goal - here)))
    motion = approach(arm, here, goal)
    obstacles = box_and_table(arm.line, c.task.box)
    if away > THERE:
        checked = check_joints(arm, motion, CheckSettings(load_mass=c.mass, obstacles=obstacles))
        if not checked.feasible:
            raise InputError(
                f"the way to the start posture is not free: {checked.sentence} Move the arm by hand nearer to it"
            )
    first = f"goes to its start posture, {away:.2f} rad away, in {motion.time[-1]:.0f} s, then " if away > THERE else ""
    if not asking.may_move(f"The arm now {first}{then}. Is its space free, and a hand on the emergency stop?"):
        raise TaskFailedError("nothing was moved")
    robot.prepare()
    here = robot.newest_state().q
    if np.max(np.abs(goal - here)) <= THERE:
        return
    motion = approach(arm, here, goal)
    total = float(motion.time[-1])
    play(robot, zip(motion.q, motion.v, motion.a, strict=True), total, lambda share: say("to the start", 0.05 * share))
    robot.stop()
    robot.advance(0.5)


def _wait_until_calm(robot: RosRobot, c: ProtocolSettings, say: Progress) -> None:
    """The load must hang still before anything is learnt from it."""
    end = robot.time + CALM_PATIENCE
    spread = np.inf
    while robot.time < end:
        say("waiting for the load to hang still", 0.0)
        seen = _forces(robot, CALM_TIME, CALM_TIME)
        if not len(seen):
            break
        spread = float(np.std(seen))
        if spread <= CALM * c.force_noise:
            return
    raise TaskFailedError(
        f"the load does not hang still: the force varies by {1e3 * spread:.0f} mN, its noise is "
        f"{1e3 * c.force_noise:.0f} mN: hold it until it is calm, then start again"
    )


def _cell_limits(calibration: Calibration) -> FaultLimits:
    ends = sorted((calibration.force(MINIMUM_COUNTS), calibration.force(MAXIMUM_COUNTS)))
    return FaultLimits(ends[0], ends[1], implausible_repeats(calibration.noise, abs(calibration.scale)), 0.2)
