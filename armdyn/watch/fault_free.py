"""Statistics of the residuals of a sound (fault-free) robot, from recordings or from the error in the model file."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import Any

import numpy as np

from armdyn.arm.model import ArmModel
from armdyn.effects.effect import Effect
from armdyn.errors import InputError
from armdyn.estimation.correlation import INDEPENDENT_STRETCH_SECONDS
from armdyn.estimation.equations import NormalEquations
from armdyn.estimation.random_effects import RandomEffects
from armdyn.recording.channels import Channel, FloatArray
from armdyn.run import Run
from armdyn.watch.changes import (
    BLOCK_MOTION_SECONDS,
    USED_SAMPLE_INTERVAL_SECONDS,
    WINDOW_SIZES_IN_BLOCKS,
    FaultFreeBaseline,
    MotionBlocks,
)
from armdyn.watch.channels import WatchedChannels
from armdyn.watch.observer import (
    CANDIDATE_BANDWIDTHS,
    DEFAULT_OBSERVER_BANDWIDTH,
    FILTER_ORDER,
    MAX_SAMPLE_GAP_SECONDS,
    REVERSAL_SHARE,
    VARIANCE_SOURCE_COUNT,
    Observer,
    ObserverOutput,
    visible_share_of_step,
)
from armdyn.watch.onset import OnsetTorqueEstimator
from armdyn.watch.tail import (
    MIN_STRETCHES_FOR_TAIL,
    ExponentialTail,
    GaussianDistribution,
    StatisticDistribution,
    block_maxima,
)
from armdyn.watch.variances import (
    MIN_TORQUE_VARIANCE,
    AdaptiveErrorStd,
    ErrorBand,
    excess,
)
from armdyn.watch.watched import WatchedChanges

JointSample = tuple[float, FloatArray, FloatArray]
"""Time, s; (nj,) positions, rad or m; (nc,) measured torques, N m or N, then the axes of sensors, N and N m."""
MIN_FAULT_FREE_SECONDS = 15.0
"""Least length of the fault-free recordings, s: seven stretches."""
CROSS_VALIDATION_FOLDS = 4
"""Number of parts of the fault-free recordings, for cross-validation: each is scored with statistics of the others."""
VARIANCE_SAMPLE_INTERVAL_SECONDS = 0.02
"""Time between the samples from which variances are fitted, s; the filters remember little for longer."""
ERROR_CORRELATION_SECONDS = 1.0
"""Assumed correlation time of the error of a model without calibration, s."""


@dataclass(frozen=True, eq=False)
class FaultFreeStatistics:
    """Statistics of the residuals of a fault-free robot.

    Attributes:
        changes: the changes that are watched.
        bandwidth: K of the observer, 1/s.
        contrast: variance of the contrast, which is the residual less its running mean.
        residual: variance of the residual.
        contrast_distributions: apart from reversals, and anywhere, by channel, distribution of the largest contrast, in
            standard deviations; near reversals, where there are few samples, the second holds.
        onset: estimator of a torque that began a moment ago; None without recordings.
        onset_distributions: likewise, distribution of its largest estimate, in standard deviations.
        baselines: by number of blocks in a window.
        shared_score_distributions: by shared change, distribution of the largest score; None if the recordings are too
            short.
        own_score_distributions: by channel and kind of change, distribution of the largest score; None likewise.
        seconds: length of the recordings, s; None without recordings.
    """

    changes: WatchedChanges
    bandwidth: float
    contrast: ErrorBand
    residual: ErrorBand
    contrast_distributions: tuple[tuple[StatisticDistribution, ...], ...]
    onset: OnsetTorqueEstimator | None
    onset_distributions: tuple[tuple[StatisticDistribution, ...], ...]
    baselines: Mapping[int, FaultFreeBaseline]
    shared_score_distributions: tuple[StatisticDistribution, ...] | None
    own_score_distributions: tuple[tuple[StatisticDistribution, ...], ...] | None
    seconds: float | None

    @property
    def sentence(self) -> str:
        """What the rate of false alarms was computed from: recordings without faults, or the model's error."""
        if self.seconds is None:
            return (
                "The rate of false alarms rests on the model's own band, which is taken to be Gaussian and new every "
                f"{ERROR_CORRELATION_SECONDS:g} s; --calibrate RUN measures it on your own sound recordings."
            )
        basis = f"The rate of false alarms is that of {self.seconds:.0f} s of sound recordings, extrapolated."
        return (
            basis
            if self.shared_score_distributions is not None
            else f"{basis} They are too short to tell slow changes: record more."
        )


