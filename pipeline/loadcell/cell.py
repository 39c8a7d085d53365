"""The real load cell: a thread reads the serial line, stamps the samples and detects faults."""

import contextlib
import math
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import NamedTuple

from pipeline.loadcell.calibration import Calibration
from pipeline.loadcell.faults import Fault, FaultDetector, FaultEvent, FaultLimits, LoadCellStatus
from pipeline.loadcell.protocol import BAUD, MAXIMUM_COUNTS, MINIMUM_COUNTS, Decoder, open_port
from pipeline.processes import Closing, PromptThread
from pipeline.robot.protocol import ForceSample

MIN_SAMPLE_SPACING = 1e-6
"""Least time between two samples [s]: a recording's times strictly increase."""
RATE_SAMPLES = 100
"""Samples over which the rate is measured."""


class ReceptionTimes:
    """Stamps samples with the time of their reception and measures their rate.

    A busy computer, or a USB adapter that collects bytes, hands over several samples at once. The last of them has just
    arrived; the others are dated back by the measured period, at most to an even spread since the sample before.
    """

    def __init__(self) -> None:
        self._times: deque[float] = deque(maxlen=RATE_SAMPLES)

    @property
    def rate(self) -> float:
        """Samples per second over the last `RATE_SAMPLES` samples; 0 before the second one."""
        if len(self._times) < 2:
            return 0.0
        return (len(self._times) - 1) / (self._times[-1] - self._times[0])

    def stamp(self, now: float, count: int) -> list[float]:
        """Strictly increasing times of `count` samples that came in one piece, handed over at `now` [s]."""
        step, earliest = MIN_SAMPLE_SPACING, now - (count - 1) * MIN_SAMPLE_SPACING
        if self._times and count:
            step = (now - self._times[-1]) / count
            if len(self._times) > 1:
                step = min(step, 1.0 / self.rate)
            step = max(step, MIN_SAMPLE_SPACING)
            earliest = max(now - (count - 1) * step, self._times[-1] + step)
        stamps = [earliest + k * step for k in range(count)]
        self._times.extend(stamps)
        return stamps


QUEUE_LENGTH = 1000
"""Samples and events that wait to be taken; the oldest go first."""
START_UP_SECONDS = 5.0
"""Longest time to the first line [s]; a board with an Arduino boot loader takes about 2 s after its port is opened."""
UNCALIBRATED_NOISE_COUNTS = 0.5
"""Counts; assumed of a cell that is not calibrated. The HX711's own is about 40 (90 nV of 20 mV at 80 samples/s)."""
SPIKE_RANGE_SHARE = 1e-3
"""Share of the converter's range by which a spike stands out at least, about 0.1 N of a 1 kg cell; and ..."""
SPIKE_NOISE_DEVIATIONS = 10.0
"""... so many standard deviations of the noise."""
MAX_PUSH_FORCE = 0.1
"""A string cannot push: a force below minus this [N] is more than the zero of a cell moves in a day."""
MAX_DRIFT_RATE = 0.1
"""Faster than this [N/s] no cell creeps or warms up."""


def count_limits(calibration: Calibration | None = None, silent_after: float = 0.2) -> FaultLimits:
    """Fault limits for the counts of an HX711, and with a calibration for the forces too."""
    noise = UNCALIBRATED_NOISE_COUNTS if calibration is None else abs(calibration.noise / calibration.scale)
    limits = replace(
        FaultLimits.of(noise, 1.0, MINIMUM_COUNTS, MAXIMUM_COUNTS),
        spike=SPIKE_RANGE_SHARE * (MAXIMUM_COUNTS - MINIMUM_COUNTS) + SPIKE_NOISE_DEVIATIONS * noise,
        silent_after=silent_after,
        start_up=START_UP_SECONDS,
    )
    if calibration is None:
        return limits
    push, pull_raises = calibration.counts(-MAX_PUSH_FORCE), calibration.scale > 0
    return replace(
        limits,
        drift=MAX_DRIFT_RATE / abs(calibration.scale),
        least=push if pull_raises else -math.inf,
        most=math.inf if pull_raises else push,
    )


class CountSample(NamedTuple):
    """Counts and the time of their reception [s]."""

    time: float
    counts: int


