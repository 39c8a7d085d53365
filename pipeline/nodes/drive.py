"""The drive: every cycle the next reference on the line, smoothed or played, through the table to the joints."""

from collections.abc import Callable, Sequence

from ik import LineTable
from pipeline.motion import Gate, LineSmoother, LineState, LineTrajectory
from pipeline.nodes.measurement import MeasurementNode
from pipeline.record import Recorder
from pipeline.robot.protocol import RobotInterface

Reference = Callable[[float], Sequence[LineState]]
"""``now -> states at the ends of the coming cycles``."""


class DriveNode:
    """Moves the arm at 100 Hz and lets nothing through that the gate refuses.

    Attributes:
        fault: a sentence once the gate has refused, else None; the arm is then on its way to rest.
    """

    name = "drive"
    period = 0.01

    def __init__(
        self,
        robot: RobotInterface,
        table: LineTable,
        smoother: LineSmoother,
        gate: Gate,
        measurement: MeasurementNode,
        recorder: Recorder,
    ) -> None:
        self._robot, self._table, self._smoother, self._gate = robot, table, smoother, gate
        self._measurement, self._recorder = measurement, recorder
        self._reference: Reference | None = None
        self._trajectory: LineTrajectory | None = None
        self._played = 0
        self.fault: str | None = None

    @property
    def state(self) -> LineState:
        """What the arm was last told, on the line."""
        return self._smoother.state

    @property
    def at_rest(self) -> bool:
        """Whether the arm is told to stand still and nothing is left to play."""
        return self._smoother.at_rest and self._trajectory is None and self._reference is None

    def follow(self, reference: Reference) -> None:
        """Smooth a reference that is made while it is followed."""
        self._reference, self._trajectory = reference, None

    def play(self, trajectory: LineTrajectory) -> None:
        """Run a trajectory that has been checked, sample by sample, from the next cycle on."""
        self._reference, self._trajectory, self._played = None, trajectory, 0

    def stop(self) -> None:
        """Brake within the limits and stay."""
        self._reference = self._trajectory = None

    def step(self, now: float) -> None:
        """Send the next reference."""
        previous = self._smoother.state
        state = self._next(now)
        refusal = self._gate.check(state, previous, measured=self._measurement.state.q)
        if refusal is not None:
            self.fault = self.fault or f"motion at {now:.2f} s: {refusal.value}"
            self.stop()
            self._smoother.reset(previous)
            state = self._smoother.stop()
        motion = self._table.joint_motion(state.s, state.v, state.a)
        self._robot.command(motion.q, motion.v, motion.a)
        for name, value in (("reference.x", state.s), ("reference.v", state.v), ("reference.a", state.a)):
            self._recorder.record(name, now, value)

    def _next(self, now: float) -> LineState:
        if self._trajectory is not None:
            state = self._trajectory[self._played]
            self._smoother.reset(state)
            self._played += 1
            if self._played == len(self._trajectory):
                self._trajectory = None
            return state
        if self._reference is not None:
            return self._smoother.update(self._reference(now))
        return self._smoother.stop()
