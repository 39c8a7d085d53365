"""Messages of topics as columns: one publisher for each number, every message accounted for.

Several nodes may publish on one topic. What they say is not mixed: of publishers that say the same joints at the same
time one is taken, others are left out and told.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from armdyn.errors import InputError
from armdyn.recording.channels import MIN_SAMPLES, FloatArray
from armdyn.recording.tracks import second_track
from pipeline.imports.foreign import SECOND, Account, Column
from pipeline.imports.stamps import DELAY, dated, on_arrival_clock
from urdf.bounds import MOST_ROWS, shown

JOINT_STATE = "sensor_msgs/msg/JointState"
FIELDS = (("position", "q"), ("velocity", "v"), ("effort", "tau"))
"""Of a JointState, and the quantity of each."""
INTERFACES = {"position": "q", "velocity": "v", "acceleration": "a", "effort": "tau", "torque": "tau"}
"""Of ros2_control, whose names of states are ``joint/interface``."""
TOLD = {"q": "q_cmd", "v": "v_cmd", "tau": "tau_ff"}
"""What a joint was told, by the quantity that it is."""
UNITS = {"q": "rad", "v": "rad/s", "a": "rad/s^2", "tau": "N m", "q_cmd": "rad", "v_cmd": "rad/s", "tau_ff": "N m"}
UNREADABLE = "of which nothing can be read"
"""Why messages are left out; for a sentence."""
Entry: TypeAlias = tuple[str, float, str]
"""Column, value and channel of one number; no channel where the message does not say which."""


def joint_entries(
    topic: str, names: Sequence[str], values: Mapping[str, Sequence[float] | None], *, told: bool
) -> Iterator[Entry]:
    """The numbers of a message with joints, measured or `told`; see `Publishers.take_joints`."""
    interfaces = [name.rpartition("/")[2] for name in names if "/" in name]
    of_control = any(interface in INTERFACES for interface in interfaces)
    for part, quantity in FIELDS:
        found = values.get(part)
        if found is None or len(found) != len(names):
            continue
        for name, value in zip(names, found, strict=True):
            joint, _, interface = name.rpartition("/")
            if not (of_control and joint):
                yield f"{topic}/{part}/{name}", float(value), f"{TOLD[quantity] if told else quantity}.{name}"
            elif part == "position":
                channel = f"{INTERFACES[interface]}.{joint}" if interface in INTERFACES else ""
                yield f"{topic}/{name}", float(value), channel


@dataclass
class _Samples:
    channel: str
    rows: list[int] = field(default_factory=list)
    value: list[float] = field(default_factory=list)


@dataclass
class _Series:
    """Messages of one publisher on one topic.

    Attributes:
        stamps: s, nan where there is none.
        arrivals: s.
        columns: numbers of the messages, with the indices of theirs.
    """

    stamps: list[float] = field(default_factory=list)
    arrivals: list[float] = field(default_factory=list)
    columns: dict[str, _Samples] = field(default_factory=dict)

    def take(self, stamp: float, received: float, entries: Iterable[Entry]) -> None:
        row = len(self.stamps)
        self.stamps.append(stamp)
        self.arrivals.append(received)
        for name, value, channel in entries:
            samples = self.columns.setdefault(name, _Samples(channel))
            samples.rows.append(row)
            samples.value.append(value)

    def split(self) -> "list[_Series]":
        """As many series as have become one: see `second_track`."""
        positions = [s for s in self.columns.values() if s.channel.startswith("q.")]
        every = [s.value for s in positions if len(s.value) == len(self.stamps)]
        values = np.column_stack(every) if every else np.empty((len(self.stamps), 0))
        second = second_track(np.where(np.isfinite(values), values, 0.0))
        return [self._part(~second), self._part(second)] if second.any() else [self]

    def _part(self, kept: npt.NDArray[np.bool_]) -> "_Series":
        place = np.cumsum(kept) - 1
        part = _Series(np.array(self.stamps)[kept].tolist(), np.array(self.arrivals)[kept].tolist())
        for name, samples in self.columns.items():
            inside = kept[samples.rows]
            rows = place[np.array(samples.rows)[inside]].tolist()
            part.columns[name] = _Samples(samples.channel, rows, np.array(samples.value)[inside].tolist())
        return part

    def joined(self, other: "_Series") -> "_Series":
        """Both, one after the other."""
        n = len(self.stamps)
        found = _Series(self.stamps + other.stamps, self.arrivals + other.arrivals)
        for series, shift in ((self, 0), (other, n)):
            for name, samples in series.columns.items():
                all_samples = found.columns.setdefault(name, _Samples(samples.channel))
                all_samples.rows += [row + shift for row in samples.rows]
                all_samples.value += samples.value
        return found

    def meets(self, other: "_Series") -> bool:
        """Whether it says some of the same numbers as another at the same time, rather than before or after."""
        if not self.columns.keys() & other.columns.keys():
            return False
        first, last = min(other.arrivals), max(other.arrivals)
        inside = sum(first <= time <= last for time in self.arrivals)
        return 2 * inside > len(self.arrivals)

    @property
    def rank(self) -> tuple[bool, bool, int]:
        """Larger for what is measured of an arm: it moves, it has efforts, it comes often."""
        said: dict[str, bool] = {}
        for samples in self.columns.values():
            quantity = samples.channel.partition(".")[0]
            said[quantity] = said.get(quantity, False) or len(set(samples.value)) >= MIN_SAMPLES
        return said.get("q", True), said.get("tau", False), len(self.stamps)


@dataclass
class Publishers:
    """Collects messages.

    Attributes:
        count: of the columns.
    """

    count: int = 0
    _series: dict[str, dict[tuple[str, tuple[str, ...]], _Series]] = field(default_factory=dict)
    _odd: Counter[tuple[str, str, int, int]] = field(default_factory=Counter)

    def take_joints(
        self,
        topic: str,
        publisher: str,
        names: Sequence[str],
        values: Mapping[str, Sequence[float] | None],
        stamp: float,
        received: float,
        *,
        told: bool = False,
        beside: Sequence[Entry] = (),
    ) -> None:
        """Take in one message of joints.

        Args:
            topic: where it came.
            publisher: whose it is; empty where nobody says it.
            names: of the joints in it: ``joint``, or ``joint/effort`` as in ros2_control. Their order tells
                publishers apart.
            values: by field of a JointState; a field without a value for every name says nothing.
            stamp: s, of its header; nan where it has none.
            received: s.
            told: whether it is what they were told.
            beside: its other numbers.

        Raises:
            InputError: there are too many messages.
            ValueError: it says nothing.
        """
        for part, found in values.items():
            if found is not None and len(found) not in (0, len(names)):
                self._odd[topic, part, len(found), len(names)] += 1
        entries = list(joint_entries(topic, names, values, told=told))
        if not entries:
            raise ValueError("it says nothing of its joints")
        self.take(topic, publisher, stamp, received, [*entries, *beside], tuple(names))

    def take(
        self,
        topic: str,
        publisher: str,
        stamp: float,
        received: float,
        entries: Sequence[Entry],
        joints: tuple[str, ...] = (),
    ) -> None:
        """Take in one message.

        Args:
            topic: where it came.
            publisher: whose it is; empty where nobody says it.
            stamp: s, of its header; nan where it has none.
            received: s.
            entries: its numbers.
            joints: whose they are, in its order.

        Raises:
            InputError: there are too many messages.
        """
        series = self._series.setdefault(topic, {}).setdefault((publisher, joints), _Series())
        if len(series.stamps) >= MOST_ROWS:
            raise InputError(f"more than {MOST_ROWS} messages of {shown(topic)}: cut the bag")
        before = len(series.columns)
        series.take(stamp, received, entries)
        self.count += len(series.columns) - before

    def columns(
        self, unread: Mapping[str, int], *, on_arrival: bool = False
    ) -> tuple[dict[str, Column], dict[str, Account], list[str]]:
        """Columns by name, an account by topic, and sentences on what else was done.

        Args:
            unread: messages by topic of which nothing could be read.
            on_arrival: whether times are those of the clock that says when messages came.
        """
        columns: dict[str, Column] = {}
        accounts: dict[str, Account] = {}
        clocks: dict[str, tuple[int, float]] = {}
        for topic, by_publisher in self._series.items():
            taken, left_out = _taken(by_publisher.values())
            left_out[UNREADABLE] += unread.get(topic, 0)
            kept, stamped = 0, True
            steps: tuple[float, ...] = ()
            for series in taken:
                order = np.argsort(series.arrivals, kind="stable")
                stamps, arrivals = np.array(series.stamps)[order], np.array(series.arrivals)[order]
                found = dated(stamps, arrivals if _tells(arrivals, stamps) else None)
                kept, left_out, steps = kept + len(found.rows), left_out + found.left_out, steps + found.steps
                stamped = stamped and (found.stamped or not np.isfinite(stamps).any())
                if not len(found.rows):
                    continue
                time, came = found.time, arrivals[found.rows]
                if on_arrival and found.stamped:
                    time = on_arrival_clock(time, came)
                if _tells(arrivals, stamps):
                    clocks[topic] = max(clocks.get(topic, (0, 0.0)), (len(time), float((came - time).min())))
                columns |= _of_series(topic, series, order[found.rows], time)
            messages = sum(len(series.stamps) for series in by_publisher.values()) + unread.get(topic, 0)
            accounts[topic] = Account(topic, messages, kept, dict(+left_out), steps, stamped)
        notes = [
            f"{topic}: {count} messages with {values} of {part} for {names} joints: these are left out"
            for (topic, part, values, names), count in self._odd.items()
        ]
        return _on_one_clock(columns, clocks, notes), accounts, notes


def _tells(arrivals: FloatArray, stamps: FloatArray) -> bool:
    """Whether it was written down when messages came; a program that converts bags may write the same for all."""
    steps = np.abs(np.diff(stamps[np.isfinite(stamps)]))
    return not len(steps) or bool(np.ptp(arrivals) > SAME * len(steps) * np.median(steps))


SAME = 0.01
"""Of a recording's length by its usual step, within which all messages cannot have come."""


