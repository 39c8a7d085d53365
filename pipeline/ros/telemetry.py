"""Messages that a trial publishes for observers, of standard types that rqt, Foxglove and rosbag read.

``/armdyn/estimate``: ``std_msgs/Float64MultiArray``, estimated length and its standard deviation [m].
``/armdyn/reference``: ``sensor_msgs/JointState``, the commanded joint positions and velocities.
``/armdyn/load_force``: ``geometry_msgs/WrenchStamped``, the string's tension as force along z [N].
``/armdyn/phase``: ``std_msgs/String``, the phase of the trial, latched.
"""

import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

from armdyn.errors import ArmdynError
from pipeline.record import Recorder
from pipeline.robot.protocol import ForceSample, Vector
from pipeline.ros.bridge import RosBridge
from pipeline.ros.topics import time_message

ESTIMATE_TOPIC, REFERENCE_TOPIC, LOAD_FORCE_TOPIC, PHASE_TOPIC = (
    f"/armdyn/{n}" for n in ("estimate", "reference", "load_force", "phase")
)
MIN_PUBLISH_PERIOD_SECONDS = 0.04
"""Shortest time between two messages on a topic [s]; the recording contains every sample."""
ESTIMATE_LAYOUT = {"dim": [{"label": "length [m], std [m]", "size": 2, "stride": 2}], "data_offset": 0}


class RosTelemetryPublisher:
    """Publishes messages on a trial for observers; failures are ignored here, because the arm's driver reports them.

    Args:
        bridge: connection to ROS.
        names: names of the commanded joints.
    """

    def __init__(self, bridge: RosBridge, names: Sequence[str]) -> None:
        self._bridge, self._names = bridge, list(names)
        self._next: dict[str, float] = {}
        self._phase = ""
        bridge.advertise(ESTIMATE_TOPIC, "std_msgs/Float64MultiArray", latch=True)
        bridge.advertise(REFERENCE_TOPIC, "sensor_msgs/JointState")
        bridge.advertise(LOAD_FORCE_TOPIC, "geometry_msgs/WrenchStamped")
        bridge.advertise(PHASE_TOPIC, "std_msgs/String", latch=True)

    def publish_reference(self, q: Vector, v: Vector) -> None:
        """Publish the commanded joint positions and velocities (n,) [rad, rad/s]."""
        if self._due(REFERENCE_TOPIC):
            position, velocity = q.tolist(), v.tolist()
            header = {"stamp": time_message(time.time())}
            self._say(
                REFERENCE_TOPIC, {"header": header, "name": self._names, "position": position, "velocity": velocity}
            )

    def publish_load_force(self, samples: Sequence[ForceSample]) -> None:
        """Publish the force of the newest of these samples of the load cell [N]."""
        if samples and self._due(LOAD_FORCE_TOPIC):
            force = {"x": 0.0, "y": 0.0, "z": samples[-1].force}
            self._say(LOAD_FORCE_TOPIC, {
                "header": {"stamp": time_message(time.time()), "frame_id": "load_cell"}, "wrench": {"force": force},
            })  # fmt: skip

    def publish_estimate(self, length: float, std: float) -> None:
        """Publish the estimated length of the string and its standard deviation [m]."""
        self._say(ESTIMATE_TOPIC, {"layout": ESTIMATE_LAYOUT, "data": [length, std]})

    def publish_phase(self, name: str) -> None:
        """Publish the present phase of the trial."""
        if name != self._phase:
            self._phase = name
            self._say(PHASE_TOPIC, {"data": name})

    def _due(self, topic: str) -> bool:
        now = time.monotonic()
        if now < self._next.get(topic, now):
            return False
        self._next[topic] = now + MIN_PUBLISH_PERIOD_SECONDS
        return True

    def _say(self, topic: str, message: Mapping[str, Any]) -> None:
        with suppress(ArmdynError):
            self._bridge.publish(topic, message)


class PublishingRecorder(Recorder):
    """A trial's recorder that also publishes each new estimate of the string's length."""

    def __init__(self, *arguments: Any, telemetry: RosTelemetryPublisher, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self._telemetry = telemetry

    def record(self, channel: str, time: float, value: float) -> None:
        """Record one sample of a channel, and publish it if it is a new estimate of the length."""
        super().record(channel, time, value)
        if channel == "estimate.length_std":
            self._telemetry.publish_estimate(float(self.channel("estimate.length").value[-1]), value)
