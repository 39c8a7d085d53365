"""What a signal means for a trial."""

import signal

from pipeline.interrupts import noted_signals

__all__ = ["noted_signals", "sentence_of_signal"]

_SENTENCES = {
    "SIGINT": "interrupted by the user",
    "SIGTERM": "ended from outside (SIGTERM)",
    "SIGHUP": "ended because its terminal was closed (SIGHUP)",
}


def sentence_of_signal(number: int) -> str:
    """What a signal means."""
    return _SENTENCES[signal.Signals(number).name]
