"""The estimator node, which estimates the string's length, and the SAC node, whose motions make it identifiable.

Twice per second the estimator fits all data since the begin of the motion; a fit takes 5 to 30 ms and runs in the
background. Twenty times per second Sequential Action Control (SAC) chooses the most informative motion of the gripper.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from time import perf_counter

import numpy as np

from armdyn.control.sac import SacAction, SacSettings, SacState, SequentialActionControl
from armdyn.errors import TaskFailedError
from armdyn.estimation.descent import Outcome
from armdyn.identify.estimator import Estimator
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

MOTION_BEFORE_ESTIMATE_SECONDS = 1.0
"""Duration of motion before the first estimate [s]; less does not determine the length."""


@dataclass(frozen=True)
class LengthEstimate:
    """One estimate of the string's length.

    Attributes:
        time: time of the estimate [s].
        value: length [m].
        std: standard deviation of the length [m].
        outcome: how the optimisation ended.
        seconds: computing time [s].
    """

    time: float
    value: float
    std: float
    outcome: Outcome
    seconds: float


class EstimatorNode:
    """Estimates the string's length at 2 Hz from the data since `begin`.

    Attributes:
        model: the model with the latest estimate.
        start: time at which the load hung at rest and the data begin [s]; None before `begin`.
        history: all estimates so far.
        left_out: sentences about samples that the last estimate left out because they are spikes.
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
        self._worker.register(self.name, self._update)
        self.start: float | None = None
        self.history: list[LengthEstimate] = []
        self.left_out: tuple[str, ...] = ()
        self._running = False
        self.model: PendulumModel = estimator.model

    def begin(self, now: float) -> None:
        """Begin to estimate; called while the load hangs at rest, at the time `now` [s]."""
        self._measurement.begin()
        self.start, self._running = now, True

    def end(self) -> None:
        """End the estimation; `model` and `start` are kept."""
        self._running = False

    def step(self, now: float) -> None:
        """Request a new estimate if there are enough data and the last one is finished.

        Raises:
            TaskFailedError: the estimate is not a number; `model` is not changed.
        """
        if not self._running or self.start is None or now - self.start < MOTION_BEFORE_ESTIMATE_SECONDS - 1e-9:
            return
        if self._worker.is_pending(self.name):
            return
        self._measurement.append_to_smoothed_path()
        run = without_spikes(self._measurement.run(), ("load_force",))
        self.left_out = run.warnings
        self._worker.request(self.name, (now, run), self._take)

    def _update(self, begun: tuple[float, Run]) -> tuple[dict[str, float], LengthEstimate]:
        """Estimate from all data until a time [s]; the standard deviation allows for errors other than white noise."""
        now, run = begun
        start = perf_counter()
        estimate = self._estimator.update(run)
        seconds = perf_counter() - start
        std = estimate.std("length") * self._estimator.std_inflation(run)
        values = dict(zip(estimate.names, estimate.values.tolist(), strict=True))
        return values, LengthEstimate(now, values["length"], std, estimate.outcome, seconds)

    def _take(self, found: tuple[dict[str, float], LengthEstimate]) -> None:
        """Store an estimate."""
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


DOUBLET_ACCELERATION, DOUBLET_SECONDS = 0.8, 0.2
"""Acceleration [m/s^2] and duration [s] of each half of the doublet with which the motion starts."""
REFERENCE_HORIZON_CYCLES = 30
"""Number of control cycles for which the reference is given to the smoother."""


class SacNode:
    """Chooses informative motions of the gripper by Sequential Action Control, with the latest estimate.

    The first motion is a doublet: acceleration in one direction, then in the other.

    Attributes:
        settings: settings of Sequential Action Control.
        actions: all actions so far.
        seconds: computing time of each action, the prediction of the state included [s].
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
        """Run the computation of `step` once, because the first run takes longer than a control cycle."""
        model = self._estimator.model
        rollout = model.rollout(fixed_pivot_path(0.0, 1.0, self.settings.dt), model.theta(), channels=("load_force",))
        self._control.act(SacState(1.0, 0.0, 0.0, *self._load(rollout)), model)

    def _load(self, rollout: Rollout) -> tuple[np.ndarray, np.ndarray]:
        """Last angle and momentum of the load, (2,), and their derivatives with respect to the length, (2,).

        Internal states of effects are not part of them.
        """
        column = rollout.state_sensitivities[:, self._estimator.model.physics_names.index("length")]
        return rollout.states[-1, :PLANAR_STATE_SIZE], column[:PLANAR_STATE_SIZE]

    def begin(self, now: float) -> None:
        """Start the motions at the time `now` [s]; the first one goes forward and back, before any estimate."""
        self._begun = now
        kick = round(DOUBLET_SECONDS / self.settings.dt)
        self._lay_out(now, np.repeat([DOUBLET_ACCELERATION, -DOUBLET_ACCELERATION], kick))
        self._drive.follow_reference(self._reference)

    def end(self) -> None:
        """End the motions; the drive brakes."""
        self._begun = None
        self._drive.stop()

    def step(self, now: float) -> None:
        """Choose the next action.

        Raises:
            TaskFailedError: the action is not a number.
        """
        if self._begun is None or self._estimator.start is None or now - self._begun < 2 * DOUBLET_SECONDS - 1e-9:
            return
        begun = perf_counter()
        model = self._estimator.model
        self._measurement.append_to_smoothed_path()
        rollout = model.rollout(gripper_path(self._measurement.run()), model.theta(), channels=("load_force",))
        here = self._drive.state
        action = self._control.act(
            SacState(self._measurement.model_time(now), here.s, here.v, *self._load(rollout)), model
        )
        if not np.isfinite(action.schedule).all():
            raise TaskFailedError(f"the action chosen at {now:.2f} s is not a number: check the model")
        self.actions.append(action)
        self.seconds.append(perf_counter() - begun)
        self._lay_out(now, action.schedule)

    def _lay_out(self, now: float, schedule: np.ndarray) -> None:
        """Compute the states at the ends of the next cycles from one acceleration per cycle."""
        dt, here = self.settings.dt, self._drive.state
        v = here.v + dt * np.cumsum(schedule)
        x = here.s + dt * np.cumsum(v - dt * schedule / 2)
        self._plan_start = now
        self._plan = [LineState(float(s), float(w), float(a)) for s, w, a in zip(x, v, schedule, strict=True)]

    def _reference(self, now: float) -> Sequence[LineState]:
        first = round((now - self._plan_start) / self.settings.dt)
        return self._plan[first : first + REFERENCE_HORIZON_CYCLES] or [LineState(self._drive.state.s)]
