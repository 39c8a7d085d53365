"""Check every reading of joints and load cell before it is used.

A single bad reading is left out and counted, and the motion continues. Several bad readings are a fault, which ends the
trial.
"""

from collections import Counter
from enum import Enum
from math import isfinite

import numpy as np

import urdf
from pipeline.robot.protocol import ForceSample, JointState, Vector

MAX_SUCCESSIVE_BAD_READINGS = 5.0
"""Largest number of successive bad readings that are not a fault: 0.05 s at 100 Hz."""
BAD_READINGS_PER_GOOD_READING = 0.1
"""Number of bad readings that a good one compensates: with more than one bad reading in ten there is a fault."""
MAX_READING_AGE_SECONDS = 0.05
"""Largest age of a reading [s]."""
MAX_STAMP_LEAD_SECONDS = 0.02
"""Largest time by which a reading's time stamp may be ahead of the robot's clock [s]."""
MAX_SPEED_TO_LIMIT_RATIO = 2.0
"""Largest plausible speed of a joint, as a share of its velocity limit; trials without faults show 0.74."""
MAX_READING_CHANGE_AT_REST = 0.01
"""Largest plausible difference of two readings of a joint at rest [rad], far above noise and resolution."""
MAX_EFFORT_TO_LIMIT_RATIO = 3.0
"""Largest plausible effort of a joint, as a share of its effort limit."""


class ReadingRefusal(Enum):
    """Reason why a reading was refused; the value completes the sentence "the reading ..."."""

    UNREADABLE = "cannot be read"
    WRONG_NUMBER = "has the wrong number of values"
    NOT_A_NUMBER = "holds a NaN or an infinity"
    OUT_OF_ORDER = "has a time stamp that is not later than the one before"
    STALE = "is too old"
    AHEAD = "has a time stamp in the future: a clock has jumped"
    OUT_OF_RANGE = "is out of range"
    JUMP = "jumps farther than is physically possible"
    SPIKE = "is a spike"


class ReadingCheck:
    """Counts the refused readings of a device, and reports a fault when there are too many.

    Args:
        source: name of the device for messages, such as "joints".
        check: advice for the message about a fault.

    Attributes:
        refused: number of refused readings, by reason.
        fault: message about too many refused readings; None before.
    """

    def __init__(self, source: str, check: str = "check sensor, cable and clock") -> None:
        self._source, self._check = source, check
        self._level = 0.0
        self._seen_good = False
        self.refused: Counter[ReadingRefusal] = Counter()
        self.fault: str | None = None

    def accept(self) -> None:
        """Count a good reading."""
        self._seen_good = True
        self._level = max(0.0, self._level - BAD_READINGS_PER_GOOD_READING)

    def refuse(self, why: ReadingRefusal, now: float) -> None:
        """Count a bad reading at the time `now` [s]."""
        self.refused[why] += 1
        self._level += 1.0
        if self.fault is None and (self._level > MAX_SUCCESSIVE_BAD_READINGS or not self._seen_good):
            self.fault = (
                f"{self._source} at {now:.2f} s: the reading {why.value}, and {self.refused.total()} were refused in "
                f"all: {self._check}"
            )

    @property
    def notes(self) -> tuple[str, ...]:
        """One sentence per reason for which readings were refused."""
        return tuple(
            f"{self._source}: {count} reading{'s' if count > 1 else ''} left out: the reading {why.value}"
            for why, count in self.refused.items()
        )


