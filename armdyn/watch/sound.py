"""What a sound robot looks like to the observer: measured on recordings, or taken from the model's own band."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import nnls

from armdyn.arm.model import ArmModel
from armdyn.errors import InputError
from armdyn.recording.channels import Channel, FloatArray
from armdyn.run import Run
from armdyn.watch.changes import BLOCK, LOAD, OWN, SAMPLE, WINDOWS, Blocks, Sums, Usual
from armdyn.watch.observer import BANDWIDTHS, GAP, ORDER, SOURCES, USUAL, Observer, arrived, compiled
from armdyn.watch.tail import FEWEST, Gaussian, Law, Tail, largest_of

Sample = tuple[float, FloatArray, FloatArray]
"""Time, s, (nj,) positions and (nj,) what the drives read."""
STRETCH = 2.0
"""s, after which a model's errors are new: of a stretch only the largest counts."""
LOCAL, STRIKING = 3.0, 5.0
"""s, and usual sizes from which on a contrast is no usual error and counts as so many. On three simulated arms 3 s and
10 s give the rates that are asked for, where one size for all motions gives up to 30 times as many."""
SHORTEST = 15.0
"""s of sound recordings at least: the largest values of seven stretches."""
PASSES = 4
"""Of a fit of variances with weights that follow from it; it changes by less than 1 % after three."""
LEAST, TINY = 1e-3, 1e-18
"""Share of the mean variance that is there always at least, and (N m)^2 of a joint without any error."""
FOLDS = 4
"""Parts of the sound recordings; each is judged by what the others say is usual, as a new recording will be."""
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
        usual: by size of a window in blocks.
        load: law of the load's largest score; None where nothing is known of it.
        own: by joint and kind of other changes, laws of their scores; likewise.
        seconds: of the recordings it was measured on; None where it is the model's own band.
    """

    bandwidth: float
    contrast: FloatArray
    residual: FloatArray
    touch: tuple[Law, ...]
    usual: Mapping[int, Usual]
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
        told = f"The rate of false alarms is that of {self.seconds:.0f} s of sound recordings, extrapolated."
        return told if self.load is not None else f"{told} They are too short to tell slow changes: record more."


class Bouts:
    """How much larger than usual the contrast was in the last `LOCAL` s: the errors of a model come in bouts.

    Args:
        joints: how many.
    """

    def __init__(self, joints: int) -> None:
        self._squares = np.ones(joints)

    @property
    def factor(self) -> FloatArray:
        """(nj,) by which errors are larger now, 1 or more."""
        return np.asarray(np.sqrt(np.maximum(1.0, self._squares)))

    def take(self, ratio: FloatArray, interval: float) -> FloatArray:
        """The factor before a sample, (nj,) sizes over usual ones, an interval [s] after the last; and take it in."""
        before, share = self.factor, 1.0 - np.exp(-interval / LOCAL)
        self._squares = self._squares + share * (np.minimum(ratio, STRIKING) ** 2 - self._squares)
        return before


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
    (contrast, residual, sources), length = _observed(model, recordings, bandwidth)
    if length < SHORTEST:
        raise InputError(
            f"the sound recordings last {length:.1f} s together: record {SHORTEST:g} s or more of usual motion"
        )
    asked = np.array([joint in model.joints for joint in model.arm.joints])
    of_contrast, of_residual = (
        np.where(asked[:, None], _variances(values, sources), np.inf) for values in (contrast, residual)
    )
    ratio = np.nan_to_num(np.abs(contrast) / np.sqrt((of_contrast * sources).sum(axis=2)))
    interval, bouts = length / len(ratio), Bouts(len(asked))
    ratio /= np.array([bouts.take(row, interval) for row in ratio])
    touch = tuple(Tail.of(values, STRETCH, 1) for values in largest_of(ratio, max(1, round(STRETCH / interval))).T)
    blocks = Blocks(compiled(model)[1], of_residual, kept=None)
    for recording in recordings:
        observer = Observer(model, bandwidth)
        for sample in recording():
            step = observer.take(*sample)
            if step is not None and step.settled and blocks.due(step.time):
                blocks.take(step, observer.bandwidth)
    usual, load, own = _usual(Sums.together(list(blocks.sums))) if blocks.sums else ({}, None, None)
    return Sound(bandwidth, of_contrast, of_residual, touch, usual, load, own, length)


def _observed(
    model: ArmModel, recordings: Sequence[Callable[[], Iterable[Sample]]], bandwidth: float, enough: float = np.inf
) -> tuple[tuple[FloatArray, FloatArray, FloatArray], float]:
    """(n, nj) contrast and residual and (n, nj, 4) sources of their errors, and how many s they are of."""
    n = len(model.arm.joints)
    contrast, residual, sources = [np.zeros((0, n))], [np.zeros((0, n))], [np.zeros((0, n, SOURCES))]
    length = 0.0
    for recording in recordings:
        observer, before, steps = Observer(model, bandwidth), None, []
        for sample in recording():
            step = observer.take(*sample)
            if step is None or not step.settled:
                continue
            steps.append(step)
            length += step.time - before if before is not None and step.time > before else 0.0
            before = step.time
            if length > enough:
                break
        if steps:
            contrast.append(np.array([step.contrast for step in steps]))
            residual.append(np.array([step.residual for step in steps]))
            sources.append(np.array([step.sources for step in steps]))
    return (np.concatenate(contrast), np.concatenate(residual), np.concatenate(sources)), length


def _quickest(model: ArmModel, recordings: Sequence[Callable[[], Iterable[Sample]]]) -> float:
    """The bandwidth, 1/s, at which errors hide least of a torque after `SOON`, by the mean of the joints' logs."""
    hidden = {}
    for bandwidth in BANDWIDTHS:
        (contrast, _, _), length = _observed(model, recordings[:1], bandwidth, SHORTEST)
        if length > 0.0:
            size = np.maximum(np.mean(contrast**2, axis=0), TINY)
            hidden[bandwidth] = float(np.mean(np.log(size))) - 2.0 * np.log(arrived(bandwidth))
    return min(hidden, key=hidden.__getitem__) if hidden else USUAL


