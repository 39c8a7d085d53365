"""The ROS master: a watch on whether it still answers, and the round-trip time of messages.

Its death goes unnoticed, because connections between nodes live without it. The bridge looks a service up at the
master for every call, so that a call shows whether the master answers. On ROS 2, which has no master, it always does.
"""

import threading
import time
from itertools import count

from armdyn.errors import InputError
from pipeline.processes import HighPriorityThread
from pipeline.robot.link import Spread
from pipeline.ros.bridge import Bridge, BridgeError, Message

MASTER_SERVICE = "/rosapi/get_time"
"""What is called; also where nobody offers it, the bridge has to ask the master first."""
MASTER_CALL_PERIOD_SECONDS = 0.05
"""Time between two calls [s]: an arm that has to stand 0.3 s after the fault leaves about 0.2 s to see it."""
MASTER_GONE_TEXT = "communicate with master"
"""What the bridge answers where the master does not: ``Unable to communicate with master!``."""


class MasterWatch:
    """A thread that asks the ROS master repeatedly until it is closed.

    Attributes:
        trouble: a sentence once the master is gone, otherwise None.
    """

    def __init__(self, bridge: Bridge) -> None:
        self._bridge = bridge
        self.trouble: str | None = None
        self._closed = threading.Event()
        self._thread = HighPriorityThread(self._ask, "ROS master")
        self._thread.start()

    def close(self) -> None:
        """End the thread after its present call."""
        self._closed.set()

    def _ask(self) -> None:
        while not self._closed.wait(MASTER_CALL_PERIOD_SECONDS):
            try:
                self._bridge.call(MASTER_SERVICE)
            except BridgeError:
                return  # the bridge itself reports that it is lost
            except InputError as error:  # no such service, or no answer: the messages themselves show delays
                if MASTER_GONE_TEXT in str(error):
                    self.trouble = f"{self._bridge.uri}: the ROS master is gone: restart master and bridge"
                    return


PING_TOPIC = "/armdyn/ping"
PINGS = 50
"""How many pings are sent."""
PING_PERIOD = 0.01
"""Time between two pings [s]: the bridge's delays depend on it."""
PING_TIMEOUT = 3.0
"""Longest time to the first answer and after the last ping [s]."""
MIN_PING_SHARE = 0.5
"""Share of the pings that come back through a bridge that works."""
_names = count()


def round_trip(bridge: Bridge) -> Spread:
    """Round-trip times [s] of pings that are sent at 100 Hz.

    Raises:
        InputError: fewer than half of them return; a bridge that pauses for 60 ms keeps one of six pings.
    """
    topic = f"{PING_TOPIC}_{next(_names)}"
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
    for _ in range(round(PING_TIMEOUT / 0.05)):  # wait until publisher and subscriber are connected
        bridge.publish(topic, {"data": -1.0})
        if heard.wait(0.05):
            break
    for number in range(PINGS):
        sent[number] = bridge.time
        bridge.publish(topic, {"data": float(number)})
        time.sleep(PING_PERIOD)
    end = time.monotonic() + PING_TIMEOUT
    while len(took) < PINGS and time.monotonic() < end:
        time.sleep(PING_PERIOD)
    spread = Spread.of(took.values())
    if spread is None or spread.count < MIN_PING_SHARE * PINGS:
        raise InputError(
            f"{bridge.uri}: {len(took)} of {PINGS} messages came back: does the bridge reach the ROS master?"
        )
    return spread
