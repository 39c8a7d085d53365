"""What a load cell has said so far: figures of the force, and the faults in the order they came."""

import math
from collections import deque
from collections.abc import Iterable

from pipeline.loadcell.faults import FaultEvent
from pipeline.loadcell.sample import ForceSample

LATEST = 1.0
"""s; the moving figures are taken over this long."""
EVENTS = 1000


class Monitor:
    """Collects samples and events for as long as one looks, in constant memory.

    Attributes:
        events: the latest `EVENTS` of them, oldest first.
        samples: how many there were.
        mean: of all forces [N].
        minimum: [N].
        maximum: [N].
    """

    def __init__(self) -> None:
        self.events: deque[FaultEvent] = deque(maxlen=EVENTS)
        self.samples = 0
        self.mean, self.minimum, self.maximum = math.nan, math.inf, -math.inf
        self._squares = 0.0
        self._latest: deque[ForceSample] = deque()

    def add(self, samples: Iterable[ForceSample], events: Iterable[FaultEvent]) -> None:
        """Take in what arrived since the last call."""
        self.events.extend(events)
        for sample in samples:
            self.samples += 1
            # Welford, Technometrics 4, 419, 1962: a plain sum of squares loses the small noise of a large force.
            before = sample.force - (0.0 if self.samples == 1 else self.mean)
            self.mean = sample.force if self.samples == 1 else self.mean + before / self.samples
            self._squares += before * (sample.force - self.mean)
            self.minimum, self.maximum = min(self.minimum, sample.force), max(self.maximum, sample.force)
            self._latest.append(sample)
            while self._latest[0].time < sample.time - LATEST:
                self._latest.popleft()

    @property
    def std(self) -> float:
        """Standard deviation of all forces [N]; nan before the second."""
        return math.sqrt(self._squares / (self.samples - 1)) if self.samples > 1 else math.nan

    @property
    def latest(self) -> tuple[float, float, float]:
        """Latest force, mean and standard deviation over the last `LATEST` seconds [N]; nan where there are none."""
        forces = [sample.force for sample in self._latest]
        if not forces:
            return math.nan, math.nan, math.nan
        mean = math.fsum(forces) / len(forces)
        if len(forces) == 1:
            return forces[-1], mean, math.nan
        return forces[-1], mean, math.sqrt(math.fsum((force - mean) ** 2 for force in forces) / (len(forces) - 1))
