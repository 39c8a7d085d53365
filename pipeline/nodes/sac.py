"""The SAC node: twenty times a second, the gripper motion that makes the load cell most informative."""

from collections.abc import Sequence
from time import perf_counter

import numpy as np

from armdyn.control.sac import SacAction, SacSettings, SacState, SequentialActionControl
from armdyn.errors import TaskFailedError
from armdyn.pendulum.path import fixed_path
from armdyn.pendulum.recorded import run_path
from armdyn.physics.simulate import Rollout
from pipeline.motion import LineState
from pipeline.nodes.drive import DriveNode
from pipeline.nodes.estimator import EstimatorNode
from pipeline.nodes.measurement import MeasurementNode

KICK_ACCELERATION, KICK_TIME = 0.8, 0.2
"""Acceleration [m/s^2] and duration [s] of each half of the doublet that starts the motion: at rest SAC never moves."""
LOOK_AHEAD = 30
"""Cycles of reference given to the smoother."""


class SacNode:
    """Starts with a doublet, then acts on the latest estimate; silent until `begin`.

    Attributes:
        actions: every action so far.
        seconds: that each took, the state's prediction included.
    """

    name = "sac"
    period = 0.05

    def __init__(
        self,
        measurement: MeasurementNode,
        estimator: EstimatorNode,
        drive: DriveNode,
        settings: SacSettings | None = None,
    ) -> None:
        self._measurement, self._estimator, self._drive = measurement, estimator, drive
        self.settings = settings or SacSettings(sample_time=self.period)
        self._control = SequentialActionControl(estimator.model, self.settings)
        self._begun: float | None = None
        self._plan_start = 0.0
        self._plan: list[LineState] = []
        self.actions: list[SacAction] = []
        self.seconds: list[float] = []

    def warm_up(self) -> None:
        """Compute once what `step` computes, on a gripper that stands: the first time takes longer than a cycle."""
        model = self._estimator.model
        rollout = model.rollout(fixed_path(0.0, 1.0, self.settings.dt), model.theta(), channels=("load_force",))
        self._control.act(SacState(1.0, 0.0, 0.0, rollout.states[-1], self._length_column(rollout)), model)

    def _length_column(self, rollout: Rollout) -> np.ndarray:
        """(2,) derivative of the last state with respect to the length."""
        column: np.ndarray = rollout.state_sensitivities[:, self._estimator.model.physics_names.index("length")]
        return column

    def begin(self, now: float) -> None:
        """Kick, then inform."""
        self._begun = now
        kick = round(KICK_TIME / self.settings.dt)
        self._lay_out(now, np.repeat([KICK_ACCELERATION, -KICK_ACCELERATION], kick))
        self._drive.follow(self._reference)

    def end(self) -> None:
        """Act no more and let the drive come to rest."""
        self._begun = None
        self._drive.stop()

    def step(self, now: float) -> None:
        """Choose the next action.

        Raises:
            TaskFailedError: the action is not a number.
        """
        start = self._estimator.start
        if self._begun is None or start is None or now - self._begun < 2 * KICK_TIME - 1e-9:
            return
        begun = perf_counter()
        model = self._estimator.model
        self._measurement.update_path()
        rollout = model.rollout(run_path(self._measurement.run()), model.theta(), channels=("load_force",))
        here = self._drive.state
        action = self._control.act(
            SacState(
                time=now - start,
                x=here.s,
                v=here.v,
                pendulum=rollout.states[-1],
                sensitivity=self._length_column(rollout),
            ),
            model,
        )
        if not np.isfinite(action.schedule).all():
            raise TaskFailedError(f"the action chosen at {now:.2f} s is not a number: check the model")
        self.actions.append(action)
        self.seconds.append(perf_counter() - begun)
        self._lay_out(now, action.schedule)

    def _lay_out(self, now: float, schedule: np.ndarray) -> None:
        """Plan the states at the end of each coming cycle, with one acceleration per cycle."""
        dt, here = self.settings.dt, self._drive.state
        v = here.v + dt * np.cumsum(schedule)
        x = here.s + dt * np.cumsum(v - dt * schedule / 2)
        self._plan_start = now
        self._plan = [LineState(float(s), float(w), float(a)) for s, w, a in zip(x, v, schedule, strict=True)]

    def _reference(self, now: float) -> Sequence[LineState]:
        first = round((now - self._plan_start) / self.settings.dt)
        return self._plan[first : first + LOOK_AHEAD] or [LineState(self._drive.state.s)]