def joint_samples_of_recording(
    run: Run, model: ArmModel, channels: WatchedChannels | None = None
) -> Iterator[JointSample]:
    """The samples of a recording of all or some channels, at the times of its first torque, or of a sensor without one.

    Raises:
        InputError: a torque or a position is missing.
    """
    channels = WatchedChannels.of(model, [run]) if channels is None else channels
    names = model.predicted_channels(run)
    joints = model.arm.joints
    asked = [name for name, is_asked in zip(channels.names, channels.asked, strict=True) if is_asked]
    missing, where = [name for name in asked if name not in names], run.source or run.name
    torques = [name.removeprefix("tau.") for name in missing if name.startswith("tau.")]
    if torques:
        raise InputError(f"{where}: holds no torque of {', '.join(torques)}: record every joint's")
    if missing:
        raise InputError(f"{where}: holds no {', '.join(missing)}, as the sound recordings do: record every axis")
    time = run.channels[asked[0]].time
    columns = []
    for name in [*(f"q.{joint}" for joint in joints), *channels.names]:
        channel = run.channels.get(name) if name in asked or name.startswith("q.") else None
        if channel is None:
            columns.append(np.zeros(len(time)))
        elif np.array_equal(channel.time, time):
            columns.append(channel.value)
        else:
            columns.append(_at(time, channel))
    table = np.column_stack(columns)
    for stamp, row in zip(time.tolist(), table, strict=True):
        yield stamp, row[: len(joints)], row[len(joints) :]


def _at(time: FloatArray, channel: Channel) -> FloatArray:
    """A channel interpolated at n times, s; nan beyond its ends and in its gaps."""
    value = np.interp(time, channel.time, channel.value, left=np.nan, right=np.nan)
    after = np.clip(np.searchsorted(channel.time, time), 1, len(channel) - 1)
    return np.where(channel.time[after] - channel.time[after - 1] > MAX_SAMPLE_GAP_SECONDS, np.nan, value)


