"""Ctrl-C, SIGTERM and SIGHUP end a trial in order: they are noted, and acted on between two rounds of the nodes."""

import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from types import FrameType

from pipeline.interrupts import Interrupts, numbers

_SENTENCES = {
    "SIGINT": "interrupted by the user",
    "SIGTERM": "ended from outside (SIGTERM)",
    "SIGHUP": "ended because its terminal was closed (SIGHUP)",
}


def sentence_of_signal(number: int) -> str:
    """What a signal means."""
    return _SENTENCES[signal.Signals(number).name]


@contextmanager
def noted_signals(note: Callable[[int], None]) -> Iterator[None]:
    """Have `note` called with the number of the signal, instead of what it usually does; a second Ctrl-C is raised.

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
