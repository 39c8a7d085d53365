"""The watch: samples in, events out. What it needs of memory does not grow, and no sample takes longer than another."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from armdyn.arm.model import ArmModel
from armdyn.identify.selection.set_score import TIE_NATS
from armdyn.recording.channels import FloatArray
from armdyn.watch.changes import OWN, SLIDING_UNITS, UNITS, WINDOWS, Blocks, Sums
from armdyn.watch.event import Estimate, Event, Kind, Reporter
from armdyn.watch.observer import Observer, Step, compiled
from armdyn.watch.sound import Sample, Sound
from armdyn.watch.touch import Touches

CLEAN = 7
"""Blocks for which a change that shows in a window as short as that waits, until all of the window may be after it."""
PATIENCE = 21
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


@dataclass(frozen=True)
class _Alarm:
    """A change that waits to be told: its window, and what an outside torque would have been."""

    window: int
    since: float
    torque: Estimate


class Watch:
    """Compares a model with its running arm, sample by sample.

    Args:
        model: the arm.
        sound: what to expect of it when nothing happened.
        per_hour: false alarms, of all events together; half for outside torques, a quarter for the load and the rest.
    """

    def __init__(self, model: ArmModel, sound: Sound, per_hour: float) -> None:
        joints = model.arm.joints
        self.model, self.sound = model, sound
        self._report = Reporter(model, per_hour)
        self.observer = Observer(model, sound.bandwidth)
        self.touches = Touches(self._report, sound, per_hour / 2.0)
        self._blocks = Blocks(compiled(model)[1], sound.residual)
        share = per_hour / 4.0
        self._load_threshold = sound.load.threshold(share) if sound.load is not None else np.inf
        laws, each = sound.own or (), share / (len(joints) * len(OWN))
        self._own_thresholds = np.array([[law.threshold(each) for law in joint] for joint in laws])
        self._carried = int(joints.index(model.joints[-1]))
        self._load, self._own = np.zeros(LOAD_AXES), np.zeros((len(joints), len(OWN)))
        self._shift = np.zeros(len(joints))
        self._alarm: _Alarm | None = None
        self._waited = 0
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
            self.touches.reset(time)
            return []
        events: list[Event] = []
        going_on = self.touches.outside
        if self._blocks.due(time):
            bandwidth = self.observer.bandwidth
            complete = not going_on and self._blocks.take(step, bandwidth)
            if going_on:
                self._blocks.observe(step, bandwidth)
            before = self._shift = self._known()
            if complete:
                events += self._changes(time)
                self._shift = self._known()
                if (self._shift != before).any():
                    # What went on until now was this.
                    self.observer.explained(step.residual - (self._shift - before))
                    self.touches.reset(time)
                    return events
        events += self.touches.take(step, self._blocks.load, self.observer.delay)
        if self.touches.outside and not going_on:
            self._blocks.drop()  # it holds some of what was only now known to be from outside
        if going_on and not self.touches.outside:
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
        best, rivals = self._best(blocks, self.sound.baselines)
        if self._alarm is not None:
            self._waited += 1
        elif best is None:
            return []
        else:
            self._alarm, self._waited = self._noticed(best, blocks), 0 if best.window <= CLEAN else CLEAN
        if self._waited < CLEAN:
            return []
        # What a short window shows holds what was before as well: by now all of it may be of after the change.
        after, others = self._best(blocks, [w for w in self.sound.baselines if w <= CLEAN])
        if after is not None:
            best, rivals = after, others
        alarm = self._alarm
        if best is None:
            self._alarm = None
            return [self._passed(time, alarm)] if alarm.window <= CLEAN else []
        others = [each for each in rivals if best.evidence - each.evidence < TIE_NATS]
        if all(each.joint == best.joint for each in others):
            self._alarm = None
            return [self._identified(time, alarm.since, best, others, blocks)]
        return [self._undecided(time, alarm.since, best, others, blocks)] if self._waited == PATIENCE else []

    def _best(self, blocks: Sums, windows: Iterable[int]) -> tuple[_Change | None, list[_Change]]:
        """The change that explains most of the window that shows one best, and all others; none where none is sure."""
        found: tuple[int, Sums] | None = None
        highest = 1.0
        for window in windows:
            if len(blocks.load) < window:
                continue
            baseline = self.sound.baselines[window]
            sums = blocks.of(slice(-window, None)).total
            load, own = baseline.scores(sums)
            over = max(float(load) / self._load_threshold, float((own / self._own_thresholds).max()))
            if over >= highest:
                found, highest = (window, sums), over
        if found is None:
            return None, []
        chosen, sums = found
        baseline = self.sound.baselines[chosen]
        load, own = baseline.scores(sums)
        of_load, each = baseline.explained(sums)
        # Nats: half of what is explained over its usual size, less what every number costs (BIC).
        alike, cost = baseline.spread + float(baseline.own_spread.mean()), 0.5 * float(np.log(chosen))
        every = [_Change(-1, 0, chosen, float(load), float(of_load) / alike - LOAD_AXES * cost)]
        every += [
            _Change(int(j), int(k), chosen, float(own[j, k]), float(each[j, k]) / alike - cost)
            for j, k in np.ndindex(own.shape)
        ]
        best = max(every, key=lambda change: change.evidence)
        if best.score < (self._load_threshold if best.joint < 0 else self._own_thresholds[best.joint, best.kind]):
            return None, []
        return best, [change for change in every if change is not best]

    def _identified(self, time: float, since: float, best: _Change, others: list[_Change], blocks: Sums) -> Event:
        """Tell a change, and count it in from now on."""
        found, sums = self._size(best, blocks)
        before = self._load[0] if best.joint < 0 else self._own[best.joint, best.kind]
        self._count_in(best, sums)
        self._blocks.clear()
        total = before + found.size
        over = before != 0.0 and abs(total) < 0.5 * abs(before)
        self._refining = best
        kind = Kind.RECOVERED if over else Kind.LOAD_CHANGED if best.joint < 0 else Kind.ROBOT_CHANGED
        tied = [OWN[each.kind] for each in others]
        if best.joint < 0:
            says = f"the tool carries {found}"
            says += f" more than before, {total:+.3g} kg in all" if before else ""
        else:
            says = f"{found.what} changed by {found}"
            says += f"; {', '.join(tied)} would explain it as well" if tied else ""
        says = f"{says}, back to what it was" if over else says
        stated = replace(
            found, size=float(found.size if before == 0.0 or over else total), what=", ".join([found.what, *tied])
        )
        return self._report.event(kind, time, since, stated, f"{says}; since {since:.1f} s.")

    def _noticed(self, best: _Change, blocks: Sums) -> _Alarm:
        sums, baseline = blocks.of(slice(-best.window, None)).total, self.sound.baselines[best.window]
        offset = OWN.index("torque_offset")
        joint = best.joint if best.joint >= 0 else int(np.argmax(baseline.scores(sums)[1][:, offset]))
        since = self._blocks.begins[-best.window]
        return _Alarm(best.window, since, self._report.torque(joint, *baseline.own_change(sums, joint, offset)))

    def _passed(self, time: float, alarm: _Alarm) -> Event:
        """Something was there and is gone, too small or too slow to be told at once, and no change of the robot."""
        sentence = (
            f"something outside acted on the arm for some seconds after {alarm.since:.1f} s, {alarm.torque} on "
            "average, and is gone."
        )
        return self._report.event(Kind.OUTSIDE_TORQUE, time, alarm.since, alarm.torque, sentence)

    def _undecided(self, time: float, since: float, best: _Change, others: list[_Change], blocks: Sums) -> Event:
        found, _ = self._size(best, blocks)
        names = dict.fromkeys(self._name(each) for each in (best, *others))
        either = " or ".join(names)
        sentence = f"something changed, and this motion does not tell what: {either}; since {since:.1f} s."
        return self._report.event(Kind.NOT_TOLD, time, since, replace(found, what=", ".join(names)), sentence)

    def _name(self, change: _Change) -> str:
        return "payload" if change.joint < 0 else f"{OWN[change.kind]}[{self.model.arm.joints[change.joint]}]"

    def _size(self, change: _Change, blocks: Sums) -> tuple[Estimate, Sums]:
        sums, baseline = blocks.of(slice(-change.window, None)).total, self.sound.baselines[change.window]
        if change.joint < 0:
            load, std = baseline.load_change(sums)
            return Estimate(self._carried, float(load[0]), float(std[0]), "kg", "payload"), sums
        units = SLIDING_UNITS if self.model.arm.slides[change.joint] else UNITS
        found = baseline.own_change(sums, change.joint, change.kind)
        return Estimate(change.joint, *found, units[change.kind], OWN[change.kind]), sums

    def _count_in(self, change: _Change, sums: Sums) -> None:
        baseline = self.sound.baselines[change.window]
        if change.joint < 0:
            self._load = self._load + baseline.load_change(sums)[0]
        else:
            self._own[change.joint, change.kind] += baseline.own_change(sums, change.joint, change.kind)[0]

    def _refine(self, blocks: Sums) -> None:
        """A change is told before all of it is seen: the blocks after it say how large it is, and nothing is told."""
        change = self._refining
        largest = max(
            window for window in self.sound.baselines if window <= max(WINDOWS[-2], min(self.sound.baselines))
        )
        if change is not None and len(blocks.load) >= largest:
            self._count_in(
                _Change(change.joint, change.kind, largest, 0.0, 0.0), blocks.of(slice(-largest, None)).total
            )
            self._blocks.clear()
            self._refining = None
