"""Model of Baxter's controller for the simulated Baxter on ROS (the twin): its reaction to messages.

Commands to a disabled robot are ignored, and so are commands that are not finite numbers or have another mode than the
two position modes. Without a command for the timeout the arm holds its posture.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import isfinite

import numpy as np

import urdf
from pipeline.robot.protocol import Vector
from pipeline.ros.baxter import ESTOP_BUTTON_PRESSED, ESTOP_BUTTON_RELEASED, AssemblyState
from pipeline.ros.bridge import Message
from pipeline.ros.states import finite_array
from pipeline.ros.topics import JOINT_COMMAND_MODES

ENABLING_SECONDS = 0.1
"""Time from the request to enable the robot until it is enabled [s]."""
DISABLED_STATE = AssemblyState(ready=False)


@dataclass
class CommandLog:
    """Log of the commands that the simulated Baxter received, for tests of programs that send commands.

    Attributes:
        ignored: number of ignored commands: not finite, for unknown joints, in another mode, or to a disabled robot.
        clipped: number of commands beyond a joint's range.
        timeouts: number of times that no command arrived within the timeout.
        received: time of each followed command on this computer's monotonic clock [s].
        positions: requested positions of each followed command (n,) [rad].
    """

    ignored: int = 0
    clipped: int = 0
    timeouts: int = 0
    received: list[float] = field(default_factory=list)
    positions: list[Vector] = field(default_factory=list)


class BaxterController:
    """Simulated controller of Baxter: enabling, emergency stops, and the reference that the joints follow.

    Args:
        q: posture at the start (n,) [rad].
        names: names of the joints.
        limits: limits of the joints.

    Attributes:
        state: power state of the robot.
        log: received commands.
        target: last requested posture (n,) [rad].
    """

    def __init__(self, q: Vector, names: tuple[str, ...], limits: urdf.Limits) -> None:
        self._names, self._limits = names, limits
        self.state, self.log = DISABLED_STATE, CommandLog()
        self.target = self._reference = q
        self._v = self._a = np.zeros_like(q)
        self._timeout, self._ratio, self._raw, self._changed = 0.2, 0.3, True, False
        self._last: float | None = None  # time of the command that is followed
        self._enabled_at: float | None = None

    def reference(
        self, now: float, duration: float, measured: Callable[[], Vector]
    ) -> tuple[Vector, Vector, Vector] | None:
        """Reference of the joints for the next step of the simulation.

        Args:
            now: present time on the clock of the commands [s].
            duration: duration of the step [s].
            measured: function that returns the arm's posture (n,) [rad].

        Returns:
            Positions, velocities and accelerations (n,) each; None if the reference does not change.
        """
        if self._enabled_at is not None and now >= self._enabled_at:
            self.state, self._enabled_at = AssemblyState(enabled=True), None
        timed_out = self.state.enabled and self._last is not None and now - self._last > self._timeout
        self.log.timeouts += timed_out
        if self._last is not None and (timed_out or not self.state.enabled):
            self.target = self._reference = measured()
            self._v = self._a = np.zeros_like(self.target)
            self._last, self._changed = None, True
        if self._raw:
            self._reference = self.target
        else:
            step = self._ratio * self._limits.velocity * duration
            moved = self._reference + np.clip(self.target - self._reference, -step, step)
            self._changed |= bool(np.any(moved != self._reference))
            self._reference = moved
        changed, self._changed = self._changed, False
        return (self._reference, self._v, self._a) if changed else None

    def press(self, button: int = ESTOP_BUTTON_PRESSED, source: int = 1) -> None:
        """Simulate an emergency stop, which disables the arm until it is released and reset.

        Args:
            button: state of the red button.
            source: cause of the stop, see `ESTOP_SOURCES`; 1 is the button.
        """
        self.state = AssemblyState(ready=False, stopped=True, estop_button=button, estop_source=source)
        self._enabled_at = None

    def release(self) -> None:
        """Release the red button; the robot stays stopped until it is reset."""
        if self.state.estop_button == ESTOP_BUTTON_PRESSED:
            self.state = replace(self.state, estop_button=ESTOP_BUTTON_RELEASED)

    def handle_enable(self, message: Message, now: float) -> None:
        """Handle a message on ``set_super_enable``, a Bool: enable or disable the arm."""
        if message.get("data") is not True:
            self.state, self._enabled_at = replace(self.state, enabled=False, ready=False), None
        elif not (self.state.stopped or self.state.enabled) and self._enabled_at is None:
            self._enabled_at = now + ENABLING_SECONDS

    def handle_reset(self, _message: Message, _now: float) -> None:
        """Handle a message on ``set_super_reset``: reset an emergency stop."""
        if self.state.estop_button != ESTOP_BUTTON_PRESSED:
            self.state = DISABLED_STATE

    def handle_stop(self, _message: Message, _now: float) -> None:
        """Handle a message on ``set_super_stop``: stop by software."""
        self.press(button=2, source=2)

    def handle_timeout(self, message: Message, _now: float) -> None:
        """Handle a message on ``joint_command_timeout``, a Float64: set the timeout of commands [s]."""
        value = message.get("data")
        if isinstance(value, float | int) and isfinite(value) and value > 0:
            self._timeout = float(value)

    def handle_speed_ratio(self, message: Message, _now: float) -> None:
        """Handle a message on ``set_speed_ratio``, a Float64: set the used share of the speed limits."""
        value = message.get("data")
        if isinstance(value, float | int) and isfinite(value):
            self._ratio = min(max(float(value), 0.0), 1.0)

    def handle_feed_forward(self, message: Message, _now: float) -> None:
        """Handle a message on ``inverse_dynamics_command``: velocity and acceleration of the next command."""
        v, a = (self._vector(message.get(name)) for name in ("velocities", "accelerations"))
        if v is not None and a is not None:
            self._v = np.clip(v, -self._limits.velocity, self._limits.velocity)
            self._a = np.clip(a, -self._limits.acceleration, self._limits.acceleration)

    def handle_command(self, message: Message, now: float) -> None:
        """Handle a message on ``joint_command``: go to a posture, at once (raw positions) or within the speed ratio."""
        q, names, mode = self._vector(message.get("command")), message.get("names"), message.get("mode")
        known = isinstance(names, list) and sorted(map(str, names)) == sorted(self._names)
        if q is None or not known or mode not in JOINT_COMMAND_MODES.values() or not self.state.enabled:
            self.log.ignored += 1
            return
        assert isinstance(names, list), "names were looked at above"
        q = q[[names.index(name) for name in self._names]]
        self.target = np.clip(q, self._limits.lower, self._limits.upper)
        self.log.clipped += bool(np.any(self.target != q))
        self.log.received.append(now)
        self.log.positions.append(q)
        self._last, self._raw, self._changed = now, mode == JOINT_COMMAND_MODES["raw_position"], True

    def _vector(self, given: object) -> Vector | None:
        """Vector with one finite number per joint; None for any other input."""
        vector = finite_array(given)
        return vector if vector is not None and vector.shape == (len(self._names),) else None
