"""Ctrl-C, SIGTERM and SIGHUP end a command at any instant, whatever it is doing. Needs nothing but Python itself."""

import _thread
import os
import signal
import sys
import time
from types import FrameType

NAMES = ("SIGINT", "SIGTERM", "SIGHUP")
GRACE = 1.0
"""Time to clean up [s]; then the process ends as it is. Libraries swallow exceptions while they are imported."""


class Interrupt(KeyboardInterrupt):
    """A signal asks this process to end.

    Attributes:
        number: of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__("interrupted" if number == signal.SIGINT else f"ended by {signal.Signals(number).name}")
        self.number = number


def numbers() -> list[int]:
    """The signals of `NAMES` that this system has."""
    return [getattr(signal, name) for name in NAMES if hasattr(signal, name)]


class Interrupts:
    """Turns the first signal into an exception, and sees to it that the process ends; a second one ends it at once.

    Attributes:
        received: number of the signal that came; None before.
    """

    def __init__(self) -> None:
        self.received: int | None = None

    def install(self) -> None:
        """Handle the signals from now on, but those that the process was told to ignore, as by nohup."""
        for number in numbers():
            if number == signal.SIGINT or signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self)
        # An exception in a finalizer cannot be raised, and would be printed.
        usual = sys.unraisablehook
        sys.unraisablehook = lambda what: None if isinstance(what.exc_value, Interrupt) else usual(what)

    def __call__(self, number: int, _frame: FrameType | None) -> None:
        """What the operating system calls."""
        if self.received is not None:
            leave(self.received)
        self.received = number
        # Not `threading`: the signal may have come while it held its lock.
        _thread.start_new_thread(_leave_soon, (number,))
        raise Interrupt(number)

    def check(self) -> None:
        """Raise again what was swallowed.

        Raises:
            Interrupt: a signal has come.
        """
        if self.received is not None:
            raise Interrupt(self.received)

    def finish(self) -> None:
        """The command is over: from now on there is nothing to clean up."""
        for number in numbers():
            if signal.getsignal(number) == self:
                signal.signal(number, lambda number, _frame: leave(number))


def installed() -> Interrupts | None:
    """The one that handles signals in this process; None where somebody else does."""
    handler = signal.getsignal(signal.SIGINT)
    return handler if isinstance(handler, Interrupts) else None


def leave(number: int) -> None:
    """End this process and its workers at once, with the exit status of the signal."""
    processes = sys.modules.get("multiprocessing")
    if processes is not None:
        for worker in processes.active_children():
            worker.kill()
    os._exit(128 + number)


def _leave_soon(number: int) -> None:
    time.sleep(GRACE)
    leave(number)
