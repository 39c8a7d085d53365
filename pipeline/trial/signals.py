"""Ctrl-C, SIGTERM and SIGHUP end a trial in order: they are noted, and acted on between two rounds of the nodes."""

import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from types import FrameType

ENDINGS = {
    name: sentence
    for name, sentence in (
        ("SIGINT", "interrupted by the user"),
        ("SIGTERM", "ended from outside (SIGTERM)"),
        ("SIGHUP", "ended because its terminal was closed (SIGHUP)"),
    )
    if hasattr(signal, name)  # Windows has no SIGHUP
}
"""What each signal means, by its name."""


@contextmanager
def noted_signals(note: Callable[[str], None]) -> Iterator[None]:
    """Have `note` called with a sentence instead of what these signals usually do; a second Ctrl-C is raised."""
    pressed = False

    def handle(number: int, _frame: FrameType | None) -> None:
        nonlocal pressed
        if number == signal.SIGINT:
            if pressed:
                raise KeyboardInterrupt
            pressed = True
        note(ENDINGS[signal.Signals(number).name])

    with ExitStack() as restored:
        for name in ENDINGS:
            number = getattr(signal, name)
            before = signal.getsignal(number)
            if before is signal.SIG_IGN and name != "SIGINT":
                continue  # nohup wants the program to go on
            try:
                signal.signal(number, handle)
            except ValueError:  # not the main thread: whoever started the thread handles signals
                break
            restored.callback(signal.signal, number, before or signal.SIG_DFL)
        yield
