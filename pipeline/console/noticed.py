"""Warnings that arise while a command runs and that belong to its answer, for every command.

The science warns of a robot whose torques are not those of its file as Python programs warn; here that becomes a line
below the answer and an entry of its JSON.
"""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

_noticed: ContextVar[tuple[str, ...]] = ContextVar("_noticed", default=())


def noticed() -> tuple[str, ...]:
    """Warnings of this command so far."""
    return _noticed.get()


@contextmanager
def noticing() -> Iterator[None]:
    """Collect warnings about robots' descriptions, each once, until the block ends; others are shown as usual."""
    token = _noticed.set(())
    with warnings.catch_warnings():
        show = warnings.showwarning

        def keep(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
            if category.__name__ != "DescriptionWarning":  # the warning's module is slow to load, and may not be needed
                show(message, category, *where, **more)
            elif str(message) not in noticed():
                _noticed.set((*noticed(), str(message)))

        warnings.showwarning = keep
        try:
            yield
        finally:
            _noticed.reset(token)
