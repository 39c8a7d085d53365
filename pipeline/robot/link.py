"""Quality of the connection to a robot: delays and intervals that are measured while the robot is commanded."""

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Percentiles:
    """Number of measured values, their median, 95th and 99th percentile and maximum, in the unit of the values."""

    count: int
    median: float
    p95: float
    p99: float
    worst: float

    @classmethod
    def of(cls, values: Iterable[float]) -> "Percentiles | None":
        """Percentiles of measured values; None for no values."""
        array = np.array(list(values))
        if not array.size:
            return None
        median, p95, p99 = np.percentile(array, [50, 95, 99])
        return cls(array.size, float(median), float(p95), float(p99), float(array.max()))

    def as_json(self) -> dict[str, float]:
        """The percentiles as JSON, for the answer of a command."""
        return {name: round(value, 5) for name, value in vars(self).items()}

    @property
    def milliseconds(self) -> str:
        """Text with the percentiles of times, whose unit is s, in milliseconds."""
        return f"{1e3 * self.median:.1f} ms, 99 % {1e3 * self.p99:.1f} ms, worst {1e3 * self.worst:.1f} ms"


@dataclass
class LinkStatistics:
    """Delays and intervals of a connection to a robot, collected while the robot is commanded.

    Attributes:
        round_trip: round-trip times of messages before the first motion [s]; None before the measurement.
        intervals: times between two commands of one stream [s].
        ages: ages of the newest joint state when a command was sent [s].
        echoes: times from sending a command to receiving it on its topic [s].
        commands: number of commands sent.
    """

    round_trip: Percentiles | None = None
    intervals: deque[float] = field(default_factory=lambda: deque(maxlen=100_000))
    ages: deque[float] = field(default_factory=lambda: deque(maxlen=100_000))
    echoes: deque[float] = field(default_factory=lambda: deque(maxlen=100_000))
    commands: int = 0

    @property
    def percentiles(self) -> dict[str, Percentiles | None]:
        """Percentiles of each measured time [s]; None where nothing was measured."""
        return {
            "round_trip": self.round_trip,
            "command_interval": Percentiles.of(tuple(self.intervals)),
            "state_age": Percentiles.of(tuple(self.ages)),
            "command_echo": Percentiles.of(tuple(self.echoes)),
        }

    def as_json(self) -> dict[str, Any]:
        """Number of commands, and percentiles of each time [s], as JSON."""
        percentiles = {name: spread.as_json() if spread else None for name, spread in self.percentiles.items()}
        return {"commands": self.commands, **percentiles}
