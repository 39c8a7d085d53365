"""Samples that no load and no noise made: isolated spikes, and readings at the end of a sensor's range."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from itertools import combinations

import numpy as np

from armdyn.channels import Channel
from armdyn.differences import normalised_differences
from armdyn.run import Run

ORDER = 4
"""Of the differences in which a spike shows: a cubic through its neighbours is as good as the signal."""
SPIKE = 6.0
"""Robust standard deviations beyond which a difference is no noise: of white noise one in 5e8."""
AROUND = 25
"""Differences to either side that tell how large they are around here, where a signal is rougher than elsewhere."""
TOGETHER = 2
"""Faulty samples side by side that are still isolated; what lasts longer is an event."""
RARE = 0.01
"""Share of the samples up to which strange ones are faults; where they are more, such is the noise of this sensor."""
CROWDED = 5.0
"""Times as many samples share the extreme value as the value next to it (and one more) where the sensor was at its
end: of a sine that is coarsely rounded 2.4 times as many are at the peak."""
DISTURBED = 2
"""Samples to either side of one at the end that are left out as well: the noise has chosen them."""


def without_saturation(run: Run, names: Iterable[str]) -> Run:
    """The run without those samples of these channels that are at the end of the sensor's range."""
    return _without(run, {n: at_the_end(run.channels[n].value) for n in names}, "at the end of its range", DISTURBED)


def without_spikes(run: Run, names: Iterable[str]) -> Run:
    """The run without isolated outliers of these channels."""
    found = {name: spikes(run.channels[name].time, run.channels[name].value) for name in names}
    return _without(run, found, "far from its neighbours", 0)


def _without(run: Run, faulty: Mapping[str, np.ndarray], what: str, around: int) -> Run:
    """The run without faulty samples and those `around` them; `Run.warnings` says how many and when."""
    channels, warnings = dict(run.channels), list(run.warnings)
    for name, bad in faulty.items():
        if bad.any():
            channel, kept = run.channels[name], np.convolve(bad, np.ones(2 * around + 1), mode="same") < 0.5
            first, last = channel.time[bad][[0, -1]]
            when = f"at {first:.4g} s" if bad.sum() == 1 else f"between {first:.4g} and {last:.4g} s"
            some = "1 sample" if bad.sum() == 1 else f"{bad.sum()} samples"
            warnings.append(f"{name}: {some} {what} left out, {when}")
            channels[name] = Channel(channel.time[kept], channel.value[kept], channel.unit)
    return replace(run, channels=channels, warnings=tuple(warnings)) if len(warnings) > len(run.warnings) else run


def at_the_end(value: np.ndarray) -> np.ndarray:
    """(n,) bool: samples that share the largest or the smallest value, where these are suspiciously many."""
    levels, counts = np.unique(value, return_counts=True)
    found = np.zeros(len(value), dtype=bool)
    for extreme, beside in ((-1, -2), (0, 1)) if len(levels) > 2 else ():
        if counts[extreme] >= CROWDED * (1 + counts[beside]):
            found |= value == levels[extreme]
    return found


def spikes(time: np.ndarray, value: np.ndarray) -> np.ndarray:
    """(n,) bool: samples without which those around them lie on a smooth curve, but not with them.

    Hampel's rule (J. Am. Stat. Assoc. 69, 1974) on fourth differences: beyond `SPIKE` times the median absolute
    difference, of all or of those around here, whichever is larger. A sample counts where it alone, or it and one
    more, explain all that is too large around it: a load that hits something shakes longer.
    """
    found = np.zeros(len(value), dtype=bool)
    if len(value) < 2 * AROUND:
        return found
    size = np.abs(normalised_differences(time, value, ORDER))
    limit = SPIKE * 1.4826 * _typical(np.where(np.isfinite(size), size, np.nanmedian(size)))
    strange = np.flatnonzero(size > limit)
    groups = np.split(strange, np.flatnonzero(np.diff(strange) > ORDER) + 1) if len(strange) else []
    if len(groups) > RARE * len(value):
        return found
    for group in groups:
        if len(group) > TOGETHER * (ORDER + 1):
            continue
        begin, end = max(0, group[0] - ORDER), min(len(value), group[-1] + 2 * ORDER + 1)
        near = slice(begin, end)
        found[[begin + i for i in _culprits(time[near], value[near], float(limit[group].max()))]] = True
    return found


def _culprits(time: np.ndarray, value: np.ndarray, limit: float) -> list[int]:
    """Positions of the fewest samples without which no difference is beyond the limit; empty where many are needed."""
    for count in range(1, TOGETHER + 1):
        if len(value) <= ORDER + 1 + count:
            break
        choices = [list(choice) for choice in combinations(range(len(value)), count)]
        worst = [_largest(time, value, choice) for choice in choices]
        best = int(np.argmin(worst))
        if worst[best] <= limit:
            return choices[best]
    return []


def _largest(time: np.ndarray, value: np.ndarray, without: list[int]) -> float:
    """The largest difference without some of the samples, 0 where there is none."""
    differences = normalised_differences(np.delete(time, without), np.delete(value, without), ORDER)
    return float(np.nanmax(np.abs(differences), initial=0.0))


def _typical(size: np.ndarray) -> np.ndarray:
    """(n,) median of all, or of those around each where that is larger."""
    padded = np.pad(size, AROUND, mode="reflect")
    around = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * AROUND + 1), axis=1)
    return np.maximum(around, np.median(size))
