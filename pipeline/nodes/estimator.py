"""The estimator node: the length from everything measured since the motion began, twice a second.

An update takes 5 to 30 ms, longer than a cycle: it is done beside the loop.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from time import perf_counter

from armdyn.errors import TaskFailedError
from armdyn.faults import without_spikes
from armdyn.identify.estimator import Estimator
from armdyn.identify.least_squares import Outcome
from armdyn.pendulum.model import PendulumModel
from armdyn.run import Run
from pipeline.nodes.beside import AtOnce, Beside
from pipeline.nodes.measurement import MeasurementNode
from pipeline.record import Recorder

FIRST_UPDATE = 1.0
"""Time of motion before the first estimate [s]: less does not determine the length."""


@dataclass(frozen=True)
class LengthEstimate:
    """One entry of the estimate's history.

    Attributes:
        time: of the update [s].
        value: length [m].
        std: its standard deviation [m].
        outcome: how the fit ended.
        seconds: that the update took.
    """

    time: float
    value: float
    std: float
    outcome: Outcome
    seconds: float


@dataclass(frozen=True)
class _Update:
    """What an update found; `std` with what white noise does not explain."""

    values: Mapping[str, float]
    std: float
    outcome: Outcome
    seconds: float


class EstimatorNode:
    """Runs the estimator at 2 Hz on the data since `begin`; an update that is not done in time is waited for.

    Attributes:
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
        beside: Beside | None = None,
    ) -> None:
        self._measurement, self._estimator, self._recorder = measurement, estimator, recorder
        self._beside = beside or AtOnce()
        self._beside.provide(self.name, self._update)
        self.start: float | None = None
        self.history: list[LengthEstimate] = []
        self.left_out: tuple[str, ...] = ()
        self._running = False
        self._model = estimator.model

    @property
    def model(self) -> PendulumModel:
        """The model with the latest estimate that is a number."""
        return self._model

    def begin(self, now: float) -> None:
        """The load hangs at rest now, and what follows is used."""
        self._measurement.begin()
        self.start, self._running = now, True

    def end(self) -> None:
        """Estimate no more; `model` and `start` stay."""
        self._running = False

    def step(self, now: float) -> None:
        """Have the estimate updated once there are enough data.

        Raises:
            TaskFailedError: the estimate is not a number; `model` stays as it was.
        """
        if not self._running or self.start is None or now - self.start < FIRST_UPDATE - 1e-9:
            return
        if self._beside.busy(self.name):
            return
        self._measurement.update_path()
        run = without_spikes(self._measurement.run(), ("load_force",))
        self.left_out = run.warnings
        self._beside.ask(self.name, run, lambda found: self._take(now, found))

    def _update(self, run: Run) -> _Update:
        """The estimate from all data so far."""
        begun = perf_counter()
        estimate = self._estimator.update(run)
        seconds = perf_counter() - begun
        std = estimate.std("length") * self._estimator.widening(run)
        values = dict(zip(estimate.names, estimate.values.tolist(), strict=True))
        return _Update(values, std, estimate.outcome, seconds)

    def _take(self, now: float, found: _Update) -> None:
        """Use what an update found that was begun at `now` [s]."""
        if not self._running:
            return
        length = found.values["length"]
        if not (isfinite(length) and isfinite(found.std)):
            raise TaskFailedError(f"the estimate of the length at {now:.2f} s is not a number: check the model")
        self._model = self._model.with_values(found.values)
        self.history.append(LengthEstimate(now, length, found.std, found.outcome, found.seconds))
        self._recorder.record("estimate.length", now, length)
        self._recorder.record("estimate.length_std", now, found.std)
