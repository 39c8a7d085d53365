"""Find faulty samples of a run, which are left out: isolated spikes and saturated readings."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from itertools import combinations

import numpy as np
from scipy.ndimage import median_filter

from armdyn.object_cache import cached_with_first_argument
from armdyn.recording.noise import MAX_DIFFERENCE_SPAN_RATIO, normalised_differences
from armdyn.run import Channel, Run
from armdyn.smoothing.choice import resolution

SPIKE_DIFFERENCE_ORDER = 4
"""Order of the differences that reveal a spike: they vanish for a cubic, which follows the signal well enough."""
MIN_SPIKE_DIFFERENCE_STDS = 6.0
"""Robust standard deviations beyond which a difference is not noise; one in 5e8 of white noise is larger."""
MAX_ROUNDING_DIFFERENCE_STEPS = 1.0
"""Largest normalised difference by rounding alone, in steps of an encoder or of a file's digits: the sum of
the absolute weights over the root of the sum of their squares, 16 / 8.4, times half a step."""
ROUNDING_RANGE_SHARE = 1e-9
"""Size of differences, as a share of the signal's range, up to which they are only rounding errors."""
DIFFERENCES_BESIDE_FOR_LOCAL_SIZE = 25
"""Number of differences to either side from which the local size of differences is estimated."""
MAX_ADJACENT_FAULTS = 2
"""Largest number of adjacent faulty samples; more are an event of the motion, such as an impact."""
MAX_FAULTY_SHARE_OF_GROUP = 1.0 / 3.0
"""Largest share of faulty samples in a group; if more samples were faulty, the signal vibrates."""
MIN_STEP_RATIO_ACROSS_OMITTED = 1.5
"""Least step of a signal across samples that are left out, over the largest other change in the same time."""
MAX_FAULTY_SAMPLE_SHARE = 0.03
"""Largest share of samples that are faults; more are the usual noise of this sensor. Of samples that fail one time in a
hundred, at random, 2.1 % fail in one of a thousand runs of 800."""
ALLOWED_FAULTS = 4
"""Number of faulty samples that even a short run may have."""
MIN_EVENT_ROUGHNESS_RATIO, MIN_FAULT_RATIO_IN_EVENT = 2.0, 4.0
"""Ratio of the typical size of differences to that in the quietest stretch from which an event occurs, such as a load
that hits something and vibrates; and least ratio, during an event, of a faulty difference to all that is left without
it."""
MAX_LARGE_DIFFERENCE_SHARE = 0.4
"""Largest share of too large differences for which single faulty samples are searched."""
MIN_SATURATED_COUNT_RATIO = 5.0
"""Ratio of the number of samples with the extreme value to that with the next value (plus one) from which the sensor
was saturated: of a coarsely rounded sine 2.4 times as many are at the peak."""
MAX_UNAVERAGED_RATE_HZ = 125.0
"""Sampling rate, Hz, above which neighbouring samples are averaged before a comparison with a prediction: a swing
contains nothing faster."""
SAMPLES_BESIDE_SATURATION = 2
"""Number of samples to either side of a saturated one that are left out as well."""


def without_faulty_samples(
    run: Run,
    measured: Iterable[str],
    driving: Iterable[str],
    held: Collection[str] = (),
    highest: float = MAX_UNAVERAGED_RATE_HZ,
) -> Run:
    """The run without faulty samples of the channels that a model uses, with fast channels averaged to a lower rate.

    Args:
        run: the recorded run.
        measured: channels that are compared with a prediction; these are thinned.
        driving: channels that drive the prediction.
        held: driving channels that hold each value until the next sample: one odd sample is not a fault of theirs.
        highest: sampling rate beyond which samples are averaged, Hz.
    """
    measured = tuple(measured)
    used = (*measured, *(name for name in driving if name in run.channels and name not in held))
    # First at the recorded rate, because a spike spoils the mean of its group; then again, when short events are single
    # samples.
    whole = without_spikes(without_saturation(run, measured), used)
    thin = thin_out(whole, held, highest)
    averaged = [name for name in measured if len(thin.channels[name]) < len(whole.channels[name])]
    return without_spikes(thin, averaged) if averaged else thin


