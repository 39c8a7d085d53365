"""How much of a misfit a change of the model explains: the one meaning of "explained" in every text and number.

The share of the squared error above the noise that is gone, on motion that no fit has seen where there is such motion,
else on the training runs:

    share = 1 - sum_c w_c max(e_c'^2 - s_c^2, 0) / sum_c w_c max(e_c^2 - s_c^2, 0),

e_c the rms error of channel c before, e_c' after, s_c the standard deviation of its noise; w_c = 1 where all channels
have one unit, such as the torques of an arm, else 1/s_c^2.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from armdyn.identify.problem import Block, by_channel

WRONG = 2.0
"""Times its noise, from which a channel's error is one that wants to be explained."""


@dataclass(frozen=True)
class RepairStep:
    """One step of a repair.

    Attributes:
        added: names of the effects that came in; empty for the model as given.
        joints: where, for an arm.
        tied_with: effects that these runs cannot tell from the one added.
        rmse: by channel, on the training runs.
        held_out_rmse: by channel, on held-out runs, which take part in choosing; empty where there is a single run.
        chi2_per_sample: 1 when only noise is left.
        bic: with the noise as assumed.
        exam_rmse: by channel, on exam runs, which take part in nothing; empty where none is given.
        values: number of small values, of the step that adds a background.
    """

    added: tuple[str, ...]
    joints: tuple[str, ...]
    tied_with: tuple[str, ...]
    rmse: dict[str, float]
    held_out_rmse: dict[str, float]
    chi2_per_sample: float
    bic: float
    exam_rmse: dict[str, float] = field(default_factory=dict)
    values: int = 0

    @property
    def errors(self) -> dict[str, dict[str, float]]:
        """By channel, for every kind of runs that there is; the most independent ones come last."""
        kinds = {"fitted": self.rmse, "held out": self.held_out_rmse, "exam": self.exam_rmse}
        return {kind: errors for kind, errors in kinds.items() if errors}

    def judged(self, scale: "Scale") -> dict[str, float]:
        """Errors of the most independent runs by channel, without channels that no training run has."""
        *_, found = self.errors.values()
        return {channel: error for channel, error in found.items() if channel in scale.units}


@dataclass(frozen=True)
class Scale:
    """What errors are measured with.

    Attributes:
        units: by channel, SI.
        noise: by channel, standard deviation in its unit.
    """

    units: Mapping[str, str]
    noise: Mapping[str, float]

    @classmethod
    def of(cls, blocks: Sequence[Block]) -> "Scale":
        """Of the channels of some blocks; of several runs the root of their mean variance."""
        channels = by_channel(blocks)
        noise = {c: float(np.sqrt(np.mean([block.noise**2 for block in mine]))) for c, mine in channels.items()}
        return cls({channel: mine[0].unit for channel, mine in channels.items()}, noise)


def explained(before: RepairStep, after: RepairStep, scale: Scale) -> float:
    """The share, at most 1; negative where the error grew. 1 where there was nothing to explain.

    Args:
        before: the model as given.
        after: the changed one.
        scale: units and noise of the channels.
    """
    return share_gone(before.judged(scale), after.judged(scale), scale)


def share_gone(before: Mapping[str, float], after: Mapping[str, float], scale: Scale) -> float:
    """The share, of rms errors by channel."""
    first, last = (_above_noise(errors, scale) for errors in (before, after))
    if first <= 0.0:
        return 1.0 if last <= 0.0 else 0.0
    return 1.0 - last / first


def least_explained(before: Mapping[str, float], after: Mapping[str, float], scale: Scale) -> tuple[str, float] | None:
    """The channel of which least is explained, and that share; None of a single channel.

    Of rms errors by channel; channels that were at their noise are left out.
    """
    seen = [channel for channel in before if channel in after and before[channel] > WRONG * scale.noise[channel]]
    shares = {c: share_gone({c: before[c]}, {c: after[c]}, scale) for c in seen}
    return min(shares.items(), key=lambda item: item[1]) if len(shares) > 1 else None


def _above_noise(errors: Mapping[str, float], scale: Scale) -> float:
    """Sum of the channels' squared errors above the noise."""
    one_unit = len({scale.units[channel] for channel in errors}) < 2
    total = 0.0
    for channel, error in errors.items():
        noise = scale.noise[channel]
        total += max(error**2 - noise**2, 0.0) / (1.0 if one_unit else noise**2)
    return total


def in_percent(share: float) -> str:
    """``0.9994`` as ``99.9 %``, in every text and number: rounded down, so never all where something is left."""
    if not math.isfinite(share):
        return "–"
    digits = 0 if share < 0.99 else 1
    cut = math.floor(round(share * 10 ** (digits + 2), 6)) / 10**digits
    return f"{100 if share >= 1.0 else cut:.{digits}f} %".replace(".0 %", " %").replace("-", "−")
