"""Detect outside torques on an arm, such as contacts, and follow them until they end.

Two statistics are compared with thresholds. The onset estimates the torque that began about 30 ms ago in each joint; it
does not see a constant torque. The contrast is later and lasts as long as the torque. An event begins when either
exceeds its threshold, and is told as an outside torque once the low-pass shows its size and no load explains it. The
contrast ends it, or, for a torque too small for the contrast, an onset of opposite sign. What a load explains is not
said to be gone before the slow sums have found none.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from armdyn.estimation.equations import NormalEquations
from armdyn.recording.channels import FloatArray
from armdyn.recording.noise import ABS_NORMAL_MEDIAN_OVER_STD
from armdyn.watch.event import EventKind, EventReporter, WatchEvent
from armdyn.watch.fault_free import FaultFreeStatistics
from armdyn.watch.observer import MAX_SAMPLE_GAP_SECONDS, RUNNING_MEAN_SECONDS, ObserverOutput
from armdyn.watch.variances import AdaptiveErrorStd, excess
from armdyn.watch.watched import LOAD_PRIOR

MAX_CONTACT_SECONDS, MAX_STANDING_SECONDS = 5.0, 60.0
"""Longest contact, s, that is no change of load or robot, and time until which the end of one that was told is awaited,
s, before others are looked for beside it."""
CONTACT_END_THRESHOLD_SHARE = 0.5
"""Share of the threshold, or of its largest value, below which a contrast counts as ended; half, against noise."""
CONTACT_END_SECONDS = 0.3
"""Time below `CONTACT_END_THRESHOLD_SHARE` until a contact ends, s; the filters of the onset have then forgotten its
start."""
FILTER_STEP_TIMES, HIDDEN_STEP_SHARE = 2.1, 0.05
"""Time in delays of the low-pass after which it shows all but a share of a step, and this share."""
MAX_WEAR_SHARE = 1.0 / 3.0
"""Share of a joint's dry friction by which wear or temperature may have changed it, seen when the joint next moves or
reverses: friction of gears changes by tens of percent (Bittencourt & Axelsson, IEEE/ASME Trans. Mechatronics 19(4),
2014)."""
ZEROED_SECONDS, EXPECTED_READINGS = 0.5, 500
"""Time before an event in which a sensor may have been zeroed, s, and number of readings that are kept from it, at
1 kHz."""
ZEROED_MEAN_SECONDS, ZEROED_SHARE, ZEROED_NOISES = 0.02, 0.1, 4.0
"""Time before and after a step over which readings are averaged, s; and what a sensor that was zeroed may still read
there, as a share of what it read before and in standard deviations of its noise."""
LOAD_REPORT_PAUSE_SECONDS = 60.0
"""Time for which a possible load is not reported again, s; the slow sums decide whether it is one."""


@dataclass(eq=False)
class _Excess:
    """A statistic of each channel (nc,) at one sample.

    Attributes:
        value: its value, N m or N.
        spread: standard deviation of what exceeds the bound, N m or N.
        bound: what friction of unknown value may leave in it, N m or N.
        threshold: in standard deviations beyond the bound.
    """

    value: FloatArray
    spread: FloatArray
    bound: FloatArray
    threshold: FloatArray

    @cached_property
    def excess(self) -> FloatArray:
        """(nc,) what friction cannot leave, N m or N."""
        return excess(self.value, self.bound)

    @cached_property
    def ratio(self) -> FloatArray:
        """(nc,) the same over the threshold."""
        return np.asarray(self.excess / (self.threshold * self.spread))

    def without(self, explained: FloatArray, share: float) -> bool:
        """Whether no joint exceeds a share of its threshold without what is explained (nc,)."""
        return bool((replace(self, value=self.value - explained).ratio < share).all())

    @property
    def std(self) -> FloatArray:
        """(nc,) standard deviation of the value, N m or N, with a friction that is uniform within its bound."""
        return np.asarray(np.hypot(self.spread, self.bound / np.sqrt(3.0)))


@dataclass
class _Open:
    """An outside torque that has not ended.

    Attributes:
        begun: time of detection, s.
        since: estimated start, s.
        began: onset in `channel`, N m or N.
        largest: (nc,) largest contrast, N m or N.
        std: (nc,) its standard deviations.
        channel: index of the channel with the clearest evidence.
        doubted: whether it may be a load, wear, or a sensor that was zeroed.
        lasting: whether the contrast has exceeded `CONTACT_END_THRESHOLD_SHARE` of its threshold.
        told: whether an event has told it as an outside torque.
        stands: whether it was told and has lasted so long that it may be a change of load or robot.
        hinted: whether an event has told it at all.
        gone: time at which it fell below that, s.
        readings: (nc,) readings that were expected in the moments in which a sensor may have been zeroed.
        zeroed: the sensor that reads nothing since a step of one sample, if any.
    """

    begun: float
    since: float
    began: float
    largest: FloatArray
    std: FloatArray
    channel: int
    doubted: bool
    lasting: bool
    told: bool = False
    stands: bool = False
    hinted: bool = False
    gone: float | None = None
    readings: list[FloatArray] = field(default_factory=list)
    zeroed: slice | None = None


class ContactDetector:
    """Detects outside torques, such as contacts, in the residuals of an arm.

    Args:
        reporter: creates the events.
        sound: statistics of the fault-free robot.
        per_hour: false alarms per hour, for these events together.

    Attributes:
        last_end: time at which the last outside torque that was told ended, s.
        gave_up: whether the end of an outside torque is no longer awaited since the last sample, so that the running
            mean must restart with it.
    """

    def __init__(self, reporter: EventReporter, sound: FaultFreeStatistics, per_hour: float) -> None:
        self._report, self._sound = reporter, sound
        channels, changes = reporter.channels, sound.changes
        each = per_hour / len(channels.names) / (2 if sound.onset is None else 4)
        self._thresholds, self._sudden = (
            np.array([[law.threshold(each) for law in laws] for laws in two])
            for two in (sound.contrast_distributions, sound.onset_distributions)
        )
        self._load = changes.shared[0].columns
        self._sensors = [channels.of_sensor(name) for name in channels.sensors]
        self._expected: deque[tuple[float, FloatArray]] = deque(maxlen=EXPECTED_READINGS)
        self._read: deque[tuple[float, FloatArray]] = deque(maxlen=EXPECTED_READINGS)
        self._level = AdaptiveErrorStd(len(channels.names))
        self._onset_level = AdaptiveErrorStd(len(channels.names))
        self._open: _Open | None = None
        self._quiet = 0.0
        self._moved = np.full(len(channels.names), np.inf)  # since it stood or reversed, as long as the mean followed
        self._outlasted: _Open | None = None
        self.last_end, self.gave_up = -np.inf, False
        self._doubted = self._last = -np.inf
        self._maybe_load: _Open | None = None

    @property
    def is_active(self) -> bool:
        """Whether an outside torque or a possible load acts at present, so that the running mean must be held."""
        return self._open is not None

    @property
    def is_certainly_outside_torque(self) -> bool:
        """Whether an outside torque acts at present that no load can explain."""
        return self._open is not None and not (self._open.doubted or self._open.stands)

    def thresholds(self, step: ObserverOutput) -> FloatArray:
        """(nc,) thresholds of the residuals' deviation from their running mean, N m or N."""
        at = self._sound.contrast.at(step.sources, step.sticking)
        return np.asarray(at.bound + _of_now(self._thresholds, at.near) * self._level.std(at))

    def reset(self, time: float) -> None:
        """Forget the present event at a time, s, because it is explained or the observer restarted."""
        self._open, self._outlasted, self._quiet, self._maybe_load = None, None, time, None
        self.last_end = min(self.last_end, time)

    @property
    def may_be_load(self) -> bool:
        """Whether something is out of sight of which the slow sums must tell whether it is a load, or is gone."""
        return self._maybe_load is not None

    def without_load(self, time: float) -> list[WatchEvent]:
        """The event that a contact, which could not be observed for a while and is no load, has ended at `time`, s."""
        past, self._maybe_load = self._maybe_load, None
        return [] if past is None else self._ended(past, time)

    def process_sample(
        self, step: ObserverOutput, columns: FloatArray, delay: float, read: FloatArray
    ) -> list[WatchEvent]:
        """Process one output of the observer; return the events.

        Args:
            step: the observer's output.
            columns: (nc, S + C) columns of the changes, see `WatchedChanges`.
            delay: mean delay of the observer, s.
            read: (nc,) the readings themselves, N m or N.
        """
        load, self.gave_up = columns[:, self._load], False
        if self._sensors:
            expected = step.predicted + step.residual - step.contrast
            if self._open is None:
                self._expected.append((step.time, expected))
            elif step.time - self._open.begun <= FILTER_STEP_TIMES * delay:
                self._open.readings.append(expected)
            self._read.append((step.time, read))
        at = self._sound.contrast.at(step.sources, step.sticking)
        contrast = _Excess(step.contrast, self._level.std(at), at.bound, _of_now(self._thresholds, at.near))
        seen = [contrast]
        interval, self._last = min(max(step.time - self._last, 0.0), MAX_SAMPLE_GAP_SECONDS), step.time
        if self._open is None:
            self._level.update(contrast.excess, at, interval)
            self._moved += interval
        self._moved[at.near] = 0.0
        if self._sound.onset is not None:
            began, at = self._sound.onset.estimate(step.stages), self._sound.onset.band.at(step.sources, step.sticking)
            onset = _Excess(began, self._onset_level.std(at), at.bound, _of_now(self._sudden, at.near))
            seen.append(onset)
            if self._open is None:
                self._onset_level.update(onset.excess, at, interval)
        if self._open is not None:
            return self._went_on(self._open, step, seen, load, delay)
        clearest = max(seen, key=lambda each: float(each.ratio.max()))
        highest = float(clearest.ratio.max())
        if highest < CONTACT_END_THRESHOLD_SHARE:
            self._quiet = step.time
        return self._begun(step, clearest, contrast, load, delay) if highest >= 1.0 else []

    def _went_on(
        self, now: _Open, step: ObserverOutput, seen: list[_Excess], load: FloatArray, delay: float
    ) -> list[WatchEvent]:
        contrast = seen[0]
        left, most = self._size(now, contrast.value, contrast.std), self._size(now, now.largest, now.std)
        if left > most:
            now.largest, now.std = contrast.value, contrast.std
        highest = float(contrast.ratio.max())
        shown = highest >= CONTACT_END_THRESHOLD_SHARE
        now.lasting |= shown
        if now.lasting:  # what would be detected again at once is not gone
            there = shown and (left > CONTACT_END_THRESHOLD_SHARE * most or highest >= 1.0)
        else:
            back, ratio = seen[-1].value[now.channel] * now.began, seen[-1].ratio[now.channel]
            opposite = step.time - now.begun > CONTACT_END_SECONDS and back < 0.0 and ratio >= 1.0
            there = now.gone is None and not opposite
        if there:
            now.gone = None
        elif now.gone is None:
            now.gone = step.time
        elif step.time - now.gone > CONTACT_END_SECONDS:
            self._open, self._quiet = None, step.time
            if now.told:
                self.last_end = step.time
                return self._ended(now, step.time)
            self._maybe_load = now if now.hinted else None
            return []
        lasts = step.time - now.begun
        if now.told and MAX_CONTACT_SECONDS < lasts <= MAX_STANDING_SECONDS:
            now.stands = True
        elif now.told and lasts > MAX_STANDING_SECONDS:
            self._open, self._quiet, self.gave_up = None, step.time, True
        elif lasts > MAX_CONTACT_SECONDS:
            self._open, self._outlasted, self._quiet = None, now, step.time
        elif not now.told and now.lasting:
            if now.doubted and self._sensors and step.time - now.begun <= 2.0 * FILTER_STEP_TIMES * delay:
                now.zeroed = now.zeroed or self._zeroed(step)
                if now.zeroed is not None:  # what it lacks since then is what the filter will show
                    now.readings[-1] = now.readings[-1].copy()
                    now.readings[-1][now.zeroed] = -contrast.value[now.zeroed]
            now.doubted = now.doubted and self._as_change(step, contrast, load, now.readings, 1.0)
            if not now.doubted and step.time - now.begun > FILTER_STEP_TIMES * delay:
                return self._told(now, step, contrast)
        return []

    def _size(self, now: _Open, value: FloatArray, std: FloatArray) -> float:
        """Size of a contrast (nc,): of what a sensor shows in N or N m, which remains as the tool turns in a force."""
        channels = self._report.channels
        if channels.joint(now.channel) is None:
            return float(np.linalg.norm(value[channels.kind == channels.kind[now.channel]]))
        return float(np.linalg.norm(value / std))

    def _begun(
        self, step: ObserverOutput, clearest: _Excess, contrast: _Excess, load: FloatArray, delay: float
    ) -> list[WatchEvent]:
        channel, lasting = int(np.argmax(clearest.ratio)), clearest is contrast
        since = self._quiet - (delay if lasting else 0.0)
        readings = [reading for then, reading in self._expected if step.time - then <= ZEROED_SECONDS]
        goes_on = False
        if self._outlasted is not None:
            readings, goes_on = self._outlasted.readings, bool(self._sensors) and self._outlasted.doubted
            before, self._outlasted = self._outlasted, None
            left, most = (
                np.linalg.norm(each / before.std) for each in (contrast.value + before.largest, before.largest)
            )
            if lasting and left < 0.5 * most:
                return []
        # An onset detects the start, but does not yet identify size and joint.
        doubted = not lasting or self._as_change(step, contrast, load, readings, 1.0 if goes_on else 0.5)
        now = self._open = _Open(
            step.time,
            since,
            float(clearest.value[channel]),
            contrast.value,
            contrast.std,
            channel,
            doubted,
            lasting,
            readings=readings,
        )
        recent, self._doubted = 0.0 <= step.time - self._doubted < LOAD_REPORT_PAUSE_SECONDS, step.time
        if recent and doubted:
            return []
        torque = self._report.torque_estimate(channel, clearest.value[channel], clearest.std[channel])
        zeroed = self._report.channels.joint(channel) is None
        names = ["outside_torque", *(change.name for change in self._sound.changes.shared[: 2 if zeroed else 1])]
        torque = replace(torque, what=", ".join(names))
        sentence = (
            f"something touches the arm, or it took up a load{', or the sensor was zeroed' * zeroed}; one moment "
            "cannot show which: "
            f"{torque} so far, since {since:.2f} s."
        )
        found = self._report.event(EventKind.UNIDENTIFIED, step.time, now.since, torque, sentence)
        now.hinted = bool(found)
        return found

    def _as_change(
        self,
        step: ObserverOutput,
        contrast: _Excess,
        load: FloatArray,
        readings: Sequence[FloatArray],
        share: float,
    ) -> bool:
        """Whether a load, a joint's friction or a zeroed sensor explains what is seen but for a share of the threshold.

        The contrast does not serve for a load: its running mean contains part of one that was lifted just before. Wear
        shows after a joint has reversed, or stood; if it is more, one factor explains residual and contrast.
        """
        at = self._sound.residual.at(step.sources, step.sticking)
        residual = replace(contrast, value=step.residual, spread=np.sqrt(at.variance))
        sums = NormalEquations.of_samples(load / residual.std[:, None], step.residual / residual.std)
        best, _ = LOAD_PRIOR.unbounded_change(sums.gram[0], sums.slope[0])
        (now, before), mean = step.friction, step.residual - step.contrast
        more = (now * step.residual + before * mean) / np.maximum(now**2 + before**2, np.finfo(float).tiny)
        limit = np.where(self._moved < RUNNING_MEAN_SECONDS, MAX_WEAR_SHARE * np.abs(now), 0.0)
        return (
            residual.without(load @ best, share)
            or residual.without(np.clip(step.residual, -limit, limit), share)
            or (residual.without(more * now, share) and contrast.without(more * (now - before), share))
            or self._as_zeroed(readings, contrast, share)
        )

    def _as_zeroed(self, readings: Sequence[FloatArray], contrast: _Excess, share: float) -> bool:
        """Whether one sensor lacks what it would have read at one of some moments, or a part, as the low-pass is late.

        A sensor that is zeroed reads nothing at this moment.
        """
        for at in self._sensors:
            e, c = np.array(readings)[:, at] / contrast.spread[at], contrast.value[at] / contrast.spread[at]
            part = np.clip(-(e @ c) / np.maximum((e * e).sum(axis=1), np.finfo(float).tiny), 0.0, 1.0)
            seen = contrast.value - np.zeros((len(e), 1))
            seen[:, at] = (c + part[:, None] * e) * contrast.spread[at]
            if (replace(contrast, value=seen).ratio < share).all(axis=1).any():
                return True
        return False

    def _zeroed(self, step: ObserverOutput) -> slice | None:
        """A sensor all axes of which read nothing on average after some sample, and something else before it."""
        time, every = np.array([then for then, _ in self._read]), np.array([read for _, read in self._read])
        spacing = max(float(np.median(np.diff(time))), np.finfo(float).tiny)
        width = max(round(ZEROED_MEAN_SECONDS / spacing), 1)
        if len(time) < 4 * width:
            return None
        sums = np.vstack([np.zeros(every.shape[1]), np.cumsum(every, axis=0)])
        means = (sums[width:] - sums[:-width]) / width  # from each sample on
        before, after = means[:-width], means[width:]
        recent = time[width : len(time) - width + 1] > step.time - ZEROED_SECONDS
        for at in self._sensors:
            second = np.diff(every[:, at], 2, axis=0)
            noise = np.median(np.abs(second), axis=0) / (ABS_NORMAL_MEDIAN_OVER_STD * np.sqrt(6.0 * width))
            sizes = np.repeat(np.linalg.norm(before[:, at].reshape(len(before), 2, 3), axis=2), 3, axis=1)
            nothing = np.abs(after[:, at]) <= ZEROED_NOISES * noise + ZEROED_SHARE * sizes
            something = np.abs(before[:, at]) > ZEROED_NOISES * noise + 3.0 * ZEROED_SHARE * sizes
            if (nothing.all(axis=1) & something.any(axis=1) & recent).any():
                return at
        return None

    def _told(self, now: _Open, step: ObserverOutput, contrast: _Excess) -> list[WatchEvent]:
        """The event that something acts, as soon as the filter shows it and it is certain."""
        kind = self._report.channels.kind
        clear = (contrast.ratio >= CONTACT_END_THRESHOLD_SHARE) & (kind == kind[int(np.argmax(contrast.ratio))])
        now.channel = int(np.argmax(np.where(clear, np.abs(contrast.value), 0.0)))
        value, std = contrast.value[now.channel], contrast.std[now.channel]
        torque = self._report.torque_estimate(now.channel, value, np.hypot(std, HIDDEN_STEP_SHARE * value))
        sentence = f"something outside acts on the arm: {torque}, since {now.since:.2f} s."
        found = self._report.event(EventKind.OUTSIDE_TORQUE, step.time, now.since, torque, sentence)
        now.told, self._doubted = bool(found), -np.inf if found else self._doubted
        return found

    def _ended(self, now: _Open, time: float) -> list[WatchEvent]:
        torque = self._report.torque_estimate(now.channel, now.largest[now.channel], now.std[now.channel])
        sentence = f"what acted since {now.since:.2f} s is gone; it was {torque} at its largest."
        return self._report.event(EventKind.RECOVERED, time, now.since, torque, sentence)


def _of_now(thresholds: FloatArray, near: np.ndarray) -> FloatArray:
    """(nc,) of (2, nj) thresholds apart from reversals and near them, for channels (nc,) that are near."""
    return np.where(near, thresholds[1], thresholds[0])
