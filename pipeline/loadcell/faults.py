"""Detect faults of a load cell in its samples, and describe the status of a cell."""

import math
import sys
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise

from pipeline.robot.protocol import ForceSample


class LoadCellFault(Enum):
    """A kind of fault of a load cell; the value says what is wrong and what to do. The most serious ones come first.

    The faults from `DISCONNECTED` to `DRIFTING` last for some time, in which the force is unreliable; the others are
    single events.
    """

    DISCONNECTED = "the serial port is gone: plug the cable in and start again"
    SILENT = "no sample arrives any more: check the cable, and that the microcontroller runs and sees the HX711"
    SATURATED = "the force is at the end of the cell's range: take a lighter load, or check the wires of the bridge"
    FROZEN = (
        "one value is repeated for longer than the noise allows: check the wires of cell, HX711 and microcontroller"
    )
    SPIKES = "single samples are far from those around them: check ground and supply, and shield the wires"
    NEGATIVE = "the force is negative: check the wires of the bridge and how the cell is mounted, and calibrate again"
    DRIFTING = "the force goes steadily up or down: wait until the cell is warm, and check what touches it"
    RESTARTED = "the microcontroller started its count anew: check its power supply"
    MALFORMED = "a line on the serial port is not a sample: check baud rate, cable and ground"
    DROPPED = "samples were lost on their way from the microcontroller: check the cable and the load of this computer"
    REPEATED = "a sample came more than once, and was taken once: check the microcontroller's program"
    OVERFLOW = "samples were thrown away because they were not read in time: read more often"


@dataclass(frozen=True)
class LoadCellFaultEvent:
    """The beginning or end of a fault of a load cell, or a single event such as a lost sample.

    Attributes:
        time: time of detection [s].
        fault: kind of the fault.
        began: True at the beginning of a fault and for a single event, False at the end.
        count: number of lines or samples that a single event concerns.
    """

    time: float
    fault: LoadCellFault
    began: bool = True
    count: int = 1


@dataclass(frozen=True)
class LoadCellFaultLimits:
    """Limits for the samples of a load cell that works, in the unit of the samples: N or counts.

    Attributes:
        lower: lower end of the range; a sample at or below it is saturated.
        upper: upper end of the range; a sample at or above it is saturated.
        step: resolution of the converter; 0 if it is unknown.
        repeats: number of successive samples within one step after which the cell counts as frozen.
        spike: largest distance of a sample from both of its neighbours, in the same direction.
        min_force: smallest possible force; a few samples may lie below.
        max_force: largest possible force; a few samples may lie above.
        drift: largest rate at which the mean may change in one direction, over `ONE_WAY_CHANGES_UNTIL_DRIFT` blocks
            [unit/s].
        silent_after: time without a sample after which the cell counts as silent [s].
        start_up_seconds: additional time for the first sample [s]; most boards restart when the port is opened.
    """

    lower: float = -math.inf
    upper: float = math.inf
    step: float = 0.0
    repeats: int = 10
    spike: float = math.inf
    min_force: float = -math.inf
    max_force: float = math.inf
    drift: float = math.inf
    silent_after: float = 0.2
    start_up_seconds: float = 0.0

    @classmethod
    def from_noise(cls, noise: float, step: float, lower: float, upper: float) -> "LoadCellFaultLimits":
        """Make limits for saturated and frozen cells.

        Args:
            noise: standard deviation of one sample.
            step: resolution of the converter.
            lower: lower end of the range.
            upper: upper end of the range.
        """
        return cls(lower, upper, step, implausible_repeats(noise, 2.0 * step))


def implausible_repeats(noise: float, resolution: float, false_alarms: float = 1e-9) -> int:
    r"""Number of equal successive samples that a load cell which works practically never gives.

    A constant force in the middle of a step r of the converter gives that step with probability
    :math:`p = \operatorname{erf}(r / (2 \sqrt 2 \sigma))`, and n times in succession with :math:`p^{n-1}`. A changing
    force gives fewer equal samples.

    Args:
        noise: standard deviation of one sample, in any unit.
        resolution: step of the converter, in the same unit.
        false_alarms: accepted probability per sample of a false alarm; 1e-9 is once in 116 days at 100 Hz.
    """
    if noise <= 0 or resolution < 0:
        return sys.maxsize  # a noiseless cell at rest repeats one value: no number is implausible
    p = math.erf(resolution / (2.0 * math.sqrt(2.0) * noise))
    if p <= 0.0:
        return 3
    return sys.maxsize if p >= 1.0 else max(3, 1 + math.ceil(math.log(false_alarms) / math.log(p)))


SPIKE_WINDOW_SAMPLES = 100
"""Number of latest samples among which spikes are counted."""
MAX_SPIKES_WITHOUT_FAULT, MAX_SPIKES_AT_END_OF_FAULT = 2, 1
"""Largest number of spikes without the fault `SPIKES`, and largest number of spikes at which that fault ends."""
IMPOSSIBLE_SAMPLES_UNTIL_FAULT = 10
"""Number of successive samples with an impossible force that is a fault; a bouncing load gives fewer."""
DRIFT_BLOCK_SECONDS, ONE_WAY_CHANGES_UNTIL_DRIFT = 0.5, 4
"""Length of a block of samples [s], and number of successive changes of the blocks' means in one direction that are a
drift; the force of a swinging load changes its direction within this time."""


