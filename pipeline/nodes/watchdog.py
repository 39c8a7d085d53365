"""The watchdog beside the loop: it stops an arm whose loop has not come round."""

import threading
from collections.abc import Callable
from time import monotonic
from types import TracebackType
from typing import Self

from pipeline.priority import PromptThread

CHECK = 0.002
"""Time between two looks [s]: by so much later than `patience` is the arm stopped, at most."""


class Watchdog:
    """A thread that stops the arm where the loop does not beat any more, whatever it hangs in.

    It judges by the computer's own monotonic clock, and is right only for a robot that goes on moving while this
    program computes; a simulated one stands still meanwhile. It cannot run while foreign code holds Python's lock:
    for that the robot's own timeout is the last resort.

    Args:
        stop: brings the arm to rest, from this thread.
        moving: whether the arm was told to move; one that stands needs no watching.
        patience: longest time between two beats [s].

    Attributes:
        fault: a sentence once the arm was stopped; None before.
    """

    def __init__(self, stop: Callable[[], None], moving: Callable[[], bool], patience: float) -> None:
        self._stop, self._moving, self._patience = stop, moving, patience
        self._seen = monotonic()
        self._ended = threading.Event()
        self._thread = PromptThread(self._watch, "watchdog")
        self.fault: str | None = None

    def beat(self) -> None:
        """The loop has come round."""
        self._seen = monotonic()

    def __enter__(self) -> Self:
        self.beat()
        self._thread.start()
        return self

    def __exit__(self, *_error: type[BaseException] | BaseException | TracebackType | None) -> None:
        self._ended.set()
        self._thread.join(timeout=1.0)  # `stop` may hang as well; then the robot is on its own

    def _watch(self) -> None:
        while not self._ended.wait(CHECK):
            silence = monotonic() - self._seen
            if silence > self._patience and self._moving():
                self.fault = f"the watchdog stopped the arm: the loop had not come round for {1e3 * silence:.0f} ms"
                try:
                    self._stop()
                except Exception as error:  # there is nobody here to whom it could be raised
                    self.fault += f", and stopping failed ({type(error).__name__}: {error})"
                return
