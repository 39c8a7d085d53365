"""Wrenches of force/torque sensors from ROS topics: their samples at the times of joint states."""

import math
from bisect import bisect_left
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress

import numpy as np

from armdyn.errors import InputError
from armdyn.recording.channels import WRENCH_CHANNELS, FloatArray
from armdyn.watch.observer import MAX_SAMPLE_GAP_SECONDS
from pipeline.ros.bridge import BridgeError, Message, RosBridge
from pipeline.ros.states import FIRST_STATE_TIMEOUT_SECONDS, StampClock, finite_array, header_stamp

WRENCH_TYPE = "geometry_msgs/WrenchStamped"
MAX_KEPT_WRENCHES = 4000
"""Number of wrenches that are kept: half a second of a sensor at 7 kHz."""


def chosen_wrench_topics(chosen: Sequence[str]) -> dict[str, str]:
    """Topics by sensor, of texts ``"SENSOR=TOPIC"``.

    Raises:
        InputError: a text has another form, or a sensor or a topic is given twice.
    """
    found: dict[str, str] = {}
    for text in chosen:
        name, _, topic = (part.strip() for part in text.partition("="))
        if not name.isidentifier() or topic[:1] != "/":
            raise InputError(f"--wrench {text}: write it as ft=/ft_sensor/wrench, the sensor and its topic")
        if name in found or topic in found.values():
            raise InputError(f"--wrench {text}: this sensor or this topic is given twice")
        found[name] = topic
    return found


def wrench_values(message: Message) -> FloatArray | None:
    """Forces [N] and torques [N m] of a message WrenchStamped, (6,); None if one is missing or not finite."""
    try:
        parts = [message["wrench"][part][axis] for part in ("force", "torque") for axis in "xyz"]
    except (KeyError, TypeError):
        return None
    return finite_array(parts)


class WrenchBuffer:
    """The latest wrenches of a sensor, on this program's clock.

    Attributes:
        newest: time of the newest wrench [s]; minus infinity before the first.
    """

    def __init__(self) -> None:
        self._stamps, self.newest = StampClock(), -math.inf
        self._kept = deque[tuple[float, FloatArray]](maxlen=MAX_KEPT_WRENCHES)

    def take(self, message: Message, received: float) -> None:
        """Store a message that was received at a time [s]; one that is repeated, or cannot be read, is left out."""
        values, stamp = wrench_values(message), header_stamp(message)
        if values is None or not math.isfinite(stamp):
            return
        time = self._stamps.local(stamp, received) if stamp > 0.0 else received
        if time > self.newest:
            self.newest = time
            self._kept.append((time, values))

    def at(self, time: float) -> FloatArray:
        """The wrench (6,) at a time [s], interpolated as that of a recording; nan beyond its ends and in its gaps."""
        after = bisect_left(self._kept, time, key=lambda sample: sample[0])
        if after == len(self._kept) or (after == 0 and self._kept[0][0] > time):
            return np.full(len(WRENCH_CHANNELS), np.nan)
        (end, later), (start, earlier) = self._kept[after], self._kept[max(after - 1, 0)]
        if end - start > MAX_SAMPLE_GAP_SECONDS:
            return np.full(len(WRENCH_CHANNELS), np.nan)
        share = (time - start) / (end - start) if end > start else 1.0
        return (1.0 - share) * earlier + share * later


def topics_with_wrenches(bridge: RosBridge) -> str:
    """On which topics wrenches are sent, as the end of a sentence."""
    found = _asked(bridge, "topics_for_type", {"type": WRENCH_TYPE}).get("topics")
    if not isinstance(found, list) or not found:
        return f"no topic with {WRENCH_TYPE} is known"
    return f"wrenches are sent on {', '.join(sorted(map(str, found)))}"


def missing_wrench_error(bridge: RosBridge, topics: Iterable[str]) -> InputError:
    """Error for topics from which no wrench came in time: what they are, and which topics have wrenches."""
    topic = next(iter(topics))
    kind, instead = _asked(bridge, "topic_type", {"topic": topic}).get("type"), topics_with_wrenches(bridge)
    if kind == "":
        return InputError(f"{topic}: there is no such topic; {instead}")
    if isinstance(kind, str) and kind.replace("/msg/", "/") != WRENCH_TYPE:
        return InputError(f"{topic}: its messages are {kind}, not {WRENCH_TYPE}; {instead}")
    return InputError(
        f"{topic}: no wrench within {FIRST_STATE_TIMEOUT_SECONDS:g} s: is the sensor on, and is this its topic?"
    )


def _asked(bridge: RosBridge, question: str, given: Mapping[str, str]) -> Message:
    """The answer of rosapi, a node beside rosbridge; empty where it does not run."""
    with suppress(InputError, BridgeError):
        return bridge.call(f"/rosapi/{question}", given)
    return {}
