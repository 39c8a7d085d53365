"""What a watch tells, once."""

from dataclasses import dataclass
from enum import Enum
from typing import Any

SCHEMA = "armdyn.watch/1"


class Kind(Enum):
    """Of an event; the value is the key in JSON."""

    OUTSIDE_TORQUE = "outside_torque"
    LOAD_CHANGED = "load_changed"
    ROBOT_CHANGED = "robot_changed"
    NOT_TOLD = "not_told"
    RECOVERED = "recovered"


@dataclass(frozen=True)
class Event:
    """Something that happened to the arm.

    Attributes:
        time: when it was told, s.
        kind: of it.
        joint: where it is seen best.
        since: when it began, s.
        size: in `unit`.
        std: of the size.
        unit: of the size.
        what: the effect that it is, or those that it may be.
        false_alarms_per_hour: how often a sound robot would make one of any kind.
        sentence: for a person.
    """

    time: float
    kind: Kind
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
        """As JSON has it."""
        return {
            "schema": SCHEMA, "time": self.time, "event": self.kind.value, "joint": self.joint, "since": self.since,
            "size": self.size, "std": self.std, "unit": self.unit, "what": self.what,
            "false_alarms_per_hour": self.false_alarms_per_hour, "sentence": self.sentence,
        }  # fmt: skip
