"""The real load cell: a thread reads the serial line, adds times to the samples, and detects faults."""

import contextlib
import math
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import NamedTuple

from pipeline.loadcell.calibration import Calibration
from pipeline.loadcell.faults import (
    LoadCellFault,
    LoadCellFaultDetector,
    LoadCellFaultEvent,
    LoadCellFaultLimits,
    LoadCellStatus,
)
from pipeline.loadcell.protocol import DEFAULT_BAUD_RATE, MAXIMUM_COUNTS, MINIMUM_COUNTS, LoadCellLineDecoder, open_port
from pipeline.processes import Closable, HighPriorityThread
from pipeline.robot.protocol import ForceSample

MIN_SAMPLE_SPACING_SECONDS = 1e-6
"""Smallest time between two samples [s]: the times of a recording must increase."""
SAMPLES_PER_RATE_ESTIMATE = 100
"""Number of latest samples over which the sample rate is measured."""


class ReceptionClock:
    """Assigns times of reception to samples, and measures their rate.

    A busy computer or a USB adapter may deliver several samples at once. The last of them gets the present time; the
    others get earlier times at the measured period, but not before the previous sample.
    """

    def __init__(self) -> None:
        self._times: deque[float] = deque(maxlen=SAMPLES_PER_RATE_ESTIMATE)

    @property
    def rate(self) -> float:
        """Samples per second over the last `SAMPLES_PER_RATE_ESTIMATE` samples [Hz]; 0 before the second sample."""
        if len(self._times) < 2:
            return 0.0
        return (len(self._times) - 1) / (self._times[-1] - self._times[0])

    def reception_times(self, now: float, count: int) -> list[float]:
        """Times of reception [s], strictly increasing, of `count` samples that were delivered together at `now` [s]."""
        step, earliest = MIN_SAMPLE_SPACING_SECONDS, now - (count - 1) * MIN_SAMPLE_SPACING_SECONDS
        if self._times and count:
            step = (now - self._times[-1]) / count
            if len(self._times) > 1:
                step = min(step, 1.0 / self.rate)
            step = max(step, MIN_SAMPLE_SPACING_SECONDS)
            earliest = max(now - (count - 1) * step, self._times[-1] + step)
        stamps = [earliest + k * step for k in range(count)]
        self._times.extend(stamps)
        return stamps


MAX_QUEUED_SAMPLES_OR_EVENTS = 1000
"""Largest number of samples, and of events, that wait to be read; the oldest ones are dropped."""
FIRST_LINE_TIMEOUT_SECONDS = 5.0
"""Longest time until the first line [s]; a board with an Arduino boot loader takes 2 s after its port is opened."""
UNCALIBRATED_NOISE_COUNTS = 0.5
"""Noise that is assumed for a cell without a calibration [counts]; the noise of an HX711 is about 40 counts."""
MIN_SPIKE_SHARE_OF_FULL_SCALE = 1e-3
"""Smallest size of a spike as a share of the converter's range, about 0.1 N for a 1 kg cell, without the noise."""
SPIKE_MARGIN_STANDARD_DEVIATIONS = 10.0
"""Standard deviations of the noise that are added to the smallest size of a spike."""
MAX_PUSHING_FORCE_FROM_ZERO_DRIFT = 0.1
"""Largest pushing force that the drift of a cell's zero explains [N]; a string cannot push."""
MAX_FORCE_DRIFT_RATE = 0.1
"""Largest rate of drift of a cell that works, by creep or temperature [N/s]."""


def count_fault_limits(calibration: Calibration | None = None, silent_after: float = 0.2) -> LoadCellFaultLimits:
    """Limits for detecting faults in the counts of an HX711.

    Args:
        calibration: calibration of the cell; without it, drift and pushing forces are not detected.
        silent_after: time without a sample after which the cell counts as silent [s].
    """
    noise = UNCALIBRATED_NOISE_COUNTS if calibration is None else abs(calibration.noise / calibration.scale)
    limits = replace(
        LoadCellFaultLimits.from_noise(noise, 1.0, MINIMUM_COUNTS, MAXIMUM_COUNTS),
        spike=MIN_SPIKE_SHARE_OF_FULL_SCALE * (MAXIMUM_COUNTS - MINIMUM_COUNTS)
        + SPIKE_MARGIN_STANDARD_DEVIATIONS * noise,
        silent_after=silent_after,
        start_up_seconds=FIRST_LINE_TIMEOUT_SECONDS,
    )
    if calibration is None:
        return limits
    push, pull_raises = calibration.counts(-MAX_PUSHING_FORCE_FROM_ZERO_DRIFT), calibration.scale > 0
    return replace(
        limits,
        drift=MAX_FORCE_DRIFT_RATE / abs(calibration.scale),
        min_force=push if pull_raises else -math.inf,
        max_force=math.inf if pull_raises else push,
    )


class CountSample(NamedTuple):
    """One sample of the load cell's converter in counts, with its time of reception [s]."""

    time: float
    counts: int


