"""The watch: samples in, events out. What it needs of memory does not grow, and no sample takes longer than another."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from armdyn.arm.model import ArmModel
from armdyn.channels import FloatArray
from armdyn.identify.appraisal import TIE
from armdyn.watch.changes import LOAD, OWN, SLIDING_UNITS, UNITS, WINDOWS, Blocks, Sums
from armdyn.watch.event import Event, Kind
from armdyn.watch.observer import Observer, Step, compiled
from armdyn.watch.sound import Sample, Sound
from armdyn.watch.touch import Touches

PATIENCE = 16
"""Blocks for which a change that is sure waits for the motion to tell what it is; then it is said that it does not."""
LOAD_AXES = 4
"""Numbers of a load: mass, and mass times place."""


@dataclass(frozen=True)
class _Change:
    """A change that explains a window: joint and index in `OWN`, or -1 and 0 for the load."""

    joint: int
    kind: int
    window: int
    score: float
    evidence: float


class Watch:
    """Holds a model against what its arm does.

    Args:
        model: the arm.
        sound: what to expect of it when nothing happened.
        per_hour: false alarms, of all events together; half for outside torques, a quarter for the load and the rest.
    """

    def __init__(self, model: ArmModel, sound: Sound, per_hour: float) -> None:
        joints = model.arm.joints
        units = tuple("N" if slides else "N m" for slides in model.arm.slides)
        self.model, self.sound, self.per_hour = model, sound, per_hour
        self.observer = Observer(model)
        self.touches = Touches(joints, units, sound, per_hour / 2.0, per_hour)
        self._blocks = Blocks(compiled(model)[1], sound.residual)
        self._thresholds = [law.threshold(per_hour / 4.0) if law is not None else np.inf
                            for law in (sound.load, sound.own)]  # fmt: skip
        self._carried = int(joints.index(model.joints[-1]))
        self._load, self._own = np.zeros(LOAD_AXES), np.zeros((len(joints), len(OWN)))
        self._shift = np.zeros(len(joints))
        self._undecided = 0
        self._refining: _Change | None = None
        self.latest: Step | None = None

    def all(self, samples: Iterable[Sample]) -> Iterator[Event]:
        """The events of samples that come one after the other."""
        for sample in samples:
            yield from self.take(*sample)

    def take(self, time: float, q: FloatArray, tau: FloatArray) -> list[Event]:
        """The events that a sample tells.

        Args:
            time: s.
            q: (nj,) positions; nan where one is missing.
            tau: (nj,) what the drives read; likewise.
        """
        self.observer.hold = self.touches.going_on
        step = self.observer.take(time, q, tau, self._shift)
        if step is None:
            return []
        self.latest = step
        if not step.settled:
            self.touches.reset()
            return []
        events: list[Event] = []
        going_on = self.touches.going_on
        if self._blocks.due(time):
            bandwidth = self.observer.bandwidth or np.nan
            complete = not going_on and self._blocks.take(step, bandwidth)
            if going_on:
                self._blocks.look(step, bandwidth)
            self._shift = self._known()
            if complete:
                events += self._changes(time)
                self.observer.explained(self._known() - self._shift)
                self._shift = self._known()
        events += self.touches.take(step, self._blocks.load, self.observer.delay)
        if going_on and not self.touches.going_on:
            self._blocks.clear()
        return events

    def _known(self) -> FloatArray:
        """(nj,) what the changes that were told add here."""
        return np.asarray(self._blocks.load @ self._load + (self._blocks.own * self._own).sum(axis=1))

    def _changes(self, time: float) -> list[Event]:
        """What the last blocks of motion tell."""
        blocks = Sums.together(list(self._blocks.sums))
        if self._refining is not None:
            self._refine(blocks)
            return []
        best, rivals = self._best(blocks)
        if best is None:
            self._undecided = 0
            return []
        others = [each for each in rivals if best.evidence - each.evidence < TIE]
        if all(each.joint == best.joint for each in others):
            return [self._told(time, best, others, blocks)]
        self._undecided += 1
        return [self._not_told(time, best, others, blocks)] if self._undecided == PATIENCE else []

    def _best(self, blocks: Sums) -> tuple[_Change | None, list[_Change]]:
        """The change that explains most of the window that shows one best, and all others; none where none is sure."""
        found, highest = None, 1.0
        for window, usual in self.sound.usual.items():
            if len(blocks.load) < window:
                continue
            sums = blocks.of(slice(-window, None)).total
            load, own = usual.scores(sums)
            over = max(float(load) / self._thresholds[0], float(own.max()) / self._thresholds[1])
            if over >= highest:
                found, highest = (window, sums, float(load), own), over
        if found is None:
            return None, []
        window, sums, load, own = found
        usual = self.sound.usual[window]
        of_load, each = usual.explained(sums)
        alike, count = 2.0 * float(usual.spread.mean()), np.log(window)
        every = [_Change(-1, 0, window, load, float(of_load) / alike - 0.5 * LOAD_AXES * count)]
        every += [_Change(int(j), int(k), window, float(own[j, k]), float(each[j, k]) / alike - 0.5 * count)
                  for j, k in np.ndindex(own.shape)]  # fmt: skip
        best = max(every, key=lambda change: change.evidence)
        if best.score < self._thresholds[0 if best.joint < 0 else 1]:
            return None, []
        return best, [change for change in every if change is not best]

    def _told(self, time: float, best: _Change, others: list[_Change], blocks: Sums) -> Event:
        """Tell a change, and count it in from now on."""
        self._undecided = 0
        size, std, sums = self._size(best, blocks)
        since = self._blocks.begins[-best.window]
        before = self._load[0] if best.joint < 0 else self._own[best.joint, best.kind]
        self._count_in(best, sums)
        self._blocks.clear()
        total = before + size
        over = before != 0.0 and abs(total) < 0.5 * abs(before)
        self._refining = best
        kind = Kind.RECOVERED if over else Kind.LOAD_CHANGED if best.joint < 0 else Kind.ROBOT_CHANGED
        what, unit, joint = self._words(best)
        tied = [OWN[each.kind] for each in others]
        if best.joint < 0:
            says = f"the tool carries {size:+.3g} ± {std:.2g} kg"
            says += f" more than before, {total:+.3g} kg in all" if before else ""
        else:
            says = f"{joint}: {what} changed by {size:+.3g} ± {std:.2g} {unit}"
            says += f"; {', '.join(tied)} would explain it as well" if tied else ""
        says = f"{says}, back to what it was" if over else says
        return Event(
            time, kind, joint, since, float(size if before == 0.0 or over else total), std, unit,
            ", ".join([what, *tied]), self.per_hour, f"{says}; since {since:.1f} s.",
        )  # fmt: skip

    def _not_told(self, time: float, best: _Change, others: list[_Change], blocks: Sums) -> Event:
        size, std, _ = self._size(best, blocks)
        _, unit, joint = self._words(best)
        names = dict.fromkeys(self._name(each) for each in (best, *others))
        since = self._blocks.begins[-best.window]
        sentence = (
            f"{joint}: something changed, and this motion does not tell what: {' or '.join(names)}; since {since:.1f} s."
        )
        return Event(time, Kind.NOT_TOLD, joint, since, size, std, unit, ", ".join(names), self.per_hour, sentence)

    def _name(self, change: _Change) -> str:
        what, _, joint = self._words(change)
        return what if change.joint < 0 else f"{what}[{joint}]"

    def _words(self, change: _Change) -> tuple[str, str, str]:
        """Effect, unit and joint."""
        joints = self.model.arm.joints
        if change.joint < 0:
            return "payload", "kg", joints[self._carried]
        units = SLIDING_UNITS if self.model.arm.slides[change.joint] else UNITS
        return OWN[change.kind], units[change.kind], joints[change.joint]

    def _size(self, change: _Change, blocks: Sums) -> tuple[float, float, Sums]:
        sums, usual = blocks.of(slice(-change.window, None)).total, self.sound.usual[change.window]
        if change.joint < 0:
            load, std = usual.load_change(sums)
            return float(load[0]), float(std[0]), sums
        return *usual.own_change(sums, change.joint, change.kind), sums

    def _count_in(self, change: _Change, sums: Sums) -> None:
        usual = self.sound.usual[change.window]
        if change.joint < 0:
            self._load = self._load + usual.load_change(sums)[0]
        else:
            self._own[change.joint, change.kind] += usual.own_change(sums, change.joint, change.kind)[0]

    def _refine(self, blocks: Sums) -> None:
        """A change is told before all of it is seen: the blocks after it say how large it is, and nothing is told."""
        change = self._refining
        largest = max(window for window in self.sound.usual if window <= max(WINDOWS[-2], min(self.sound.usual)))
        if change is not None and len(blocks.load) >= largest:
            self._count_in(_Change(change.joint, change.kind, largest, 0.0, 0.0), blocks.of(slice(-largest, None)).total)
            self._blocks.clear()
            self._refining = None
