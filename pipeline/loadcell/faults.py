"""What can go wrong with a load cell, its detection in the simulated and the real cell, and the status of a cell."""

import math
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum

from pipeline.robot.protocol import ForceSample


class Fault(Enum):
    """A fault; its value says what is wrong and what to do. The most serious ones come first."""

    DISCONNECTED = "the serial port is gone: plug the cable in and start again"
    SILENT = "no sample arrives any more: check the cable, and that the microcontroller runs and sees the HX711"
    SATURATED = "the force is at the end of the cell's range: take a lighter load, or check the wires of the bridge"
    FROZEN = (
        "one value is repeated for longer than the noise allows: check the wires of cell, HX711 and microcontroller"
    )
    RESTARTED = "the microcontroller started its count anew: check its power supply"
    MALFORMED = "a line on the serial port is not a sample: check baud rate, cable and ground"
    DROPPED = "samples were lost on their way from the microcontroller: check the cable and the load of this computer"
    REPEATED = "a sample came more than once, and was taken once: check the microcontroller's program"
    OVERFLOW = "samples were thrown away because they were not read in time: read more often"

    @property
    def lasts(self) -> bool:
        """Whether it lasts, and the force is unreliable until it is over; the other faults are single events."""
        return self in _LASTING


_LASTING = (Fault.DISCONNECTED, Fault.SILENT, Fault.SATURATED, Fault.FROZEN)


@dataclass(frozen=True)
class FaultEvent:
    """A fault that began or ended, or a single event.

    Attributes:
        time: when it was noticed [s].
        fault: what it was.
        began: False where it ended.
        count: how many lines or samples a single event concerns.
    """

    time: float
    fault: Fault
    began: bool = True
    count: int = 1


@dataclass(frozen=True)
class FaultLimits:
    """What is still in order.

    Attributes:
        lower: end of the range, itself not in order, in the unit of the stream [N].
        upper: end of the range, itself not in order [N].
        identical: so many identical values in a row are a frozen cell.
        silent_after: so long without a sample is silence [s].
        start_up: how much longer the first sample may take [s]; most boards restart when the port is opened.
    """

    lower: float = -math.inf
    upper: float = math.inf
    identical: int = 10
    silent_after: float = 0.2
    start_up: float = 0.0

    @classmethod
    def of(cls, noise: float, resolution: float, full_scale: float, silent_after: float = 0.2) -> "FaultLimits":
        """Limits of a cell with this noise, resolution and range of either sign [N]."""
        return cls(-full_scale, full_scale, implausible_repeats(noise, resolution), silent_after)


def implausible_repeats(noise: float, resolution: float, false_alarms: float = 1e-9) -> int:
    r"""How many identical values in a row a working cell does not give.

    A constant force in the middle of a step of the converter gives that step with probability
    :math:`p = \operatorname{erf}(r / (2 \sqrt 2 \sigma))`, and n in a row with :math:`p^{n-1}`. A moving force gives
    fewer. The default, once in 1e9 samples, is once in 116 days at 100 Hz.

    Args:
        noise: standard deviation of one sample.
        resolution: step of the converter, same unit.
        false_alarms: probability that is still accepted, per sample.
    """
    if noise <= 0 or resolution < 0:
        return sys.maxsize  # a noiseless cell at rest repeats itself: nothing is implausible
    p = math.erf(resolution / (2.0 * math.sqrt(2.0) * noise))
    if p <= 0.0:
        return 3
    return sys.maxsize if p >= 1.0 else max(3, 1 + math.ceil(math.log(false_alarms) / math.log(p)))


class FaultDetector:
    """Finds a frozen, saturated or silent load cell in its stream of samples. It has no clock and no thread.

    Args:
        limits: what is still in order.
    """

    def __init__(self, limits: FaultLimits | None = None) -> None:
        self._limits = limits or FaultLimits()
        self._active: set[Fault] = set()
        self._events: list[FaultEvent] = []
        self._heard: float | None = None
        self._patience = self._limits.start_up + self._limits.silent_after
        self._value = math.nan
        self._repeats = 0

    @property
    def active(self) -> tuple[Fault, ...]:
        """Faults that hold now, the most serious first."""
        return tuple(fault for fault in Fault if fault in self._active)

    def update(self, now: float, samples: Iterable[ForceSample]) -> Fault | None:
        """Take in what arrived up to `now` [s], oldest first; the most serious fault that holds now, if any."""
        for sample in samples:
            self.sample(sample.time, sample.force)
        return self.check(now)

    def sample(self, time: float, value: float) -> None:
        """Take in one sample: the time of its reception [s] and its value in the unit of the limits."""
        self.check(time)
        self._heard, self._patience = time, self._limits.silent_after
        self._set(Fault.SILENT, False, time)
        self._repeats = self._repeats + 1 if value == self._value else 1
        self._value = value
        self._set(Fault.FROZEN, self._repeats >= self._limits.identical, time)
        # In this form a value that is not a number is out of range, too.
        self._set(Fault.SATURATED, not self._limits.lower < value < self._limits.upper, time)

    def check(self, now: float) -> Fault | None:
        """Look for silence at `now` [s]; the most serious fault that holds now, if any."""
        if self._heard is None:
            self._heard = now
        if now - self._heard > self._patience:
            self._set(Fault.SILENT, True, now)
        return next(iter(self.active), None)

    def take_events(self) -> list[FaultEvent]:
        """What began and ended since the last call, oldest first."""
        events, self._events = self._events, []
        return events

    def _set(self, fault: Fault, holds: bool, time: float) -> None:
        if holds != (fault in self._active):
            (self._active.add if holds else self._active.remove)(fault)
            self._events.append(FaultEvent(time, fault, began=holds))


@dataclass(frozen=True)
class LoadCellStatus:
    """How a load cell is doing at one moment.

    Attributes:
        connected: whether the port is open and there.
        samples: how many samples were received.
        rate: measured over the latest samples [Hz]; 0 while nothing arrives.
        latest: time of the latest sample [s], None before the first.
        active: faults that hold now, the most serious first.
        counts: per fault, how many lines or samples it concerned, or how often it began where it lasts.
    """

    connected: bool
    samples: int
    rate: float
    latest: float | None
    active: tuple[Fault, ...]
    counts: Mapping[Fault, int]

    @property
    def reliable(self) -> bool:
        """Whether the force can be used now."""
        return self.connected and self.samples > 0 and not self.active
