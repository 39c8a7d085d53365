"""What a sound robot looks like to the observer: measured on recordings, or taken from the model's own band."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import Any

import numpy as np

from armdyn.arm.model import ArmModel
from armdyn.errors import InputError
from armdyn.recording.channels import Channel, FloatArray
from armdyn.run import Run
from armdyn.watch.changes import BLOCK, LOAD, OWN, SAMPLE, WINDOWS, Baseline, Blocks, Sums
from armdyn.watch.observer import BANDWIDTHS, GAP, ORDER, USUAL, Observer, Step, arrived, compiled
from armdyn.watch.onset import Onset
from armdyn.watch.tail import FEWEST, Gaussian, Law, Tail, largest_of
from armdyn.watch.variances import TINY, Level, variances

Sample = tuple[float, FloatArray, FloatArray]
"""Time, s, (nj,) positions and (nj,) what the drives read."""
STRETCH = 2.0
"""s, after which a model's errors are new: of a stretch only the largest counts."""
SHORTEST = 15.0
"""s of sound recordings at least: the largest values of seven stretches."""
FOLDS = 4
"""Parts of the sound recordings; each is judged by what the others say is usual, as a new recording will be."""
APART = 0.02
"""s from sample to sample of which variances are made, after which filters hold little of what was."""
UNKNOWN = np.array([np.inf, 0.0, 0.0, 0.0])
"""Variance by sources of a joint whose torque the model does not tell."""
COHERENT = 1.0
"""s for which the error of a model that nobody calibrated is taken to stay what it is."""


@dataclass(frozen=True, eq=False)
class Sound:
    """What to expect of a robot on which nothing changed.

    Attributes:
        bandwidth: of the observer, 1/s.
        contrast: (nj, 4) variance of the contrast by its sources, see `Step`.
        residual: (nj, 4) likewise of the residual.
        touch: by joint, law of the largest contrast over its size.
        onset: what shows a torque that began a moment ago; None where nothing is known of it.
        sudden: by joint, law of the largest of those over its size.
        baselines: by size of a window in blocks.
        load: law of the load's largest score; None where nothing is known of it.
        own: by joint and kind of other changes, laws of their scores; likewise.
        seconds: of the recordings it was measured on; None where it is the model's own band.
    """

    bandwidth: float
    contrast: FloatArray
    residual: FloatArray
    touch: tuple[Law, ...]
    onset: Onset | None
    sudden: tuple[Law, ...]
    baselines: Mapping[int, Baseline]
    load: Law | None
    own: tuple[tuple[Law, ...], ...] | None
    seconds: float | None

    @property
    def sentence(self) -> str:
        """What the rate of false alarms rests on."""
        if self.seconds is None:
            return (
                "The rate of false alarms rests on the model's own band, which is taken to be Gaussian and new every "
                f"{COHERENT:g} s; --calibrate RUN measures it on your own sound recordings."
            )
        basis = f"The rate of false alarms is that of {self.seconds:.0f} s of sound recordings, extrapolated."
        return basis if self.load is not None else f"{basis} They are too short to tell slow changes: record more."


def samples_of(run: Run, model: ArmModel) -> Iterator[Sample]:
    """The samples of a recording, at the stamps of its first torque.

    Raises:
        InputError: it holds no torque, or lacks a position.
    """
    names = model.predicted_channels(run)
    joints = model.arm.joints
    missing = [joint for joint in model.joints if f"tau.{joint}" not in names]
    if missing:
        raise InputError(f"{run.source or run.name}: holds no torque of {', '.join(missing)}: record every joint's")
    time = run.channels[names[0]].time
    columns = []
    for name in [f"q.{joint}" for joint in joints] + [f"tau.{joint}" for joint in joints]:
        channel = run.channels.get(name)
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
    """(n,) a channel at times of others; nan beyond its ends and in its gaps."""
    value = np.interp(time, channel.time, channel.value, left=np.nan, right=np.nan)
    after = np.clip(np.searchsorted(channel.time, time), 1, len(channel) - 1)
    return np.where(channel.time[after] - channel.time[after - 1] > GAP, np.nan, value)


