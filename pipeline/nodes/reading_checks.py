"""Checks of readings: every reading is judged before it is used.

A single bad reading is left out and counted, and the motion goes on. A lasting problem is a fault, and ends the trial.
"""

from collections import Counter
from enum import Enum
from math import isfinite

import numpy as np

import urdf
from pipeline.robot.protocol import ForceSample, JointState, Vector

MAX_BRIDGED_READINGS = 5.0
"""Bad readings in a row that are bridged: 0.05 s at 100 Hz, in which the fastest swing moves the gripper by 5 cm."""
FORGIVEN_PER_GOOD_READING = 0.1
"""Bad readings that each good one makes up for: one in ten may be bad for ever, more than that are a fault."""
MAX_READING_AGE_SECONDS = 0.05
"""A reading that was taken longer ago than this [s] says nothing about where the arm is now."""
MAX_STAMP_LEAD_SECONDS = 0.02
"""A stamp may be ahead of the robot's clock by two cycles [s]: it is read before the clock."""
MAX_SPEED_SHARE = 2.0
"""No joint moves faster than this share of its velocity limit; in healthy trials 0.74 is the most."""
MAX_REST_DIFFERENCE = 0.01
"""Difference of two readings of a joint at rest [rad], far above noise and resolution (0.0005 rad)."""
MAX_EFFORT_SHARE = 3.0
"""An effort is plausible up to this share of the joint's limit: gains and offsets of the measurement included."""


class Refused(Enum):
    """Reason why a reading is left out; the value completes the sentence "the reading ..."."""

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
    """Counts refused readings, and reports a fault when there are too many in a row.

    Args:
        source: name of the device for messages, such as "joints".
        check: advice to a person where readings are refused for long.

    Attributes:
        refused: number of readings that were left out, by reason.
        fault: a sentence once bad readings have lasted; None before.
    """

    def __init__(self, source: str, check: str = "check sensor, cable and clock") -> None:
        self._source, self._check = source, check
        self._level = 0.0
        self._seen_good = False
        self.refused: Counter[Refused] = Counter()
        self.fault: str | None = None

    def accept(self) -> None:
        """Note a good reading."""
        self._seen_good = True
        self._level = max(0.0, self._level - FORGIVEN_PER_GOOD_READING)

    def refuse(self, why: Refused, now: float) -> None:
        """Note a bad reading at `now` [s]."""
        self.refused[why] += 1
        self._level += 1.0
        if self.fault is None and (self._level > MAX_BRIDGED_READINGS or not self._seen_good):
            self.fault = (
                f"{self._source} at {now:.2f} s: the reading {why.value}, and {self.refused.total()} were refused in "
                f"all: {self._check}"
            )

    @property
    def notes(self) -> tuple[str, ...]:
        """A sentence per kind of refused reading."""
        return tuple(
            f"{self._source}: {count} reading{'s' if count > 1 else ''} left out: the reading {why.value}"
            for why, count in self.refused.items()
        )


