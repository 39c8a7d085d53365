"""Background computations of the workbench: a thread that reads and fits opened files, and a process for searches."""

import asyncio
import os
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from multiprocessing import get_context
from multiprocessing.connection import Connection
from threading import Thread
from typing import Any, TypeVar

from armdyn.checked_study import CheckedStudy
from armdyn.errors import error_sentence
from ik.child_processes import initialise_child
from pipeline.console.inputs import ModelAndRunInputs
from pipeline.workbench.bench import Workbench

_T = TypeVar("_T")
SearchWork = Callable[[ModelAndRunInputs, Sequence[str], Callable[[str], None]], dict[str, Any]]
"""A search: function from input files, labels of effects to add first, and a progress function, to a JSON answer."""
SearchListener = Callable[[str, Any], None]
"""Function called from another thread with "progress" or "failed" and a sentence, or with "done" and the answer."""


class WorkbenchComputingThread:
    """A thread that reads the files of a model and its recordings, and then computes with them, one task at a time.

    Args:
        inputs: the files.
    """

    def __init__(self, inputs: ModelAndRunInputs) -> None:
        self.inputs = inputs
        self._thread = ThreadPoolExecutor(1, "armdyn-session")
        given = self._given = self._thread.submit(inputs.read)
        bench = self._bench = self._thread.submit(_first_look, given)
        self._ready = self._thread.submit(lambda: bench.result().linear_scorer)

    async def opened(self) -> tuple[CheckedStudy, Workbench]:
        """Wait until the model as given is fitted; return the read files and the workbench.

        Raises:
            InputError: a file cannot be used.
        """
        return await asyncio.wrap_future(self._given), await asyncio.wrap_future(self._bench)

    async def ready(self) -> None:
        """Wait until the change of the error by an effect can be predicted."""
        await asyncio.wrap_future(self._ready)

    async def do(self, work: Callable[[], _T]) -> _T:
        """Run a slow function in this thread, and return its result."""
        return await asyncio.wrap_future(self._thread.submit(work))


def _first_look(given: Future[CheckedStudy]) -> Workbench:
    bench = Workbench(given.result().study)
    _ = bench.given_state
    return bench


def inputs_key(inputs: ModelAndRunInputs) -> tuple[object, ...]:
    """Key of a set of input files, which changes when a file is written again."""
    roles = (("model", [inputs.model]), ("fit", inputs.runs), ("held out", inputs.held_out or []),
             ("effects", [inputs.effects] if inputs.effects else []))  # fmt: skip
    return inputs.trust_data, *(
        (role, str(path), path.stat().st_mtime if path.exists() else 0.0) for role, paths in roles for path in paths
    )


class SearchProcess:
    """A search in a separate process; it takes from one second to minutes.

    Args:
        work: the search, `run_diagnosis` or `run_discovery`.
        inputs: files of model and recordings.
        effects: labels of effects that are added to the model first.
        tell: function that is called with progress, failure or answer of the search.
    """

    def __init__(
        self, work: SearchWork, inputs: ModelAndRunInputs, effects: Sequence[str], tell: SearchListener
    ) -> None:
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

    def _listen(self, answers: Connection, tell: SearchListener) -> None:
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
        answers.send(("failed", error_sentence(error, "The search failed")))


def run_diagnosis(inputs: ModelAndRunInputs, effects: Sequence[str], say: Callable[[str], None]) -> dict[str, Any]:
    """Diagnose a model with some added effects.

    Args:
        inputs: files of model and recordings.
        effects: labels of the effects that are added first.
        say: called with a sentence on the progress.

    Returns:
        JSON of the command `armdyn diagnose`, with the labels of the added effects as ``beside``.

    Raises:
        InputError: a file or a label cannot be used.
    """
    from pipeline.answers import diagnosis_json

    given = inputs.read().with_effects(effects)
    return {**diagnosis_json(given.study, given.diagnose(say)), "beside": list(effects)}


def run_discovery(inputs: ModelAndRunInputs, effects: Sequence[str], say: Callable[[str], None]) -> dict[str, Any]:
    """Discover laws that a model with some added effects lacks, like the command `armdyn discover`.

    Args:
        inputs: files of model and recordings.
        effects: labels of the effects that are added first.
        say: called with a sentence on the progress.

    Returns:
        A ``sentence``, ``labels`` of the found effects, and ``text`` of a Python file that defines them.

    Raises:
        InputError: a file or a label cannot be used.
    """
    found = inputs.read().with_effects(effects).discover(say)
    labels = [one.label for one in found.laws]
    return {
        "sentence": found.sentence,
        "labels": labels,
        "text": found.file_text() if found.laws_outside_catalogue else "",
    }
