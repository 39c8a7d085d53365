"""Work longer than a cycle of the loop: done at once on a simulated clock, in another process on a real one.

A process and not a thread: the check of a motion holds Python's lock for up to 0.1 s at a time, and the estimator and
SAC would share CasADi's buffers.
"""

import multiprocessing
import pickle
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

from armdyn.errors import InputError, TaskFailedError, sentence_of
from ik.child_processes import initialise_child
from pipeline.processes import be_ordinary

Work = Callable[[Any], Any]
Then = Callable[[Any], None]


class BackgroundWorker:
    """Does long work at once in the loop, which is right on a simulated clock, where no time passes meanwhile.

    Attributes:
        at_once: whether `ask` returns only when the work is done, and no time passes meanwhile.
        thinking: whether this process does such work now.
    """

    at_once = True

    def __init__(self) -> None:
        self.thinking = False
        self._work: dict[str, Work] = {}
        self._then: dict[str, list[Then]] = {}  # requests that wait for results, oldest first

    def provide(self, name: str, work: Work) -> None:
        """Register a function under a name, before `start`."""
        self._work[name], self._then[name] = work, []

    def start(self) -> None:
        """Start the worker; later changes of the objects that it uses may not reach it."""

    def ask(self, name: str, argument: Any, then: Then) -> None:
        """Request `work(argument)`; `then` is called with the result in the loop, by `collect` at the latest."""
        self.thinking = True
        try:
            result = self._work[name](argument)
        finally:
            self.thinking = False
        then(result)

    def busy(self, name: str) -> bool:
        """Whether work of this name was requested and is not done."""
        return bool(self._then[name])

    def collect(self) -> None:
        """Hand out finished results; called in every round of the loop.

        Raises:
            Exception: the exception that the work raised.
        """

    def end(self) -> None:
        """End the worker; results that were not collected are lost."""


class ProcessWorker(BackgroundWorker):
    """Does long work in a process that begins as a copy of this one, while the loop goes on.

    Arguments and results are copied by pickling; changes that the work makes to its objects
    stays in the process. `start` it while the arm stands, and before other threads are started where that is possible.

    Raises:
        InputError: this system cannot copy a process.
    """

    at_once = False

    def __init__(self) -> None:
        if "fork" not in multiprocessing.get_all_start_methods():
            raise InputError("a robot that moves by itself needs Linux or macOS: this system cannot copy a process")
        super().__init__()
        self._connection: Connection | None = None
        self._process: multiprocessing.process.BaseProcess | None = None

    def start(self) -> None:
        """See `BackgroundWorker`."""
        context = multiprocessing.get_context("fork")
        self._connection, other = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(self._connection, other, self._work), name="armdyn background", daemon=True
        )
        self._process.start()
        other.close()

    def ask(self, name: str, argument: Any, then: Then) -> None:
        """See `BackgroundWorker`."""
        if self._connection is None:
            raise RuntimeError("start the process before it is asked")
        self._then[name].append(then)
        try:
            self._connection.send_bytes(pickle.dumps((name, argument)))
        except OSError as error:
            raise _gone() from error

    def collect(self) -> None:
        """See `BackgroundWorker`."""
        if self._connection is None:
            return
        try:
            while self._connection.poll():
                name, result, problem = pickle.loads(self._connection.recv_bytes())
                then = self._then[name].pop(0)
                if problem is not None:
                    raise TaskFailedError(problem)
                then(result)
        except (EOFError, OSError) as error:
            raise _gone() from error

    def end(self) -> None:
        """See `BackgroundWorker`."""
        if self._process is not None and self._connection is not None:
            self._connection.close()
            self._process.kill()
            self._process.join()
        self._process = self._connection = None
        for waiting in self._then.values():
            waiting.clear()


def _gone() -> TaskFailedError:
    return TaskFailedError("the process that estimates and plans has ended: check this computer's memory")


def _serve(ours: Connection, connection: Connection, work: dict[str, Work]) -> None:
    """Main function of the process: it works until the other end of the pipe is closed."""
    be_ordinary()
    ours.close()  # otherwise this process would keep the pipe open, and outlive its parent
    initialise_child()
    with suppress(EOFError, OSError):
        while True:
            name, argument = pickle.loads(connection.recv_bytes())
            try:
                answer = pickle.dumps((name, work[name](argument), None))
            except BaseException as error:
                answer = pickle.dumps((name, None, sentence_of(error, f"the {name} failed")))
            connection.send_bytes(answer)