class JointReadingCheck(ReadingCheck):
    """Judges the readings of the joints."""

    def __init__(self, limits: urdf.Limits) -> None:
        super().__init__("joints")
        self._limits = limits
        self._last: JointState | None = None

    def judge(self, state: JointState, now: float) -> Refused | None:
        """Reason why a reading received at `now` [s] cannot be used; None where it can, and the reading is stored."""
        why = self._why_not(state, now)
        if why is None:
            self._last = state
            self.accept()
        else:
            self.refuse(why, now)
        return why

    def _why_not(self, state: JointState, now: float) -> Refused | None:
        joints = self._limits.velocity.shape
        values = (state.q, state.v, state.tau)
        told = [state.q, *(value for value in (state.v, state.tau) if not np.isnan(value).all())]
        if any(np.shape(value) != joints for value in values):
            return Refused.WRONG_NUMBER
        if not (isfinite(state.time) and all(np.isfinite(value).all() for value in told)):
            return Refused.NOT_A_NUMBER
        last = self._last
        if last is not None and state.time <= last.time:
            return Refused.OUT_OF_ORDER
        stamp = _stamp_problem(state.time, now)
        if stamp is not None:
            return stamp
        quick = MAX_SPEED_SHARE * self._limits.velocity
        speed, effort = np.abs(np.nan_to_num(state.v)), np.abs(np.nan_to_num(state.tau))
        if not (np.all(speed <= quick) and np.all(effort <= MAX_EFFORT_SHARE * self._limits.effort)):
            return Refused.OUT_OF_RANGE
        if last is not None and np.any(
            np.abs(state.q - last.q) > quick * (state.time - last.time) + MAX_REST_DIFFERENCE
        ):
            return Refused.JUMP
        return None

    def bridged(self, period: float) -> Vector:
        """Joint positions (n,) [rad] extrapolated by a period [s] from the last good reading.

        Valid for few missing readings only; a fault ends the trial before the extrapolation is far off.
        """
        last = self._last
        assert last is not None, "bridging needs a good reading"
        position: Vector = last.q + np.nan_to_num(last.v) * period
        return position


class ForceReadingCheck(ReadingCheck):
    """Judges the samples of the load cell.

    Samples that jump are held back. Where the force returns within `MAX_BRIDGED_READINGS` samples, they were spikes;
    where it stays, the string has gone slack, and the samples are used, or the cell has failed.

    Args:
        jump: largest change of the force between two samples while the string is taut [N].
        drift: how much more it may change with every sample that is held back [N].
        taut: force above which the string is taut [N]; a string that was slack may pull with any jerk.

    Attributes:
        failed: samples of the last call that jumped and stayed; they may show what is wrong with the cell.
    """

    def __init__(self, jump: float, drift: float, taut: float) -> None:
        super().__init__("load cell", "check sensor, cable and clock, and whether the load struck something")
        self._jump, self._drift, self._taut = jump, drift, taut
        self._last: ForceSample | None = None
        self._held: list[ForceSample] = []
        self._stamp = -np.inf
        self.failed: list[ForceSample] = []

    def judge(self, samples: list[ForceSample], now: float, hangs_until: float) -> list[ForceSample]:
        """The usable samples, oldest first, of those received at `now` [s].

        From `hangs_until` [s] on the load may touch something, and any jump is possible.
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
            if len(self._held) <= MAX_BRIDGED_READINGS:
                continue
            if all(held.force <= self._taut for held in self._held[1:]):
                good += self._take_held()
            else:
                self.failed += self._held
                self._refuse_held(now, Refused.JUMP)
        return good

    def _follows(self, sample: ForceSample) -> bool:
        """Whether a force can follow from the last good one."""
        last = self._last
        if last is None or last.force <= self._taut:
            return True
        return abs(sample.force - last.force) <= self._jump + self._drift * len(self._held)

    def _take_held(self) -> list[ForceSample]:
        held, self._held = self._held, []
        return [self._take(sample) for sample in held]

    def _refuse_held(self, now: float, why: Refused = Refused.SPIKE) -> None:
        for _ in self._held:
            self.refuse(why, now)
        self._held = []

    def _take(self, sample: ForceSample) -> ForceSample:
        self._last = sample
        self.accept()
        return sample

    def _why_not(self, sample: ForceSample, now: float) -> Refused | None:
        if not (isfinite(sample.time) and isfinite(sample.force)):
            return Refused.NOT_A_NUMBER
        if sample.time <= self._stamp:
            return Refused.OUT_OF_ORDER
        return _stamp_problem(sample.time, now)


def _stamp_problem(stamp: float, now: float) -> Refused | None:
    if stamp > now + MAX_STAMP_LEAD_SECONDS:
        return Refused.AHEAD
    return Refused.STALE if now - stamp > MAX_READING_AGE_SECONDS else None
