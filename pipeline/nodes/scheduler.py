"""The control loop, which runs every node at its own rate on the robot's clock, and the watchdog of the loop."""

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from math import inf, isfinite
from time import monotonic, perf_counter
from types import TracebackType
from typing import Protocol, Self

from armdyn.errors import InputError, TaskFailedError
from pipeline.processes import HighPriorityThread
from pipeline.robot.protocol import RobotInterface

MAX_BACKWARD_CLOCK_STEP_SECONDS = 1e-3
"""Allowed backward step of a clock between two readings [s]."""


class ClockError(TaskFailedError):
    """The control loop stood still for too long, or its clock jumped, so that the commands are not a smooth motion."""


class Node(Protocol):
    """A task that the control loop runs at a fixed rate.

    Attributes:
        name: name of the node, for tables and messages.
        period: time between two steps [s].
    """

    name: str
    period: float

    def step(self, now: float) -> None:
        """Run the node's task once; `now` is the time for which this step was planned [s]."""


@dataclass
class NodeTiming:
    """Computing times of a node's steps.

    Attributes:
        name: name of the node.
        period: time between two steps [s]; None for a node that runs once.
        steps: number of steps.
        total: computing time of all steps [s].
        longest: longest computing time of one step [s].
        overruns: number of steps that took longer than the node's period, or began late by more than a period.
        skipped: number of steps that were left out because their time had passed.
    """

    name: str
    period: float | None
    steps: int = 0
    total: float = 0.0
    longest: float = 0.0
    overruns: int = 0
    skipped: int = 0

    @property
    def mean(self) -> float:
        """Mean computing time of a step [s]."""
        return self.total / self.steps if self.steps else 0.0


class Scheduler:
    """Runs nodes at their rates on the clock of a robot; nodes that are due at the same time run in the given order.

    A late node runs once, as soon as possible; steps whose time has passed meanwhile are skipped and counted.

    Args:
        robot: robot whose clock is used; a simulated robot computes the time until the next step, a real one waits.
        nodes: nodes in the order in which data flow.
        patience: function that returns how long the loop may stand still [s]; None to only count late steps.
        each_round: function that is called at the begin of every round; None for nothing.

    Attributes:
        timing: computing times of each node, by name.
        running: name of the node that runs at present, or ran last.
    """

    def __init__(
        self,
        robot: RobotInterface,
        nodes: Sequence[Node],
        patience: Callable[[], float] | None = None,
        each_round: Callable[[], None] | None = None,
    ) -> None:
        for node in nodes:
            if not node.period > 0:
                raise InputError(f"node '{node.name}' has a period of {node.period} s: it must be positive")
        self._robot, self._nodes = robot, tuple(nodes)
        self._patience, self._each_round = patience, each_round
        self.begin()
        self.running = nodes[0].name
        self.timing = {node.name: NodeTiming(node.name, node.period) for node in nodes}

    def begin(self) -> None:
        """Plan the first step of every node for the present time; it is also called when the scheduler is created."""
        self._seen = self._robot.time
        self._start = {node.name: self._seen for node in self._nodes}
        self._count = {node.name: 0 for node in self._nodes}

    def run(self, until: Callable[[], bool], longest: float) -> bool:
        """Run the loop until a condition is satisfied.

        Args:
            until: the condition, which is tested after every round.
            longest: longest duration [s].

        Returns:
            Whether the condition is satisfied.

        Raises:
            ClockError: the loop stood still for too long, or the clock jumped, if `patience` was given.
        """
        end = self._robot.time + longest
        while not until():
            due = min(self._due(node) for node in self._nodes)
            if due > end + 1e-9:
                self._wait_until(end)
                return until()
            with self._watched("waiting", until=due):
                self._wait_until(due)
            with self._watched("the nodes"):
                if self._each_round is not None:
                    self._each_round()
                for node in self._nodes:
                    if self._due(node) <= due + 1e-9:
                        self._step(node)
        return True

    def _wait_until(self, time: float) -> None:
        """Wait until a time [s], if it has not passed."""
        remaining = time - self._robot.time
        if remaining > 1e-9:
            self._robot.advance(remaining)

    @contextmanager
    def _watched(self, what: str, until: float = -inf) -> Iterator[None]:
        """Check that the clock runs to about `until` [s] in the block, and has not jumped since the last check."""
        if self._patience is None:
            yield
            return
        patience = self._patience()
        self._require_steady("pausing", self._robot.time - self._seen, patience)
        self._seen = self._robot.time
        yield
        self._require_steady(what, self._robot.time - max(until, self._seen), patience)
        self._seen = self._robot.time

    def _require_steady(self, what: str, late: float, patience: float) -> None:
        # Written in this form, the comparison also fails for a time that is nan.
        if not -MAX_BACKWARD_CLOCK_STEP_SECONDS <= late <= patience:
            raise ClockError(
                f"the loop stood still or its clock jumped at {self._seen:.2f} s: while {what} ({self.running} node) "
                f"{1e3 * late:.0f} ms passed that should not have: check this computer's load and the robot's clock"
            )

    def _due(self, node: Node) -> float:
        return self._start[node.name] + self._count[node.name] * node.period

    def _step(self, node: Node) -> None:
        due, timing = self._due(node), self.timing[node.name]
        late = self._robot.time - due
        self.running = node.name
        begun = perf_counter()
        node.step(due)
        took = perf_counter() - begun
        timing.steps += 1
        timing.total += took
        timing.longest = max(timing.longest, took)
        if took > node.period or late > node.period:
            timing.overruns += 1
        self._count[node.name] += 1
        behind = (self._robot.time - self._due(node)) / node.period
        behind = int(behind) if isfinite(behind) else 0
        if behind > 0:
            timing.skipped += behind
            self._count[node.name] += behind


WATCHDOG_PERIOD_SECONDS = 0.002
"""Time between two checks of the watchdog [s]."""


class Watchdog:
    """A thread that stops the arm if the control loop hangs, that is, if the loop does not call `report_alive` in time.

    Use it for a real robot only: the clock of a simulated robot stands while this program computes. The thread cannot
    run while other code holds Python's global lock; then only the robot's own timeout helps.

    Args:
        stop: function that brings the arm to rest; it is called from the watchdog's thread.
        moving: function that returns whether the arm is commanded to move; an arm at rest is not stopped.
        patience: longest time between two calls of `report_alive` [s].

    Attributes:
        fault: message about the stop; None before.
    """

    def __init__(self, stop: Callable[[], None], moving: Callable[[], bool], patience: float) -> None:
        self._stop, self._moving, self._patience = stop, moving, patience
        self._seen = monotonic()
        self._ended = threading.Event()
        self._thread = HighPriorityThread(self._watch, "watchdog")
        self.fault: str | None = None

    def report_alive(self) -> None:
        """Report that the control loop is running; called in every round."""
        self._seen = monotonic()

    def __enter__(self) -> Self:
        self.report_alive()
        self._thread.start()
        return self

    def __exit__(self, *_error: type[BaseException] | BaseException | TracebackType | None) -> None:
        self._ended.set()
        self._thread.join(timeout=1.0)  # `stop` may hang too; then only the robot's own timeout is left

    def _watch(self) -> None:
        while not self._ended.wait(WATCHDOG_PERIOD_SECONDS):
            silence = monotonic() - self._seen
            if silence > self._patience and self._moving():
                self.fault = f"the watchdog stopped the arm: the loop had not come round for {1e3 * silence:.0f} ms"
                try:
                    self._stop()
                except Exception as error:  # no caller exists here to which the error could be raised
                    self.fault += f", and stopping failed ({type(error).__name__}: {error})"
                return
