"""Run computations that take longer than a control cycle: directly in a simulation, in another process on a real robot.

A thread would not do, because checking a motion holds Python's global lock for up to 0.1 s.
"""

import multiprocessing
import pickle
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

from armdyn.errors import InputError, TaskFailedError, error_sentence
from ik.child_processes import initialise_child
from pipeline.processes import drop_real_time_priority

BackgroundFunction = Callable[[Any], Any]
ResultCallback = Callable[[Any], None]


class BackgroundWorker:
    """Runs long computations directly in the control loop, for a simulated robot whose clock stands meanwhile.

    Attributes:
        is_synchronous: whether `request` returns only when the computation is finished.
        is_computing: whether this process runs a long computation at present.
    """

    is_synchronous = True

    def __init__(self) -> None:
        self.is_computing = False
        self._work: dict[str, BackgroundFunction] = {}
        self._then: dict[str, list[ResultCallback]] = {}  # requests that wait for results, oldest first

    def register(self, name: str, work: BackgroundFunction) -> None:
        """Register the function `work` under a name; called before `start`."""
        self._work[name], self._then[name] = work, []

    def start(self) -> None:
        """Start the worker; it may not see later changes of the objects that the functions use."""

    def request(self, name: str, argument: Any, then: ResultCallback) -> None:
        """Request a computation.

        Args:
            name: name under which the function was registered.
            argument: argument of the function.
            then: function that is called with the result, now or later by `collect`.
        """
        self.is_computing = True
        try:
            result = self._work[name](argument)
        finally:
            self.is_computing = False
        then(result)

    def is_pending(self, name: str) -> bool:
        """Whether a computation of this name was requested and is not finished."""
        return bool(self._then[name])

    def collect(self) -> None:
        """Pass finished results to the functions that wait for them; called in every round of the control loop.

        Raises:
            Exception: a computation failed.
        """

    def stop(self) -> None:
        """Stop the worker; results that were not collected are lost."""


class ProcessWorker(BackgroundWorker):
    """Runs long computations in a forked process, while the control loop continues.

    Arguments and results are pickled. Changes that a computation makes to objects stay in the process. Call `start`
    while the arm is at rest, and if possible before other threads are started.

    Raises:
        InputError: the operating system cannot fork a process.
    """

    is_synchronous = False

    def __init__(self) -> None:
        if "fork" not in multiprocessing.get_all_start_methods():
            raise InputError("a robot that moves by itself needs Linux or macOS: this system cannot copy a process")
        super().__init__()
        self._connection: Connection | None = None
        self._process: multiprocessing.process.BaseProcess | None = None

    def start(self) -> None:
        """Fork the process; it does not see later changes of the objects that the functions use."""
        context = multiprocessing.get_context("fork")
        self._connection, other = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(self._connection, other, self._work), name="armdyn background", daemon=True
        )
        self._process.start()
        other.close()

    def request(self, name: str, argument: Any, then: ResultCallback) -> None:
        """Send a computation to the process; `then` is called with its result by a later `collect`."""
        if self._connection is None:
            raise RuntimeError("start the process before it is asked")
        self._then[name].append(then)
        try:
            self._connection.send_bytes(pickle.dumps((name, argument)))
        except OSError as error:
            raise _gone() from error

    def collect(self) -> None:
        """Pass finished results to the functions that wait for them.

        Raises:
            TaskFailedError: a computation failed, or the process has ended.
        """
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

    def stop(self) -> None:
        """Kill the process; results that were not collected are lost."""
        if self._process is not None and self._connection is not None:
            self._connection.close()
            self._process.kill()
            self._process.join()
        self._process = self._connection = None
        for waiting in self._then.values():
            waiting.clear()


def _gone() -> TaskFailedError:
    return TaskFailedError("the process that estimates and plans has ended: check this computer's memory")


def _serve(ours: Connection, connection: Connection, work: dict[str, BackgroundFunction]) -> None:
    """Main function of the process: compute until the other end of the pipe is closed."""
    drop_real_time_priority()
    ours.close()  # otherwise this process would keep the pipe open, and outlive its parent
    initialise_child()
    with suppress(EOFError, OSError):
        while True:
            name, argument = pickle.loads(connection.recv_bytes())
            try:
                answer = pickle.dumps((name, work[name](argument), None))
            except BaseException as error:
                answer = pickle.dumps((name, None, error_sentence(error, f"the {name} failed")))
            connection.send_bytes(answer)
