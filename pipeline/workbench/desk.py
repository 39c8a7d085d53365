"""Files that were opened once, and the one thread that computes with them, so that the page never waits."""

import asyncio
from collections.abc import Callable
from concurrent.futures import Future
from queue import SimpleQueue
from threading import Thread
from typing import Any, TypeVar

from pipeline.commands.identify import Given, Inputs
from pipeline.workbench.bench import Bench

T = TypeVar("T")


class Desk:
    """A model and runs that are read in the background.

    Args:
        inputs: their files.
    """

    def __init__(self, inputs: Inputs) -> None:
        self.inputs = inputs
        self._work: SimpleQueue[tuple[Future[Any], Callable[[], Any]] | None] = SimpleQueue()
        # A daemon: the program ends at once, whatever is being computed.
        Thread(target=self._working, name="armdyn-desk", daemon=True).start()
        self._given = self._submit(inputs.read)
        self._bench = self._submit(self._first_look)
        self._ready = self._submit(lambda: self._bench.result().foretelling)

    def _first_look(self) -> Bench:
        bench = Bench(self._given.result().study)
        _ = bench.opening
        return bench

    async def opened(self) -> tuple[Given, Bench]:
        """Both, as soon as the model as given can be shown.

        Raises:
            InputError: a file cannot be used.
        """
        return await asyncio.wrap_future(self._given), await asyncio.wrap_future(self._bench)

    async def ready(self) -> None:
        """Returns when effects can be foretold."""
        await asyncio.wrap_future(self._ready)

    async def do(self, work: Callable[[], T]) -> T:
        """The answer of something slow, computed one after the other."""
        return await asyncio.wrap_future(self._submit(work))

    def close(self) -> None:
        """Do nothing further."""
        self._work.put(None)

    def _submit(self, work: Callable[[], T]) -> "Future[T]":
        future: Future[T] = Future()
        self._work.put((future, work))
        return future

    def _working(self) -> None:
        while (item := self._work.get()) is not None:
            future, work = item
            if not future.set_running_or_notify_cancel():
                continue
            try:
                future.set_result(work())
            except BaseException as error:
                future.set_exception(error)


def key_of(inputs: Inputs) -> tuple[object, ...]:
    """Tells files, as they are now, from others."""
    roles = (("model", [inputs.model]), ("fit", inputs.runs), ("held out", inputs.held_out or []),
             ("effects", [inputs.effects] if inputs.effects else []))  # fmt: skip
    return tuple(
        (role, str(path), path.stat().st_mtime if path.exists() else 0.0) for role, paths in roles for path in paths
    )
