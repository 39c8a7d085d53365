"""Find where a model fails: ranges of time, angle, rate or joint speed in which the residual is far above the noise."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from armdyn.identify.fit import Fit
from armdyn.identify.residual.block import ResidualBlock, blocks_by_channel, chi2_sum, chi2_z_value, sample_count
from armdyn.identify.settings import VerdictSettings
from armdyn.recording.channel_names import channel_full_name
from armdyn.recording.channels import is_auxiliary
from armdyn.run import Channel

SIGNAL_BINS_OF_EQUAL_COUNT = 16
"""Number of bins over a signal such as an angle, each with equally many samples."""
TIME_BINS = 30
"""Number of equally wide bins over the time of a run."""
MAX_REPORTED_FAILING_RANGES = 12
"""Largest number of ranges that are reported."""


@dataclass(frozen=True)
class FailingRange:
    """A range of time, or of another quantity, in which a model predicts a channel badly.

    Attributes:
        channel: the channel.
        run: name of the run; ``""`` where the range holds for all runs together.
        against: quantity of the range, such as ``"time"`` or ``"swing_angle"``; ``"run"`` for a whole run.
        start: lower end of the range.
        end: upper end of the range.
        unit: unit of both ends.
        chi2_per_sample: squared residual over the noise variance, per sample, in the range; 1 is noise.
        share: share of the channel's squared residual that lies in the range.
    """

    channel: str
    run: str
    against: str
    start: float
    end: float
    unit: str
    chi2_per_sample: float
    share: float

    @property
    def quantity(self) -> str:
        """Quantity of the range in words, such as ``"velocity of elbow"``."""
        side = "sign of "
        name = channel_full_name(self.against.removeprefix(side))
        return f"the {side}{name}" if self.against.startswith(side) else "whole run" if name == "run" else name

    @property
    def sentence(self) -> str:
        """The range in words, such as ``"against time from 3 to 4 s in a.csv"``."""
        text = f"against {self.against} from {self.start:.3g} to {self.end:.3g} {self.unit}"
        return f"{text} in {self.run}" if self.run else text


def find_failing_ranges(fit: Fit) -> tuple[FailingRange, ...]:
    """Find the ranges in which the residual of a fit is far above the noise and above its average, the worst first."""
    words = fit.problem.settings.verdict
    covariates, places = fit.covariates(), list[FailingRange]()
    for channel, blocks in blocks_by_channel(fit.blocks).items():
        total, samples = chi2_sum(blocks), sample_count(blocks)
        overall = total / samples
        if chi2_z_value(total, samples) < words.range_stds:
            continue
        found = _over_runs(blocks, words.range_ratio * overall) if len(blocks) > 1 else []
        for block in blocks:
            found += _bins(channel, block.run, "time", "s", block.time, block.residual**2, TIME_BINS, words, even=True)
        joint = "" if is_auxiliary(channel) else channel.partition(".")[2]
        for name in dict.fromkeys(n for b in blocks for n in covariates[b.run]):
            if joint and not name.endswith(f".{joint}"):
                continue
            found += _against(
                channel, name, [(b, covariates[b.run][name]) for b in blocks if name in covariates[b.run]], words
            )
        far = (p for p in found if p.chi2_per_sample > words.range_ratio * overall or p.against == "run")
        places += [replace(p, share=min(1.0, p.share / total)) for p in far]
    return tuple(sorted(places, key=lambda p: -p.chi2_per_sample)[:MAX_REPORTED_FAILING_RANGES])


def _against(
    channel: str, name: str, pairs: Sequence[tuple[ResidualBlock, Channel]], words: VerdictSettings
) -> list[FailingRange]:
    at = np.concatenate([b.interpolate(c) for b, c in pairs])
    square = np.concatenate([b.residual**2 for b, _ in pairs])
    unit = pairs[0][1].unit
    found = _bins(channel, "", name, unit, at, square, SIGNAL_BINS_OF_EQUAL_COUNT, words, even=False)
    if name.startswith("v.") or name == "swing_rate":
        moving = np.abs(at) > 0.05 * np.max(np.abs(at), initial=0.0)
        sides = [square[moving & (sign * at > 0)] for sign in (-1, 1)]
        means = [_mean(side) for side in sides]
        if min(means) > 0 and max(means) > 2 * min(means):
            worse = int(np.argmax(means))
            bounds = (float(at.min()), 0.0) if worse == 0 else (0.0, float(at.max()))
            found.append(
                FailingRange(channel, "", f"sign of {name}", *bounds, unit, means[worse], float(sides[worse].sum()))
            )
    return found


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if len(values) else 0.0


def _over_runs(blocks: Sequence[ResidualBlock], least: float) -> list[FailingRange]:
    squares = [float(b.residual @ b.residual) for b in blocks]
    return [
        FailingRange(
            b.channel, b.run, "run", float(b.time[0]), float(b.time[-1]), "s", square / len(b.residual), square
        )
        for b, square in zip(blocks, squares, strict=True)
        if square / len(b.residual) > least
    ]


def _bins(
    channel: str,
    run: str,
    against: str,
    unit: str,
    at: np.ndarray,
    square: np.ndarray,
    bins: int,
    words: VerdictSettings,
    *,
    even: bool,
) -> list[FailingRange]:
    """Ranges of neighbouring bins that stand out; bins are equally wide, or hold equally many samples."""
    if np.ptp(at) <= 0:
        return []
    edges = (
        np.linspace(at.min(), at.max(), bins + 1) if even else np.unique(np.quantile(at, np.linspace(0, 1, bins + 1)))
    )
    if len(edges) < 3:
        return []
    index = np.clip(np.searchsorted(edges, at, side="right") - 1, 0, len(edges) - 2)
    counts = np.bincount(index, minlength=len(edges) - 1)
    sums = np.bincount(index, weights=square, minlength=len(edges) - 1)
    overall = float(square.mean())
    mean = sums / np.maximum(counts, 1)
    failing = (sums - counts > words.range_stds * np.sqrt(2 * np.maximum(counts, 1))) & (
        mean > words.range_ratio * overall
    )
    places, first = [], None
    for i, fails in enumerate([*failing, False]):
        if fails and first is None:
            first = i
        elif not fails and first is not None:
            level = float(sums[first:i].sum() / counts[first:i].sum())
            # a sum of squares here; the caller divides it by the channel's sum
            places.append(FailingRange(channel, run, against, float(edges[first]), float(edges[i]), unit, level,
                                float(sums[first:i].sum())))  # fmt: skip
            first = None
    return places
