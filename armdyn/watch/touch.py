"""Outside torques: what no sound robot shows, told at once, and where it ends.

Two statistics are followed. The onset says of each joint what torque began some 30 ms ago, and nothing of what stays;
the contrast is later, and stays as long as the torque does. Either one beyond its threshold begins an event; the
contrast, or an onset of the opposite sign where the torque is too small for the contrast, ends it.
"""

from dataclasses import dataclass, replace

import numpy as np

from armdyn.recording.channels import FloatArray
from armdyn.watch.changes import WEAK
from armdyn.watch.event import Event, Kind, Reporter
from armdyn.watch.observer import GAP, Step
from armdyn.watch.sound import Sound
from armdyn.watch.variances import Level

LASTING = 5.0
"""s after which it is no touch any more: whatever stays so long is looked at as a change of load or robot."""
OVER = 0.5
"""Of the threshold, or of what it was, below which a contrast is gone: half-way, so that noise neither ends nor begins
it."""
QUIET = 0.3
"""s for which it must be gone, and after which the onset's filters hold nothing of how it began."""
REPEATED = 60.0
"""s for which what may be a load is not told again: whether it is one is told by the slow sums."""


@dataclass(frozen=True, eq=False)
class _Excess:
    """A statistic at one sample, (nj,): value, standard deviation, and how many of those a sound robot has at most."""

    value: FloatArray
    std: FloatArray
    threshold: FloatArray

    @property
    def ratio(self) -> FloatArray:
        """Over the largest sound one."""
        return np.asarray(np.abs(self.value) / (self.threshold * self.std))


@dataclass
class _Open:
    """One that goes on.

    Attributes:
        begun: when it was noticed, s.
        since: when it began, s.
        began: the onset in that joint.
        largest: (nj,) contrast at its largest.
        joint: where it shows best.
        doubted: whether it may be a load.
        lasting: whether the contrast shows it.
        reported: whether an event said so.
        gone: when it was gone, s.
    """

    begun: float
    since: float
    began: float
    largest: FloatArray
    joint: int
    doubted: bool
    lasting: bool
    reported: bool = True
    gone: float | None = None


