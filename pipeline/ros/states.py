"""Joint states from a topic: matched by name, dated on our clock, and read at a requested time."""

import threading
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from math import inf, isfinite, nan
from typing import Any

import numpy as np

from armdyn.errors import InputError
from pipeline.imports.stamps import DRIFT
from pipeline.robot.protocol import JointState, Vector
from pipeline.ros.bridge import Bridge

MAX_BURST_DELAY_SECONDS = 0.05
"""s by which messages are late that come together when a client only listens, 0.04 s, and a little more."""
FIRST_STATE = 3.0
"""Longest time to the first joint state [s]."""
KEPT_STATES = 64
"""States that are kept: more than half a second at 100 Hz."""


class StampClock:
    """Maps the stamps of another clock to ours.

    A message is received after it was stamped, by a delay that varies: the smallest difference seen is the best
    estimate of the offset between the clocks, and is forgotten as slowly as clocks drift. The error is the quickest
    delay itself, 1 ms on a local network, by which states seem later than they are. A stamp from the future by more
    than `MAX_BURST_DELAY_SECONDS` is believed when the next one says the same: then a clock was set, else it was wrong.
    """

    def __init__(self) -> None:
        self._offset, self._at, self._doubted = inf, 0.0, inf

    def local(self, stamp: float, received: float) -> float:
        """Time of a stamp [s] on our clock, never after the message's reception on our clock [s]."""
        shortest, given = self._offset + DRIFT * max(received - self._at, 0.0), received - stamp
        doubted = shortest < inf and given < shortest - MAX_BURST_DELAY_SECONDS
        self._offset = min(shortest, max(given, self._doubted) if doubted else given)
        self._doubted = given if doubted else inf
        self._at = received
        return min(stamp + self._offset, received)


