"""What is Baxter's own: how it is enabled or stopped, and, for the twin, what its controller makes of commands."""

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np

import urdf
from armdyn.errors import InputError
from pipeline.robot.protocol import Vector
from pipeline.ros.bridge import Bridge

STATE_PERIOD = 0.02
"""Least time between two states of the robot that the bridge passes on [s]."""
ASK_EVERY = 0.1
"""Requests are repeated, as in the robot's SDK, until the state follows [s]."""
FIRST_STATE, RESET, ENABLE = 3.0, 3.0, 10.0
"""Longest time until the first state, and until the robot is reset and enabled [s]; homing may go on before that."""


class Button(IntEnum):
    """The emergency stop button of ``baxter_core_msgs/AssemblyState``."""

    UNPRESSED = 0
    PRESSED = 1
    UNKNOWN = 2
    RELEASED = 3


SOURCES = {0: "", 1: " by the red button", 2: " by software", 3: " by a fault of the robot", 4: " by its own computer"}
"""Who stopped it, by ``estop_source``."""


@dataclass(frozen=True)
class AssemblyState:
    """One ``baxter_core_msgs/AssemblyState``.

    Attributes:
        enabled: whether the motors are on.
        ready: whether it is not homing; robots before SDK 1.2 do not say and count as ready.
        error: a fault, which may be harmless while it is enabled.
        stopped: by an emergency stop, until it is reset.
        button: the red button.
        source: who stopped it.
    """

    enabled: bool
    ready: bool
    error: bool
    stopped: bool
    button: int
    source: int

    @classmethod
    def read(cls, message: Mapping[str, Any]) -> "AssemblyState":
        """From the message; what is missing counts as not enabled, stopped, not pressed."""
        return cls(
            enabled=message.get("enabled") is True,
            ready=message.get("ready", True) is True,
            error=message.get("error") is True,
            stopped=message.get("stopped") is not False,
            button=_whole(message.get("estop_button")),
            source=_whole(message.get("estop_source")),
        )

    @property
    def reset(self) -> bool:
        """Whether nothing is left of a stop or an error."""
        return not (self.enabled or self.stopped or self.error or self.button or self.source)

    @property
    def trouble(self) -> str | None:
        """Why it does not follow commands; None where it does."""
        if self.stopped:
            return f"the robot was stopped{SOURCES.get(self.source, '')}: look why, then start again"
        if not self.enabled:
            return "the robot is not enabled any more: look at its display, then start again"
        return None


class Power:
    """Watches whether Baxter is enabled, and enables it.

    Args:
        bridge: connected.
        name: above the topics, ``/robot``.
    """

    def __init__(self, bridge: Bridge, name: str) -> None:
        self._bridge, self._name = bridge, name
        self._state: AssemblyState | None = None
        self._changed = threading.Condition()
        bridge.subscribe(f"{name}/state", "baxter_core_msgs/AssemblyState", self._take, throttle=STATE_PERIOD)
        bridge.advertise(f"{name}/set_super_enable", "std_msgs/Bool")
        bridge.advertise(f"{name}/set_super_reset", "std_msgs/Empty")

    @property
    def trouble(self) -> str | None:
        """Why the robot does not follow commands; None where it does."""
        state = self._state
        return "the robot has not said whether it is enabled" if state is None else state.trouble

    def enable(self) -> None:
        """Reset the robot where it was stopped, and enable it.

        Raises:
            InputError: it says nothing, its red button is pressed, or it does not follow.
        """
        if not self._wait(lambda _state: True, FIRST_STATE):
            raise InputError(f"{self._name}/state: nothing arrived within {FIRST_STATE:g} s: is the robot on?")
        state = self._state
        assert state is not None, "a state was waited for"
        if state.button == Button.PRESSED:
            raise InputError("the emergency stop is pressed: release it, then start again")
        if state.stopped or (state.error and not state.enabled):
            done = self._ask("set_super_reset", {}, lambda s: s.reset, RESET)
            if not done:
                raise InputError(f"the robot could not be reset within {RESET:g} s: look at its display")
        if not self._ask("set_super_enable", {"data": True}, lambda s: s.enabled and s.ready, ENABLE):
            raise InputError(f"the robot was not enabled within {ENABLE:g} s: look at its display")

    def _ask(
        self, what: str, message: Mapping[str, Any], done: Callable[[AssemblyState], bool], patience: float
    ) -> bool:
        """Repeat a request until the state follows; whether it did in time."""
        for _ in range(round(patience / ASK_EVERY)):
            if self._wait(done, 0.0):
                return True
            self._bridge.publish(f"{self._name}/{what}", message)
            if self._wait(done, ASK_EVERY):
                return True
        return False

    def _wait(self, done: Callable[[AssemblyState], bool], patience: float) -> bool:
        with self._changed:
            return self._changed.wait_for(lambda: self._state is not None and done(self._state), patience)

    def _take(self, message: Mapping[str, Any], _now: float) -> None:
        with self._changed:
            self._state = AssemblyState.read(message)
            self._changed.notify_all()


