"""A connection to a dask cluster whose workers the user started."""

from typing import Any

from armdyn.errors import InputError

CONNECT = 10.0
"""To wait for a scheduler, s."""


def dask_client(scheduler: str, extra: str) -> Any:
    """A `distributed.Client`, to be closed by its ``with`` block.

    Args:
        scheduler: its address, such as ``tcp://host:8786``.
        extra: of armdyn, that brings dask.

    Raises:
        InputError: dask is missing, or the scheduler does not answer.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError(f"--scheduler needs dask: run 'pip install armdyn[{extra}]'") from error
    try:
        return Client(scheduler, timeout=CONNECT, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"{scheduler}: no dask scheduler answers there; start one with 'dask scheduler'") from error
