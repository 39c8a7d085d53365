"""Joint states from a ROS topic: joints matched by name, times on this program's clock, states at any time."""

import threading
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from math import inf, isfinite, nan
from typing import Any

import numpy as np

from armdyn.errors import InputError
from pipeline.imports.stamps import MAX_RELATIVE_CLOCK_DRIFT
from pipeline.robot.protocol import JointState, Vector
from pipeline.ros.bridge import RosBridge

MAX_BURST_DELAY_SECONDS = 0.05
"""Largest delay of messages that arrive in a burst [s]: 0.04 s for a client that only receives, with a margin."""
SAME_DELAY_SECONDS = 0.002
"""Largest difference of two delays [s] that are taken to be the same; messages that overtake others differ by more."""
FIRST_STATE_TIMEOUT_SECONDS = 3.0
"""Longest waiting time for the first joint state [s]."""
MAX_KEPT_STATES = 64
"""Number of joint states that are kept: more than half a second at 100 Hz."""


class StampClock:
    """Converts time stamps of another computer's clock to times of this program's clock.

    A message arrives after its stamp by a varying delay. The smallest difference of reception and stamp estimates the
    offset between the clocks; it grows with time at the rate at which clocks drift. Converted times are late by the
    smallest delay, 1 ms on a local network. A stamp that is more than `MAX_BURST_DELAY_SECONDS` too early for the
    estimate is only used if the next stamp agrees with it (the other clock was set); otherwise it was a wrong stamp.

    A stamp below an earlier one was overtaken, or the other clock was set back: that is so if the next stamp follows it
    and arrives after the same delay, which costs one sample.
    """

    def __init__(self) -> None:
        self._offset, self._at, self._doubted = inf, 0.0, inf
        self._newest, self._back = -inf, (inf, inf)

    def local(self, stamp: float, received: float) -> float:
        """Time of a stamp on this program's clock [s], never after the reception of its message.

        Args:
            stamp: time stamp of the message [s].
            received: time of its reception on this program's clock [s].
        """
        shortest, given = self._offset + MAX_RELATIVE_CLOCK_DRIFT * max(received - self._at, 0.0), received - stamp
        if stamp < self._newest:
            before, delay = self._back
            agreed = MAX_BURST_DELAY_SECONDS if given - shortest > MAX_BURST_DELAY_SECONDS else SAME_DELAY_SECONDS
            if before < stamp and abs(given - delay) <= agreed:
                shortest, self._newest = given, stamp
            self._back = stamp, given
        else:
            self._newest, self._back = stamp, (inf, inf)
        doubted = shortest < inf and given < shortest - MAX_BURST_DELAY_SECONDS
        self._offset = min(shortest, max(given, self._doubted) if doubted else given)
        self._doubted = given if doubted else inf
        self._at = received
        return min(stamp + self._offset, received)


class JointStateBuffer:
    """The latest states of an arm's joints, from messages that may contain other joints too.

    The bridge's thread adds messages; any thread may read states. Messages that lack one of the arm's joints, such as a
    gripper's on the same topic, are left out.

    Args:
        names: names of the arm's joints, in the order of the states.

    Attributes:
        unreadable: number of messages of the arm's joints whose values are missing or not finite.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._names = tuple(names)
        self._stamps = StampClock()
        self._states: deque[JointState] = deque(maxlen=MAX_KEPT_STATES)
        self._order: tuple[list[str], list[int]] | None = None
        self._contents: deque[tuple[object, ...]] = deque(maxlen=MAX_KEPT_STATES)
        self._changed = threading.Condition()
        self.unreadable = 0

    def take(self, message: Mapping[str, Any], received: float) -> None:
        """Store a message ``sensor_msgs/JointState``.

        Args:
            message: the message.
            received: time of its reception on this program's clock [s].
        """
        index = self._index(message.get("name"))
        if index is None:
            return
        if self._is_repeated(message):
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
        """The newest state; None before the first one."""
        with self._changed:
            return self._states[-1] if self._states else None

    def wait_for_recent(self, time: Callable[[], float], patience: float) -> None:
        """Wait until the newest state is not older than a time, at most for `patience` [s].

        Args:
            time: function that returns the earliest accepted time [s]; it is called again after each state.
            patience: longest waiting time [s].
        """
        with self._changed:
            self._changed.wait_for(lambda: bool(self._states) and self._states[-1].time >= time(), patience)

    def first(self, topic: str) -> JointState:
        """The newest state, or the first one as soon as it arrives.

        Args:
            topic: name of the topic, for the error message.

        Raises:
            InputError: no state arrived in time.
        """
        with self._changed:
            self._changed.wait_for(lambda: bool(self._states), FIRST_STATE_TIMEOUT_SECONDS)
            if self._states:
                return self._states[-1]
            seen = f"; {self.unreadable} could not be read" if self.unreadable else ""
        raise missing_state_error(topic, self._names, seen)

    def at(self, time: float) -> JointState | None:
        """State at a time [s]: interpolated between two states, extrapolated at constant velocity after the newest one.

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

    def _is_repeated(self, message: Mapping[str, Any]) -> bool:
        """Whether the same content came before, with the same stamp, which says nothing about the clocks."""
        content = header_stamp(message), message.get("position"), message.get("velocity"), message.get("effort")
        if content in self._contents:
            return True
        self._contents.append(content)
        return False

    def _index(self, names: object) -> list[int] | None:
        """Indices of the arm's joints in a message; None where one of them is missing."""
        if not isinstance(names, list):
            return None
        if self._order is None or self._order[0] != names:
            if not set(self._names) <= set(names):
                return None
            self._order = names, [names.index(name) for name in self._names]
        return self._order[1]

    def _read(self, message: Mapping[str, Any], index: list[int], received: float) -> JointState | None:
        q = _values(message.get("position"), index)
        stamp = header_stamp(message)
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