def _whole(value: object) -> int:
    return value if isinstance(value, int) else 0


@dataclass
class Tally:
    """What the twin was sent, for whoever tests a commander.

    Attributes:
        commands: that were followed.
        ignored: commands that were not: not a number, unknown joints, another mode, or while it was disabled.
        clipped: commands beyond a joint's range.
        largest_step: of a position from one command to the next (n,) [rad].
        timeouts: how often no command came for the timeout.
        after_timeout: commands that came after a timeout and moved the arm again.
        behind: time that this computer lost [s].
        received: time of each command on this computer's monotonic clock [s].
        positions: that each command asked for (n,) [rad].
    """

    commands: int = 0
    ignored: int = 0
    clipped: int = 0
    largest_step: Vector = field(default_factory=lambda: np.zeros(0))
    timeouts: int = 0
    after_timeout: int = 0
    behind: float = 0.0
    received: list[float] = field(default_factory=list)
    positions: list[Vector] = field(default_factory=list)


class CommandedArm:
    """What the robot's controller makes of commands: a posture to hold, its feed-forward, timeout and speed ratio."""

    def __init__(self, q: Vector, limits: urdf.Limits) -> None:
        self._limits = limits
        self.timeout, self.ratio = 0.2, 0.3
        self.target = q
        self._reference = q
        self._v = self._a = np.zeros_like(q)
        self._raw, self._changed = True, False
        self._last: float | None = None

    @property
    def waiting(self) -> bool:
        """Whether no command is being followed."""
        return self._last is None

    def hold(self, q: Vector) -> None:
        """Stay where the arm is, until the next command."""
        if self._last is not None:
            self.target = self._reference = q
            self._last, self._changed = None, True
            self._v = self._a = np.zeros_like(q)

    def feed(self, v: Vector, a: Vector) -> None:
        """Velocity and acceleration that go with the next command (n,), within the limits."""
        self._v = np.clip(v, -self._limits.velocity, self._limits.velocity)
        self._a = np.clip(a, -self._limits.acceleration, self._limits.acceleration)

    def command(self, q: Vector, now: float, raw: bool) -> None:
        """Go to a posture (n,) [rad], at once or within the speed ratio."""
        self.target, self._last, self._raw, self._changed = q, now, raw, True

    def timed_out(self, now: float) -> bool:
        """Whether the last command is too old."""
        return self._last is not None and now - self._last > self.timeout

    def advance(self, duration: float) -> tuple[Vector, Vector, Vector] | None:
        """The reference for the next `duration` seconds; None where it stays as it is."""
        if self._raw:
            self._reference = self.target
        else:
            step = self.ratio * self._limits.velocity * duration
            moved = self._reference + np.clip(self.target - self._reference, -step, step)
            self._changed |= bool(np.any(moved != self._reference))
            self._reference = moved
        changed, self._changed = self._changed, False
        return (self._reference, self._v, self._a) if changed else None
