"""The estimator node: the length from everything measured since the motion began, twice a second."""

from dataclasses import dataclass
from math import isfinite
from time import perf_counter

from armdyn.errors import TaskFailedError
from armdyn.identify.estimator import Estimator
from armdyn.identify.least_squares import Outcome
from armdyn.pendulum.model import PendulumModel
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


class EstimatorNode:
    """Runs the estimator at 2 Hz on the data since `begin`.

    Attributes:
        start: time at which the load hung at rest and the data begin [s]; None while it does not estimate.
        history: every update so far.
    """

    name = "estimator"
    period = 0.5

    def __init__(self, measurement: MeasurementNode, estimator: Estimator[PendulumModel], recorder: Recorder) -> None:
        self._measurement, self._estimator, self._recorder = measurement, estimator, recorder
        self.start: float | None = None
        self.history: list[LengthEstimate] = []
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
        """Update the estimate once there are enough data.

        Raises:
            TaskFailedError: the estimate is not a number; `model` stays as it was.
        """
        if not self._running or self.start is None or now - self.start < FIRST_UPDATE - 1e-9:
            return
        self._measurement.update_path()
        run = self._measurement.run()
        begun = perf_counter()
        estimate = self._estimator.update(run)
        seconds = perf_counter() - begun
        std = estimate.std("length") * self._estimator.widening(run)
        if not (isfinite(estimate.value("length")) and isfinite(std)):
            raise TaskFailedError(f"the estimate of the length at {now:.2f} s is not a number: check the model")
        self._model = self._estimator.model
        entry = LengthEstimate(now, estimate.value("length"), std, estimate.outcome, seconds)
        self.history.append(entry)
        self._recorder.record("estimate.length", now, entry.value)
        self._recorder.record("estimate.length_std", now, entry.std)
