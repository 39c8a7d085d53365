"""Cut runs where samples are missing, so that nothing is smoothed, filtered or simulated across a gap."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from armdyn.recording.channels import MIN_COMPARED_CHANNEL_SAMPLES, Channel, FloatArray
from armdyn.run import Run

MIN_GAP_USUAL_INTERVALS, MIN_GAP_SECONDS = 5.0, 0.25
"""A gap exceeds both this number of usual intervals and this time, s. Over 0.25 s motions of 1.5 Hz are still
interpolated to 2 %."""
MIN_SAMPLES_BETWEEN_GAPS = 40
"""Least number of samples of every channel in a part of a run that is cut at gaps."""


def gaps_of(run: Run) -> list[tuple[float, float]]:
    """Time spans, s, in which a channel was not recorded; overlapping spans are joined."""
    spans = []
    for channel in run.channels.values():
        steps = np.diff(channel.time)
        if len(steps) >= MIN_COMPARED_CHANNEL_SAMPLES:
            for i in np.flatnonzero(steps > longest_interval_without_gap(channel.time)):
                spans.append((float(channel.time[i]), float(channel.time[i + 1])))
    merged: list[tuple[float, float]] = []
    for begin, end in sorted(spans):
        if merged and begin <= merged[-1][1]:
            merged[-1] = merged[-1][0], max(end, merged[-1][1])
        else:
            merged.append((begin, end))
    return merged


def longest_interval_without_gap(time: FloatArray) -> float:
    """Longest interval, s, between successive time stamps (n,) without a gap."""
    steps = np.diff(time)
    return max(MIN_GAP_USUAL_INTERVALS * float(np.median(steps)), MIN_GAP_SECONDS) if len(steps) else MIN_GAP_SECONDS


def run_until(run: Run, end: float) -> Run:
    """The part of a run up to the time `end`, s."""
    return replace(run, channels=channels_between(run, -np.inf, end))


def channels_between(run: Run, begin: float, end: float, fewest: int = 0) -> Mapping[str, Channel]:
    """Channels of a run from `begin` to `end`, s; those with fewer than `fewest` samples there are left out."""
    found = {}
    for name, channel in run.channels.items():
        inside = (channel.time >= begin) & (channel.time <= end)
        if inside.sum() >= fewest:
            found[name] = channel.selected(inside)
    return found


def cut_at_gaps(run: Run) -> tuple[Run, ...]:
    """Cut a run into its parts between gaps; the first part's warnings state the gaps.

    A part that is too short is left out; if all are, the run is not cut.
    """
    spans = gaps_of(run)
    if not spans:
        return (run,)
    edges = [-np.inf, *(t for span in spans for t in span), np.inf]
    parts = [
        channels_between(run, *piece, MIN_COMPARED_CHANNEL_SAMPLES)
        for piece in zip(edges[::2], edges[1::2], strict=True)
    ]
    whole = [
        p for p in parts if set(p) == set(run.channels) and min(len(c) for c in p.values()) >= MIN_SAMPLES_BETWEEN_GAPS
    ]
    if not whole:
        return (run,)
    return runs_of_parts(
        run, whole, f"no samples {time_spans_in_words(spans)}: the run is cut there, each piece with its own start"
    )


def time_spans_in_words(spans: Iterable[tuple[float, float]]) -> str:
    """Time spans, s, in words."""
    return ", ".join(f"from {begin:.4g} to {end:.4g} s" for begin, end in spans)


def runs_of_parts(run: Run, parts: Sequence[Mapping[str, Channel]], said: str) -> tuple[Run, ...]:
    """Make runs of parts of a run; the first one gets the reason of the cut, `said`, as a warning."""
    began = min(float(c.time[0]) for c in run.channels.values()) if run.began is None else run.began
    return tuple(
        replace(
            run, name=f"{run.name}#{k}" if len(parts) > 1 else run.name, channels=channels, began=began,
            warnings=(*run.warnings, said) if k == 1 else (),
        )
        for k, channels in enumerate(parts, start=1)
    )  # fmt: skip
