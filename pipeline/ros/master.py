"""Whether the ROS master is still there: its death goes unnoticed, because connections between nodes live without it.

The bridge looks a service up at the master for every call, so that a call shows whether the master answers. On ROS 2,
which has no master, it always does.
"""

import threading

from armdyn.errors import InputError
from pipeline.priority import PromptThread
from pipeline.ros.bridge import Bridge, BridgeError

SERVICE = "/rosapi/get_time"
"""What is called; also where nobody offers it, the bridge has to ask the master first."""
EVERY = 0.05
"""Time between two calls [s]: an arm that has to stand 0.3 s after the fault leaves about 0.2 s to see it."""
GONE = "communicate with master"
"""What the bridge answers where the master does not: ``Unable to communicate with master!``."""


class MasterWatch:
    """A thread that asks until it is closed.

    Args:
        bridge: a connection to rosbridge.

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
        while not self._closed.wait(EVERY):
            try:
                self._bridge.call(SERVICE)
            except BridgeError:
                return  # the bridge itself says that it is lost
            except InputError as error:  # no such service, or no answer: the messages themselves show what is late
                if GONE in str(error):
                    self.trouble = f"{self._bridge.uri}: the ROS master is gone: restart master and bridge"
                    return
