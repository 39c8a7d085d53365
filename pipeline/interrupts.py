"""Ctrl-C, SIGTERM and SIGHUP end a command at any instant, whatever it is doing. Needs nothing but Python itself."""

import _thread
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from types import FrameType
from typing import NoReturn

NAMES = ("SIGINT", "SIGTERM", "SIGHUP")
GRACE_SECONDS = 1.0
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
        noted: likewise, of SIGTERM or SIGHUP where what ran ended in order, see `noted_signals`.
    """

    def __init__(self) -> None:
        self.received: int | None = None
        self.noted: int | None = None

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

    def check(self, *, ended: bool = False) -> None:
        """Raise again what was swallowed, and, where the command has `ended`, what was noted.

        Raises:
            Interrupt: a signal has come.
        """
        number = self.received or (self.noted if ended else None)
        if number is not None:
            raise Interrupt(number)

    def finish(self) -> None:
        """The command is over: from now on there is nothing to clean up."""
        for number in numbers():
            if signal.getsignal(number) == self:
                signal.signal(number, lambda number, _frame: leave(number))


@contextmanager
def noted_signals(note: Callable[[int], None]) -> Iterator[None]:
    """Call `note` with the number of a signal, so that running work can end in order; a second Ctrl-C is raised.

    Raises:
        Interrupt: a signal came before, and a library has swallowed what it raised.
    """
    pressed = False

    def handle(number: int, _frame: FrameType | None) -> None:
        nonlocal pressed
        if number == signal.SIGINT:
            if pressed:
                raise KeyboardInterrupt
            pressed = True
        for usual in before.values():
            if isinstance(usual, Interrupts) and number != signal.SIGINT:  # Ctrl-C may be the usual end
                usual.noted = number
        note(number)

    with ExitStack() as restored:
        before = {number: signal.getsignal(number) for number in numbers()}
        for number, usual in before.items():
            if usual is signal.SIG_IGN and number != signal.SIGINT:
                continue  # nohup wants the program to go on
            try:
                signal.signal(number, handle)
            except ValueError:  # not the main thread: whoever started the thread handles signals
                break
            restored.callback(signal.signal, number, usual or signal.SIG_DFL)
        # Only now: from here on no signal can come unnoticed.
        for usual in before.values():
            if isinstance(usual, Interrupts):
                usual.check()
        yield


def leave(number: int, status: int | None = None) -> NoReturn:
    """End this process and its workers at once, with the exit status of the signal where none is given."""
    processes = sys.modules.get("multiprocessing")
    if processes is not None:
        for worker in processes.active_children():
            worker.kill()
    os._exit(128 + number if status is None else status)


def _leave_soon(number: int) -> None:
    time.sleep(GRACE_SECONDS)
    leave(number)