class JointReadingCheck(ReadingCheck):
    """Checks the readings of the joints; `limits` are the limits of the joints."""

    def __init__(self, limits: urdf.Limits) -> None:
        super().__init__("joints")
        self._limits = limits
        self._last: JointState | None = None

    def check(self, state: JointState, now: float) -> ReadingRefusal | None:
        """Check a reading that was received at the time `now` [s]; returns why it cannot be used, or None if it can."""
        why = self._why_not(state, now)
        if why is None:
            self._last = state
            self.accept()
        else:
            self.refuse(why, now)
        return why

    def _why_not(self, state: JointState, now: float) -> ReadingRefusal | None:
        joints = self._limits.velocity.shape
        values = (state.q, state.v, state.tau)
        told = [state.q, *(value for value in (state.v, state.tau) if not np.isnan(value).all())]
        if any(np.shape(value) != joints for value in values):
            return ReadingRefusal.WRONG_NUMBER
        if not (isfinite(state.time) and all(np.isfinite(value).all() for value in told)):
            return ReadingRefusal.NOT_A_NUMBER
        last = self._last
        if last is not None and state.time <= last.time:
            return ReadingRefusal.OUT_OF_ORDER
        stamp = _stamp_problem(state.time, now)
        if stamp is not None:
            return stamp
        quick = MAX_SPEED_TO_LIMIT_RATIO * self._limits.velocity
        speed, effort = np.abs(np.nan_to_num(state.v)), np.abs(np.nan_to_num(state.tau))
        if not (np.all(speed <= quick) and np.all(effort <= MAX_EFFORT_TO_LIMIT_RATIO * self._limits.effort)):
            return ReadingRefusal.OUT_OF_RANGE
        if last is not None and np.any(
            np.abs(state.q - last.q) > quick * (state.time - last.time) + MAX_READING_CHANGE_AT_REST
        ):
            return ReadingRefusal.JUMP
        return None

    def extrapolated(self, period: float) -> Vector:
        """Joint positions (n,) [rad], extrapolated with constant velocity by a time [s] from the last good reading.

        The extrapolation is used for few missing readings; before it becomes inaccurate, a fault ends the trial.
        """
        last = self._last
        assert last is not None, "bridging needs a good reading"
        position: Vector = last.q + np.nan_to_num(last.v) * period
        return position


class ForceReadingCheck(ReadingCheck):
    """Checks the samples of the load cell.

    After a jump of the force, samples wait. If the force returns within `MAX_SUCCESSIVE_BAD_READINGS` samples, they
    were spikes. If it does not return, the string has become slack and the samples are used, or the load cell has
    failed.

    Args:
        jump: largest change of the force between two samples while the string is taut [N].
        drift: further change of the force for every sample that waits [N].
        taut: force above which the string is taut [N]; after a slack string, any change is possible.

    Attributes:
        failed: samples of the last call after a jump without a return, for the detection of the cell's fault.
    """

    def __init__(self, jump: float, drift: float, taut: float) -> None:
        super().__init__("load cell", "check sensor, cable and clock, and whether the load struck something")
        self._jump, self._drift, self._taut = jump, drift, taut
        self._last: ForceSample | None = None
        self._held: list[ForceSample] = []
        self._stamp = -np.inf
        self.failed: list[ForceSample] = []

    def check(self, samples: list[ForceSample], now: float, hangs_until: float) -> list[ForceSample]:
        """Check samples; returns the good ones, oldest first.

        Args:
            samples: the samples, oldest first.
            now: time of their reception [s].
            hangs_until: time from which the load may touch the box, so that any jump is possible [s].
        """
        good: list[ForceSample] = []
        self.failed = []
        for sample in samples:
            why = self._why_not(sample, now)
            if why is not None:
                self.refuse(why, now)
                continue
            self._stamp = sample.time
            touches = sample.time > hangs_until
            if touches:
                good += self._take_held()
            if touches or self._follows(sample):
                self._refuse_held(now)
                good.append(self._take(sample))
                continue
            self._held.append(sample)
            if len(self._held) <= MAX_SUCCESSIVE_BAD_READINGS:
                continue
            if all(held.force <= self._taut for held in self._held[1:]):
                good += self._take_held()
            else:
                self.failed += self._held
                self._refuse_held(now, ReadingRefusal.JUMP)
        return good

    def _follows(self, sample: ForceSample) -> bool:
        """Whether a force is plausible after the last good one."""
        last = self._last
        if last is None or last.force <= self._taut:
            return True
        return abs(sample.force - last.force) <= self._jump + self._drift * len(self._held)

    def _take_held(self) -> list[ForceSample]:
        held, self._held = self._held, []
        return [self._take(sample) for sample in held]

    def _refuse_held(self, now: float, why: ReadingRefusal = ReadingRefusal.SPIKE) -> None:
        for _ in self._held:
            self.refuse(why, now)
        self._held = []

    def _take(self, sample: ForceSample) -> ForceSample:
        self._last = sample
        self.accept()
        return sample

    def _why_not(self, sample: ForceSample, now: float) -> ReadingRefusal | None:
        if not (isfinite(sample.time) and isfinite(sample.force)):
            return ReadingRefusal.NOT_A_NUMBER
        if sample.time <= self._stamp:
            return ReadingRefusal.OUT_OF_ORDER
        return _stamp_problem(sample.time, now)


def _stamp_problem(stamp: float, now: float) -> ReadingRefusal | None:
    if stamp > now + MAX_STAMP_LEAD_SECONDS:
        return ReadingRefusal.AHEAD
    return ReadingRefusal.STALE if now - stamp > MAX_READING_AGE_SECONDS else None