def statistics_of_recordings(
    model: ArmModel,
    recordings: Sequence[Callable[[], Iterable[JointSample]]],
    further: Sequence[Effect] = (),
    channels: WatchedChannels | None = None,
) -> FaultFreeStatistics:
    """Statistics from recordings of a fault-free robot.

    Args:
        model: the arm.
        recordings: functions that return the samples; each is called several times.
        further: effects that may change besides `USUAL_CHANGES`.
        channels: the channels of the samples; None for all of the arm's.

    Raises:
        InputError: the recordings are shorter than `MIN_FAULT_FREE_SECONDS`, or an effect cannot be watched.
    """
    channels = WatchedChannels.of(model) if channels is None else channels
    changes = WatchedChanges.of(model, further, channels)
    bandwidth = _quickest(model, channels, recordings)
    seen = _Seen.of(_settled(model, channels, recordings, bandwidth))
    if seen.length < MIN_FAULT_FREE_SECONDS:
        raise InputError(
            f"the sound recordings last {seen.length:.1f} s together: record {MIN_FAULT_FREE_SECONDS:g} s or more of "
            "usual motion"
        )
    asked = channels.asked
    reversal, one = REVERSAL_SHARE * seen.sticking.max(axis=0), np.ones(len(asked))
    contrast, residual = (
        ErrorBand.of(each, seen.sources, seen.sticking, reversal, one).only(asked)
        for each in (seen.contrast, seen.residual)
    )
    parts = [
        seen.onset(bandwidth, asked, reversal, (seen.time * CROSS_VALIDATION_FOLDS // seen.length) != k)
        for k in range(CROSS_VALIDATION_FOLDS)
    ]
    lasting, *early = (AdaptiveErrorStd(len(asked)) for _ in range(1 + len(parts)))
    blocks = MotionBlocks(changes, residual, kept=None)
    largest: list[list[FloatArray]] = []
    before = 0.0
    for elapsed, step in _settled(model, channels, recordings, bandwidth):
        k, interval, before = (
            min(int(elapsed * CROSS_VALIDATION_FOLDS / seen.length), CROSS_VALIDATION_FOLDS - 1),
            elapsed - before,
            elapsed,
        )
        began = parts[k].estimate(step.stages)
        ratios = []
        for level, band, error in ((lasting, contrast, step.contrast), (early[k], parts[k].band, began)):
            at = band.at(step.sources, step.sticking)
            over = excess(error, at.bound)
            ratio = over / level.std(at)
            ratios += [np.where(at.near, 0.0, ratio), ratio]
            level.update(over, at, interval)
        # Only the largest error of each stretch counts.
        if elapsed >= INDEPENDENT_STRETCH_SECONDS * len(largest):
            largest.append([np.zeros(len(asked))] * len(ratios))
        largest[-1] = [np.fmax(*pair) for pair in zip(largest[-1], ratios, strict=True)]
        if blocks.is_due(step.time):
            blocks.add_sample(step, bandwidth)
    laws = [
        tuple(
            ExponentialTail.of_rare(values, INDEPENDENT_STRETCH_SECONDS, 1)
            for values in np.array(each)[: int(seen.length // INDEPENDENT_STRETCH_SECONDS)].T
        )
        for each in zip(*largest, strict=True)
    ]
    baselines, several, own = (
        _baselines(NormalEquations.stacked(list(blocks.equations)), changes) if blocks.equations else ({}, None, None)
    )
    onset = seen.onset(bandwidth, asked, reversal, np.ones(len(seen.time), dtype=bool))
    return FaultFreeStatistics(
        changes, bandwidth, contrast, residual, tuple(laws[:2]), onset, tuple(laws[2:]), baselines, several, own,
        seen.length,
    )  # fmt: skip


def _settled(
    model: ArmModel,
    channels: WatchedChannels,
    recordings: Sequence[Callable[[], Iterable[JointSample]]],
    bandwidth: float,
) -> Iterator[tuple[float, ObserverOutput]]:
    """Outputs of the settled observer, each after the settled time that came before it, s."""
    elapsed = 0.0
    for recording in recordings:
        observer, before = Observer(model, bandwidth, channels), np.inf
        for sample in recording():
            step = observer.process_sample(*sample)
            if isinstance(step, ObserverOutput) and step.settled:
                elapsed += max(step.time - before, 0.0)
                before = step.time
                yield elapsed, step


@dataclass(frozen=True, eq=False)
class _Seen:
    """Outputs of n samples `VARIANCE_SAMPLE_INTERVAL_SECONDS` apart: settled time, s, arrays (n, ...), length, s."""

    time: FloatArray
    contrast: FloatArray
    residual: FloatArray
    stages: np.ndarray
    sources: np.ndarray
    sticking: FloatArray
    length: float

    @classmethod
    def of(cls, steps: Iterable[tuple[float, ObserverOutput]]) -> "_Seen":
        kept: list[tuple[float, ObserverOutput]] = []
        elapsed = 0.0
        for elapsed, step in steps:
            if not kept or elapsed - kept[-1][0] >= VARIANCE_SAMPLE_INTERVAL_SECONDS:
                kept.append((elapsed, step))
        chosen = [step for _, step in kept]
        contrast, residual, stages, sources, sticking = (
            np.array([getattr(step, name) for step in chosen])
            for name in ("contrast", "residual", "stages", "sources", "sticking")
        )
        return cls(np.array([time for time, _ in kept]), contrast, residual, stages, sources, sticking, elapsed)

    def onset(
        self, bandwidth: float, asked: np.ndarray, reversal: FloatArray, chosen: np.ndarray
    ) -> OnsetTorqueEstimator:
        """Onset estimator from the samples with mask `chosen` (n,), of an observer with a bandwidth K, 1/s."""
        seen = self.stages[chosen], self.sources[chosen], self.sticking[chosen]
        found = OnsetTorqueEstimator.of(bandwidth, *seen, reversal)
        return OnsetTorqueEstimator(found.weights, found.band.only(asked))


def _quickest(
    model: ArmModel, channels: WatchedChannels, recordings: Sequence[Callable[[], Iterable[JointSample]]]
) -> float:
    """The bandwidth, 1/s, with the least error over the share of a torque that arrives in time (mean of logs)."""
    hidden = {}
    for bandwidth in CANDIDATE_BANDWIDTHS:
        steps = takewhile(
            lambda each: each[0] < MIN_FAULT_FREE_SECONDS, _settled(model, channels, recordings[:1], bandwidth)
        )
        contrast = np.array([step.contrast[channels.asked] for _, step in steps])
        if len(contrast):
            size = np.maximum(np.mean(contrast**2, axis=0), MIN_TORQUE_VARIANCE)
            hidden[bandwidth] = float(np.mean(np.log(size))) - 2.0 * np.log(visible_share_of_step(bandwidth))
    return min(hidden, key=hidden.__getitem__) if hidden else DEFAULT_OBSERVER_BANDWIDTH


def _baselines(
    blocks: NormalEquations, changes: WatchedChanges
) -> tuple[
    dict[int, FaultFreeBaseline],
    tuple[StatisticDistribution, ...] | None,
    tuple[tuple[StatisticDistribution, ...], ...] | None,
]:
    """Baselines by window size, and distributions of the largest scores of shared and of each channel's changes."""
    shared, alike = changes.shared, changes.channels.kind
    channels, kinds = len(alike), len(changes.names)
    count = len(blocks.square) // channels
    sizes = [size for size in WINDOW_SIZES_IN_BLOCKS if count >= (CROSS_VALIDATION_FOLDS - 1) * size]
    scores = np.zeros((count, len(shared) + channels * kinds))
    baselines = {}
    for size in sizes:
        windows = blocks.windows(size, channels)
        baselines[size] = FaultFreeBaseline.of(windows, shared, alike, size)
        ends = np.arange(size - 1, count)
        fold = ends * CROSS_VALIDATION_FOLDS // count
        for k in np.unique(fold):
            mine = fold == k
            begin, end = ends[mine][0] - size + 1, ends[mine][-1] + size - 1
            others = (ends < begin) | (ends > end)
            if others.any():
                elsewhere = FaultFreeBaseline.of(windows.only(np.repeat(others, channels)), shared, alike, size)
                several, own = elsewhere.scores(windows.only(np.repeat(mine, channels)))
                together = np.column_stack([several, own.reshape(len(own), -1)])
                scores[ends[mine]] = np.maximum(scores[ends[mine]], together)
    # Neighbouring windows share blocks for at least the length of the shortest window.
    largest = block_maxima(scores, WINDOW_SIZES_IN_BLOCKS[0])
    if not sizes or len(largest) < MIN_STRETCHES_FOR_TAIL:
        return {}, None, None
    laws = [ExponentialTail.of(values, WINDOW_SIZES_IN_BLOCKS[0] * BLOCK_MOTION_SECONDS, 2) for values in largest.T]
    own_laws = laws[len(shared) :]
    by_channel = tuple(tuple(own_laws[i : i + kinds]) for i in range(0, len(own_laws), kinds))
    return baselines, tuple(laws[: len(shared)]), by_channel


def statistics_of_model_error(
    model: ArmModel,
    history: Sequence[Mapping[str, Any]],
    further: Sequence[Effect] = (),
    channels: WatchedChannels | None = None,
) -> FaultFreeStatistics:
    """Statistics from the errors that the last repair wrote to the model file (`history`), taken as Gaussian.

    Raises:
        InputError: the file has no error for a joint, or one of the effects `further` cannot be watched.
    """
    last: Mapping[str, Any] = next((change for change in reversed(history) if change.get("rmse")), {})
    errors = {**last.get("rmse", {}), **last.get("held_out_rmse", {})}
    channels = WatchedChannels.of(model) if channels is None else channels
    asked = dict(zip(channels.names, channels.asked, strict=True))
    missing = [name.removeprefix("tau.") for name in asked if asked[name] and not errors.get(name, 0.0) > 0.0]
    if missing:
        raise InputError(
            f"the model says nothing of its error on {', '.join(missing)}: repair it first, or measure it on sound "
            "recordings, --calibrate RUN"
        )
    none = [0.0] * (VARIANCE_SOURCE_COUNT - 1)
    size = np.array([[errors[name] ** 2 if asked[name] else np.inf, *none] for name in asked])
    n, alike = len(size), ERROR_CORRELATION_SECONDS / USED_SAMPLE_INTERVAL_SECONDS
    # Upcrossings of white noise behind F: its bandwidth K over 2 pi sqrt(3) (Rice 1944).
    crossings = 3600.0 * DEFAULT_OBSERVER_BANDWIDTH / (2.0 * np.pi * np.sqrt(FILTER_ORDER))
    changes = WatchedChanges.of(model, further, channels)
    kinds = len(changes.names)
    baseline = FaultFreeBaseline.of_model_error(changes.shared, RandomEffects.of_noise(np.full(n, alike), kinds))
    baselines = dict.fromkeys(WINDOW_SIZES_IN_BLOCKS, baseline)
    values, band = 3600.0 / BLOCK_MOTION_SECONDS, ErrorBand(size, np.full(n, np.inf), np.ones(n))
    return FaultFreeStatistics(
        changes, DEFAULT_OBSERVER_BANDWIDTH, band, band, ((GaussianDistribution(crossings),) * n,) * 2, None, (),
        baselines, tuple(GaussianDistribution(values, len(change.columns)) for change in changes.shared),
        ((GaussianDistribution(values),) * kinds,) * n, None,
    )  # fmt: skip
