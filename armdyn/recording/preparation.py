"""Facts on the processing of a measured torque before its comparison with a model, for reports."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

HARDLY_MOVING_TIME_SHARE = 0.01
"""Share of a recording during which a joint moves, below which a report states that it hardly moves."""


@dataclass(frozen=True)
class Preparation:
    """Facts on the processing of one measured torque.

    Attributes:
        cutoff: cut-off of the low-pass on measured and predicted torque, Hz.
        position_cutoff: frequency up to which the joint's position is motion rather than noise, Hz.
        rate: rate of the samples that were kept, 1/s.
        samples: number of these samples.
        recorded_rate: rate of the recorded samples, 1/s.
        recorded: number of the recorded samples.
        left_out: share of the recorded samples at which the joint's direction is uncertain.
        moving: share of the recorded samples at which the joint's direction is certain.
        smoothed: cut-off, Hz, of the drive's own low-pass on the recorded torque; None without one.
    """

    cutoff: float
    position_cutoff: float
    rate: float
    samples: int
    recorded_rate: float
    recorded: int
    left_out: float
    moving: float
    smoothed: float | None = None


def combined_preparations(runs: Iterable[Mapping[str, Preparation]]) -> dict[str, Preparation]:
    """Combine several runs by channel: the lowest cut-offs and rates, and the total numbers of samples."""
    by_channel: dict[str, list[Preparation]] = {}
    for run in runs:
        for channel, done in run.items():
            by_channel.setdefault(channel, []).append(done)
    return {channel: _together(every) for channel, every in by_channel.items()}


def preparation_sentence(prepared: Mapping[str, Preparation]) -> str:
    """Sentence on the band, rate and left-out samples of prepared torques and wrenches; empty if there are none."""
    if not prepared:
        return ""
    every = list(prepared.values())
    left_out = float(np.average([p.left_out for p in every], weights=[p.recorded for p in every]))
    torques = [name.startswith("tau.") for name in prepared]
    what = "Torques" if all(torques) else "Torques and wrenches" if any(torques) else "Wrenches"
    text = (
        f"{what} are compared below {_range([p.cutoff for p in every])} Hz (positions are motion below "
        f"{_range([p.position_cutoff for p in every])} Hz, noise above): {_range([p.rate for p in every])} samples per "
        f"second of {_range([p.recorded_rate for p in every])} hold all of that"
    )
    text += f"; {100 * left_out:.2g} % are left out where a joint reverses or rests." if left_out > 0.0 else "."
    smoothed = [p.smoothed for p in every if p.smoothed is not None]
    if smoothed:
        text += (
            f" The drives smoothed their torques below {_range(smoothed)} Hz before they were recorded: samples beside "
            "each other show less noise than there is, and only what is well below is compared."
        )
    still = [channel.partition(".")[2] for channel, done in prepared.items() if done.moving < HARDLY_MOVING_TIME_SHARE]
    if still:
        names = " and ".join(part for part in (", ".join(still[:-1]), still[-1]) if part)
        text += (
            f" {names} hardly move{'s' if len(still) == 1 else ''}: these runs show no friction or rotor inertia there."
        )
    return text


def _together(every: Sequence[Preparation]) -> Preparation:
    recorded = sum(p.recorded for p in every)
    return Preparation(
        cutoff=min(p.cutoff for p in every),
        position_cutoff=min(p.position_cutoff for p in every),
        rate=min(p.rate for p in every),
        samples=sum(p.samples for p in every),
        recorded_rate=min(p.recorded_rate for p in every),
        recorded=recorded,
        left_out=sum(p.left_out * p.recorded for p in every) / recorded,
        moving=sum(p.moving * p.recorded for p in every) / recorded,
        smoothed=min((p.smoothed for p in every if p.smoothed is not None), default=None),
    )


def _range(values: Sequence[float]) -> str:
    low, high = f"{min(values):.3g}", f"{max(values):.3g}"
    return low if low == high else f"{low} to {high}"