class Touches:
    """Follows onset and contrast.

    Args:
        reporter: makes the events.
        sound: what a sound robot shows.
        per_hour: false alarms of these events.

    Attributes:
        going_on: whether the running mean and the slow sums must wait.
    """

    def __init__(self, reporter: Reporter, sound: Sound, per_hour: float) -> None:
        self._report, self._sound = reporter, sound
        each = per_hour / len(reporter.joints) / (1 if sound.onset is None else 2)
        self.threshold, self._sudden = (
            np.array([law.threshold(each) for law in laws]) for laws in (sound.touch, sound.sudden)
        )
        self._level = Level(sound.contrast)
        self._onset_level = None if sound.onset is None else Level(sound.onset.variance)
        self._open: _Open | None = None
        self._quiet = 0.0
        self._outlasted: FloatArray | None = None
        self._doubted = self._last = -np.inf

    @property
    def going_on(self) -> bool:
        """Whether something touches the arm now."""
        return self._open is not None

    @property
    def outside(self) -> bool:
        """Whether that is surely nothing that the tool carries."""
        return self._open is not None and not self._open.doubted

    def limit(self, step: Step) -> FloatArray:
        """(nj,) contrasts that a sound robot does not have."""
        return np.asarray(self.threshold * self._level.std(step.sources))

    def reset(self, time: float) -> None:
        """At a time, s, what went on is explained, or nothing is known of it."""
        self._open, self._outlasted, self._quiet = None, None, time

    def take(self, step: Step, load: FloatArray, delay: float) -> list[Event]:
        """What one sample tells.

        Args:
            step: of the observer.
            load: (nj, 4) columns of the load there.
            delay: of the observer, s.
        """
        contrast = _Excess(step.contrast, self._level.std(step.sources), self.threshold)
        seen = [contrast]
        interval, self._last = min(max(step.time - self._last, 0.0), GAP), step.time
        if self._open is None:
            self._level.take(step.contrast, step.sources, interval)
        if self._sound.onset is not None and self._onset_level is not None:
            began = self._sound.onset.began(step.stages)
            seen.append(_Excess(began, self._onset_level.std(step.sources), self._sudden))
            if self._open is None:
                self._onset_level.take(began, step.sources, interval)
        if self._open is not None:
            return self._went_on(self._open, step, seen, load)
        clearest = max(seen, key=lambda each: float(each.ratio.max()))
        highest = float(clearest.ratio.max())
        if highest < OVER:
            self._quiet = step.time
        return self._begun(step, clearest, contrast, load, delay) if highest >= 1.0 else []

    def _went_on(self, now: _Open, step: Step, seen: list[_Excess], load: FloatArray) -> list[Event]:
        contrast = seen[0]
        left, most = (float(np.linalg.norm(each / contrast.std)) for each in (contrast.value, now.largest))
        if left > most:
            now.largest = contrast.value
        shown = float(contrast.ratio.max()) >= OVER
        now.lasting |= shown
        if now.lasting:
            there = shown and left > OVER * most
        else:
            back = seen[-1].value[now.joint] * now.began
            opposite = step.time - now.begun > QUIET and back < 0.0 and seen[-1].ratio[now.joint] >= 1.0
            there = now.gone is None and not opposite
        if there:
            now.gone = None
        elif now.gone is None:
            now.gone = step.time
        elif step.time - now.gone > QUIET:
            self._open, self._quiet = None, step.time
            return [self._ended(now, step, contrast)] if now.reported else []
        if step.time - now.begun > LASTING:
            self._open, self._outlasted, self._quiet = None, now.largest, step.time
        elif now.doubted and not self._as_load(step, load, 1.0):
            now.doubted, now.reported, self._doubted = False, True, -np.inf
            return [self._event(Kind.OUTSIDE_TORQUE, now, step, contrast)]
        return []

    def _begun(self, step: Step, clearest: _Excess, contrast: _Excess, load: FloatArray, delay: float) -> list[Event]:
        joint, since, lasting = int(np.argmax(clearest.ratio)), self._quiet - delay, clearest is contrast
        if self._outlasted is not None:
            before, self._outlasted = self._outlasted, None
            left, most = (np.linalg.norm(each / contrast.std) for each in (contrast.value + before, before))
            if lasting and left < 0.5 * most:
                now = _Open(step.time, since, 0.0, -before, joint, doubted=False, lasting=True)
                return [self._ended(now, step, contrast)]
        # An onset says that something began, and not yet how large it is in which joint.
        doubted = not lasting or self._as_load(step, load, 0.5)
        now = self._open = _Open(
            step.time, since, float(clearest.value[joint]), contrast.value, joint, doubted, lasting
        )
        if not doubted:
            return [self._event(Kind.OUTSIDE_TORQUE, now, step, contrast)]
        now.reported, self._doubted = not 0.0 <= step.time - self._doubted < REPEATED, step.time
        return [self._event(Kind.NOT_TOLD, now, step, contrast)] if now.reported else []

    def _as_load(self, step: Step, load: FloatArray, share: float) -> bool:
        """Whether something that the tool carries would do: what it leaves is below a share of the threshold.

        Asked of the residual: the contrast's mean holds some of a load that was taken up in its last moments.
        """
        std = np.sqrt((self._sound.residual * step.sources).sum(axis=1))
        X, r = load / std[:, None], step.residual / std
        best = np.linalg.solve(X.T @ X + WEAK, X.T @ r)
        return bool((np.abs(r - X @ best) < share * self.threshold).all())

    def _event(self, kind: Kind, now: _Open, step: Step, contrast: _Excess) -> Event:
        torque = self._report.torque(now.joint, contrast.value[now.joint], contrast.std[now.joint])
        says = f"{torque} by now, since {now.since:.2f} s"
        if kind is Kind.NOT_TOLD:
            torque = replace(torque, what="outside_torque, payload")
            sentence = f"something touches the arm, or it took up a load; one moment cannot tell which: {says}."
        else:
            sentence = f"something outside acts on the arm: {says}."
        return self._report.event(kind, step.time, now.since, torque, sentence)

    def _ended(self, now: _Open, step: Step, contrast: _Excess) -> Event:
        torque = self._report.torque(now.joint, now.largest[now.joint], contrast.std[now.joint])
        sentence = f"what acted since {now.since:.2f} s is gone; it was {torque} at its largest."
        return self._report.event(Kind.RECOVERED, step.time, now.since, torque, sentence)
