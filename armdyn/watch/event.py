"""Events that a watch reports, each once."""

from dataclasses import dataclass
from enum import Enum
from typing import Any

from armdyn.arm.model import ArmModel

EVENT_SCHEMA = "armdyn.watch/1"


class EventKind(Enum):
    """Kind of an event; the value is its name in JSON. `UNIDENTIFIED`: detected, but not identifiable yet."""

    OUTSIDE_TORQUE = "outside_torque"
    LOAD_CHANGED = "load_changed"
    ROBOT_CHANGED = "robot_changed"
    UNIDENTIFIED = "not_told"
    RECOVERED = "recovered"


@dataclass(frozen=True)
class WatchEvent:
    """An event on the arm: an outside torque or a change, detected or ended.

    Attributes:
        time: time of the report, s.
        kind: see `EventKind`.
        joint: name of the joint with the clearest evidence.
        since: estimated start, s.
        size: estimated size, in `unit`.
        std: standard deviation of the size, in `unit`.
        unit: unit of size and std.
        what: name of the effect, or of all possible effects.
        false_alarms_per_hour: rate of events of all kinds on a sound robot.
        sentence: the event in words.
    """

    time: float
    kind: EventKind
    joint: str
    since: float
    size: float
    std: float
    unit: str
    what: str
    false_alarms_per_hour: float
    sentence: str

    @property
    def answer(self) -> dict[str, Any]:
        """The event as an object for JSON."""
        return {
            "schema": EVENT_SCHEMA, "time": self.time, "event": self.kind.value, "joint": self.joint,
            "since": self.since,
            "size": self.size, "std": self.std, "unit": self.unit, "what": self.what,
            "false_alarms_per_hour": self.false_alarms_per_hour, "sentence": self.sentence,
        }  # fmt: skip


@dataclass(frozen=True)
class ChangeEstimate:
    """Estimated size of a change, and its standard deviation.

    Attributes:
        joint: index of the joint.
        size: estimated size, in `unit`.
        std: standard deviation of the size, in `unit`.
        unit: unit of both.
        what: name of the effect, or of all possible effects.
    """

    joint: int
    size: float
    std: float
    unit: str
    what: str = "outside_torque"

    def __str__(self) -> str:
        return f"{self.size:+.3g} ± {self.std:.2g} {self.unit}"


class EventReporter:
    """Creates the events of an arm.

    Args:
        model: the arm.
        per_hour: false alarms per hour, for all events together.
    """

    def __init__(self, model: ArmModel, per_hour: float) -> None:
        self.joints, self.per_hour = model.arm.joints, per_hour
        self.units = tuple("N" if slides else "N m" for slides in model.arm.slides)

    def torque_estimate(self, joint: int, size: float, std: float) -> ChangeEstimate:
        """Estimate of an outside torque on a joint, N m or N."""
        return ChangeEstimate(joint, float(size), float(std), self.units[joint])

    def event(self, kind: EventKind, time: float, since: float, found: ChangeEstimate, sentence: str) -> WatchEvent:
        """An event; `sentence` is what follows the joint's name; times in s."""
        joint = self.joints[found.joint]
        return WatchEvent(
            time, kind, joint, since, found.size, found.std, found.unit, found.what, self.per_hour,
            f"{joint}: {sentence}",
        )  # fmt: skip
