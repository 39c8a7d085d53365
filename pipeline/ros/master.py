"""Checks of the ROS network: whether the ROS master still answers, and the round-trip time of messages.

Connections between nodes continue without a master, so its end is not noticed. For every call of a service the bridge
looks the service up at the master; therefore a call shows whether the master answers. ROS 2 has no master, and calls
never fail for this reason.
"""

import threading
import time
from itertools import count

from armdyn.errors import InputError
from pipeline.processes import HighPriorityThread
from pipeline.robot.link import Percentiles
from pipeline.ros.bridge import BridgeError, Message, RosBridge

MASTER_SERVICE = "/rosapi/get_time"
"""Service that is called to test the master; it need not exist, since the bridge asks the master first."""
MASTER_CALL_PERIOD_SECONDS = 0.05
"""Time between two test calls of the ROS master [s]: the arm must stand 0.3 s after the fault, which leaves about 0.2 s
for its detection."""
MASTER_LOST_TEXT = "communicate with master"
"""Part of the bridge's answer when the master does not answer: ``Unable to communicate with master!``."""


class MasterWatch:
    """A thread that tests repeatedly whether the ROS master answers.

    Attributes:
        trouble: sentence on the lost master; None while it answers.
    """

    def __init__(self, bridge: RosBridge) -> None:
        self._bridge = bridge
        self.trouble: str | None = None
        self._closed = threading.Event()
        self._thread = HighPriorityThread(self._ask, "ROS master")
        self._thread.start()

    def close(self) -> None:
        """End the thread after its present test."""
        self._closed.set()

    def _ask(self) -> None:
        while not self._closed.wait(MASTER_CALL_PERIOD_SECONDS):
            try:
                self._bridge.call(MASTER_SERVICE)
            except BridgeError:
                return  # the bridge itself reports that it is lost
            except InputError as error:  # no such service, or no answer: the messages themselves show delays
                if MASTER_LOST_TEXT in str(error):
                    self.trouble = f"{self._bridge.uri}: the ROS master is gone: restart master and bridge"
                    return


PING_TOPIC = "/armdyn/ping"
PING_COUNT = 50
"""Number of messages (pings) that are sent to measure the round-trip time."""
PING_PERIOD_SECONDS = 0.01
"""Time between two pings [s], as between commands, because the bridge's delays depend on it."""
PING_TIMEOUT_SECONDS = 3.0
"""Longest waiting time for the first ping to return, and for the rest after the last ping [s]."""
MIN_RETURNED_PING_SHARE = 0.5
"""Smallest share of pings that must return through a working bridge."""
_names = count()


def round_trip_times(bridge: RosBridge) -> Percentiles:
    """Measure round-trip times of messages through a bridge, sent at 100 Hz [s].

    Raises:
        InputError: fewer than half of the messages return.
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
    for _ in range(round(PING_TIMEOUT_SECONDS / 0.05)):  # wait until publisher and subscriber are connected
        bridge.publish(topic, {"data": -1.0})
        if heard.wait(0.05):
            break
    for number in range(PING_COUNT):
        sent[number] = bridge.time
        bridge.publish(topic, {"data": float(number)})
        time.sleep(PING_PERIOD_SECONDS)
    end = time.monotonic() + PING_TIMEOUT_SECONDS
    while len(took) < PING_COUNT and time.monotonic() < end:
        time.sleep(PING_PERIOD_SECONDS)
    spread = Percentiles.of(took.values())
    if spread is None or spread.count < MIN_RETURNED_PING_SHARE * PING_COUNT:
        raise InputError(
            f"{bridge.uri}: {len(took)} of {PING_COUNT} messages came back: does the bridge reach the ROS master?"
        )
    return spread
