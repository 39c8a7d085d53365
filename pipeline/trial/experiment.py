"""The protocol of one trial in phases: rest, learn the length, bring the load to rest, swing, move over the box, wait.

The protocol is the same for a real and a simulated robot. `Experiment.run` commands the arm from the first motion to
the last. An error, a delay or a value that is not finite ends the trial, and is reported after the arm is at rest.
"""

import gc
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from armdyn.control.task import SwingPlan, SwingState
from armdyn.errors import ArmdynError, error_sentence
from armdyn.estimation.descent import Outcome
from armdyn.identify.estimator import Estimator
from armdyn.pendulum.model import PendulumModel
from armdyn.pendulum.path import GripperPath, gripper_path
from armdyn.run import Channel
from ik.torque import JointTorque
from pipeline.interrupts import deferred_signals
from pipeline.loadcell.faults import LoadCellFaultDetector
from pipeline.motion import JointCommandCheck, LineLimits, LineReferenceCheck, LineSmoother, LineState, LineTrajectory
from pipeline.motion.feasibility import CheckSettings, FeasibilityReport, PlannedSwing, check_line
from pipeline.motion.gate import CONTROL_PERIOD_SECONDS
from pipeline.nodes.background import BackgroundWorker, ProcessWorker
from pipeline.nodes.drive import MAX_COMMAND_SILENCE_SECONDS, DriveNode
from pipeline.nodes.learning import EstimatorNode, SacNode
from pipeline.nodes.measurement import MeasurementNode, channel_units
from pipeline.nodes.scheduler import Node, Scheduler, Watchdog
from pipeline.nodes.task import SwingPlanningNode
from pipeline.record import Recorder
from pipeline.robot.protocol import Vector
from pipeline.trial.ending import TrialEnding, bring_to_rest, signal_sentence
from pipeline.trial.moves import line_sweep
from pipeline.trial.rig import TrialRig
from pipeline.trial.settings import ProtocolSettings

REST_BEFORE_MOTION_SECONDS = 0.5
"""Time at rest before the motion that identifies the length [s], because the estimate assumes a load at rest."""
PAUSE_BEFORE_SWING_SECONDS = 0.6
"""Time between bringing the load to rest and the swing [s]."""
LOAD_SETTLING_IN_BOX_SECONDS = 1.5
"""Time after the last motion for which the load is watched; within it, it must come to rest in the box [s]."""
WAIT_FOR_FIRST_READINGS_SECONDS = 0.1
"""Time before the first cycle with a real robot [s], in which its latest readings arrive."""
MAX_LOOP_PAUSE_AT_REST_SECONDS = 10.0
"""Longest pause of the control loop while the arm is at rest [s]; the planner computes for 1 to 3 s without a break."""

ProgressCallback = Callable[[str, float], None]
"""Function that is called with the name of the present phase and the finished share of the trial."""


class Phase(Enum):
    """Phase of a trial's protocol; the value is its name for the user."""

    REST = "at rest"
    LEARN = "learning the length"
    SETTLE = "settling"
    CALM = "calm"
    SWING = "swing"
    FINISH = "finish"
    LOOK = "look"
    STOP = "coming to rest"


@dataclass(frozen=True)
class PhaseSpan:
    """A phase of the protocol with its start and end [s]."""

    phase: Phase
    start: float
    end: float


class _StopError(ArmdynError):
    """Raised to end the trial with a sentence for a person."""


class _InterruptedError(BaseException):
    """A signal arrived during a computation in the loop; no library handles this class by mistake."""


def recorded_channels(joint_names: tuple[str, ...]) -> dict[str, str]:
    """Units of the channels that a trial records, by channel, for an arm with these joints."""
    reference = {"reference.x": "m", "reference.v": "m/s", "reference.a": "m/s^2"}
    return {**channel_units(joint_names), **reference, "estimate.length": "m", "estimate.length_std": "m"}