class LoadCell(Closable):
    """A load cell with an HX711 on a microcontroller, which sends lines as in `pipeline.loadcell.protocol`.

    A thread reads the serial port from creation to `close`; use the object in a ``with`` block. Every method may be
    called from any thread. After a disconnection the cell stays disconnected, so that a plug which was pulled during a
    motion is noticed.

    Args:
        port: serial port, such as ``/dev/ttyUSB0`` or ``COM3``.
        calibration: conversion to newtons; None if only counts are needed.
        baud: baud rate.
        clock: function that returns the present time [s].
        silent_after: time without a sample after which the cell counts as silent [s].

    Raises:
        InputError: the port cannot be opened.
    """

    def __init__(
        self,
        port: str,
        calibration: Calibration | None,
        *,
        baud: int = DEFAULT_BAUD_RATE,
        clock: Callable[[], float] = time.monotonic,
        silent_after: float = 0.2,
    ) -> None:
        self._calibration, self._clock = calibration, clock
        self._line = open_port(port, baud)
        self._lock = threading.Lock()
        self._decoder, self._times = LoadCellLineDecoder(), ReceptionClock()
        self._detector = LoadCellFaultDetector(count_fault_limits(calibration, silent_after))
        self._samples: deque[CountSample] = deque(maxlen=MAX_QUEUED_SAMPLES_OR_EVENTS)
        self._events: deque[LoadCellFaultEvent] = deque(maxlen=MAX_QUEUED_SAMPLES_OR_EVENTS)
        self._faults: Counter[LoadCellFault] = Counter()
        self._received = 0
        self._overflowing = False
        self._connected = True
        self._detector.check(clock())
        self._stop = threading.Event()
        self._thread = HighPriorityThread(self._run, "load cell")
        self._thread.start()

    def close(self) -> None:
        """End the thread and close the port; received samples can still be read."""
        self._stop.set()
        self._thread.join()
        with contextlib.suppress(OSError):  # a disconnected port may refuse to close
            self._line.close()
        with self._lock:
            self._connected = False

    def read(self) -> list[ForceSample]:
        """Samples of force received since the last call, oldest first; also those of a faulty cell, see `status`."""
        assert self._calibration is not None, "a cell without a calibration gives counts"
        return [ForceSample(sample.time, self._calibration.force(sample.counts)) for sample in self.read_counts()]

    def read_counts(self) -> list[CountSample]:
        """Samples in counts received since the last call, oldest first."""
        with self._lock:
            samples = list(self._samples)
            self._samples.clear()
            self._overflowing = False
            return samples

    def take_events(self) -> list[LoadCellFaultEvent]:
        """Faults that began or ended since the last call, oldest first."""
        with self._lock:
            self._watch()
            events = list(self._events)
            self._events.clear()
            return events

    def status(self) -> LoadCellStatus:
        """Present status of the cell: connection, rate and faults."""
        with self._lock:
            self._watch()
            active = self._detector.active
            if self._faults[LoadCellFault.DISCONNECTED]:
                active = (LoadCellFault.DISCONNECTED, *active)
            heard = bool(self._received) and LoadCellFault.SILENT not in active and self._connected
            return LoadCellStatus(
                connected=self._connected,
                samples=self._received,
                rate=self._times.rate if heard else 0.0,
                active=active,
                counts={fault: self._faults[fault] for fault in LoadCellFault},
            )

    def _run(self) -> None:
        try:
            while not self._stop.is_set():
                # A disconnected line raises an error here; on some systems only `in_waiting` does.
                data = self._line.read(max(1, self._line.in_waiting))
                with self._lock:
                    self._take(data)
        except OSError:
            with self._lock:
                self._connected = False
                self._note([LoadCellFaultEvent(self._clock(), LoadCellFault.DISCONNECTED)])

    def _take(self, data: bytes) -> None:
        now = self._clock()
        decoded = self._decoder.decode_bytes(data)
        self._note(LoadCellFaultEvent(now, fault, count=count) for fault, count in decoded.faults.items())
        stamps = self._times.reception_times(now, len(decoded.readings))
        for stamp, reading in zip(stamps, decoded.readings, strict=True):
            self._detector.add_sample(stamp, reading.counts)
            self._received += 1
            if len(self._samples) == self._samples.maxlen:
                self._faults[LoadCellFault.OVERFLOW] += 1
                if not self._overflowing:
                    self._overflowing = True
                    self._events.append(LoadCellFaultEvent(stamp, LoadCellFault.OVERFLOW))
            self._samples.append(CountSample(stamp, reading.counts))
        self._watch()

    def _watch(self) -> None:
        if self._connected:
            self._detector.check(self._clock())
        self._note(self._detector.take_events())

    def _note(self, events: Iterable[LoadCellFaultEvent]) -> None:
        for event in events:
            self._events.append(event)
            if event.began:
                self._faults[event.fault] += event.count