class _Stuck:
    """Counts the latest successive values that differ by at most one step of the converter."""

    def __init__(self, step: float) -> None:
        self._room = 1.01 * step
        self._last = self._low = self._high = math.nan
        self.count = 0

    def add(self, value: float) -> None:
        low, high, count = min(self._low, value), max(self._high, value), self.count + 1
        if not high - low <= self._room:  # and no run of equal values without a last value
            low, high, count = min(self._last, value), max(self._last, value), 2
        if not high - low <= self._room:
            low, high, count = value, value, 1
        self._last, self._low, self._high, self.count = value, low, high, count


class _Drift:
    """Detects a drift: the means of the last blocks change in one direction, faster than a limit."""

    def __init__(self, limit: float) -> None:
        self._least = limit * DRIFT_BLOCK_SECONDS
        self._begin, self._sum, self._count = math.nan, 0.0, 0
        self._means: deque[float] = deque(maxlen=ONE_WAY_CHANGES_UNTIL_DRIFT + 1)
        self.steady = False

    def add(self, time: float, value: float) -> None:
        if not time < self._begin + DRIFT_BLOCK_SECONDS:
            if self._count:
                self._means.append(self._sum / self._count)
                steps = [after - before for before, after in pairwise(self._means)]
                one_way = all(s > self._least for s in steps) or all(s < -self._least for s in steps)
                self.steady = len(steps) == ONE_WAY_CHANGES_UNTIL_DRIFT and one_way
            self._begin, self._sum, self._count = time, 0.0, 0
        self._sum += value
        self._count += 1


class LoadCellFaultDetector:
    """Detects faults of a load cell from its samples, which are passed in with their times.

    Args:
        limits: limits for the samples of a cell that works; by default `FaultLimits()`.
    """

    def __init__(self, limits: LoadCellFaultLimits | None = None) -> None:
        self._limits = limits or LoadCellFaultLimits()
        self._active: set[LoadCellFault] = set()
        self._events: list[LoadCellFaultEvent] = []
        self._heard: float | None = None
        self._patience = self._limits.start_up_seconds + self._limits.silent_after
        self._stuck, self._drift = _Stuck(self._limits.step), _Drift(self._limits.drift)
        self._latest: deque[float] = deque(maxlen=3)
        self._spikes: deque[bool] = deque(maxlen=SPIKE_WINDOW_SAMPLES)
        self._impossible = 0

    @property
    def active(self) -> tuple[LoadCellFault, ...]:
        """Faults that last at present, the most serious first."""
        return tuple(fault for fault in LoadCellFault if fault in self._active)

    def update(self, now: float, samples: Iterable[ForceSample]) -> LoadCellFault | None:
        """Add samples that arrived until `now` [s], oldest first; returns the most serious present fault, or None."""
        for sample in samples:
            self.add_sample(sample.time, sample.force)
        return self.check(now)

    def add_sample(self, time: float, value: float) -> None:
        """Add one sample: its time of reception [s], and its value in the unit of the limits."""
        self.check(time)
        self._heard, self._patience = time, self._limits.silent_after
        self._set(LoadCellFault.SILENT, False, time)
        limits = self._limits
        self._stuck.add(value)
        self._set(LoadCellFault.FROZEN, self._stuck.count >= limits.repeats, time)
        if limits.spike < math.inf:
            self._set(
                LoadCellFault.SPIKES,
                self._count_spikes(value)
                > (MAX_SPIKES_AT_END_OF_FAULT if LoadCellFault.SPIKES in self._active else MAX_SPIKES_WITHOUT_FAULT),
                time,
            )
        if limits.drift < math.inf:
            self._drift.add(time, value)
            self._set(LoadCellFault.DRIFTING, self._drift.steady, time)
        self._impossible = 0 if limits.min_force <= value <= limits.max_force else self._impossible + 1
        self._set(LoadCellFault.NEGATIVE, self._impossible >= IMPOSSIBLE_SAMPLES_UNTIL_FAULT, time)
        # Written in this form, the comparison also finds nan out of range.
        self._set(LoadCellFault.SATURATED, not limits.lower < value < limits.upper, time)

    def _count_spikes(self, value: float) -> int:
        """Count the latest samples that differ strongly from both neighbours, on the same side."""
        self._latest.append(value)
        if len(self._latest) == 3:
            before, middle, after = self._latest
            step = min(abs(middle - before), abs(middle - after))
            self._spikes.append(step > self._limits.spike and (middle > before) == (middle > after))
        return sum(self._spikes)

    def check(self, now: float) -> LoadCellFault | None:
        """Check whether samples are missing at `now` [s]; returns the most serious present fault, or None."""
        if self._heard is None:
            self._heard = now
        if now - self._heard > self._patience:
            self._set(LoadCellFault.SILENT, True, now)
        return next(iter(self.active), None)

    def take_events(self) -> list[LoadCellFaultEvent]:
        """Faults that began or ended since the last call, oldest first."""
        events, self._events = self._events, []
        return events

    def _set(self, fault: LoadCellFault, holds: bool, time: float) -> None:
        if holds != (fault in self._active):
            (self._active.add if holds else self._active.remove)(fault)
            self._events.append(LoadCellFaultEvent(time, fault, began=holds))


@dataclass(frozen=True)
class LoadCellStatus:
    """Status of a load cell at one instant.

    Attributes:
        connected: whether the serial port is open and connected.
        samples: number of received samples.
        rate: rate of the latest samples [Hz]; 0 while no samples arrive.
        active: faults that last at present, the most serious first.
        counts: for each fault, how often it began; for a single event, the number of lines or samples concerned.
    """

    connected: bool
    samples: int
    rate: float
    active: tuple[LoadCellFault, ...]
    counts: Mapping[LoadCellFault, int]

    @property
    def reliable(self) -> bool:
        """Whether the force of the load cell is reliable at present: connected, with samples and without a fault."""
        return self.connected and self.samples > 0 and not self.active
