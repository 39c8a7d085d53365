"""One trial, phase by phase: rest, learn, settle, plan, swing, finish over the box, look."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import ik
import urdf
from armdyn.control.task import SwingPlan, SwingState
from armdyn.errors import InputError, TaskFailedError
from armdyn.identify.estimator import Estimator
from armdyn.identify.least_squares import Outcome
from armdyn.model_file import ModelFile, write_model_file
from armdyn.pendulum.recorded import run_path
from armdyn.run import Known
from pipeline.loadcell.faults import FaultDetector, FaultLimits
from pipeline.motion import Gate, LineLimits, LineSmoother, LineState, LineTrajectory
from pipeline.motion.feasibility import CheckSettings, FeasibilityReport, Swing, check_line
from pipeline.nodes.drive import DriveNode
from pipeline.nodes.estimator import EstimatorNode
from pipeline.nodes.measurement import MeasurementNode, channel_units
from pipeline.nodes.sac import SacNode
from pipeline.nodes.scheduler import Node, Scheduler, SimulatedClock
from pipeline.nodes.task import DT, TaskNode
from pipeline.record import Recorder
from pipeline.report.theme import Phase
from pipeline.robot.simulated import SimulatedRobot
from pipeline.trial.model import trial_model
from pipeline.trial.result import Peaks, TrialResult
from pipeline.trial.settings import TrialSettings

REST = 0.5
"""s at rest before the motion: the estimate starts from a load that hangs still."""
CALM = 0.6
"""s between settling and swing."""
LOOK = 1.5
"""s after the finish in which the load must come to rest in the box."""
EXTRA_CHANNELS = {
    "reference.x": "m",
    "reference.v": "m/s",
    "reference.a": "m/s^2",
    "estimate.length": "m",
    "estimate.length_std": "m",
}

Progress = Callable[[str, float], None]
"""``(what is going on, share of the trial that is done)``."""


class _StopError(Exception):
    """The trial ends here, with this sentence."""


class Experiment:
    """One trial on the simulated robot, with everything that its report needs.

    Attributes:
        phases: what went on when.
        feasibility: report on the last planned motion.
        recorded: every channel, once the trial has run.
    """

    def __init__(self, settings: TrialSettings, progress: Progress | None = None) -> None:
        self.settings = settings
        self._progress = progress or (lambda _what, _share: None)
        self.description = urdf.load("baxter")
        self.table = ik.default_table(self.description, progress=lambda stage: self._progress(stage, 0.0))
        self.plant = replace(settings.plant, length=settings.length, mass=settings.mass)
        self.robot = SimulatedRobot(
            self.description, self.table.posture(0.0).q, self.plant, settings.hidden, settings.seed
        )
        self._interrupted = False
        self.phases: list[Phase] = []
        self.feasibility: FeasibilityReport | None = None
        self._feasible: bool | None = None

    def run(self) -> TrialResult:
        """The whole trial; it always ends with the arm at rest and the recording closed."""
        with self._directory() as directory, self._recorder(directory) as recorder, self._interruptible():
            self._build(recorder)
            try:
                message = self._phases()
                stopped = False
            except (_StopError, TaskFailedError) as reason:
                message, stopped = str(reason), True
                self._come_to_rest()
            self.measurement.finish()
            success = not stopped and self.robot.load_in_box()
            return self._result(success, message, stopped, recorder)

    def _build(self, recorder: Recorder) -> None:
        c, limits = self.settings, LineLimits.from_table(self.table)
        model = trial_model(c)
        noise = {"load_force": c.force_noise}
        cell = c.plant.cell
        detector = FaultDetector(FaultLimits.of(cell.noise, cell.resolution, cell.full_scale))
        self.measurement = MeasurementNode(self.robot, self.description, recorder, detector, noise)
        self.estimator = EstimatorNode(self.measurement, Estimator(model, noise), recorder)
        gate = Gate(limits, self.table, self.description.limits, DT)
        smoother = LineSmoother(limits, DT, LineState(0.0))
        self.drive = DriveNode(self.robot, self.table, smoother, gate, self.measurement, recorder)
        self.sac = SacNode(self.measurement, self.estimator, self.drive)
        # Without an estimate the planner is the paper's, which knows no box: that is what Table I compares with.
        task = c.task if c.estimate or c.model else replace(c.task, cautious=False)
        self.task = TaskNode(model, self.drive, limits, self._check, task)
        self.nodes: list[Node] = [self.measurement, self.estimator, self.sac, self.task, self.drive]
        self.scheduler = Scheduler(SimulatedClock(self.robot), self.nodes)

    def _phases(self) -> str:
        c = self.settings
        self._run("at rest", 0.0, REST)
        if c.estimate:
            start = self.robot.time
            self.estimator.begin(start)
            self.sac.begin(start)
            self._run("learning the length", 0.05, c.estimation_time, self._certain)
            self.sac.end()
            self.estimator.end()
            self._require_estimate()
            self.task.settle(self.estimator.model, self._swing_state)
            self._run("settling", 0.5, c.task.settling + 2.0, lambda: self.task.idle)
            self._run("calm", 0.65, CALM)
        self.task.throw(self.estimator.model, self.estimator.start, self.measurement.expect_touch)
        self._run("swing", 0.7, c.task.duration + 1.0, self._swing_ends)
        self.measurement.let_down(self.robot.time)
        self._run("finish", 0.9, 3.0, lambda: self.task.idle)
        self._run("look", 0.95, LOOK)
        if self.robot.load_in_box():
            return "the load came to rest in the box"
        return "the load missed the box"

    def _run(self, name: str, share: float, longest: float, until: Callable[[], bool] | None = None) -> None:
        """Run the nodes for a phase; without a condition for its whole time, else at most that long."""
        self._progress(name, share)
        start = self.robot.time
        done = self.scheduler.run(lambda: self._reason() is not None or (until is not None and until()), longest)
        self.phases.append(Phase(name, start, self.robot.time))
        reason = self._reason()
        if reason is not None:
            raise _StopError(reason)
        if until is not None and not done and name != "learning the length":
            raise _StopError(f"{name} did not end within {longest:g} s: the arm does not follow")

    def _reason(self) -> str | None:
        """Why the trial must stop now."""
        if self._interrupted:
            return f"interrupted by the user at {self.robot.time:.2f} s"
        return self.measurement.fault or self.drive.fault

    def _come_to_rest(self) -> None:
        self._progress("coming to rest", 0.9)
        start = self.robot.time
        self.task.cancel()
        self.sac.end()
        self.estimator.end()
        self.drive.stop()
        self.scheduler.run(lambda: self.drive.at_rest, 3.0)
        self.scheduler.run(lambda: False, 0.3)
        self.phases.append(Phase("coming to rest", start, self.robot.time))

    def _certain(self) -> bool:
        c, history = self.settings, self.estimator.history
        if not history or self.estimator.start is None:
            return False
        return history[-1].std < c.enough and self.robot.time - self.estimator.start >= c.least_estimation_time

    def _require_estimate(self) -> None:
        history = self.estimator.history
        if not history:
            raise _StopError(f"no estimate within {self.settings.estimation_time:g} s: allow at least 1 s")
        last = history[-1]
        if last.outcome is not Outcome.CONVERGED or last.std > self.settings.certain_enough:
            raise _StopError(
                f"the estimate did not converge: length {last.value:.4f} +/- {last.std:.4f} m ({last.outcome.value}); "
                "weigh the load, check the load cell, or allow more time"
            )

    def _swing_ends(self) -> bool:
        swing, started = self.task.swing, self.task.started
        return swing is not None and started is not None and self.robot.time >= started + swing.time[-1] - DT / 2

    def _swing_state(self) -> SwingState:
        """Gripper and load now, from the measured path and the latest estimate."""
        model, here = self.estimator.model, self.drive.state
        path = run_path(self.measurement.run())
        speed, angle, rate = model.swing_at_the_end(path)
        # A gripper that trails has its string behind, and at another speed, by what the lag says of the present speed.
        lag = model.gripper_lag(model.physics_theta())
        hung_at, at_speed = (here.s - lag * speed, speed) if lag else (here.s, here.v)
        return SwingState(hung_at, at_speed, angle, rate, self.robot.time - path.start)

    def _check(self, trajectory: LineTrajectory, plan: SwingPlan) -> None:
        """Refuse a motion that the arm cannot do; the box is left out where the load is meant to go in."""
        c, length = self.settings, self.estimator.model.value("length")
        swing = Swing(plan.time, plan.angle, np.append(plan.tension, plan.tension[-1]), length, c.plant.load_radius)
        report = check_line(
            self.table,
            self.description,
            trajectory,
            CheckSettings(load_mass=c.mass),
            swing,
            at=self.measurement.state.q,
        )
        self.feasibility, self._feasible = report, report.feasible
        report.require_feasible("the plan")

    def _result(self, success: bool, message: str, stopped: bool, recorder: Recorder) -> TrialResult:
        c, history, swing = self.settings, self.estimator.history, self.task.swing
        if c.out is not None:
            write_model_file(c.out / "model.toml", ModelFile(self.estimator.model, {}))
        names = (*channel_units(self.description.joint_names), *EXTRA_CHANNELS)
        self.recorded = {name: recorder.channel(name) for name in names}
        force = self.recorded["load_force"].value
        return TrialResult(
            success=success,
            message=message,
            length_guess=c.length_guess,
            length_true=c.length,
            length_estimate=self.estimator.model.value("length"),
            length_std=history[-1].std if history else 0.0,
            estimates=tuple(history),
            peak=self._peaks(),
            minimum_tension=float(force.min()) if len(force) else 0.0,
            feasible=self._feasible,
            iterations=len(swing.solution.iterations) if swing else 0,
            cost=swing.solution.cost if swing else None,
            planning_seconds=swing.solution.seconds if swing else 0.0,
            model=self.estimator.model,
            timing=self.scheduler.timing,
            cycle_seconds=float(np.mean(self.sac.seconds)) if self.sac.seconds else 0.0,
            stopped=stopped,
            recording=recorder.path if c.out else None,
        )

    def _peaks(self) -> Peaks:
        """Largest magnitudes while learning, or in the swing where nothing was learnt."""
        wanted = "learning the length" if self.settings.estimate else "swing"
        phase = next((p for p in self.phases if p.name == wanted), None)
        if phase is None:
            return Peaks(0.0, 0.0, 0.0, 0.0)

        def peak(name: str) -> float:
            channel = self.recorded[name]
            inside = (channel.time >= phase.start) & (channel.time <= phase.end)
            return float(np.max(np.abs(channel.value[inside]), initial=0.0))

        return Peaks(peak("reference.x"), peak("reference.v"), peak("reference.a"), self._largest_angle(phase))

    def _largest_angle(self, phase: Phase) -> float:
        """Of the model with the last estimate along the measured path."""
        if self.estimator.start is None:
            return float(np.max(np.abs(self.task.swing.angle))) if self.task.swing else 0.0
        path, model = run_path(self.measurement.run()), self.estimator.model
        angles = model.rollout(path, model.theta(), channels=("load_force",)).states[:, 0]
        return float(np.max(np.abs(angles[: int((phase.end - phase.start) / path.dt)]), initial=0.0))

    @contextmanager
    def _directory(self) -> Iterator[Path]:
        if self.settings.out is not None:
            try:
                self.settings.out.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise InputError(
                    f"cannot write to {self.settings.out}: {error.strerror or error}; choose another directory"
                ) from error
            yield self.settings.out
            return
        with TemporaryDirectory() as scratch:
            yield Path(scratch)

    def _recorder(self, directory: Path) -> Recorder:
        c = self.settings
        return Recorder(
            directory / "trial.mcap",
            {**channel_units(self.description.joint_names), **EXTRA_CHANNELS},
            description=f"simulated Baxter, load on a string, seed {c.seed}",
            noise={"load_force": c.force_noise},
            known={"mass": Known(c.mass, c.mass_std, "kg")},
        )

    @contextmanager
    def _interruptible(self) -> Iterator[None]:
        """Ctrl-C is noted, and acted on between two rounds of the nodes; a second one ends the program."""

        def note(_number: int, _frame: object) -> None:
            if self._interrupted:
                raise KeyboardInterrupt
            self._interrupted = True

        try:
            before = signal.signal(signal.SIGINT, note)
        except ValueError:  # not the main thread: whoever started the thread handles Ctrl-C
            yield
            return
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)


def run_trial(settings: TrialSettings, progress: Progress | None = None) -> TrialResult:
    """One whole trial on the simulated robot.

    Raises:
        InputError: settings that cannot be used.
        UnknownNameError: a hidden effect that the simulated robot does not have.
    """
    return Experiment(settings, progress).run()