def without_saturation(run: Run, names: Iterable[str]) -> Run:
    """The run without the saturated samples of these channels."""
    return _without(
        run,
        {n: saturated_samples(run.channels[n].value) for n in names},
        "at the end of its range",
        SAMPLES_BESIDE_SATURATION,
    )


def without_spikes(run: Run, names: Iterable[str]) -> Run:
    """The run without isolated outliers of these channels; `Run.warnings` has their number.

    Where their share exceeds `MAX_FAULTY_SAMPLE_SHARE`, all samples are kept, and a warning says so.
    """
    found = {name: spikes_of(run.channels[name]) for name in names}
    many = {name: bad for name, bad in found.items() if not _rare(int(bad.sum()), len(bad))}
    rare = {name: bad for name, bad in found.items() if name not in many}
    kept = _without(run, rare, "far from its neighbours", 0)
    counts = dict(run.outliers)
    for name, bad in rare.items():
        if bad.any():
            counts[name] = counts.get(name, 0) + int(bad.sum())
    kept = replace(kept, outliers=counts)
    told = [
        f"{name}: {bad.sum()} of {len(bad)} samples are far from their neighbours, too many to be faults: none is left "
        "out; check the sensor"
        for name, bad in many.items()
    ]
    return replace(kept, warnings=(*kept.warnings, *told)) if told else kept


def outlier_counts(runs: Iterable[Run]) -> dict[str, int]:
    """Number of samples that were left out as faulty, by channel, of several runs."""
    counts: dict[str, int] = {}
    for run in runs:
        for name, count in run.outliers.items():
            counts[name] = counts.get(name, 0) + count
    return counts


def outlier_sentence(runs: Iterable[Run]) -> str:
    """Sentence on the number of outliers that were left out of some runs; empty if there were none."""
    counts = outlier_counts(runs)
    return f" Left out as outliers: {', '.join(f'{n} of {name}' for name, n in counts.items())}." if counts else ""


def _rare(faults: int, samples: int) -> bool:
    return faults <= max(ALLOWED_FAULTS, MAX_FAULTY_SAMPLE_SHARE * samples)


def _without(run: Run, faulty: Mapping[str, np.ndarray], what: str, around: int) -> Run:
    """The run without faulty samples and those `around` them; `Run.warnings` says how many and when."""
    channels, warnings = dict(run.channels), list(run.warnings)
    for name, bad in faulty.items():
        if bad.any():
            channel, kept = run.channels[name], np.convolve(bad, np.ones(2 * around + 1), mode="same") < 0.5
            first, last = channel.time[bad][[0, -1]]
            when = f"at {first:.4g} s" if bad.sum() == 1 else f"between {first:.4g} and {last:.4g} s"
            some = f"1 of {len(bad)} samples" if bad.sum() == 1 else f"{bad.sum()} of {len(bad)} samples"
            warnings.append(f"{name}: {some} {what} left out, {when}")
            channels[name] = channel.selected(kept)
    return replace(run, channels=channels, warnings=tuple(warnings)) if len(warnings) > len(run.warnings) else run


def saturated_samples(value: np.ndarray) -> np.ndarray:
    """(n,) bool, whether each sample is saturated: it has an extreme value that too many samples have."""
    levels, counts = np.unique(value, return_counts=True)
    found = np.zeros(len(value), dtype=bool)
    for extreme, beside in ((-1, -2), (0, 1)) if len(levels) > 2 else ():
        if counts[extreme] >= MIN_SATURATED_COUNT_RATIO * (1 + counts[beside]):
            found |= value == levels[extreme]
    return found


@cached_with_first_argument
def spikes_of(channel: Channel) -> np.ndarray:
    """(n,) bool, whether each sample of a channel is a spike; cached."""
    found = spikes(channel.time, channel.value)
    found.setflags(write=False)
    return found