def measured(model: ArmModel, recordings: Sequence[Callable[[], Iterable[Sample]]]) -> Sound:
    """From sound recordings.

    Args:
        model: the arm.
        recordings: each gives its samples, as often as it is asked.

    Raises:
        InputError: they are too short.
    """
    bandwidth = _quickest(model, recordings)
    seen = _Seen.of(_settled(model, recordings, bandwidth))
    if seen.length < SHORTEST:
        raise InputError(
            f"the sound recordings last {seen.length:.1f} s together: record {SHORTEST:g} s or more of usual motion"
        )
    asked = np.array([joint in model.joints for joint in model.arm.joints])[:, None]
    contrast, residual = (
        np.where(asked, variances(values, seen.sources), UNKNOWN) for values in (seen.contrast, seen.residual)
    )
    parts = [seen.onset(asked, (seen.time * FOLDS // seen.length) != k) for k in range(FOLDS)]
    lasting, early = Level(contrast), [Level(part.variance) for part in parts]
    blocks = Blocks(compiled(model)[1], residual, kept=None)
    largest: list[list[FloatArray]] = []
    before = 0.0
    for elapsed, step in _settled(model, recordings, bandwidth):
        k, interval, before = min(int(elapsed * FOLDS / seen.length), FOLDS - 1), elapsed - before, elapsed
        began = parts[k].began(step.stages)
        ratios = []
        for level, error in ((lasting, step.contrast), (early[k], began)):
            ratios.append(np.abs(error) / level.std(step.sources))
            level.take(error, step.sources, interval)
        if elapsed >= STRETCH * len(largest):
            largest.append([np.zeros(len(asked))] * 2)
        largest[-1] = [np.fmax(*pair) for pair in zip(largest[-1], ratios, strict=True)]
        if blocks.due(step.time):
            blocks.take(step, bandwidth)
    touch, sudden = (
        tuple(Tail.of(values, STRETCH, 1) for values in np.array(each)[: int(seen.length // STRETCH)].T)
        for each in zip(*largest, strict=True)
    )
    baselines, load, own = _baselines(Sums.together(list(blocks.sums))) if blocks.sums else ({}, None, None)
    onset = seen.onset(asked, np.ones(len(seen.time), dtype=bool))
    return Sound(bandwidth, contrast, residual, touch, onset, sudden, baselines, load, own, seen.length)


def _settled(
    model: ArmModel, recordings: Sequence[Callable[[], Iterable[Sample]]], bandwidth: float
) -> Iterator[tuple[float, Step]]:
    """What the observer says when its filters are settled, and how many s of that there were before."""
    elapsed = 0.0
    for recording in recordings:
        observer, before = Observer(model, bandwidth), np.inf
        for sample in recording():
            step = observer.take(*sample)
            if step is not None and step.settled:
                elapsed += max(step.time - before, 0.0)
                before = step.time
                yield elapsed, step


@dataclass(frozen=True, eq=False)
class _Seen:
    """Of n samples `APART` s apart: times from the first, s, contrast, residual, stages and sources; s of all."""

    time: FloatArray
    contrast: FloatArray
    residual: FloatArray
    stages: np.ndarray
    sources: np.ndarray
    length: float

    @classmethod
    def of(cls, steps: Iterable[tuple[float, Step]]) -> "_Seen":
        kept: list[tuple[float, Step]] = []
        elapsed = 0.0
        for elapsed, step in steps:
            if not kept or elapsed - kept[-1][0] >= APART:
                kept.append((elapsed, step))
        chosen = [step for _, step in kept]
        contrast, residual, stages, sources = (
            np.array([getattr(step, name) for step in chosen]) for name in ("contrast", "residual", "stages", "sources")
        )
        return cls(np.array([time for time, _ in kept]), contrast, residual, stages, sources, elapsed)

    def onset(self, asked: np.ndarray, chosen: np.ndarray) -> Onset:
        """From some of the samples."""
        found = Onset.of(self.stages[chosen], self.sources[chosen])
        return Onset(found.weights, np.where(asked, found.variance, UNKNOWN))


def _quickest(model: ArmModel, recordings: Sequence[Callable[[], Iterable[Sample]]]) -> float:
    """The bandwidth, 1/s, at which errors hide least of a torque after `SOON`, by the mean of the joints' logs."""
    hidden = {}
    for bandwidth in BANDWIDTHS:
        steps = takewhile(lambda each: each[0] < SHORTEST, _settled(model, recordings[:1], bandwidth))
        contrast = np.array([step.contrast for _, step in steps])
        if len(contrast):
            size = np.maximum(np.mean(contrast**2, axis=0), TINY)
            hidden[bandwidth] = float(np.mean(np.log(size))) - 2.0 * np.log(arrived(bandwidth))
    return min(hidden, key=hidden.__getitem__) if hidden else USUAL


def _baselines(blocks: Sums) -> tuple[dict[int, Baseline], Law | None, tuple[tuple[Law, ...], ...] | None]:
    """Baselines by size of window, and the laws of the largest scores of load and everything else."""
    count = len(blocks.load)
    sizes = [size for size in WINDOWS if count >= (FOLDS - 1) * size]
    scores = np.zeros((count, 1 + blocks.own_error[0].size))
    baselines = {}
    for size in sizes:
        windows = blocks.windows(size)
        baselines[size] = Baseline.of(windows, size)
        ends = np.arange(size - 1, count)
        fold = ends * FOLDS // count
        for k in np.unique(fold):
            mine = fold == k
            begin, end = ends[mine][0] - size + 1, ends[mine][-1] + size - 1
            others = (ends < begin) | (ends > end)
            if others.any():
                load, own = Baseline.of(windows.of(others), size).scores(windows.of(mine))
                scores[ends[mine]] = np.maximum(scores[ends[mine]], np.column_stack([load, own.reshape(len(own), -1)]))
    # Windows share blocks with their neighbours for as long as the shortest lasts at least.
    largest = largest_of(scores, WINDOWS[0])
    if not sizes or len(largest) < FEWEST:
        return {}, None, None
    first, *laws = (Tail.of(values, WINDOWS[0] * BLOCK, 2) for values in largest.T)
    kinds = len(OWN)
    return baselines, first, tuple(tuple(laws[i : i + kinds]) for i in range(0, len(laws), kinds))


def from_band(model: ArmModel, history: Sequence[Mapping[str, Any]]) -> Sound:
    """From the errors that the model's last repair left, as its file tells them.

    Raises:
        InputError: the file tells none.
    """
    last: Mapping[str, Any] = next((change for change in reversed(history) if change.get("rmse")), {})
    errors = {**last.get("rmse", {}), **last.get("held_out_rmse", {})}
    missing = [joint for joint in model.joints if not errors.get(f"tau.{joint}", 0.0) > 0.0]
    if missing:
        raise InputError(
            f"the model says nothing of its error on {', '.join(missing)}: repair it first, or measure it on sound "
            "recordings, --calibrate RUN"
        )
    size = np.array([[errors.get(f"tau.{joint}", np.inf) ** 2, 0.0, 0.0, 1.0] for joint in model.arm.joints])
    n, alike = len(size), COHERENT / SAMPLE
    # Upcrossings of white noise behind F: its bandwidth K over 2 pi sqrt(3) (Rice 1944).
    crossings = 3600.0 * USUAL / (2.0 * np.pi * np.sqrt(ORDER))
    per_sample = np.full((n, len(OWN)), np.inf)
    baselines = {
        w: Baseline(
            np.zeros(len(LOAD)),
            np.zeros((n, len(OWN))),
            np.zeros((n, len(OWN), len(OWN))),
            np.full(n, alike),
            1.0,
            np.ones((n, len(OWN))),
            (np.inf, per_sample),
        )
        for w in WINDOWS
    }
    values = 3600.0 / BLOCK
    return Sound(
        USUAL, size, size, (Gaussian(crossings),) * n, None, (), baselines, Gaussian(values, len(LOAD)),
        ((Gaussian(values),) * len(OWN),) * n, None,
    )  # fmt: skip
