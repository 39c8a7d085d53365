"""Background work of the page: a thread that reads, fits and writes for opened files, and a process for a search."""

import asyncio
import os
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from multiprocessing import get_context
from multiprocessing.connection import Connection
from threading import Thread
from typing import Any, TypeVar

from armdyn.checked_study import CheckedStudy
from armdyn.errors import sentence_of
from ik.child_processes import initialise_child
from pipeline.console.inputs import ModelAndRunInputs
from pipeline.workbench.bench import Workbench

_T = TypeVar("_T")
SearchWork = Callable[[ModelAndRunInputs, Sequence[str], Callable[[str], None]], dict[str, Any]]
"""Function from files, labels of effects that the model gets first, and a receiver of progress, to an answer."""
Tell = Callable[[str, Any], None]
"""Told from another thread how a search goes: "progress" or "failed" with a sentence, "done" with an answer."""


class Session:
    """A model and runs that are read in a thread of their own, which goes on to compute with them one by one."""

    def __init__(self, inputs: ModelAndRunInputs) -> None:
        self.inputs = inputs
        self._thread = ThreadPoolExecutor(1, "armdyn-session")
        given = self._given = self._thread.submit(inputs.read)
        bench = self._bench = self._thread.submit(_first_look, given)
        self._ready = self._thread.submit(lambda: bench.result().expansion)

    async def opened(self) -> tuple[CheckedStudy, Workbench]:
        """Inputs and workbench, as soon as the given model can be shown.

        Raises:
            InputError: a file cannot be used.
        """
        return await asyncio.wrap_future(self._given), await asyncio.wrap_future(self._bench)

    async def ready(self) -> None:
        """Wait until the change by an effect can be predicted."""
        await asyncio.wrap_future(self._ready)

    async def do(self, work: Callable[[], _T]) -> _T:
        """Run a slow function in the session's thread, and return its answer."""
        return await asyncio.wrap_future(self._thread.submit(work))


def _first_look(given: Future[CheckedStudy]) -> Workbench:
    bench = Workbench(given.result().study)
    _ = bench.opening
    return bench


def key_of(inputs: ModelAndRunInputs) -> tuple[object, ...]:
    """Key of input files that changes with their contents."""
    roles = (("model", [inputs.model]), ("fit", inputs.runs), ("held out", inputs.held_out or []),
             ("effects", [inputs.effects] if inputs.effects else []))  # fmt: skip
    return inputs.trust_data, *(
        (role, str(path), path.stat().st_mtime if path.exists() else 0.0) for role, paths in roles for path in paths
    )


class SearchProcess:
    """One search in a separate process; it takes from a second to minutes.

    Args:
        work: the search, `diagnosed` or `discovered`.
        inputs: files of model and runs.
        effects: labels of effects that are added to the model first.
        tell: see `Tell`; the answer is that of `work`.
    """

    def __init__(self, work: SearchWork, inputs: ModelAndRunInputs, effects: Sequence[str], tell: Tell) -> None:
        # The process is not forked: the server has threads, whose locks a copy would hold for ever.
        context = get_context("spawn")
        mine, theirs = context.Pipe(duplex=False)
        arguments = (work, inputs, tuple(effects), theirs)
        self._process = context.Process(target=_search, args=arguments, daemon=True, name="armdyn-search")
        self._stopped = False
        self._process.start()
        theirs.close()
        Thread(target=self._listen, args=(mine, tell), daemon=True).start()

    def stop(self) -> None:
        """End the search without an answer."""
        self._stopped = True
        self._process.kill()

    def _listen(self, answers: Connection, tell: Tell) -> None:
        kind = "progress"
        while kind == "progress":
            try:
                kind, what = answers.recv()
            except (EOFError, OSError):
                kind, what = "failed", "The search ended before it had an answer: start it again."
            if not self._stopped:
                tell(kind, what)
        self._process.join()


def _search(work: SearchWork, inputs: ModelAndRunInputs, effects: tuple[str, ...], answers: Connection) -> None:
    initialise_child()
    os.nice(5)  # the page's process has priority
    try:
        answers.send(("done", work(inputs, effects, lambda what: answers.send(("progress", what)))))
    except Exception as error:
        answers.send(("failed", sentence_of(error, "The search failed")))


def diagnosed(inputs: ModelAndRunInputs, effects: Sequence[str], say: Callable[[str], None]) -> dict[str, Any]:
    """JSON of `armdyn diagnose` for a model with some added effects, whose labels are in ``beside``.

    Raises:
        InputError: something cannot be used.
    """
    from pipeline.answers import diagnosis_answer

    given = inputs.read().with_effects(effects)
    return {**diagnosis_answer(given.study, given.diagnose(say)), "beside": list(effects)}


def discovered(inputs: ModelAndRunInputs, effects: Sequence[str], say: Callable[[str], None]) -> dict[str, Any]:
    """Laws found by `armdyn discover` beside some effects: a ``sentence``, ``labels`` to tick, ``text`` of their file.

    Raises:
        InputError: something cannot be used.
    """
    found = inputs.read().with_effects(effects).discover(say)
    labels = [one.label for one in found.findings]
    return {"sentence": found.sentence, "labels": labels, "text": found.file_text() if found.new else ""}
