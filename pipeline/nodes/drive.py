"""The drive node: it sends the next reference on the line, smoothed or played, to the joints in every cycle."""

from collections.abc import Callable, Sequence
from contextlib import suppress

from armdyn.errors import InputError
from ik import LineTable
from pipeline.motion import LineGate, LineSmoother, LineState, LineTrajectory
from pipeline.motion.gate import PERIOD, Refusal, RefusalReason
from pipeline.nodes.measurement import MeasurementNode
from pipeline.record import Recorder
from pipeline.robot.protocol import RobotInterface

Reference = Callable[[float], Sequence[LineState]]
"""``now -> states at the ends of the coming cycles``."""

MAX_COMMAND_SILENCE = 0.031
"""A moving arm that has had no command for longer than this [s] has missed three cycles. The robot extrapolates the
last one; after three cycles the next reference would pull it back, faster than its limits allow."""


class DriveNode:
    """Moves the arm at 100 Hz, and sends no command that the gate refuses.

    There are two ways to rest. `stop` brakes along the line, cycle by cycle, as long as the loop runs. `halt` tells the
    robot to brake on its own; nothing is sent after it. Whatever is raised in a step ends in `halt`.

    Attributes:
        fault: a sentence once the gate has refused, otherwise None; the arm is then braking.
        halted: whether the robot was commanded to come to rest on its own.
        sent_at: robot's time of the last command [s]; None before the first.
    """

    name = "drive"
    period = PERIOD

    def __init__(
        self,
        robot: RobotInterface,
        table: LineTable,
        smoother: LineSmoother,
        gate: LineGate,
        measurement: MeasurementNode,
        recorder: Recorder,
    ) -> None:
        self._robot, self._table, self._smoother, self._gate = robot, table, smoother, gate
        self._measurement, self._recorder = measurement, recorder
        self._reference: Reference | None = None
        self._trajectory: LineTrajectory | None = None
        self._played = 0
        self.fault: str | None = None
        self.halted = False
        self.sent_at: float | None = None

    @property
    def state(self) -> LineState:
        """Last commanded state on the line."""
        return self._smoother.state

    @property
    def standing(self) -> bool:
        """Whether the last command was a state at rest."""
        return self.halted or self._smoother.at_rest

    @property
    def at_rest(self) -> bool:
        """Whether the last command was a state at rest and no motion remains to be played."""
        return self.standing and self._trajectory is None and self._reference is None

    def follow(self, reference: Reference) -> None:
        """Follow a reference that is computed online, through the smoother."""
        self._reference, self._trajectory = reference, None

    def play(self, trajectory: LineTrajectory) -> None:
        """Run a trajectory that has been checked, sample by sample, from the next cycle on."""
        self._reference, self._trajectory, self._played = None, trajectory, 0

    def stop(self) -> None:
        """Brake along the line within the limits, then stay at rest."""
        self._reference = self._trajectory = None

    def halt(self) -> None:
        """Let the robot brake on its own and hold; send no more commands. The watchdog calls it from its thread."""
        self.halted = True
        self.stop()
        self._robot.stop()

    def step(self, now: float) -> None:
        """Send the next reference to the joints."""
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
        late = 0.0 if self.sent_at is None else self._robot.time - self.sent_at
        if moving and not 0.0 <= late <= MAX_COMMAND_SILENCE:
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
        self.sent_at = self._robot.time
        for name, value in (("reference.x", state.s), ("reference.v", state.v), ("reference.a", state.a)):
            self._recorder.record(name, now, value)

    def _checked(self, now: float, previous: LineState) -> tuple[LineState, Refusal | None]:
        """The next reference, and the refusal of the gate; None where it may be sent."""
        played = self._trajectory
        state = self._next(now)
        refusal = self._gate.check(state, previous, measured=self._measurement.state.q)
        if refusal is None and played is not None:
            try:
                self._smoother.reset(state)
            except InputError:
                refusal = Refusal(RefusalReason.NO_WAY_TO_REST)
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
