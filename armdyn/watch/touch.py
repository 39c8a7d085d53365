"""Outside torques: a contrast that no sound robot has, told at once, and where it ends."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armdyn.recording.channels import FloatArray
from armdyn.watch.changes import LOAD
from armdyn.watch.event import Event, Kind
from armdyn.watch.observer import GAP, Step
from armdyn.watch.sound import Bouts, Sound

LASTING = 5.0
"""s after which it is no touch any more: whatever stays so long is looked at as a change of load or robot."""
OVER = 0.5
"""Of the threshold, or of what it was, below which a contrast is gone: half-way, so that noise neither ends nor begins
it."""
QUIET = 0.3
"""s for which it must be gone."""
REPEATED = 60.0
"""s for which what may be a load is not told again: whether it is one is told by the slow sums."""


@dataclass
class _Open:
    """One that goes on.

    Attributes:
        begun: when it was noticed, s.
        since: when it began, s.
        largest: (nj,) contrast at its largest.
        joint: where it shows best.
        doubted: whether it may be a load.
        told: whether it was told.
        gone: when it was gone, s.
    """

    begun: float
    since: float
    largest: FloatArray
    joint: int
    doubted: bool
    told: bool = True
    gone: float | None = None


class Touches:
    """Follows the contrast.

    Args:
        joints: their names.
        units: of their torques.
        sound: what is usual.
        per_hour: false alarms of these events.
        told: rate of all false alarms, which events state.

    Attributes:
        going_on: whether the running mean and the slow sums must wait.
    """

    def __init__(self, joints: Sequence[str], units: Sequence[str], sound: Sound, per_hour: float, told: float) -> None:
        self._joints, self._units, self._sound, self._told = joints, units, sound, told
        self.threshold = np.array([law.threshold(per_hour / len(joints)) for law in sound.touch])
        self._open: _Open | None = None
        self._quiet = 0.0
        self._lasting: FloatArray | None = None
        self._doubted = self._last = -np.inf
        self._bouts = Bouts(len(joints))

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
        return np.asarray(self.threshold * self._scale(step))

    def _usual(self, step: Step) -> FloatArray:
        return np.asarray(np.sqrt((self._sound.contrast * step.sources).sum(axis=1)))

    def _scale(self, step: Step) -> FloatArray:
        return np.asarray(self._bouts.factor * self._usual(step))

    def reset(self, time: float) -> None:
        """At a time, s, what went on is explained, or nothing is known of it."""
        self._open, self._lasting, self._quiet = None, None, time

    def take(self, step: Step, load: FloatArray, delay: float) -> list[Event]:
        """What one sample tells.

        Args:
            step: of the observer.
            load: (nj, 4) columns of the load there.
            delay: of the observer, s.
        """
        usual = self._usual(step)
        ratio = np.abs(step.contrast) / (self.threshold * self._bouts.factor * usual)
        highest = float(ratio.max())
        if self._open is None:
            self._bouts.take(np.abs(step.contrast) / usual, min(max(step.time - self._last, 0.0), GAP))
        self._last = step.time
        if self._open is None:
            if highest < OVER:
                self._quiet = step.time
            return self._begun(step, ratio, load, delay) if highest >= 1.0 else []
        now = self._open
        left, most = (float(np.linalg.norm(each / self._scale(step))) for each in (step.contrast, now.largest))
        if left > most:
            now.largest = step.contrast
        if highest >= OVER and left > OVER * most:
            now.gone = None
        elif now.gone is None:
            now.gone = step.time
        elif step.time - now.gone > QUIET:
            self._open, self._quiet = None, step.time
            return [self._ended(now, step)] if now.told else []
        if step.time - now.begun > LASTING:
            self._open, self._lasting, self._quiet = None, now.largest, step.time
        elif now.doubted and not self._as_load(step, load, 1.0):
            now.doubted, now.told = False, True
            return [self._event(Kind.OUTSIDE_TORQUE, now, step)]
        return []

    def _begun(self, step: Step, ratio: FloatArray, load: FloatArray, delay: float) -> list[Event]:
        scale, joint = self._scale(step), int(np.argmax(ratio))
        if self._lasting is not None:
            left = np.linalg.norm((step.contrast + self._lasting) / scale)
            before, self._lasting = self._lasting, None
            if left < 0.5 * np.linalg.norm(before / scale):
                now = _Open(step.time, self._quiet - delay, -before, joint, doubted=False)
                return [self._ended(now, step)]
        now = _Open(step.time, self._quiet - delay, step.contrast, joint, self._as_load(step, load, 0.5))
        self._open = now
        if not now.doubted:
            return [self._event(Kind.OUTSIDE_TORQUE, now, step)]
        now.told, self._doubted = not 0.0 <= step.time - self._doubted < REPEATED, step.time
        return [self._event(Kind.NOT_TOLD, now, step)] if now.told else []

    def _as_load(self, step: Step, load: FloatArray, share: float) -> bool:
        """Whether something that the tool carries would do as well: what it leaves is below a share of the threshold.

        Asked of the residual: the mean of the last moments holds some of a load that was taken up in them.
        """
        scale = np.sqrt((self._sound.residual * step.sources).sum(axis=1))
        X, r = load / scale[:, None], step.residual / scale
        best = np.linalg.solve(X.T @ X + np.diag(1.0 / LOAD**2), X.T @ r)
        return bool((np.abs(r - X @ best) < share * self.threshold).all())

    def _event(self, kind: Kind, now: _Open, step: Step) -> Event:
        j = now.joint
        size, std, name, unit = float(step.contrast[j]), float(self._scale(step)[j]), self._joints[j], self._units[j]
        says = f"{size:+.3g} ± {std:.2g} {unit} by now, since {now.since:.2f} s"
        if kind is Kind.NOT_TOLD:
            what = "outside_torque, payload"
            sentence = f"{name}: something touches the arm, or it took up a load; one moment cannot tell which: {says}."
        else:
            what, sentence = "outside_torque", f"{name}: something outside acts on the arm: {says}."
        return Event(step.time, kind, name, now.since, size, std, unit, what, self._told, sentence)

    def _ended(self, now: _Open, step: Step) -> Event:
        j = now.joint
        size, std, name, unit = float(now.largest[j]), float(self._scale(step)[j]), self._joints[j], self._units[j]
        sentence = (
            f"{name}: what acted since {now.since:.2f} s is gone; it was {size:+.3g} ± {std:.2g} {unit} at its largest."
        )
        return Event(
            step.time, Kind.RECOVERED, name, now.since, size, std, unit, "outside_torque", self._told, sentence
        )  # fmt: skip
