"""The drive node: in every control cycle it sends the next reference on the line to the joints."""

from collections.abc import Callable, Sequence
from contextlib import suppress

from armdyn.errors import InputError
from ik import LineTable
from pipeline.motion import LineReferenceCheck, LineSmoother, LineState, LineTrajectory
from pipeline.motion.gate import CONTROL_PERIOD_SECONDS, CommandRefusalReason, Refusal
from pipeline.nodes.measurement import MeasurementNode
from pipeline.record import Recorder
from pipeline.robot.protocol import RobotInterface

ReferenceFunction = Callable[[float], Sequence[LineState]]
"""Function from the present time [s] to the states that the tool should have at the ends of the next cycles."""

MAX_COMMAND_SILENCE_SECONDS = 0.031
"""Longest time without a command while the arm moves [s].

The robot extrapolates the last command; after three cycles, the next one would exceed the joints' limits.
"""


class DriveNode:
    """Moves the arm along the line at 100 Hz; it sends only commands that the gate accepts.

    There are two ways to bring the arm to rest: `stop` brakes along the line, cycle by cycle; `halt` lets the robot
    brake by itself, and no command is sent afterwards. Every exception in a step leads to `halt`.

    Attributes:
        fault: why the gate refused a command, so that the arm brakes; None before.
        halted: whether the robot was told to brake by itself.
        last_command_time: time of the last command on the robot's clock [s]; None before the first command.
    """

    name = "drive"
    period = CONTROL_PERIOD_SECONDS

    def __init__(
        self,
        robot: RobotInterface,
        table: LineTable,
        smoother: LineSmoother,
        gate: LineReferenceCheck,
        measurement: MeasurementNode,
        recorder: Recorder,
    ) -> None:
        self._robot, self._table, self._smoother, self._gate = robot, table, smoother, gate
        self._measurement, self._recorder = measurement, recorder
        self._reference: ReferenceFunction | None = None
        self._trajectory: LineTrajectory | None = None
        self._played = 0
        self.fault: str | None = None
        self.halted = False
        self.last_command_time: float | None = None

    @property
    def state(self) -> LineState:
        """Last commanded state of the tool on the line."""
        return self._smoother.state

    @property
    def standing(self) -> bool:
        """Whether the last command was a state at rest, or the robot brakes by itself."""
        return self.halted or self._smoother.at_rest

    @property
    def at_rest(self) -> bool:
        """Whether the last command was a state at rest and no motion is left to be sent."""
        return self.standing and self._trajectory is None and self._reference is None

    def follow_reference(self, reference: ReferenceFunction) -> None:
        """Follow a reference that is computed in every cycle, smoothed to be within the limits."""
        self._reference, self._trajectory = reference, None

    def run_trajectory(self, trajectory: LineTrajectory) -> None:
        """Send a checked trajectory, one sample per cycle, from the next cycle on."""
        self._reference, self._trajectory, self._played = None, trajectory, 0

    def stop(self) -> None:
        """Brake along the line within the limits, and stay at rest."""
        self._reference = self._trajectory = None

    def halt(self) -> None:
        """Let the robot brake by itself, and send no further commands; may be called from another thread."""
        self.halted = True
        self.stop()
        self._robot.stop()

    def step(self, now: float) -> None:
        """Compute the next reference, check it, and send it to the joints."""
        if self.halted:
            return
        try:
            self._send(now)
        except BaseException:
            with suppress(Exception):  # a failing stop command must not hide the reason
                self.halt()
            raise

    def _send(self, now: float) -> None:
        previous, moving = self._smoother.state, not self._smoother.at_rest
        late = 0.0 if self.last_command_time is None else self._robot.time - self.last_command_time
        if moving and not 0.0 <= late <= MAX_COMMAND_SILENCE_SECONDS:
            self.fault = self.fault or f"motion at {now:.2f} s: no command for {1e3 * late:.0f} ms, and the arm went on"
            self.halt()
            return
        state, refusal = self._checked(now, previous)
        if refusal is not None:
            self.fault = self.fault or f"motion at {now:.2f} s: {refusal.sentence}"
            self.stop()
            self._smoother.reset(previous)
            state = self._smoother.stop()
        motion = self._table.joint_motion(state.s, state.v, state.a)
        if self.halted:  # halted by the watchdog during the computation
            return
        self._robot.command(motion.q, motion.v, motion.a)
        if self.halted:  # halted by the watchdog just before the command
            self._robot.stop()
            return
        self.last_command_time = self._robot.time
        for name, value in (("reference.x", state.s), ("reference.v", state.v), ("reference.a", state.a)):
            self._recorder.record(name, now, value)

    def _checked(self, now: float, previous: LineState) -> tuple[LineState, Refusal | None]:
        """The next reference, and the refusal of the gate; None if the reference may be sent."""
        played = self._trajectory
        state = self._next(now)
        refusal = self._gate.check(state, previous, measured=self._measurement.state.q)
        if refusal is None and played is not None:
            try:
                self._smoother.reset(state)
            except InputError:
                refusal = Refusal(CommandRefusalReason.NO_WAY_TO_REST)
        return state, refusal

    def _next(self, now: float) -> LineState:
        if self._trajectory is not None:
            state = self._trajectory[self._played]
            self._played += 1
            if self._played == len(self._trajectory):
                self._trajectory = None
            return state
        if self._reference is not None:
            return self._smoother.update(self._reference(now))
        return self._smoother.stop()
