"""What a watch has seen: how long it watched, which samples it skipped and why, and when its source fell silent."""

import math
from collections import Counter
from enum import Enum

SILENT_SECONDS = 3.0
"""Time without a sample that is watched after which a source is silent, s; after a gap the filters need 1 s of it."""


class Skipped(Enum):
    """Why a sample is not watched."""

    NO_TIME = "no time"
    NO_POSITION = "no position"
    NO_TORQUE = "no torque"
    NO_WRENCH = "no wrench"
    NO_VALUE = "no position and no torque"
    IMPOSSIBLE = "a torque that no drive has"
    NOT_LATER = "time does not increase"
    SETTLING = "filters settle after a start, a gap or a jump"


class Coverage:
    """Counts what was watched of one source after the other.

    Attributes:
        watched: time that was watched, s.
        skipped: number of samples that were not, by reason.
        is_watching: whether the last sample was watched.
    """

    def __init__(self) -> None:
        self.watched = 0.0
        self.skipped = Counter[Skipped]()
        self.begin()

    def begin(self) -> None:
        """A new source begins."""
        self._last: float | None = None
        self._silent_since: float | None = None
        self.is_watching = False

    @property
    def reasons(self) -> dict[str, int]:
        """Number of skipped samples by reason, most frequent first."""
        return {reason.value: count for reason, count in self.skipped.most_common()}

    @property
    def sentence(self) -> str:
        """The present state in one line."""
        if self._silent_since is not None:
            state = f"silent since {self._silent_since:.1f} s"
        elif self.is_watching and self._last is not None:
            state = f"watching at {self._last:.1f} s"
        else:
            state = "no sample is watched yet" if self._last is None else f"not watching since {self._last:.1f} s"
        why = ", ".join(f"{reason}: {count}" for reason, count in self.reasons.items())
        skipped = f"{self.skipped.total()} samples skipped" + (f" ({why})" if why else "")
        return f"{state}; watched {self.watched:.1f} s, {skipped}"

    def count(self, time: float, reason: Skipped | None) -> float | None:
        """Count a sample at a time, s, which was watched unless there is a reason.

        Returns:
            Time since which the source was silent, s, if this sample ends it; otherwise None.
        """
        if reason is not None:
            self.is_watching = False
            self.skipped[reason] += 1
            if math.isfinite(time) and (self._last is None or time < self._last):
                self._last = time
            return None
        if self.is_watching and self._last is not None:
            self.watched += time - self._last
        ended, self._silent_since = self._silent_since, None
        self._last, self.is_watching = time, True
        return ended

    def silent_since(self, time: float) -> float | None:
        """Time of the last watched sample, s, if the source has just become silent at a time, s; otherwise None."""
        last = 0.0 if self._last is None else self._last
        if self._silent_since is not None or not time - last > SILENT_SECONDS:
            return None
        self._silent_since = last
        return last

    def time_after(self, idle: float) -> float:
        """The time `idle` s after the last watched sample."""
        return (0.0 if self._last is None else self._last) + idle
