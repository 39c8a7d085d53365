"""Compare a working arm with its model online: take samples and return events, with constant memory."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from armdyn.arm.model import ArmModel
from armdyn.estimation.equations import NormalEquations
from armdyn.identify.settings import DEFAULT_SETTINGS
from armdyn.recording.channels import FloatArray
from armdyn.watch.changes import WINDOW_SIZES_IN_BLOCKS, FaultFreeBaseline, MotionBlocks
from armdyn.watch.coverage import Coverage, Skipped
from armdyn.watch.event import MIN_TOLD_STDS, ChangeEstimate, EventKind, EventReporter, WatchEvent
from armdyn.watch.fault_free import FaultFreeStatistics, JointSample
from armdyn.watch.observer import MAX_SAMPLE_GAP_SECONDS, Observer, ObserverOutput
from armdyn.watch.touch import ContactDetector
from armdyn.watch.variances import excess

BLOCKS_AFTER_DETECTION = 7
"""Blocks to wait after detection in a window of at most this length, so that the whole window lies after the change."""
MAX_IDENTIFICATION_WAIT_BLOCKS = 21
"""Longest wait, in blocks, for the motion to identify a detected change; then `EventKind.UNIDENTIFIED` is reported."""


@dataclass(frozen=True)
class _Change:
    """A candidate change: joint and index of its change, or -1 and that of a shared one; blocks; evidence in nats."""

    joint: int
    kind: int
    window: int
    score: float
    evidence: float

    @property
    def is_load(self) -> bool:
        return self.joint < 0 and self.kind == 0


@dataclass(frozen=True)
class _Alarm:
    """A detected change, not yet told: window in blocks; start, s; mean torque, where a constant one explains most."""

    window: int
    since: float
    torque: ChangeEstimate | None


@dataclass(frozen=True)
class _Size:
    """What is told of a change: estimate, index of its parameter, and words before the size."""

    estimate: ChangeEstimate
    parameter: int
    quantity: str

    @property
    def size(self) -> float:
        return self.estimate.size


class Watch:
    """Compares a working arm with its model, sample by sample, and reports events.

    Args:
        model: the arm.
        sound: statistics of the fault-free arm.
        per_hour: false alarms per hour; half for outside torques, a quarter for the load, and one for the changes of
            joints and sensors.

    Attributes:
        channels: the channels that are watched.
        observer: filters that compute the residuals.
        touches: detector of outside torques.
        false_alarms_per_hour: the same as `per_hour`.
        coverage: what was watched, and what was not.
        latest: the observer's latest output.
    """

    def __init__(self, model: ArmModel, sound: FaultFreeStatistics, per_hour: float) -> None:
        self.model, self.sound, self.false_alarms_per_hour = model, sound, per_hour
        self.channels = channels = sound.changes.channels
        self._report = EventReporter(channels, per_hour)
        self.observer = Observer(model, sound.bandwidth, channels)
        self.touches = ContactDetector(self._report, sound, per_hour / 2.0)
        self._blocks = MotionBlocks(sound.changes, sound.residual)
        share = per_hour / 4.0
        joints, sensors = len(channels.joints), len(channels.sensors)
        each = share / (joints * len(sound.changes.names) + sensors)
        several = sound.shared_score_distributions or ()
        self._shared_thresholds = np.array(
            [law.threshold(each if k else share) for k, law in enumerate(several)] or [np.inf] * (1 + sensors)
        )
        laws = (sound.own_score_distributions or ())[:joints]
        # A change that no sample of a sound robot depends on has the score 0.
        self._own_thresholds = np.maximum(
            [[law.threshold(each) for law in joint] for joint in laws], np.finfo(float).tiny
        )
        self.coverage = Coverage()
        self.latest: ObserverOutput | None = None
        self.begin_source()

    def begin_source(self) -> None:
        """Begin with another source, such as the next recording; nothing that was found in the last one holds."""
        changes = self.sound.changes
        self.observer.restart()
        self.coverage.begin()
        self.touches.reset(-np.inf)
        self._blocks.clear()
        self._shared = np.zeros(changes.shared_parameters)
        self._own = np.zeros((len(self.channels.names), len(changes.names)))
        self._has_told = False
        self._alarm: _Alarm | None = None
        self._refining: _Change | None = None
        self._waited = self._unseen = 0

    def events_of(self, samples: Iterable[JointSample]) -> Iterator[WatchEvent]:
        """Process successive samples; return all their events."""
        for sample in samples:
            yield from self.process_sample(*sample)

    def process_sample(self, time: float, q: FloatArray, tau: FloatArray) -> list[WatchEvent]:
        """Process one sample; return the events that it causes.

        Args:
            time: time of the sample, s.
            q: (nj,) positions, rad or m; nan for a missing one.
            tau: (nc,) measured torques, N m or N, then the axes of sensors; nan for a missing one.
        """
        self.observer.mean_is_held = self.touches.is_active
        step = self.observer.process_sample(time, q, tau, self._known_at(time))
        if isinstance(step, Skipped):
            return self._skipped(time, step)
        self.latest = step
        if not step.settled:
            self.touches.reset(time)
            return self._skipped(time, Skipped.SETTLING)
        silent_since = self.coverage.count(time, None)
        events: list[WatchEvent] = []
        if silent_since is not None:
            sentence = f"samples can be watched again; those since {silent_since:.2f} s could not."
            events.append(self._report.source_event(EventKind.RECOVERED, time, silent_since, "silent", sentence))
        going_on = self.touches.is_certainly_outside_torque
        if self._blocks.is_due(time):
            bandwidth = self.observer.bandwidth
            complete = not going_on and self._blocks.add_sample(step, bandwidth)
            if going_on:
                self._blocks.update_columns(step, bandwidth)
            if complete:
                before = self._known(self._blocks.columns)
                events += self._changes(time)
                shift = self._known(self._blocks.columns) - before
                if shift.any():
                    # This change explains the present contrast.
                    self._restart_mean(step, shift)
                    self.touches.reset(time)
                    return events
        events += self.touches.process_sample(step, self._blocks.columns, self.observer.delay, tau)
        if self.touches.gave_up:
            self._restart_mean(step)
        if self.touches.is_certainly_outside_torque and not going_on:
            self._blocks.drop_partial()  # it contains samples from before the detection
        if going_on and not self.touches.is_certainly_outside_torque:
            self._blocks.clear()
        return events

    def _restart_mean(self, step: ObserverOutput, shift: FloatArray | float = 0.0) -> None:
        """Let the running mean begin at the residual of a sample less a shift (nc,), N m or N."""
        left = step.residual - shift
        self.observer.restart_mean(np.sign(left) * excess(left, step.sticking))

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each channel."""
        return self.channels.units

    def wait(self, idle: float) -> list[WatchEvent]:
        """The events after `idle` s, on the observer's own clock, without a sample that can be watched."""
        return self._silence(self.coverage.time_after(idle), "no sample")

    def _skipped(self, time: float, reason: Skipped) -> list[WatchEvent]:
        self.coverage.count(time, reason)
        return self._silence(time, reason.value)

    def _silence(self, time: float, why: str) -> list[WatchEvent]:
        since = self.coverage.silent_since(time)
        if since is None:
            return []
        sentence = f"nothing can be watched since {since:.2f} s: {why}."
        return [self._report.source_event(EventKind.SILENT, time, since, why, sentence)]

    def _known_at(self, time: float) -> FloatArray | float:
        """(nc,) torque of the reported changes at a sample that comes now, N m or N.

        An older one would be late, and a load's torque that is late resembles viscous friction.
        """
        if self.latest is None or not self._has_told:
            return 0.0
        h = time - self.latest.time if 0.0 < time - self.latest.time <= MAX_SAMPLE_GAP_SECONDS else 0.0
        q, v, a = self.latest.motion
        columns, _ = self.sound.changes.function(q + h * (v + h / 2.0 * a), v + h * a, a, self.observer.bandwidth)
        return self._known(columns)

    def _known(self, columns: FloatArray) -> FloatArray:
        """(nc,) torque of the reported changes for the columns (nc, S + C) of the changes, N m or N."""
        shared = len(self._shared)
        return np.asarray(columns[:, :shared] @ self._shared + (columns[:, shared:] * self._own).sum(axis=1))

    def _changes(self, time: float) -> list[WatchEvent]:
        """The events that the last blocks of motion give, at a time, s."""
        if self._refining is not None:
            self._refine()
            return []
        best, rivals = self._best(self.sound.baselines)
        self._unseen = self._unseen + 1 if self.touches.may_be_load else 0
        if self._alarm is not None:
            self._waited += 1
        elif best is None:
            return self.touches.without_load(time) if self._unseen > BLOCKS_AFTER_DETECTION else []
        else:
            self._alarm, self._waited = (
                self._noticed(best),
                0 if best.window <= BLOCKS_AFTER_DETECTION else BLOCKS_AFTER_DETECTION,
            )
        if self._waited < BLOCKS_AFTER_DETECTION:
            return []
        # At detection a short window contains motion before the change; now all of it may lie after the change.
        after, others = self._best([w for w in self.sound.baselines if w <= BLOCKS_AFTER_DETECTION])
        if after is not None:
            best, rivals = after, others
        alarm = self._alarm
        if best is None:
            self._alarm = None
            return self._passed(time, alarm) if alarm.window <= BLOCKS_AFTER_DETECTION else []
        others = [each for each in rivals if best.evidence - each.evidence < DEFAULT_SETTINGS.search.tie_nats]
        last = self._waited >= MAX_IDENTIFICATION_WAIT_BLOCKS
        if not self._is_steady(best) and not last:
            return []
        if not others or (last and all(each.joint == best.joint for each in others)):
            found = self._identified(time, best, others)
            if found or last:
                self._alarm = None
            return found
        if last:
            self._alarm = None
            return self._undecided(time, alarm.since, best, others)
        return []

    def _is_steady(self, change: _Change) -> bool:
        """Whether the first and the last half of a change's window agree on its size."""
        apart, std = self._between_halves(change)
        return bool((np.abs(apart) <= MIN_TOLD_STDS * std).all())

    def _between_halves(self, change: _Change) -> tuple[FloatArray, FloatArray]:
        """How much larger a change is in the last half of its window than in the first, and standard deviations."""
        halves = [size for size in self.sound.baselines if 2 * size <= change.window]
        if not halves:
            return np.zeros(1), np.zeros(1)
        (early, before), (late, after) = (
            self._estimate(change, self._blocks.window(max(halves), end), self.sound.baselines[max(halves)])
            for end in (change.window - max(halves), 0)
        )
        return late - early, np.hypot(before, after)

    def _best(self, windows: Iterable[int]) -> tuple[_Change | None, list[_Change]]:
        """The best change in the window with the highest score, and its rivals; None below the threshold."""
        found: tuple[int, NormalEquations] | None = None
        joints = len(self.channels.joints)
        highest = 1.0
        for window in windows:
            if len(self._blocks.equations) < window:
                continue
            baseline = self.sound.baselines[window]
            sums = self._blocks.window(window)
            several, own = (part[0] for part in baseline.scores(sums))
            over = max(
                float((several / self._shared_thresholds).max()), float((own[:joints] / self._own_thresholds).max())
            )
            if over >= highest:
                found, highest = (window, sums), over
        if found is None:
            return None, []
        chosen, sums = found
        baseline = self.sound.baselines[chosen]
        several, own = (part[0] for part in baseline.scores(sums))
        of_shared, each = (part[0] for part in baseline.explained(sums))
        # Evidence in nats: half the fall of chi2 over its sound mean, less half log(blocks) per parameter (BIC).
        alike = float(baseline.spread.sum() + baseline.own_spread[:joints].mean())
        cost = 0.5 * float(np.log(chosen))
        every = [
            _Change(-1, k, chosen, float(several[k]), float(of_shared[k]) / alike - len(change.columns) * cost)
            for k, change in enumerate(self.sound.changes.shared)
        ]
        every += [
            _Change(int(j), int(k), chosen, float(own[j, k]), float(each[j, k]) / alike - cost)
            for j, k in np.ndindex(own[:joints].shape)
        ]
        best = max(every, key=lambda change: change.evidence)
        thresholds = self._shared_thresholds if best.joint < 0 else self._own_thresholds[best.joint]
        if best.score < thresholds[best.kind]:
            return None, []
        if not self._shows(best, sums):
            return None, []
        return best, [change for change in every if change is not best]

    def _shows(self, change: _Change, window: NormalEquations) -> bool:
        """Whether a change is, in its window, as large as the error of a sound model in a channel; root mean squares.

        What is less matters to no prediction, however certain it is; and a few motions of a sound robot do not tell how
        far its apparent changes reach.
        """
        values, _ = self._estimate(change, window, self.sound.baselines[change.window])
        changes, units = self.sound.changes, slice(None)
        if change.joint < 0:
            own = changes.shared[change.kind].columns
        else:
            own, units = np.array([changes.shared_parameters + change.kind]), slice(change.joint, change.joint + 1)
        squares = np.einsum("i,uij,j->u", values, window.gram[units][:, own][:, :, own], values)
        return bool((squares >= np.maximum(window.count[units], 1.0)).any())

    def _identified(self, time: float, best: _Change, others: list[_Change]) -> list[WatchEvent]:
        """Report a change, and subtract it from now on."""
        found, since = self._size(best), self._start_of(best)
        known = self._own[best.joint, best.kind : best.kind + 1]
        if best.joint < 0:
            known = self._shared[self.sound.changes.shared[best.kind].columns]
        before = float(known[found.parameter])
        total = before + found.size
        over = before != 0.0 and abs(total) < 0.5 * abs(before)
        kind = EventKind.RECOVERED if over else EventKind.LOAD_CHANGED if best.is_load else EventKind.ROBOT_CHANGED
        tied = [self.sound.changes.names[each.kind] for each in others]
        says = f"{found.quantity} {found.estimate}"
        if before:
            says += f" more than before, {total:+.3g} {found.estimate.unit} in all"
        says += f"; {', '.join(tied)} would explain it as well" if tied else ""
        says = f"{says}, back to what it was" if over else says
        stated = replace(found.estimate, total=total if before else None, what=", ".join([found.estimate.what, *tied]))
        events = self._report.event(kind, time, since, stated, f"{says}; since {since:.1f} s.")
        if events:
            self._count_in(best, self._blocks.window(best.window))
            self._blocks.clear()
            self._refining = best
        return events

    def _noticed(self, best: _Change) -> _Alarm:
        torque = None
        if best.joint >= 0 and best.kind == self.sound.changes.steady:
            window, baseline = self._blocks.window(best.window), self.sound.baselines[best.window]
            torque = self._report.torque_estimate(best.joint, *baseline.joint_change(window, best.joint, best.kind))
        return _Alarm(best.window, self._start_of(best), torque)

    def _start_of(self, change: _Change) -> float:
        """Start of a change, s: that of the blocks until the present that it explains best."""
        sizes = range(min(self.sound.baselines), len(self._blocks.equations) + 1)
        gains = []
        for size in sizes:
            baseline = self.sound.baselines[max(w for w in self.sound.baselines if w <= size)]
            several, own = (part[0] for part in baseline.explained(self._blocks.window(size)))
            gains.append(float((several if change.joint < 0 else own[change.joint])[change.kind]))
        return self._blocks.start_times[-sizes[int(np.argmax(gains))]]

    def _passed(self, time: float, alarm: _Alarm) -> list[WatchEvent]:
        """Report a past outside torque that was too small or too slow for immediate detection."""
        if alarm.torque is None or alarm.since <= self.touches.last_end:
            return []  # nothing, or what was told
        sentence = (
            f"something outside acted on the arm for some seconds after {alarm.since:.1f} s, {alarm.torque} on "
            "average, and is gone."
        )
        return self._report.event(EventKind.OUTSIDE_TORQUE, time, alarm.since, alarm.torque, sentence)

    def _undecided(self, time: float, since: float, best: _Change, others: list[_Change]) -> list[WatchEvent]:
        found = self._size(best).estimate
        names = dict.fromkeys(self._name(each) for each in (best, *others))
        either = " or ".join(names)
        sentence = f"something changed, and this motion does not tell what: {either}; since {since:.1f} s."
        return self._report.event(EventKind.UNIDENTIFIED, time, since, replace(found, what=", ".join(names)), sentence)

    def _name(self, change: _Change) -> str:
        if change.joint < 0:
            return self.sound.changes.shared[change.kind].name
        return f"{self.sound.changes.names[change.kind]}[{self.model.arm.joints[change.joint]}]"

    def _size(self, change: _Change) -> _Size:
        """What the evidence is about: a load's mass, or the clearest of its mass times position, or of an offset."""
        window, baseline = self._blocks.window(change.window), self.sound.baselines[change.window]
        values, stds = self._estimate(change, window, baseline)
        # Of a change that goes on, halves of the window differ by more than chance.
        apart, by_chance = self._between_halves(change)
        stds = np.sqrt(stds**2 + np.maximum(apart**2 - by_chance**2, 0.0) / 4.0)
        if change.joint >= 0:
            name, unit = self.sound.changes.names[change.kind], self.sound.changes.units[change.joint][change.kind]
            estimate = ChangeEstimate(change.joint, float(values[0]), float(stds[0]), unit, name)
            return _Size(estimate, 0, f"{name} changed by")
        shared = self.sound.changes.shared[change.kind]
        estimates = [
            ChangeEstimate(channel, float(value), float(std), unit, shared.name)
            for channel, value, std, unit in zip(shared.channels, values, stds, shared.units, strict=True)
        ]
        which = int(np.argmax(np.abs(values) / stds))
        if not change.is_load:
            axes = [str(estimate) for estimate in estimates if estimate.is_certain and estimate is not estimates[which]]
            quantity = f"{shared.name} changed" + (f", in other axes by {', '.join(axes)}, here by" if axes else " by")
            return _Size(estimates[which], which, quantity)
        which = 0 if estimates[0].is_certain else which
        quantity = "the tool carries" if which == 0 else f"what the tool carries shifts along {'xyz'[which - 1]} by"
        return _Size(estimates[which], which, quantity)

    def _estimate(
        self, change: _Change, window: NormalEquations, baseline: FaultFreeBaseline
    ) -> tuple[FloatArray, FloatArray]:
        """Values and standard deviations of a change in a window: (p,) of a shared one, (1,) of a joint's change."""
        if change.joint < 0:
            return baseline.shared_change(window, change.kind)
        size, std = baseline.joint_change(window, change.joint, change.kind)
        return np.array([size]), np.array([std])

    def _count_in(self, change: _Change, window: NormalEquations) -> None:
        values, _ = self._estimate(change, window, self.sound.baselines[change.window])
        self._has_told = True
        if change.joint < 0:
            self._shared[self.sound.changes.shared[change.kind].columns] += values
        else:
            self._own[change.joint, change.kind] += values[0]

    def _refine(self) -> None:
        """Correct the size of a reported change with the blocks after it, without an event."""
        change = self._refining
        largest = max(
            window
            for window in self.sound.baselines
            if window <= max(WINDOW_SIZES_IN_BLOCKS[-2], min(self.sound.baselines))
        )
        if change is not None and len(self._blocks.equations) >= largest:
            self._count_in(_Change(change.joint, change.kind, largest, 0.0, 0.0), self._blocks.window(largest))
            self._blocks.clear()
            self._refining = None