class LoadCell(Closing):
    """An HX711 on a microcontroller that speaks the line protocol of `pipeline.loadcell.protocol`.

    It reads in a thread of its own from creation to `close`; use it as a context manager. Every method may be called
    from any thread. After a disconnection nothing more arrives: a cell that was unplugged in the middle of a motion
    must not come back unnoticed. Without a calibration it gives only counts. The clock gives the time of reception [s];
    a time without a sample [s] counts as silence.

    Raises:
        InputError: the port, such as ``/dev/ttyUSB0`` or ``COM3``, cannot be opened.
    """

    def __init__(
        self,
        port: str,
        calibration: Calibration | None,
        *,
        baud: int = BAUD,
        clock: Callable[[], float] = time.monotonic,
        silent_after: float = 0.2,
    ) -> None:
        self._calibration, self._clock = calibration, clock
        self._line = open_port(port, baud)
        self._lock = threading.Lock()
        self._decoder, self._times = Decoder(), ReceptionTimes()
        self._detector = FaultDetector(count_limits(calibration, silent_after))
        self._samples: deque[CountSample] = deque(maxlen=QUEUE_LENGTH)
        self._events: deque[FaultEvent] = deque(maxlen=QUEUE_LENGTH)
        self._faults: Counter[Fault] = Counter()
        self._received = 0
        self._overflowing = False
        self._connected = True
        self._detector.check(clock())
        self._stop = threading.Event()
        self._thread = PromptThread(self._run, "load cell")
        self._thread.start()

    def close(self) -> None:
        """End the thread, then release the port; samples that were received can still be read."""
        self._stop.set()
        self._thread.join()
        with contextlib.suppress(OSError):  # a disconnected port may refuse to close
            self._line.close()
        with self._lock:
            self._connected = False

    def read(self) -> list[ForceSample]:
        """Forces received since the last call, oldest first; those of a faulty cell are among them, see `status`."""
        assert self._calibration is not None, "a cell without a calibration gives counts"
        return [ForceSample(sample.time, self._calibration.force(sample.counts)) for sample in self.read_counts()]

    def read_counts(self) -> list[CountSample]:
        """Counts received since the last call, oldest first, with their times of reception."""
        with self._lock:
            samples = list(self._samples)
            self._samples.clear()
            self._overflowing = False
            return samples

    def events(self) -> list[FaultEvent]:
        """Faults that began or ended since the last call, oldest first."""
        with self._lock:
            self._watch()
            events = list(self._events)
            self._events.clear()
            return events

    def status(self) -> LoadCellStatus:
        """Present status of the cell."""
        with self._lock:
            self._watch()
            active = self._detector.active
            if self._faults[Fault.DISCONNECTED]:
                active = (Fault.DISCONNECTED, *active)
            heard = bool(self._received) and Fault.SILENT not in active and self._connected
            return LoadCellStatus(
                connected=self._connected,
                samples=self._received,
                rate=self._times.rate if heard else 0.0,
                active=active,
                counts={fault: self._faults[fault] for fault in Fault},
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
                self._note([FaultEvent(self._clock(), Fault.DISCONNECTED)])

    def _take(self, data: bytes) -> None:
        now = self._clock()
        decoded = self._decoder.feed(data)
        self._note(FaultEvent(now, fault, count=count) for fault, count in decoded.faults.items())
        stamps = self._times.stamp(now, len(decoded.readings))
        for stamp, reading in zip(stamps, decoded.readings, strict=True):
            self._detector.sample(stamp, reading.counts)
            self._received += 1
            if len(self._samples) == self._samples.maxlen:
                self._faults[Fault.OVERFLOW] += 1
                if not self._overflowing:
                    self._overflowing = True
                    self._events.append(FaultEvent(stamp, Fault.OVERFLOW))
            self._samples.append(CountSample(stamp, reading.counts))
        self._watch()

    def _watch(self) -> None:
        if self._connected:
            self._detector.check(self._clock())
        self._note(self._detector.take_events())

    def _note(self, events: Iterable[FaultEvent]) -> None:
        for event in events:
            self._events.append(event)
            if event.began:
                self._faults[event.fault] += event.count
