"""Power state of Baxter: the message ``baxter_core_msgs/AssemblyState``, and the requests that enable and reset it."""

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from armdyn.errors import InputError
from pipeline.ros.bridge import RosBridge

MIN_POWER_STATE_PERIOD_SECONDS = 0.02
"""Shortest time between two messages on the power state that the bridge passes on [s]."""
REQUEST_REPEAT_PERIOD_SECONDS = 0.1
"""Time after which a request is repeated if the robot's state has not changed [s], as in the robot's SDK."""
POWER_STATE_TIMEOUT_SECONDS, RESET_TIMEOUT_SECONDS, ENABLE_TIMEOUT_SECONDS = 3.0, 3.0, 10.0
"""Longest waiting times for the first power state, for a reset and for enabling, which may include homing [s]."""
ESTOP_BUTTON_PRESSED, ESTOP_BUTTON_RELEASED = 1, 3
"""Values of the field ``estop_button``, the state of the red emergency-stop button; 0 is untouched, 2 unknown."""
ESTOP_SOURCES = {
    0: "",
    1: " by the red button",
    2: " by software",
    3: " by a fault of the robot",
    4: " by its own computer",
}
"""Cause of an emergency stop in words, by the number in the field ``estop_source``."""


@dataclass(frozen=True)
class AssemblyState:
    """Contents of one message ``baxter_core_msgs/AssemblyState``.

    Attributes:
        enabled: whether the motors are on.
        ready: whether homing is finished; robots before SDK 1.2 do not report it and count as ready.
        error: whether there is a fault, which may be harmless while the robot is enabled.
        stopped: whether an emergency stop is active; it must be reset.
        estop_button: state of the red emergency-stop button, see `ESTOP_BUTTON_PRESSED`.
        estop_source: cause of the stop, see `ESTOP_SOURCES`.
    """

    enabled: bool = False
    ready: bool = True
    error: bool = False
    stopped: bool = False
    estop_button: int = 0
    estop_source: int = 0

    @classmethod
    def from_message(cls, message: Mapping[str, Any]) -> "AssemblyState":
        """State from a message; a missing field counts as not enabled, stopped, or button not pressed."""
        button, source = (message.get(name) for name in ("estop_button", "estop_source"))
        return cls(
            enabled=message.get("enabled") is True,
            ready=message.get("ready", True) is True,
            error=message.get("error") is True,
            stopped=message.get("stopped") is not False,
            estop_button=button if isinstance(button, int) else 0,
            estop_source=source if isinstance(source, int) else 0,
        )

    @property
    def is_reset(self) -> bool:
        """Whether the robot is disabled and has no emergency stop and no error, as after a reset."""
        return not (self.enabled or self.stopped or self.error or self.estop_button or self.estop_source)

    @property
    def trouble(self) -> str | None:
        """Reason why the robot does not follow commands, as a sentence; None if it follows them."""
        if self.stopped:
            return f"the robot was stopped{ESTOP_SOURCES.get(self.estop_source, '')}: look why, then start again"
        if not self.enabled:
            return "the robot is not enabled any more: look at its display, then start again"
        return None


class BaxterPower:
    """Monitors whether Baxter is enabled, and enables it.

    Args:
        bridge: connection to ROS.
        name: name space of the topics, such as ``/robot``.
    """

    def __init__(self, bridge: RosBridge, name: str) -> None:
        self._bridge, self._name = bridge, name
        self._state: AssemblyState | None = None
        self._changed = threading.Condition()
        bridge.subscribe(
            f"{name}/state", "baxter_core_msgs/AssemblyState", self._take, throttle=MIN_POWER_STATE_PERIOD_SECONDS
        )
        bridge.advertise(f"{name}/set_super_enable", "std_msgs/Bool")
        bridge.advertise(f"{name}/set_super_reset", "std_msgs/Empty")

    @property
    def trouble(self) -> str | None:
        """Reason why the robot does not follow commands at present, as a sentence; None if it follows them."""
        state = self._state
        return "the robot has not said whether it is enabled" if state is None else state.trouble

    def enable(self) -> None:
        """Enable the robot, after a reset where it was stopped.

        Raises:
            InputError: the robot sends no state, its red button is pressed, or it does not react.
        """
        if not self._wait(lambda _state: True, POWER_STATE_TIMEOUT_SECONDS):
            raise InputError(
                f"{self._name}/state: nothing arrived within {POWER_STATE_TIMEOUT_SECONDS:g} s: is the robot on?"
            )
        state = self._state
        assert state is not None, "a state was waited for"
        if state.estop_button == ESTOP_BUTTON_PRESSED:
            raise InputError("the emergency stop is pressed: release it, then start again")
        if state.stopped or (state.error and not state.enabled):
            self._ask("set_super_reset", {}, lambda s: s.is_reset, RESET_TIMEOUT_SECONDS, "could not be reset")
        self._ask(
            "set_super_enable",
            {"data": True},
            lambda s: s.enabled and s.ready,
            ENABLE_TIMEOUT_SECONDS,
            "was not enabled",
        )

    def _ask(
        self, what: str, message: Mapping[str, Any], done: Callable[[AssemblyState], bool], patience: float, failed: str
    ) -> None:
        """Repeat a request until the robot's state shows that it was followed."""
        for _ in range(round(patience / REQUEST_REPEAT_PERIOD_SECONDS)):
            if self._wait(done, 0.0):
                return
            self._bridge.publish(f"{self._name}/{what}", message)
            if self._wait(done, REQUEST_REPEAT_PERIOD_SECONDS):
                return
        raise InputError(f"the robot {failed} within {patience:g} s: look at its display")

    def _wait(self, done: Callable[[AssemblyState], bool], patience: float) -> bool:
        with self._changed:
            return self._changed.wait_for(lambda: self._state is not None and done(self._state), patience)

    def _take(self, message: Mapping[str, Any], _now: float) -> None:
        with self._changed:
            self._state = AssemblyState.from_message(message)
            self._changed.notify_all()
