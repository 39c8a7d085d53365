"""The nodes that learn: the estimator, which finds the length, and SAC, whose motions make it identifiable.

The estimate is of everything measured since the motion began, twice a second; an update takes 5 to 30 ms, longer than a
cycle, and is done beside the loop. Twenty times a second SAC finds the gripper motion that informs most.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from time import perf_counter

import numpy as np

from armdyn.control.sac import SacAction, SacSettings, SacState, SequentialActionControl
from armdyn.errors import TaskFailedError
from armdyn.identify.estimator import Estimator
from armdyn.identify.least_squares import Outcome
from armdyn.pendulum.dynamics import PLANAR_STATE_SIZE
from armdyn.pendulum.model import PendulumModel
from armdyn.pendulum.path import fixed_pivot_path, gripper_path
from armdyn.physics.simulate import Rollout
from armdyn.recording.spikes import without_spikes
from armdyn.run import Run
from pipeline.motion import LineState
from pipeline.nodes.background import BackgroundWorker
from pipeline.nodes.drive import DriveNode
from pipeline.nodes.measurement import MeasurementNode
from pipeline.record import Recorder

FIRST_UPDATE_SECONDS = 1.0
"""Time of motion before the first estimate [s]: less does not determine the length."""


@dataclass(frozen=True)
class LengthEstimate:
    """One update of the length estimate: time [s], length and its standard deviation [m], and computing time [s]."""

    time: float
    value: float
    std: float
    outcome: Outcome
    seconds: float


class EstimatorNode:
    """Runs the estimator at 2 Hz on the data since `begin`; it waits for an update that is late.

    Attributes:
        model: the model with the latest finite estimate.
        start: time at which the load hung at rest and the data begin [s]; None while it does not estimate.
        history: every update so far.
        left_out: a sentence on the samples that the last update left out, because they do not belong to their
            neighbours; empty where there were none.
    """

    name = "estimator"
    period = 0.5

    def __init__(
        self,
        measurement: MeasurementNode,
        estimator: Estimator[PendulumModel],
        recorder: Recorder,
        worker: BackgroundWorker,
    ) -> None:
        self._measurement, self._estimator, self._recorder, self._worker = measurement, estimator, recorder, worker
        self._worker.provide(self.name, self._update)
        self.start: float | None = None
        self.history: list[LengthEstimate] = []
        self.left_out: tuple[str, ...] = ()
        self._running = False
        self.model: PendulumModel = estimator.model

    def begin(self, now: float) -> None:
        """Begin the data: the load hangs at rest now, and later samples are used."""
        self._measurement.begin()
        self.start, self._running = now, True

    def end(self) -> None:
        """End the estimation; `model` and `start` stay."""
        self._running = False

    def step(self, now: float) -> None:
        """Request an update of the estimate once there are enough data.

        Raises:
            TaskFailedError: the estimate is not a number; `model` stays as it was.
        """
        if not self._running or self.start is None or now - self.start < FIRST_UPDATE_SECONDS - 1e-9:
            return
        if self._worker.busy(self.name):
            return
        self._measurement.update_path()
        run = without_spikes(self._measurement.run(), ("load_force",))
        self.left_out = run.warnings
        self._worker.ask(self.name, (now, run), self._take)

    def _update(self, begun: tuple[float, Run]) -> tuple[dict[str, float], LengthEstimate]:
        """The estimate from all data at a time [s]; its standard deviation allows for errors other than white noise."""
        now, run = begun
        start = perf_counter()
        estimate = self._estimator.update(run)
        seconds = perf_counter() - start
        std = estimate.std("length") * self._estimator.std_inflation(run)
        values = dict(zip(estimate.names, estimate.values.tolist(), strict=True))
        return values, LengthEstimate(now, values["length"], std, estimate.outcome, seconds)

    def _take(self, found: tuple[dict[str, float], LengthEstimate]) -> None:
        """Store the result of an update."""
        values, estimate = found
        if not self._running:
            return
        if not (isfinite(estimate.value) and isfinite(estimate.std)):
            raise TaskFailedError(
                f"the estimate of the length at {estimate.time:.2f} s is not a number: check the model"
            )
        self.model = self.model.with_values(values)
        self.history.append(estimate)
        self._recorder.record("estimate.length", estimate.time, estimate.value)
        self._recorder.record("estimate.length_std", estimate.time, estimate.std)


KICK_ACCELERATION, KICK_SECONDS = 0.8, 0.2
"""Acceleration [m/s^2] and duration [s] of each half of the doublet that starts the motion: at rest SAC never moves."""
REFERENCE_CYCLES = 30
"""Cycles of reference given to the smoother."""


class SacNode:
    """Starts with a doublet, then chooses actions by the latest estimate; inactive until `begin`.

    Attributes:
        actions: every action so far.
        seconds: computing time of each action, with the state's prediction [s].
    """

    name = "sac"
    period = 0.05

    def __init__(self, measurement: MeasurementNode, estimator: EstimatorNode, drive: DriveNode) -> None:
        self._measurement, self._estimator, self._drive = measurement, estimator, drive
        self.settings = SacSettings(sample_time=self.period)
        self._control = SequentialActionControl(estimator.model, self.settings)
        self._begun: float | None = None
        self._plan_start = 0.0
        self._plan: list[LineState] = []
        self.actions: list[SacAction] = []
        self.seconds: list[float] = []

    def warm_up(self) -> None:
        """Do the computation of `step` once, for a gripper at rest: the first time takes longer than a cycle."""
        model = self._estimator.model
        rollout = model.rollout(fixed_pivot_path(0.0, 1.0, self.settings.dt), model.theta(), channels=("load_force",))
        self._control.act(SacState(1.0, 0.0, 0.0, *self._load(rollout)), model)

    def _load(self, rollout: Rollout) -> tuple[np.ndarray, np.ndarray]:
        """(2,) last angle and momentum, and (2,) their derivatives with respect to the length.

        What effects remember follows them; SAC holds it as it was when the run began.
        """
        column = rollout.state_sensitivities[:, self._estimator.model.physics_names.index("length")]
        return rollout.states[-1, :PLANAR_STATE_SIZE], column[:PLANAR_STATE_SIZE]

    def begin(self, now: float) -> None:
        """Begin with the doublet; then choose informative actions."""
        self._begun = now
        kick = round(KICK_SECONDS / self.settings.dt)
        self._lay_out(now, np.repeat([KICK_ACCELERATION, -KICK_ACCELERATION], kick))
        self._drive.follow(self._reference)

    def end(self) -> None:
        """End the actions, and let the drive come to rest."""
        self._begun = None
        self._drive.stop()

    def step(self, now: float) -> None:
        """Choose the next action.

        Raises:
            TaskFailedError: the action is not a number.
        """
        start = self._estimator.start
        if self._begun is None or start is None or now - self._begun < 2 * KICK_SECONDS - 1e-9:
            return
        begun = perf_counter()
        model = self._estimator.model
        self._measurement.update_path()
        rollout = model.rollout(gripper_path(self._measurement.run()), model.theta(), channels=("load_force",))
        here = self._drive.state
        action = self._control.act(SacState(now - start, here.s, here.v, *self._load(rollout)), model)
        if not np.isfinite(action.schedule).all():
            raise TaskFailedError(f"the action chosen at {now:.2f} s is not a number: check the model")
        self.actions.append(action)
        self.seconds.append(perf_counter() - begun)
        self._lay_out(now, action.schedule)

    def _lay_out(self, now: float, schedule: np.ndarray) -> None:
        """States at the end of each coming cycle, with one acceleration per cycle."""
        dt, here = self.settings.dt, self._drive.state
        v = here.v + dt * np.cumsum(schedule)
        x = here.s + dt * np.cumsum(v - dt * schedule / 2)
        self._plan_start = now
        self._plan = [LineState(float(s), float(w), float(a)) for s, w, a in zip(x, v, schedule, strict=True)]

    def _reference(self, now: float) -> Sequence[LineState]:
        first = round((now - self._plan_start) / self.settings.dt)
        return self._plan[first : first + REFERENCE_CYCLES] or [LineState(self._drive.state.s)]