class Experiment:
    """Protocol of one trial on a robot, from rest to the load in the box.

    Args:
        rig: robot with its description, IK table and load cell.
        recorder: recorder for the channels of `recorded_channels`.
        settings: settings of the protocol.
        progress: called to report the progress.
        begin: position of the gripper on the line at the start [m].

    Attributes:
        phases: every phase with its start and end.
        interrupted: number of the signal that requested the end; None for no signal.
        measurement, estimator, sac, task, drive: periodic tasks (nodes) of the control loop.
        scheduler: runs the nodes.
        watchdog: stops the arm if the control loop hangs; None with a simulated clock.
    """

    def __init__(
        self,
        rig: TrialRig,
        recorder: Recorder,
        settings: ProtocolSettings,
        progress: ProgressCallback | None = None,
        begin: float = 0.0,
    ) -> None:
        self.settings, self.description, self.table = settings, rig.arm, rig.table
        robot, description, table = rig.robot, rig.arm, rig.table
        self._robot, self._real, self._recorder, self._landed = robot, rig.real, recorder, rig.hooks.load_landed
        self._progress = progress or (lambda _what, _share: None)
        self.phases: list[PhaseSpan] = []
        self.interrupted: int | None = None
        limits = LineLimits.from_table(table, JointTorque(description, settings.mass))
        model = settings.starting_model()
        # A motion is shifted to begin at the arm's present position, before it is checked and run.
        given, check = settings.motion, CheckSettings(load_mass=settings.mass)
        self._motion = None if given is None else replace(given, s=given.s + (begin - given.s[0]))
        if self._motion is not None:
            check_line(table, description, self._motion, check).require_feasible(
                "the motion, from where the arm stands,"
            )
        elif settings.estimate:  # SAC goes anywhere on the line
            check_line(table, description, line_sweep(table), check).require_feasible(
                "the line, along which SAC moves,"
            )
        noise = {"load_force": settings.force_noise}
        self.measurement = MeasurementNode(
            robot, description, recorder, LoadCellFaultDetector(rig.cell), noise, settings.mass, settings.clock
        )
        self._worker = ProcessWorker() if rig.real else BackgroundWorker()
        self.estimator = EstimatorNode(self.measurement, Estimator(model, noise), recorder, self._worker)
        gate = LineReferenceCheck(limits, table, JointCommandCheck(description.joint_names, description.limits))
        smoother = LineSmoother(limits, CONTROL_PERIOD_SECONDS, LineState(begin))
        self.drive = DriveNode(robot, table, smoother, gate, self.measurement, recorder)
        self.sac = SacNode(self.measurement, self.estimator, self.drive)
        # Without an estimate the planner is the paper's, which knows no box: that is what Table I compares with.
        task = settings.task if settings.estimate or settings.model else replace(settings.task, cautious=False)
        self.task = SwingPlanningNode(
            model, self.drive, limits, self._check, lambda: self.measurement.state.q, task, self._worker
        )
        nodes: list[Node] = [self.measurement, self.estimator, self.sac, self.task, self.drive]
        each_round = self._come_round if rig.real else None
        self.scheduler = Scheduler(
            robot,
            nodes,
            lambda: MAX_LOOP_PAUSE_AT_REST_SECONDS if self.drive.standing else MAX_COMMAND_SILENCE_SECONDS,
            each_round,
        )
        self.watchdog = (
            Watchdog(self.drive.halt, lambda: not self.drive.standing, MAX_COMMAND_SILENCE_SECONDS)
            if rig.real
            else None
        )

    def run(self) -> TrialEnding:
        """Run the whole protocol, and return its ending; then the arm is at rest, even after a second Ctrl-C."""
        with deferred_signals(self._interrupt), ExitStack() as ended:
            try:
                self._begin(ended)
                success = self._protocol()
                ending = TrialEnding(success, f"the load {'came to rest in' if success else 'missed'} the box", False)
            except (Exception, SystemExit, _InterruptedError) as error:  # a user's effect may call sys.exit
                ending = self._stopped(error)
            finally:
                with suppress(Exception):  # the robot holds its posture on its own, even if this program dies
                    self._robot.stop()
            try:
                self.measurement.finish()
            except Exception as error:
                said = error_sentence(error, "completing the recording failed")
                ending = replace(ending, message=f"{ending.message}; {said}")
            return ending

    def _begin(self, ended: ExitStack) -> None:
        """On a real clock, start the worker process and the watchdog while the arm is at rest."""
        ended.callback(self._worker.stop)
        if self.watchdog is None:
            return
        self.sac.warm_up()
        self._worker.start()
        ended.enter_context(self.watchdog)  # a thread: only now, because the process is a copy of this one
        ended.enter_context(_no_collection())
        self._robot.advance(WAIT_FOR_FIRST_READINGS_SECONDS)
        self.measurement.discard_stale_samples()
        self.scheduler.begin()

    def _come_round(self) -> None:
        if self.watchdog is not None:
            self.watchdog.report_alive()
        self._worker.collect()

    def channel(self, name: str) -> Channel:
        """Recorded samples of a channel."""
        return self._recorder.channel(name)

    def span(self, phase: Phase) -> PhaseSpan | None:
        """Start and end of a phase; None if the phase did not take place."""
        return next((span for span in self.phases if span.phase is phase), None)

    def _protocol(self) -> bool:
        """Run all phases, and return whether the load came to rest in the box."""
        c = self.settings
        self._run(Phase.REST, 0.0, REST_BEFORE_MOTION_SECONDS)
        if c.estimate:
            self._learn()
            self._settle()
        self.task.request_swing(
            self.estimator.model, self.measurement.model_time, self.measurement.mark_possible_touch_from
        )
        self._run(Phase.SWING, 0.7, self.task.max_planning_seconds + c.task.duration + 1.0, self._swing_ends)
        self.measurement.let_down(self._robot.time)
        self._run(Phase.FINISH, 0.9, 3.0, lambda: self.task.idle)
        self._run(Phase.LOOK, 0.95, LOAD_SETTLING_IN_BOX_SECONDS)
        return self._landed()

    def _learn(self) -> None:
        """Move so that the load cell determines the length: as SAC chooses, or along a given motion."""
        c = self.settings
        self.estimator.begin(self._robot.time)
        if self._motion is None:
            self.sac.begin(self._robot.time)
            self._run(Phase.LEARN, 0.05, c.estimation_time)
            self.sac.end()
        else:
            self.drive.run_trajectory(self._motion)
            self._run(Phase.LEARN, 0.05, float(self._motion.time[-1]) + 1.0, lambda: self.drive.at_rest)
        self.estimator.end()
        self._require_estimate()

    def _settle(self) -> None:
        self.task.request_settling(self.estimator.model, self._swing_state)
        longest = self.task.max_planning_seconds + self.settings.task.settling + 2.0
        self._run(Phase.SETTLE, 0.5, longest, lambda: self.task.idle)
        self._run(Phase.CALM, 0.65, PAUSE_BEFORE_SWING_SECONDS)

    def _run(self, phase: Phase, share: float, longest: float, until: Callable[[], bool] | None = None) -> None:
        """Run the nodes for a phase: until a condition holds, and at most for the phase's duration."""
        self._progress(phase.value, share)
        start = self._robot.time
        done = self.scheduler.run(lambda: self._reason() is not None or (until is not None and until()), longest)
        self.phases.append(PhaseSpan(phase, start, self._robot.time))
        reason = self._reason()
        if reason is not None:
            raise _StopError(reason)
        if until is not None and not done:
            raise _StopError(f"{phase.value} did not end within {longest:g} s: the arm does not follow")

    def _reason(self) -> str | None:
        """Reason why the trial must stop, as a sentence; None if it may continue."""
        if self.interrupted is not None:
            return f"{signal_sentence(self.interrupted)} at {self._robot.time:.2f} s"
        return self.measurement.fault or self.drive.fault or self._watched

    @property
    def _watched(self) -> str | None:
        """Sentence on the watchdog's stop of the arm; None if it did not stop the arm."""
        return None if self.watchdog is None else self.watchdog.fault

    def _interrupt(self, number: int) -> None:
        if self.interrupted is None:
            self.interrupted = number
            if (
                self._worker.is_computing
            ):  # this computation may take seconds, and an interruption leaves no damaged data
                raise _InterruptedError

    def _stopped(self, error: BaseException) -> TrialEnding:
        """Bring the arm to rest, then return the trial's ending."""
        interrupted = self._reason() if isinstance(error, _InterruptedError) else None
        reason = interrupted or error_sentence(
            error, f"the {self.scheduler.running} node failed at {self._robot.time:.2f} s"
        )
        with suppress(Exception):
            self._progress(Phase.STOP.value, 0.9)
        start = self._robot.time
        self.task.cancel()
        self.estimator.end()
        also = [self._watched] if self._watched and self._watched not in reason else []
        failed = bring_to_rest(
            self.drive, self.measurement, self._robot, self.watchdog.report_alive if self.watchdog is not None else None
        )
        self.phases.append(PhaseSpan(Phase.STOP, start, self._robot.time))
        message = "; ".join([reason, *also, *failed])
        return TrialEnding(False, message, True)

    def _require_estimate(self) -> None:
        history = self.estimator.history
        if not history:
            raise _StopError(f"no estimate within {self.settings.estimation_time:g} s: allow at least 1 s")
        last = history[-1]
        if last.outcome is not Outcome.CONVERGED or last.std > self.settings.max_length_std_for_swing:
            raise _StopError(
                f"the estimate did not converge: length {last.value:.4f} +/- {last.std:.4f} m ({last.outcome.value}); "
                "weigh the load, check the load cell, or allow more time"
            )

    def _swing_ends(self) -> bool:
        swing, started = self.task.swing, self.task.swing_start
        return (
            swing is not None
            and started is not None
            and self._robot.time >= started + swing.time[-1] - CONTROL_PERIOD_SECONDS / 2
        )

    def _swing_state(self, at: float) -> SwingState:
        """Gripper and load at an instant [s], from the measured path and the latest estimate.

        For an instant in the future, the gripper is assumed to stand where it is now while the load continues to swing.
        """
        model, here, begun = self.estimator.model, self.drive.state, self.estimator.start or 0.0
        self.measurement.append_to_smoothed_path()
        path = gripper_path(self.measurement.run())
        path = _waiting(path, at - begun) if self._real else path
        speed, angle, rate = model.final_swing_state(path)
        # With a gripper lag the string's upper end follows the gripper late, and has another speed.
        lag = model.gripper_lag(model.physics_theta())
        hung_at, at_speed = (here.s - lag * speed, speed) if lag else (here.s, here.v)
        return SwingState(hung_at, at_speed, angle, rate, self.measurement.model_time(at))

    def _check(
        self, trajectory: LineTrajectory, plan: SwingPlan, model: PendulumModel, at: Vector
    ) -> FeasibilityReport:
        """Check a motion; the box is not an obstacle where the load is meant to enter it."""
        c, length = self.settings, model.value("length")
        swing = PlannedSwing(plan.time, plan.angle, np.append(plan.tension, plan.tension[-1]), length, c.load_radius)
        return check_line(self.table, self.description, trajectory, CheckSettings(load_mass=c.mass), swing, at=at)


@contextmanager
def _no_collection() -> Iterator[None]:
    """Disable Python's garbage collector until the block ends: it stops the loop for 20 to 50 ms at a time."""
    was_on = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def _waiting(path: GripperPath, end: float) -> GripperPath:
    """The path, extended by a gripper at rest until `end` [s]."""
    steps = max(0, round((end - path.start) / path.dt) - (len(path.x) - 1))
    still = np.zeros(steps)
    height = np.hstack([path.height_motion, np.vstack([np.full(steps, path.height_motion[0, -1]), still, still])])
    x = np.append(path.x, np.full(steps, path.x[-1]))
    v, a = (np.append(part, still) for part in (path.v, path.a))
    return GripperPath(path.start, path.dt, x, v, a, height, float(path.nodes[0, 0]))
