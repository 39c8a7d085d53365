"""Enabling and stopping Baxter: ``baxter_core_msgs/AssemblyState``, and the requests that change it."""

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from armdyn.errors import InputError
from pipeline.ros.bridge import Bridge

STATE_PERIOD = 0.02
"""Least time between two states of the robot that the bridge passes on [s]."""
REQUEST_PERIOD_SECONDS = 0.1
"""Requests are repeated, as in the robot's SDK, until the state follows [s]."""
POWER_STATE_TIMEOUT, RESET_TIMEOUT_SECONDS, ENABLE_TIMEOUT_SECONDS = 3.0, 3.0, 10.0
"""Longest time until the first state, and until the robot is reset and enabled [s]; homing may go on before that."""
PRESSED, RELEASED = 1, 3
"""Of the red button, ``estop_button``; 0 is untouched, 2 unknown."""
STOP_SOURCES = {
    0: "",
    1: " by the red button",
    2: " by software",
    3: " by a fault of the robot",
    4: " by its own computer",
}
"""Who stopped it, by ``estop_source``."""


@dataclass(frozen=True)
class AssemblyState:
    """Contents of one message ``baxter_core_msgs/AssemblyState``.

    Attributes:
        enabled: whether the motors are on.
        ready: whether the robot is not homing; robots before SDK 1.2 do not report it and count as ready.
        error: whether there is a fault, which may be harmless while the robot is enabled.
        stopped: whether an emergency stop holds, until it is reset.
        estop_button: state of the red button.
        estop_source: number of the cause of the stop.
    """

    enabled: bool = False
    ready: bool = True
    error: bool = False
    stopped: bool = False
    estop_button: int = 0
    estop_source: int = 0

    @classmethod
    def read(cls, message: Mapping[str, Any]) -> "AssemblyState":
        """Read a message; missing fields count as not enabled, stopped, button not pressed."""
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
    def reset(self) -> bool:
        """Whether no stop and no error is left after a reset."""
        return not (self.enabled or self.stopped or self.error or self.estop_button or self.estop_source)

    @property
    def trouble(self) -> str | None:
        """Sentence on why the robot does not follow commands; None where it does."""
        if self.stopped:
            return f"the robot was stopped{STOP_SOURCES.get(self.estop_source, '')}: look why, then start again"
        if not self.enabled:
            return "the robot is not enabled any more: look at its display, then start again"
        return None


class Power:
    """Watches whether Baxter is enabled, and enables it; `name` is the name space of the topics, such as ``/robot``."""

    def __init__(self, bridge: Bridge, name: str) -> None:
        self._bridge, self._name = bridge, name
        self._state: AssemblyState | None = None
        self._changed = threading.Condition()
        bridge.subscribe(f"{name}/state", "baxter_core_msgs/AssemblyState", self._take, throttle=STATE_PERIOD)
        bridge.advertise(f"{name}/set_super_enable", "std_msgs/Bool")
        bridge.advertise(f"{name}/set_super_reset", "std_msgs/Empty")

    @property
    def trouble(self) -> str | None:
        """Sentence on why the robot does not follow commands now; None where it does."""
        state = self._state
        return "the robot has not said whether it is enabled" if state is None else state.trouble

    def enable(self) -> None:
        """Reset the robot where it was stopped, and enable it.

        Raises:
            InputError: the robot sends no state, its red button is pressed, or it does not react.
        """
        if not self._wait(lambda _state: True, POWER_STATE_TIMEOUT):
            raise InputError(f"{self._name}/state: nothing arrived within {POWER_STATE_TIMEOUT:g} s: is the robot on?")
        state = self._state
        assert state is not None, "a state was waited for"
        if state.estop_button == PRESSED:
            raise InputError("the emergency stop is pressed: release it, then start again")
        if state.stopped or (state.error and not state.enabled):
            self._ask("set_super_reset", {}, lambda s: s.reset, RESET_TIMEOUT_SECONDS, "could not be reset")
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
        for _ in range(round(patience / REQUEST_PERIOD_SECONDS)):
            if self._wait(done, 0.0):
                return
            self._bridge.publish(f"{self._name}/{what}", message)
            if self._wait(done, REQUEST_PERIOD_SECONDS):
                return
        raise InputError(f"the robot {failed} within {patience:g} s: look at its display")

    def _wait(self, done: Callable[[AssemblyState], bool], patience: float) -> bool:
        with self._changed:
            return self._changed.wait_for(lambda: self._state is not None and done(self._state), patience)

    def _take(self, message: Mapping[str, Any], _now: float) -> None:
        with self._changed:
            self._state = AssemblyState.read(message)
            self._changed.notify_all()