class JointStates:
    """The latest states of an arm's joints, in the order of their names.

    The bridge's thread adds messages; any thread may read. Other joints, and messages without ours (a gripper's, on the
    same topic), are left out.

    Attributes:
        unreadable: number of messages with our joints whose values are missing or not finite.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._names = tuple(names)
        self._stamps = StampClock()
        self._states: deque[JointState] = deque(maxlen=KEPT_STATES)
        self._order: tuple[list[str], list[int]] | None = None
        self._changed = threading.Condition()
        self.unreadable = 0

    def take(self, message: Mapping[str, Any], received: float) -> None:
        """Store one ``sensor_msgs/JointState`` that was received at a time of our clock [s]."""
        index = self._index(message.get("name"))
        if index is None:
            return
        state = self._read(message, index, received)
        with self._changed:
            if state is None:
                self.unreadable += 1
                return
            if self._states and state.time <= self._states[-1].time:
                return  # the message is repeated, or a later one came first
            self._states.append(state)
            self._changed.notify_all()

    @property
    def latest(self) -> JointState | None:
        """The newest state; None before the first."""
        with self._changed:
            return self._states[-1] if self._states else None

    def wait_for_younger(self, time: Callable[[], float], patience: float) -> None:
        """Wait until the newest state is at or after a time [s], which may change meanwhile, or patience [s] ends."""
        with self._changed:
            self._changed.wait_for(lambda: bool(self._states) and self._states[-1].time >= time(), patience)

    def first(self, topic: str) -> JointState:
        """The newest state, waited for where there is none yet; the topic's name is for the error.

        Raises:
            InputError: no state came in time.
        """
        with self._changed:
            self._changed.wait_for(lambda: bool(self._states), FIRST_STATE)
            if self._states:
                return self._states[-1]
            seen = f"; {self.unreadable} could not be read" if self.unreadable else ""
        raise no_state(topic, self._names, seen)

    def at(self, time: float) -> JointState | None:
        """The state at a time [s]: between two states by a cubic, beyond the newest along its velocity.

        None before the first state.
        """
        with self._changed:
            states = tuple(self._states)
        if not states:
            return None
        after = bisect_right(states, time, key=lambda state: state.time)
        if after == len(states):
            last = states[-1]
            return JointState(time, last.q + np.nan_to_num(last.v) * (time - last.time), last.v, last.tau)
        return _between(states[after - 1], states[after], time) if after else states[0]

    def _index(self, names: object) -> list[int] | None:
        """Indices of our joints in a message; None where one of them is missing."""
        if not isinstance(names, list):
            return None
        if self._order is None or self._order[0] != names:
            if not set(self._names) <= set(names):
                return None
            self._order = names, [names.index(name) for name in self._names]
        return self._order[1]

    def _read(self, message: Mapping[str, Any], index: list[int], received: float) -> JointState | None:
        q = _values(message.get("position"), index)
        stamp = stamp_of(message)
        if q is None or not isfinite(stamp):
            return None
        # A driver may omit speed or effort. A message without both is still a reading of the posture: a quantity that
        # was not sent is missing, not 0.
        v, tau = (
            _values(message[name], index) if message.get(name) else np.full(len(index), nan)
            for name in ("velocity", "effort")
        )
        if v is None or tau is None:
            return None
        return JointState(self._stamps.local(stamp, received) if stamp > 0.0 else received, q, v, tau)


LATE_CYCLES = 5
"""A cycle may begin late now and then; only when so many in a row are late was one left out."""
MAX_CAUGHT_UP_PERIODS = 3.0
"""Periods behind that are caught up at once."""


class EvenTimes:
    """Evenly spaced reading times for a loop whose cycles sometimes begin a little late or are left out.

    Late cycles must not bend what is read into a path; a cycle that was left out leaves a gap of whole periods [s].
    """

    def __init__(self, period: float) -> None:
        self._period = period
        self._last: float | None = None
        self._behind: deque[float] = deque(maxlen=LATE_CYCLES)

    def next(self, wanted: float) -> float:
        """Reading time of this cycle [s]: one period after the last one, unless that is far from `wanted` [s]."""
        if self._last is None:
            self._last = wanted
            return wanted
        behind = (wanted - self._last) / self._period - 1.0
        if behind < -0.5:  # called twice in one cycle
            return self._last
        self._behind.append(behind)
        steps = 1
        if behind >= MAX_CAUGHT_UP_PERIODS or (len(self._behind) == LATE_CYCLES and min(self._behind) > 0.9):
            steps += int(behind if behind >= MAX_CAUGHT_UP_PERIODS else min(self._behind) + 0.1)
            self._behind.clear()
        self._last += steps * self._period
        return self._last


def where_is(uri: str, names: Sequence[str], topic: str) -> JointState:
    """Present positions of the named joints, from the states that a bridge passes on; no command is sent.

    Raises:
        InputError: no bridge, or no state of these joints in time.
    """
    joints = JointStates(names)
    with Bridge(uri) as bridge:
        bridge.subscribe(topic, "sensor_msgs/JointState", joints.take)
        return joints.first(topic)


def no_state(topic: str, names: Sequence[str], seen: str) -> InputError:
    """The error where no state of the named joints has come, with what was seen in its place."""
    missing = f"no state of {', '.join(names)} within {FIRST_STATE:g} s{seen}"
    return InputError(f"{topic}: {missing}: is the robot on, and is this its topic?")


def stamp_of(message: Mapping[str, Any]) -> float:
    """Time stamp of a message's header [s]; 0 where it has none, and nan where it cannot be read."""
    header = message.get("header")
    stamp = header.get("stamp") if isinstance(header, Mapping) else None
    if not isinstance(stamp, Mapping):
        return 0.0
    try:  # the fields are secs and nsecs in ROS 1, sec and nanosec in ROS 2
        return float(stamp.get("secs", stamp.get("sec", 0))) + 1e-9 * float(stamp.get("nsecs", stamp.get("nanosec", 0)))
    except (TypeError, ValueError):
        return float("nan")


def finite(given: object) -> Vector | None:
    """Numbers of a message as an array; None where an entry is no number, or not finite."""
    try:
        values = np.array(given, dtype=float)
    except (TypeError, ValueError):
        return None
    return values if np.isfinite(values).all() else None


def _values(given: object, index: list[int]) -> Vector | None:
    """The values of our joints (n,); None where one is missing or not finite."""
    if not isinstance(given, list) or max(index) >= len(given):
        return None
    return finite([given[i] for i in index])


def _between(a: JointState, b: JointState, time: float) -> JointState:
    """State between two states: positions by a cubic Hermite (a line without velocities), the rest linearly."""
    h = b.time - a.time
    u, mean = (time - a.time) / h, (b.q - a.q) / h
    before, after = (np.where(np.isnan(v), mean, v) for v in (a.v, b.v))
    q = (1 + 2 * u) * (1 - u) ** 2 * a.q + u**2 * (3 - 2 * u) * b.q + h * u * (1 - u) * ((1 - u) * before - u * after)
    return JointState(time, q, (1 - u) * a.v + u * b.v, (1 - u) * a.tau + u * b.tau)
