"""Messages of topics as columns: one publisher for each number, every message accounted for.

Several nodes may publish on one topic. Their messages are not mixed: of publishers that send the same joints at the
same time one is used; the messages of the others are left out, counted and reported.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from armdyn.errors import InputError
from armdyn.recording.channels import JOINT_CHANNELS, MIN_COMPARED_CHANNEL_SAMPLES, FloatArray
from armdyn.recording.tracks import samples_of_second_series
from pipeline.imports.foreign import SECOND_PUBLISHER, ForeignColumn, ImportedSampleCounts
from pipeline.imports.stamps import MAX_MESSAGE_DELAY_SECONDS, samples_with_valid_stamps, shift_to_arrival_clock
from urdf.bounds import MAX_RECORDING_ROWS, MAX_TABLE_COLUMNS, printable_excerpt

JOINT_STATE = "sensor_msgs/msg/JointState"
JOINT_STATE_QUANTITIES = (("position", "q"), ("velocity", "v"), ("effort", "tau"))
"""Fields of the ROS message JointState, and the quantity of each."""
ROS2_CONTROL_INTERFACES = {"position": "q", "velocity": "v", "acceleration": "a", "effort": "tau", "torque": "tau"}
"""Interfaces of ros2_control, whose state names are ``joint/interface``, and the quantity of each."""
COMMAND_QUANTITIES = {"q": "q_cmd", "v": "v_cmd", "tau": "tau_ff"}
"""Quantity of a command, such as ``q_cmd``, by the measured quantity, such as ``q``."""
REVOLUTE_UNITS = {quantity: kind.units[0] for quantity, kind in JOINT_CHANNELS.items()}
"""Units of the values of a revolute joint, by quantity."""
UNREADABLE_REASON = "of which nothing can be read"
"""Reason for left-out messages, as the end of a sentence on them."""
MessageNumber: TypeAlias = tuple[str, float, str]
"""Column, value and channel of one number; the channel is empty where the message does not define it."""


class _Message(NamedTuple):
    """One message: stamp [s] or nan, time of reception [s], columns with their channels (c,), values (c,)."""

    stamp: float
    received: float
    columns: tuple[tuple[str, str], ...]
    values: FloatArray


@dataclass(frozen=True, eq=False)
class _Series:
    """Messages of one publisher on one topic, in the order in which they came."""

    messages: list[_Message] = field(default_factory=list)

    @cached_property
    def columns(self) -> "dict[str, tuple[str, npt.NDArray[np.intp], FloatArray]]":
        """Channel, indices of the messages (k,) and values (k,) of every column."""
        rows: dict[tuple[tuple[str, str], ...], list[int]] = {}
        for row, message in enumerate(self.messages):
            rows.setdefault(message.columns, []).append(row)
        parts: dict[tuple[str, str], list[tuple[list[int], FloatArray]]] = {}
        for layout, of in rows.items():
            table = np.stack([self.messages[row].values for row in of])
            for column, value in zip(layout, table.T, strict=True):
                parts.setdefault(column, []).append((of, value))
        found = {}
        for (name, channel), pieces in parts.items():
            index, value = (np.concatenate(part) for part in zip(*pieces, strict=True))
            order = np.argsort(index)
            found[name] = channel, index[order], value[order]
        return found

    def split(self) -> "list[_Series]":
        """The separate series where two publishers look like one; see `samples_of_second_series`."""
        n = len(self.messages)
        positions = [v for channel, _, v in self.columns.values() if channel.startswith("q.") and len(v) == n]
        values = np.column_stack(positions) if positions else np.empty((n, 0))
        second = samples_of_second_series(np.where(np.isfinite(values), values, 0.0))
        if not second.any():
            return [self]
        return [_Series([m for m, s in zip(self.messages, second, strict=True) if s == which]) for which in (0, 1)]

    def shares_columns(self, other: "_Series") -> bool:
        """Whether both contain one of the same columns."""
        return not self.columns.keys().isdisjoint(other.columns)

    def meets(self, other: "_Series") -> bool:
        """Whether most messages came while another series with the same columns came, not before or after it."""
        if not self.shares_columns(other):
            return False
        times = [message.received for message in other.messages]
        first, last = min(times), max(times)
        return 2 * sum(first <= m.received <= last for m in self.messages) > len(self.messages)

    @property
    def rank(self) -> tuple[bool, bool, int]:
        """Sort key, larger for measurements of an arm: positions change, efforts change, number of messages."""
        varies: dict[str, bool] = {}
        for channel, _, value in self.columns.values():
            quantity = channel.partition(".")[0]
            varies[quantity] = varies.get(quantity, False) or len(set(value.tolist())) >= MIN_COMPARED_CHANNEL_SAMPLES
        return varies.get("q", True), varies.get("tau", False), len(self.messages)


@dataclass
class Publishers:
    """Collects the numbers in messages of ROS topics, separately for each publisher.

    Attributes:
        crowded: topics that are left out because their messages contain too many numbers.
    """

    crowded: set[str] = field(default_factory=set)
    _series: dict[str, dict[tuple[str, tuple[str, ...]], _Series]] = field(default_factory=dict)
    _layouts: dict[tuple[tuple[str, str], ...], tuple[tuple[str, str], ...]] = field(default_factory=dict)
    _names: set[str] = field(default_factory=set)
    _incomplete: Counter[tuple[str, str, int, int]] = field(default_factory=Counter)

    def add_joint_message(
        self,
        topic: str,
        publisher: str,
        names: Sequence[str],
        values: Mapping[str, Sequence[float] | None],
        stamp: float,
        received: float,
        *,
        commanded: bool = False,
        beside: Sequence[MessageNumber] = (),
    ) -> None:
        """Add one message about joints; see `take`.

        Args:
            topic: topic of the message.
            publisher: name of the publisher; empty where it is unknown.
            names: names of the joints: ``joint``, or ``joint/effort`` as in ros2_control. Publishers are also
                distinguished by the order of the names.
            values: values by field of a JointState; a field without a value for every name is left out.
            stamp: stamp of the header [s]; nan where there is none.
            received: time of reception [s].
            commanded: whether the values are commands.
            beside: further numbers of the message.

        Raises:
            InputError: there are too many messages.
            ValueError: the message contains no value of a joint.
        """
        interfaces = [name.rpartition("/")[2] for name in names if "/" in name]
        of_control = any(interface in ROS2_CONTROL_INTERFACES for interface in interfaces)
        entries: list[MessageNumber] = []
        for part, quantity in JOINT_STATE_QUANTITIES:
            found = values.get(part)
            if found is None or len(found) == 0:
                continue
            if len(found) != len(names):
                self._incomplete[topic, part, len(found), len(names)] += 1
                continue
            for name, value in zip(names, found, strict=True):
                joint, _, interface = name.rpartition("/")
                if not (of_control and joint):
                    channel = f"{COMMAND_QUANTITIES[quantity] if commanded else quantity}.{name}"
                    entries.append((f"{topic}/{part}/{name}", float(value), channel))
                elif part == "position":
                    channel = (
                        f"{ROS2_CONTROL_INTERFACES[interface]}.{joint}" if interface in ROS2_CONTROL_INTERFACES else ""
                    )
                    entries.append((f"{topic}/{name}", float(value), channel))
        if not entries:
            raise ValueError("it says nothing of its joints")
        self.take(topic, publisher, stamp, received, [*entries, *beside], tuple(names))

    def take(
        self,
        topic: str,
        publisher: str,
        stamp: float,
        received: float,
        entries: Sequence[MessageNumber],
        joints: tuple[str, ...] = (),
    ) -> None:
        """Add one message with its numbers; of several numbers under one name, the first is used.

        Raises:
            InputError: there are too many messages.
        """
        series = self._series.setdefault(topic, {}).setdefault((publisher, joints), _Series())
        if len(series.messages) >= MAX_RECORDING_ROWS:
            raise InputError(f"more than {MAX_RECORDING_ROWS} messages of {printable_excerpt(topic)}: cut the bag")
        numbers: dict[tuple[str, str], float] = {}
        for name, value, channel in entries:
            numbers.setdefault((name, channel), value)
        layout = tuple(numbers)
        if layout not in self._layouts:
            names = self._names | {name for name, _ in layout}
            if len(names) > MAX_TABLE_COLUMNS:
                self.crowded.add(topic)
                layout = ()
            else:
                self._names = names
        layout = self._layouts.setdefault(layout, layout)
        series.messages.append(_Message(stamp, received, layout, np.array([numbers[column] for column in layout])))

    def columns(
        self, unread: Mapping[str, int], *, on_arrival: bool = False
    ) -> tuple[dict[str, ForeignColumn], dict[str, ImportedSampleCounts], list[str]]:
        """Columns by name, an account by topic, and sentences on everything that was changed or left out.

        Args:
            unread: number of unreadable messages by topic.
            on_arrival: whether the times shall be those of the clock of the reception.
        """
        columns: dict[str, ForeignColumn] = {}
        accounts: dict[str, ImportedSampleCounts] = {}
        clocks: dict[str, tuple[int, float]] = {}
        for topic, by_publisher in self._series.items():
            used, left_out = _used(by_publisher.values())
            left_out[UNREADABLE_REASON] += unread.get(topic, 0)
            kept, stamped = 0, True
            steps: tuple[float, ...] = ()
            for series in used:
                messages = sorted(series.messages, key=lambda message: message.received)
                stamps, received = (
                    np.array(part) for part in zip(*((m.stamp, m.received) for m in messages), strict=True)
                )
                known = _are_receptions(received, stamps)
                found = samples_with_valid_stamps(stamps, received if known else None)
                kept, left_out, steps = kept + len(found.rows), left_out + found.left_out, steps + found.steps
                stamped = stamped and (found.stamped or not np.isfinite(stamps).any())
                if not len(found.rows):
                    continue
                time, came = found.time, received[found.rows]
                if on_arrival and found.stamped:
                    time = shift_to_arrival_clock(time, came)
                if known:
                    clocks[topic] = max(clocks.get(topic, (0, 0.0)), (len(time), float((came - time).min())))
                for name, (channel, rows, value) in _Series([messages[row] for row in found.rows]).columns.items():
                    unit = REVOLUTE_UNITS.get(channel.partition(".")[0], "")
                    columns[name] = ForeignColumn(value, unit, time[rows], channel, topic)
            count = sum(len(series.messages) for series in by_publisher.values()) + unread.get(topic, 0)
            accounts[topic] = ImportedSampleCounts(topic, count, kept, dict(+left_out), steps, stamped)
        notes = [
            f"{topic}: {count} messages with {values} of {part} for {names} joints: these are left out"
            for (topic, part, values, names), count in self._incomplete.items()
        ]
        return _on_one_clock(columns, clocks, notes), accounts, notes


def _are_receptions(received: FloatArray, stamps: FloatArray) -> bool:
    """Whether the times of reception differ; a program that converts bags may write the same time for all messages."""
    steps = np.abs(np.diff(stamps[np.isfinite(stamps)]))
    return not len(steps) or bool(np.ptp(received) > MIN_RECEPTION_TO_STAMP_DURATION * len(steps) * np.median(steps))


MIN_RECEPTION_TO_STAMP_DURATION = 0.01
"""Smallest credible duration in which the messages were received, as a share of the duration of their stamps."""


def _used(publishers: Iterable[_Series]) -> tuple[list[_Series], Counter[str]]:
    """The series that are used, and the number of messages of others that are left out, by reason."""
    parts = [part for series in publishers for part in series.split()]
    used: list[_Series] = []
    left_out: Counter[str] = Counter()
    for part in sorted(parts, key=lambda part: part.rank, reverse=True):
        if any(part.meets(series) for series in used):
            moves, efforts, count = part.rank
            why = "that does not move" if not moves else "without efforts" if not efforts else "that says less"
            left_out[f"{SECOND_PUBLISHER} {why}"] += count
            continue
        same = next((i for i, series in enumerate(used) if series.shares_columns(part)), None)
        if same is None:
            used.append(part)
        else:
            used[same] = _Series(used[same].messages + part.messages)
    return used, left_out


def _on_one_clock(
    columns: Mapping[str, ForeignColumn], clocks: Mapping[str, tuple[int, float]], notes: list[str]
) -> dict[str, ForeignColumn]:
    """Columns whose stamps are all on the clock of the topic with the most messages."""
    if not clocks:
        return dict(columns)
    first, (_, delay) = max(clocks.items(), key=lambda item: item[1][0])
    late = {topic: own - delay for topic, (_, own) in clocks.items() if abs(own - delay) > MAX_MESSAGE_DELAY_SECONDS}
    notes += [
        f"{topic}: its stamps are those of another clock, {abs(shift):.6g} s apart: brought to that of {first} by when "
        "messages came"
        for topic, shift in late.items()
    ]
    return {
        name: replace(c, time=c.time + late[c.source]) if c.source in late and c.time is not None else c
        for name, c in columns.items()
    }
