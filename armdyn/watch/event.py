"""Events that the online comparison of an arm with its model reports."""

from dataclasses import dataclass
from enum import Enum
from typing import Any

from armdyn.watch.channels import WatchedChannels

EVENT_SCHEMA = "armdyn.watch/1"
MIN_TOLD_STDS = 3.0
"""Least size of what is told, in its standard deviations."""


class EventKind(Enum):
    """Kind of an event, with its name in JSON.

    `UNIDENTIFIED` is a detected change that is not identifiable yet; `SILENT` a source without samples to watch.
    """

    OUTSIDE_TORQUE = "outside_torque"
    LOAD_CHANGED = "load_changed"
    ROBOT_CHANGED = "robot_changed"
    UNIDENTIFIED = "not_told"
    RECOVERED = "recovered"
    SILENT = "silent"


@dataclass(frozen=True)
class WatchEvent:
    """An event on the arm: an outside torque or a change, detected or ended; or one of the source of its samples.

    Attributes:
        time: time of the report, s.
        kind: kind of the event.
        since: estimated time of the event's start, s.
        what: name of the effect, or of all possible effects; why samples of the source are not watched.
        false_alarms_per_hour: rate of events of all kinds on a fault-free robot.
        sentence: the event in words.
        joint: name of the joint with the clearest evidence; None for an event of the source, as all that follows.
        channel: the same for an axis of a force/torque sensor, such as ``"fz.ft"``.
        size: estimated size since the last event about it, in `unit`; a torque's sign is that of what acts on the arm.
        std: standard deviation of the size, in `unit`.
        unit: unit of size, std and total.
        total: the same since the start, where an earlier event was about it.
    """

    time: float
    kind: EventKind
    since: float
    what: str
    false_alarms_per_hour: float
    sentence: str
    joint: str | None = None
    channel: str | None = None
    size: float | None = None
    std: float | None = None
    unit: str | None = None
    total: float | None = None

    @property
    def answer(self) -> dict[str, Any]:
        """The event as a dictionary for JSON."""
        given = {
            "schema": EVENT_SCHEMA, "time": self.time, "event": self.kind.value, "joint": self.joint,
            "channel": self.channel, "since": self.since, "size": self.size, "std": self.std, "total": self.total,
            "unit": self.unit, "what": self.what,
            "false_alarms_per_hour": self.false_alarms_per_hour, "sentence": self.sentence,
        }  # fmt: skip
        return {name: value for name, value in given.items() if value is not None}


@dataclass(frozen=True)
class ChangeEstimate:
    """Estimated size of a change, and its standard deviation.

    Attributes:
        channel: index of the channel.
        size: estimated size, in `unit`.
        std: standard deviation of the size, in `unit`.
        unit: unit of both.
        what: name of the effect, or of all possible effects.
        total: size since the start, where an earlier event was about it.
    """

    channel: int
    size: float
    std: float
    unit: str
    what: str = "outside_torque"
    total: float | None = None

    @property
    def is_certain(self) -> bool:
        """Whether it is large enough to be told."""
        return abs(self.size) >= MIN_TOLD_STDS * self.std

    def __str__(self) -> str:
        return f"{self.size:+.3g} ± {self.std:.2g} {self.unit}"


class EventReporter:
    """Creates the events of an arm.

    Args:
        channels: the channels that are watched.
        per_hour: false alarms per hour, for all events together.
    """

    def __init__(self, channels: WatchedChannels, per_hour: float) -> None:
        self.channels, self.per_hour = channels, per_hour

    def torque_estimate(self, channel: int, residual: float, std: float) -> ChangeEstimate:
        """The estimate of an outside torque on a joint, or force on a sensor, from the residual that it leaves.

        Residual and standard deviation are in N m or N. The drives hold against what acts on the arm, so that the
        residual of a joint has the other sign.
        """
        size = float(self.channels.reaction[channel] * residual)
        return ChangeEstimate(channel, size, float(std), self.channels.units[channel])

    def event(
        self, kind: EventKind, time: float, since: float, found: ChangeEstimate, sentence: str
    ) -> list[WatchEvent]:
        """The event at `time`, s, that began at `since`, s; none if its size is below `MIN_TOLD_STDS`.

        `sentence` follows the name of joint or axis in its text.
        """
        if not found.is_certain:
            return []
        joint, axis = self.channels.joint(found.channel), None
        if joint is None:
            axis = self.channels.names[found.channel]
        return [
            WatchEvent(
                time, kind, since, found.what, self.per_hour, f"{self.channels.labels[found.channel]}: {sentence}",
                joint, axis, found.size, found.std, found.unit, found.total,
            )
        ]  # fmt: skip

    def source_event(self, kind: EventKind, time: float, since: float, what: str, sentence: str) -> WatchEvent:
        """Create an event of the source of samples at `time`, s, that began at `since`, s."""
        return WatchEvent(time, kind, since, what, self.per_hour, sentence)
