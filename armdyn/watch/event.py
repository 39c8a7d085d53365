"""What a watch tells, once."""

from dataclasses import dataclass
from enum import Enum
from typing import Any

from armdyn.arm.model import ArmModel

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


@dataclass(frozen=True)
class Estimate:
    """How large a change is, and its standard deviation, in a unit.

    Attributes:
        joint: its index.
        size: in `unit`.
        std: likewise.
        unit: of both.
        what: the effect that it is, or those that it may be.
    """

    joint: int
    size: float
    std: float
    unit: str
    what: str = "outside_torque"

    def __str__(self) -> str:
        return f"{self.size:+.3g} ± {self.std:.2g} {self.unit}"


class Reporter:
    """Makes the events of an arm.

    Args:
        model: the arm.
        per_hour: false alarms of all events together.
    """

    def __init__(self, model: ArmModel, per_hour: float) -> None:
        self.joints, self.per_hour = model.arm.joints, per_hour
        self.units = tuple("N" if slides else "N m" for slides in model.arm.slides)

    def torque(self, joint: int, size: float, std: float) -> Estimate:
        """Of an outside torque on a joint."""
        return Estimate(joint, float(size), float(std), self.units[joint])

    def event(self, kind: Kind, time: float, since: float, found: Estimate, sentence: str) -> Event:
        """One of them; the sentence begins after the joint's name."""
        joint = self.joints[found.joint]
        return Event(
            time, kind, joint, since, found.size, found.std, found.unit, found.what, self.per_hour,
            f"{joint}: {sentence}",
        )  # fmt: skip
