"""The ROS master: whether it is still there, and how long a message takes to it and back.

Its death goes unnoticed, because connections between nodes live without it. The bridge looks a service up at the
master for every call, so that a call shows whether the master answers. On ROS 2, which has no master, it always does.
"""

import threading
import time
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import count
from typing import Any

import numpy as np

from armdyn.errors import InputError
from pipeline.processes import PromptThread
from pipeline.ros.bridge import Bridge, BridgeError, Message

SERVICE = "/rosapi/get_time"
"""What is called; also where nobody offers it, the bridge has to ask the master first."""
ASKED_EVERY = 0.05
"""Time between two calls [s]: an arm that has to stand 0.3 s after the fault leaves about 0.2 s to see it."""
GONE = "communicate with master"
"""What the bridge answers where the master does not: ``Unable to communicate with master!``."""


class MasterWatch:
    """A thread that asks until it is closed.

    Attributes:
        trouble: a sentence once the master is gone, else None.
    """

    def __init__(self, bridge: Bridge) -> None:
        self._bridge = bridge
        self.trouble: str | None = None
        self._closed = threading.Event()
        self._thread = PromptThread(self._ask, "ROS master")
        self._thread.start()

    def close(self) -> None:
        """End the thread after the call under way."""
        self._closed.set()

    def _ask(self) -> None:
        while not self._closed.wait(ASKED_EVERY):
            try:
                self._bridge.call(SERVICE)
            except BridgeError:
                return  # the bridge itself says that it is lost
            except InputError as error:  # no such service, or no answer: the messages themselves show what is late
                if GONE in str(error):
                    self.trouble = f"{self._bridge.uri}: the ROS master is gone: restart master and bridge"
                    return


TOPIC = "/armdyn/ping"
EVERY = 0.01
"""Time between two pings [s]: the bridge's delays depend on it."""
PATIENCE = 3.0
"""Longest time to the first answer and after the last ping [s]."""
ENOUGH = 0.5
"""Share of the pings that come back through a bridge that works."""
_names = count()


@dataclass(frozen=True)
class Spread:
    """How some quantity was spread, in its own unit.

    Attributes:
        count: values.
        median: half are below it.
        p95: 95 % are below it.
        p99: 99 % are below it.
        worst: the largest.
    """

    count: int
    median: float
    p95: float
    p99: float
    worst: float

    @classmethod
    def of(cls, values: Iterable[float]) -> "Spread | None":
        """Of some values; None where there are none."""
        array = np.array(list(values))
        if not array.size:
            return None
        median, p95, p99 = np.percentile(array, [50, 95, 99])
        return cls(array.size, float(median), float(p95), float(p99), float(array.max()))

    def as_json(self, digits: int = 5) -> dict[str, float]:
        """For the answer of a command."""
        return {name: round(value, digits) for name, value in vars(self).items()}

    @property
    def milliseconds(self) -> str:
        """In words, of times in s."""
        return f"{1e3 * self.median:.1f} ms, 99 % {1e3 * self.p99:.1f} ms, worst {1e3 * self.worst:.1f} ms"


def round_trip(bridge: Bridge, pings: int = 50) -> Spread:
    """Send pings at 100 Hz and see when they come back [s].

    Raises:
        InputError: fewer than half come back; a bridge that pauses for 60 ms keeps one of the six sent meanwhile.
    """
    topic = f"{TOPIC}_{next(_names)}"
    sent: dict[int, float] = {}
    took: dict[int, float] = {}
    heard = threading.Event()

    def take(message: Message, now: float) -> None:
        number = round(float(message["data"]))
        if number < 0:
            heard.set()
        elif number in sent:
            took.setdefault(number, now - sent[number])

    bridge.advertise(topic, "std_msgs/Float64")
    bridge.subscribe(topic, "std_msgs/Float64", take)
    for _ in range(round(PATIENCE / 0.05)):  # until publisher and subscriber have found each other
        bridge.publish(topic, {"data": -1.0})
        if heard.wait(0.05):
            break
    for number in range(pings):
        sent[number] = bridge.time
        bridge.publish(topic, {"data": float(number)})
        time.sleep(EVERY)
    end = time.monotonic() + PATIENCE
    while len(took) < pings and time.monotonic() < end:
        time.sleep(EVERY)
    spread = Spread.of(took.values())
    if spread is None or spread.count < ENOUGH * pings:
        raise InputError(
            f"{bridge.uri}: {len(took)} of {pings} messages came back: does the bridge reach the ROS master?"
        )
    return spread


@dataclass
class Figures:
    """What is measured while it runs.

    Attributes:
        round_trip: of messages before the first motion [s]; None before it was measured.
        intervals: between two commands of one stream [s].
        ages: of the newest joint state when a command was sent [s].
        echoes: from sending a command to seeing it on its topic [s].
        commands: sent.
    """

    round_trip: Spread | None = None
    intervals: deque[float] = field(default_factory=lambda: deque(maxlen=100_000))
    ages: deque[float] = field(default_factory=lambda: deque(maxlen=100_000))
    echoes: deque[float] = field(default_factory=lambda: deque(maxlen=100_000))
    commands: int = 0

    def as_json(self) -> dict[str, Any]:
        """Spread of each [s]."""
        spreads = {"command_interval": self.intervals, "state_age": self.ages, "command_echo": self.echoes}
        found = {name: Spread.of(tuple(values)) for name, values in spreads.items()}
        return {
            "commands": self.commands,
            "round_trip": self.round_trip.as_json() if self.round_trip else None,
            **{name: spread.as_json() if spread else None for name, spread in found.items()},
        }
