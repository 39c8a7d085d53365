"""Let the signals SIGINT (Ctrl-C), SIGTERM and SIGHUP end a command at any time, with Python's own modules only."""

import _thread
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from types import FrameType
from typing import NoReturn

SIGNAL_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")
CLEANUP_SECONDS = 1.0
"""Time after a signal until the process is ended by force [s]; some libraries suppress exceptions in their import."""


class Interrupt(KeyboardInterrupt):
    """Raised when a signal asks this process to end.

    Attributes:
        number: number of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__("interrupted" if number == signal.SIGINT else f"ended by {signal.Signals(number).name}")
        self.number = number


def signal_numbers() -> list[int]:
    """Numbers of the signals in `SIGNAL_NAMES` that this operating system has."""
    return [getattr(signal, name) for name in SIGNAL_NAMES if hasattr(signal, name)]


class SignalHandler:
    """Signal handler that raises `Interrupt` at the first signal, and ends the process at once at the second.

    Attributes:
        received: number of the signal that came; None before.
        noted: number of a SIGTERM or SIGHUP that `deferred_signals` has received; None before.
    """

    def __init__(self) -> None:
        self.received: int | None = None
        self.noted: int | None = None

    def install(self) -> None:
        """Handle the signals, except those that the process ignores, for example under the program nohup."""
        for number in signal_numbers():
            if number == signal.SIGINT or signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self)
        # An exception in a finalizer cannot be raised, and would be printed.
        usual = sys.unraisablehook
        sys.unraisablehook = lambda what: None if isinstance(what.exc_value, Interrupt) else usual(what)

    def __call__(self, number: int, _frame: FrameType | None) -> None:
        """Handle a signal; called by the operating system.

        Raises:
            Interrupt: always, unless this is the second signal, which ends the process.
        """
        if self.received is not None:
            exit_at_once(self.received)
        self.received = number
        # Not `threading`: the signal may have come while it held its lock.
        _thread.start_new_thread(_leave_soon, (number,))
        raise Interrupt(number)

    def check(self, *, ended: bool = False) -> None:
        """Raise `Interrupt` if a signal has come, also if a library has suppressed the first exception.

        Args:
            ended: whether the command has ended, so that a signal in `noted` is raised too.

        Raises:
            Interrupt: a signal has come.
        """
        number = self.received or (self.noted if ended else None)
        if number is not None:
            raise Interrupt(number)

    def finish(self) -> None:
        """Let every later signal end the process at once; called when the command is over."""
        for number in signal_numbers():
            if signal.getsignal(number) == self:
                signal.signal(number, lambda number, _frame: exit_at_once(number))


@contextmanager
def deferred_signals(note: Callable[[int], None]) -> Iterator[None]:
    """Call `note` with a signal's number in the ``with`` block, in place of raising, so that work can end normally.

    Raises:
        Interrupt: a signal came before the block, and a library has suppressed its exception.
        KeyboardInterrupt: Ctrl-C was pressed a second time.
    """
    pressed = False

    def handle(number: int, _frame: FrameType | None) -> None:
        nonlocal pressed
        if number == signal.SIGINT:
            if pressed:
                raise KeyboardInterrupt
            pressed = True
        for usual in before.values():
            if isinstance(usual, SignalHandler) and number != signal.SIGINT:  # Ctrl-C may be the usual end
                usual.noted = number
        note(number)

    with ExitStack() as restored:
        before = {number: signal.getsignal(number) for number in signal_numbers()}
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
            if isinstance(usual, SignalHandler):
                usual.check()
        yield


def exit_at_once(number: int, status: int | None = None) -> NoReturn:
    """End this process and its child processes at once; the exit status is `status`, by default 128 + signal number."""
    processes = sys.modules.get("multiprocessing")
    if processes is not None:
        for worker in processes.active_children():
            worker.kill()
    os._exit(128 + number if status is None else status)


def _leave_soon(number: int) -> None:
    time.sleep(CLEANUP_SECONDS)
    exit_at_once(number)
