"""Files that were opened once, and the one thread that computes with them, so that the page never waits."""

import asyncio
from collections.abc import Callable
from concurrent.futures import Future
from queue import SimpleQueue
from threading import Thread
from typing import Any, TypeVar

from pipeline.console.inputs import Given, Inputs
from pipeline.workbench.bench import Bench

T = TypeVar("T")
Work = SimpleQueue[tuple[Future[Any], Callable[[], Any]] | None]


class Desk:
    """A model and runs that are read in the background."""

    def __init__(self, inputs: Inputs) -> None:
        self.inputs = inputs
        self._work: Work = SimpleQueue()
        # A daemon: the program ends at once, whatever is being computed.
        Thread(target=_working, args=(self._work,), name="armdyn-desk", daemon=True).start()
        given = self._given = self._submit(inputs.read)
        bench = self._bench = self._submit(lambda: _first_look(given.result()))
        self._ready = self._submit(lambda: bench.result().foretelling)

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

    def __del__(self) -> None:
        self._work.put(None)

    def _submit(self, work: Callable[[], T]) -> "Future[T]":
        future: Future[T] = Future()
        self._work.put((future, work))
        return future


def _first_look(given: Given) -> Bench:
    bench = Bench(given.study)
    _ = bench.opening
    return bench


def _working(queue: Work) -> None:
    """One after the other; it holds no desk, so that one which nobody uses any more goes with all that was opened."""
    while (item := queue.get()) is not None:
        future, work = item
        if future.set_running_or_notify_cancel():
            try:
                future.set_result(work())
            except BaseException as error:
                future.set_exception(error)
        del item, future, work


def key_of(inputs: Inputs) -> tuple[object, ...]:
    """Tells files, as they are now, from others."""
    roles = (("model", [inputs.model]), ("fit", inputs.runs), ("held out", inputs.held_out or []),
             ("effects", [inputs.effects] if inputs.effects else []))  # fmt: skip
    return inputs.trust_data, *(
        (role, str(path), path.stat().st_mtime if path.exists() else 0.0) for role, paths in roles for path in paths
    )
