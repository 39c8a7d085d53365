"""Collect the warnings about robot descriptions that are raised while a command runs.

A robot whose torques differ from those of its file raises a Python warning. The command prints it below its answer, and
adds it to its JSON output.
"""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

_noticed: ContextVar[tuple[str, ...]] = ContextVar("_noticed", default=())


def collected_warnings() -> tuple[str, ...]:
    """The warnings about robot descriptions that were collected so far."""
    return _noticed.get()


@contextmanager
def collecting_warnings() -> Iterator[None]:
    """Collect each different warning about a robot description in the ``with`` block; other warnings are shown."""
    token = _noticed.set(())
    with warnings.catch_warnings():
        show = warnings.showwarning

        def keep(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
            if category.__name__ != "DescriptionWarning":  # the warning's module is slow to load, and may not be needed
                show(message, category, *where, **more)
            elif str(message) not in collected_warnings():
                _noticed.set((*collected_warnings(), str(message)))

        warnings.showwarning = keep
        try:
            yield
        finally:
            _noticed.reset(token)