def spikes(time: np.ndarray, value: np.ndarray) -> np.ndarray:
    """(n,) bool, whether each sample is a spike: without it the samples around it lie on a smooth curve.

    Hampel's rule (J. Am. Stat. Assoc. 69, 1974) on fourth differences: a difference is too large beyond
    `MIN_SPIKE_DIFFERENCE_STDS` times the median absolute difference, of all or of those nearby, whichever is larger. A
    sample is a spike where it and few others explain all differences that are too large around it. Otherwise they are
    an event: a load that hits something vibrates for longer, and the torque of dry friction, where a joint reverses,
    steps and stays.
    """
    found = np.zeros(len(value), dtype=bool)
    if len(value) < 2 * DIFFERENCES_BESIDE_FOR_LOCAL_SIZE:
        return found
    size = np.abs(normalised_differences(time, value, SPIKE_DIFFERENCE_ORDER))
    if not np.isfinite(size).any():
        return found
    rounding = max(MAX_ROUNDING_DIFFERENCE_STEPS * resolution(value), ROUNDING_RANGE_SHARE * float(np.ptp(value)))
    typical = _typical(np.where(np.isfinite(size), size, np.nanmedian(size)))
    limit = np.maximum(MIN_SPIKE_DIFFERENCE_STDS * 1.4826 * typical, rounding)
    strange = np.flatnonzero(size > limit)
    if not 0 < len(strange) <= MAX_LARGE_DIFFERENCE_SHARE * len(value):
        return found
    for group in np.split(strange, np.flatnonzero(np.diff(strange) > SPIKE_DIFFERENCE_ORDER) + 1):
        begin, end = (
            max(0, group[0] - SPIKE_DIFFERENCE_ORDER),
            min(len(value), group[-1] + 2 * SPIKE_DIFFERENCE_ORDER + 1),
        )
        rough = bool(typical[group].max() > MIN_EVENT_ROUGHNESS_RATIO * typical.min())
        window = _Window(time[begin:end], value[begin:end], float(limit[group].max()), rough)
        found[[begin + i for i in window.culprits(len(group))]] = True
    return found