MAX_LATE_CYCLES_IN_A_ROW = 5
"""Number of consecutive late cycles from which one cycle counts as left out; single cycles may be late."""
MAX_CYCLE_DELAY_PERIODS = 3.0
"""Delay of a single control cycle from which the cycles that it covers count as left out [periods of the cycle]."""


class EvenReadingTimes:
    """Evenly spaced reading times for a loop whose cycles sometimes begin late or are left out.

    Without them a late cycle would distort the read motion. A left-out cycle makes a gap of a whole number of periods.

    Args:
        period: time between two readings [s].
    """

    def __init__(self, period: float) -> None:
        self._period = period
        self._last: float | None = None
        self._behind: deque[float] = deque(maxlen=MAX_LATE_CYCLES_IN_A_ROW)

    def next(self, wanted: float) -> float:
        """Reading time of this cycle [s]: one period after the last reading, or whole periods later after a gap.

        Args:
            wanted: time that the loop would read now [s].
        """
        if self._last is None:
            self._last = wanted
            return wanted
        behind = (wanted - self._last) / self._period - 1.0
        if behind < -0.5:  # called twice in one cycle
            return self._last
        self._behind.append(behind)
        steps = 1
        if behind >= MAX_CYCLE_DELAY_PERIODS or (
            len(self._behind) == MAX_LATE_CYCLES_IN_A_ROW and min(self._behind) > 0.9
        ):
            steps += int(behind if behind >= MAX_CYCLE_DELAY_PERIODS else min(self._behind) + 0.1)
            self._behind.clear()
        self._last += steps * self._period
        return self._last


def present_joint_state(uri: str, names: Sequence[str], topic: str) -> JointState:
    """Present state of an arm's joints on a ROS robot; no command is sent.

    Args:
        uri: address of the bridge.
        names: names of the joints.
        topic: topic of the joint states.

    Raises:
        InputError: no bridge, or no state of these joints in time.
    """
    joints = JointStateBuffer(names)
    with RosBridge(uri) as bridge:
        bridge.subscribe(topic, "sensor_msgs/JointState", joints.take)
        return joints.first(topic)


def missing_state_error(topic: str, names: Sequence[str], seen: str = "") -> InputError:
    """Error for joints whose state did not arrive in time.

    Args:
        topic: topic of the joint states.
        names: names of the missing joints.
        seen: text on the messages that arrived instead, with a semicolon before it.
    """
    missing = f"no state of {', '.join(names)} within {FIRST_STATE_TIMEOUT_SECONDS:g} s{seen}"
    return InputError(f"{topic}: {missing}: is the robot on, and is this its topic?")


def header_stamp(message: Mapping[str, Any]) -> float:
    """Time stamp in a message's header [s]; 0 for a message without a stamp, nan for an unreadable stamp."""
    header = message.get("header")
    stamp = header.get("stamp") if isinstance(header, Mapping) else None
    if not isinstance(stamp, Mapping):
        return 0.0
    try:  # the fields are secs and nsecs in ROS 1, sec and nanosec in ROS 2
        return float(stamp.get("secs", stamp.get("sec", 0))) + 1e-9 * float(stamp.get("nsecs", stamp.get("nanosec", 0)))
    except (TypeError, ValueError):
        return float("nan")


def finite_array(given: object) -> Vector | None:
    """Numbers of a message as an array; None if an entry is not a finite number."""
    try:
        values = np.array(given, dtype=float)
    except (TypeError, ValueError):
        return None
    return values if np.isfinite(values).all() else None


def _values(given: object, index: list[int]) -> Vector | None:
    """Values of the arm's joints (n,); None where one is missing or not finite."""
    if not isinstance(given, list) or max(index) >= len(given):
        return None
    return finite_array([given[i] for i in index])


def _between(a: JointState, b: JointState, time: float) -> JointState:
    """State between two states: positions by a cubic Hermite (a line without velocities), the rest linearly."""
    h = b.time - a.time
    u, mean = (time - a.time) / h, (b.q - a.q) / h
    before, after = (np.where(np.isnan(v), mean, v) for v in (a.v, b.v))
    q = (1 + 2 * u) * (1 - u) ** 2 * a.q + u**2 * (3 - 2 * u) * b.q + h * u * (1 - u) * ((1 - u) * before - u * after)
    return JointState(time, q, (1 - u) * a.v + u * b.v, (1 - u) * a.tau + u * b.tau)
