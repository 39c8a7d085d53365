"""Times of reception for samples that may come in one piece."""

from collections import deque

SMALLEST_STEP = 1e-6
"""s; a recording's times strictly increase."""
WINDOW = 100
"""Samples over which the rate is measured."""


class ReceptionTimes:
    """Stamps samples with the time of their reception and measures their rate.

    A busy computer, or a USB adapter that collects bytes, hands over several samples at once. The last of them has just
    arrived; the others are dated back by the measured period, at most to an even spread since the sample before.
    """

    def __init__(self) -> None:
        self._times: deque[float] = deque(maxlen=WINDOW)

    @property
    def latest(self) -> float | None:
        """Time of the latest sample [s]."""
        return self._times[-1] if self._times else None

    @property
    def rate(self) -> float:
        """Samples per second over the last `WINDOW` samples; 0 before the second one."""
        if len(self._times) < 2:
            return 0.0
        return (len(self._times) - 1) / (self._times[-1] - self._times[0])

    def stamp(self, now: float, count: int) -> list[float]:
        """Strictly increasing times of `count` samples that came in one piece, handed over at `now` [s]."""
        if count == 0:
            return []
        step, earliest = SMALLEST_STEP, now - (count - 1) * SMALLEST_STEP
        if self._times:
            step = (now - self._times[-1]) / count
            if len(self._times) > 1:
                step = min(step, 1.0 / self.rate)
            step = max(step, SMALLEST_STEP)
            earliest = max(now - (count - 1) * step, self._times[-1] + step)
        stamps = [earliest + k * step for k in range(count)]
        self._times.extend(stamps)
        return stamps