class _Window:
    """Samples around differences that are too large.

    Args:
        time: (w,) s.
        value: (w,).
        limit: largest difference of noise.
        rough: whether something goes on here, so that a fault must stand out more.
    """

    def __init__(self, time: np.ndarray, value: np.ndarray, limit: float, rough: bool) -> None:
        self._time, self._value, self._limit = time, value, limit
        largest = np.nanmax(np.abs(normalised_differences(time, value, SPIKE_DIFFERENCE_ORDER)))
        if rough:
            self._limit = min(limit, float(largest) / MIN_FAULT_RATIO_IN_EVENT)
        self._typical = float(np.median(np.diff(time)))

    def culprits(self, strange: int) -> list[int]:
        """Positions of the fewest samples without which no difference is too large; empty where it is an event.

        Args:
            strange: how many differences are too large; every sample takes part in `SPIKE_DIFFERENCE_ORDER` + 1 of
                them.
        """
        count = len(self._time)
        for few in range(1, MAX_ADJACENT_FAULTS + 1):
            if count <= SPIKE_DIFFERENCE_ORDER + 1 + few:
                return []
            choices = np.array(list(combinations(range(count), few)))
            left = self._left(choices)
            if left.min() == 0.0:
                # At an end one difference alone is too large, and several samples would do: the one that leaves the
                # smoothest rest, and no step.
                enough = choices[left == 0.0]
                rest = np.nanmean(self._differences(enough) ** 2, axis=0)
                found = (self._isolated(enough[i].tolist()) for i in np.argsort(rest, kind="stable"))
                return next((out for out in found if out), [])
        return self._isolated(self._one_by_one(int(MAX_FAULTY_SHARE_OF_GROUP * strange) + 1))

    def _one_by_one(self, most: int) -> list[int]:
        """Samples taken out one after another, each time that which explains most; empty where `most` do not do."""
        out: list[int] = []
        while len(out) < most and len(self._time) > len(out) + SPIKE_DIFFERENCE_ORDER + 2:
            others = [i for i in range(len(self._time)) if i not in out]
            left = self._left(np.array([[*out, i] for i in others]))
            out.append(others[int(np.argmin(left))])
            if left.min() == 0.0:
                return out
        return []

    def _isolated(self, out: list[int]) -> list[int]:
        """These samples, unless so many lie side by side or so close that it is an event."""
        if not out:
            return []
        ordered = np.sort(out)
        alone = np.split(ordered, np.flatnonzero(np.diff(ordered) > 1) + 1)
        longest = max((len(side_by_side) for side_by_side in alone), default=0)
        crowded = len(out) > MAX_ADJACENT_FAULTS and len(out) > MAX_FAULTY_SHARE_OF_GROUP * (
            ordered[-1] - ordered[0] + 1
        )
        step = any(self._steps(side_by_side, ordered) for side_by_side in alone)
        return [] if longest > MAX_ADJACENT_FAULTS or crowded or step else out

    def _steps(self, out: np.ndarray, everything: np.ndarray) -> bool:
        """Whether the signal is elsewhere after neighbouring samples that are taken out than it was before them.

        High differences hardly see a step in a gap. It is one where the way across the gap is longer, by more than the
        noise, than every other way as long around here; or than most of them, and what is taken out lies between.
        """
        before, after = int(out[0]) - 1, int(out[-1]) + 1
        if before < 0 or after >= len(self._value):
            return False
        ends = self._value[[before, after]]
        ways = np.abs(self._value[after - before :] - self._value[: before - after])
        touched = np.isin(np.arange(len(self._value)), everything)
        others = ways[np.lib.stride_tricks.sliding_window_view(touched, after - before + 1).sum(axis=1) == 0]
        if len(others) == 0:
            return False
        between = bool(np.all((self._value[out] >= ends.min()) & (self._value[out] <= ends.max())))
        usual = float(np.median(others) if between else np.max(others))
        return bool(np.ptp(ends) > MIN_STEP_RATIO_ACROSS_OMITTED * usual + self._limit)

    def _left(self, choices: np.ndarray) -> np.ndarray:
        """(r,) sum of what differences are beyond the limit, squared, without the samples (r, k) that a row names."""
        size = self._differences(choices)
        excess = np.where(size > self._limit, size - self._limit, 0.0)
        return np.asarray((excess**2).sum(axis=0))

    def _differences(self, choices: np.ndarray) -> np.ndarray:
        """(d, r) sizes of the differences without the samples (r, k) that a row names; NaN across a gap."""
        rows, without = choices.shape
        kept = np.ones((rows, len(self._time)), dtype=bool)
        kept[np.arange(rows)[:, None], choices] = False
        place = np.nonzero(kept)[1].reshape(rows, -1)
        # A gap that is made here is not a gap of the recording: differences across it tell a spike from a step.
        longest = MAX_DIFFERENCE_SPAN_RATIO + without / SPIKE_DIFFERENCE_ORDER
        return np.abs(
            normalised_differences(
                self._time[place].T, self._value[place].T, SPIKE_DIFFERENCE_ORDER, longest, self._typical
            )
        )


def _typical(size: np.ndarray) -> np.ndarray:
    """(n,) median of all, or of those around each where that is larger."""
    return np.maximum(median_filter(size, 2 * DIFFERENCES_BESIDE_FOR_LOCAL_SIZE + 1, mode="mirror"), np.median(size))


def thin_out(run: Run, held: Collection[str] = (), highest: float = MAX_UNAVERAGED_RATE_HZ) -> Run:
    """The run with channels that were sampled faster than `highest` averaged in groups.

    Averaging k samples shifts nothing in time and reduces white noise by sqrt(k).

    Args:
        run: as recorded.
        held: channels that are not averaged, such as commands that are held between samples.
        highest: rate beyond which samples are averaged, Hz.
    """
    channels, noise, spread = {}, dict(run.noise), dict(run.spread)
    for name, channel in run.channels.items():
        interval = float(np.median(np.diff(channel.time))) if len(channel) > 1 else np.inf
        group = int(1.0 / (highest * interval) + 1e-6) if interval > 0 else 1
        if group < 2 or name in held or len(channel) < 4 * group:
            channels[name] = channel
            continue
        channels[name] = channel.averaged(group)
        spread[name] = spread.get(name, 0.0) + interval**2 * (group**2 - 1) / 12.0
        if name in noise:
            noise[name] /= np.sqrt(group)
    return replace(run, channels=channels, noise=noise, spread=spread)