def _variances(errors: np.ndarray, sources: np.ndarray) -> np.ndarray:
    """(nj, 4) v >= 0 of the variance sum_k v_k s_k of (n, nj) errors with (n, nj, 4) sources.

    The squares of errors are fitted, each weighted by what it varies by itself, 1 over the square of its mean.
    """
    found = np.zeros(sources.shape[1:])
    for j, square in enumerate((errors**2).T):
        mean = np.full(len(square), max(float(square.mean()), TINY))
        for _ in range(PASSES):
            weight = 1.0 / mean
            found[j] = nnls(sources[:, j] * weight[:, None], square * weight)[0]
            found[j, 0] = max(found[j, 0], LEAST * float(square.mean()), TINY)
            mean = sources[:, j] @ found[j]
    return found


def _usual(blocks: Sums) -> tuple[dict[int, Usual], Law | None, tuple[tuple[Law, ...], ...] | None]:
    """What is usual by size of window, and the laws of the largest scores of load and everything else."""
    count = len(blocks.load)
    sizes = [size for size in WINDOWS if count >= (FOLDS - 1) * size]
    scores = np.zeros((count, 1 + blocks.own[0].size))
    usual = {}
    for size in sizes:
        windows = blocks.windows(size)
        usual[size] = Usual.of(windows, size)
        ends = np.arange(size - 1, count)
        fold = ends * FOLDS // count
        for k in np.unique(fold):
            mine = fold == k
            begin, end = ends[mine][0] - size + 1, ends[mine][-1] + size - 1
            others = (ends < begin) | (ends > end)
            if others.any():
                load, own = Usual.of(windows.of(others), size).scores(windows.of(mine))
                scores[ends[mine]] = np.maximum(scores[ends[mine]], np.column_stack([load, own.reshape(len(own), -1)]))
    # Windows share blocks with their neighbours for as long as the shortest lasts at least.
    largest = largest_of(scores, WINDOWS[0])
    if not sizes or len(largest) < FEWEST:
        return {}, None, None
    first, *laws = (Tail.of(values, WINDOWS[0] * BLOCK, 2) for values in largest.T)
    kinds = len(OWN)
    return usual, first, tuple(tuple(laws[i : i + kinds]) for i in range(0, len(laws), kinds))


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
    usual = {
        w: Usual(
            np.zeros(len(LOAD)), np.zeros((n, len(OWN))), alike, np.full((n, len(OWN)), alike), (np.inf, per_sample)
        )
        for w in WINDOWS
    }
    looks = 3600.0 / BLOCK
    return Sound(
        USUAL, size, size, (Gaussian(crossings),) * n, usual, Gaussian(looks, len(LOAD)),
        ((Gaussian(looks),) * len(OWN),) * n, None,
    )  # fmt: skip