def _taken(publishers: Iterable[_Series]) -> tuple[list[_Series], Counter[str]]:
    """The series that are used, and how many messages of others are left out, by reason."""
    parts = [part for series in publishers for part in series.split()]
    taken: list[_Series] = []
    left_out: Counter[str] = Counter()
    for part in sorted(parts, key=lambda part: part.rank, reverse=True):
        if any(part.meets(series) for series in taken):
            moves, efforts, count = part.rank
            why = "that does not move" if not moves else "without efforts" if not efforts else "that says less"
            left_out[f"{SECOND} {why}"] += count
            continue
        same = next((i for i, series in enumerate(taken) if series.columns.keys() & part.columns.keys()), None)
        if same is None:
            taken.append(part)
        else:
            taken[same] = taken[same].joined(part)
    return taken, left_out


def _of_series(topic: str, series: _Series, rows: npt.NDArray[np.intp], time: FloatArray) -> dict[str, Column]:
    """Columns of the messages that are kept, (k,) `rows` in the order of their (k,) times."""
    place = np.full(len(series.stamps), -1)
    place[rows] = np.arange(len(rows))
    columns = {}
    for name, samples in series.columns.items():
        at, first = np.unique(place[samples.rows], return_index=True)  # a joint may stand in a message twice
        first = first[at >= 0]
        value = np.array(samples.value)[first]
        unit = UNITS.get(samples.channel.partition(".")[0], "")
        columns[name] = Column(value, unit, time[at[at >= 0]], samples.channel, topic)
    return columns


def _on_one_clock(
    columns: Mapping[str, Column], clocks: Mapping[str, tuple[int, float]], notes: list[str]
) -> dict[str, Column]:
    """Columns with the stamps of the topic that has most messages; others' differ where their clocks do.

    Args:
        columns: by name.
        clocks: by topic the number of messages, and how much later than their stamps they came at least, s.
        notes: get a sentence for each clock that is another.
    """
    if not clocks:
        return dict(columns)
    first, (_, delay) = max(clocks.items(), key=lambda item: item[1][0])
    late = {topic: own - delay for topic, (_, own) in clocks.items() if abs(own - delay) > DELAY}
    notes += [
        f"{topic}: its stamps are those of another clock, {abs(shift):.6g} s apart: brought to that of {first} by when "
        "messages came"
        for topic, shift in late.items()
    ]
    return {
        name: replace(c, time=c.time + late[c.source]) if c.source in late and c.time is not None else c
        for name, c in columns.items()
    }
