"""The share of the error that a change of the model explains, as all texts and numbers of armdyn define it.

It is the share of the squared error above the noise that the change removes, measured on runs that were not fitted
where there are any, else on the training runs:

    share = 1 - sum_c w_c max(e_c'^2 - s_c^2, 0) / sum_c w_c max(e_c^2 - s_c^2, 0),

e_c the rms error of channel c before, e_c' after, s_c the standard deviation of its noise; w_c = 1 where all channels
have one unit, such as the torques of an arm, else 1/s_c^2.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from armdyn.identify.residual.block import ResidualBlock, blocks_by_channel


@dataclass(frozen=True)
class RepairStep:
    """One step of a repair: the effects that it added, and the errors of the model after it.

    Attributes:
        added: names of the effects that this step added; empty for the model as given.
        joints: joints on which the effects act, for an arm.
        tied_with: effects that these runs cannot distinguish from the one added, ``"leak:upper"`` on another state.
        rmse: root mean square residual of the training runs, by channel.
        held_out_rmse: root mean square residual of held-out runs, which help to choose effects, by channel; empty for a
            single run.
        chi2_per_sample: squared residual over the noise variance, per sample; 1 where the residual is only noise.
        bic: Bayesian information criterion with the assumed noise.
        exam_rmse: root mean square residual of exam runs, which are used for nothing else, by channel; empty without
            exam runs.
        values: number of small values, for the step that adds a background.
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
        """Errors by kind of run (``"fitted"``, ``"held out"``, ``"exam"``) and channel, the most independent last."""
        kinds = {"fitted": self.rmse, "held out": self.held_out_rmse, "exam": self.exam_rmse}
        return {kind: errors for kind, errors in kinds.items() if errors}

    def independent_errors(self, scale: "ChannelScale") -> dict[str, float]:
        """Errors, by channel, on the runs that were used least: exam runs if any, else held-out, else training runs.

        Channels without a unit in `scale`, which no training run has, are left out.
        """
        *_, found = self.errors.values()
        return {channel: error for channel, error in found.items() if channel in scale.units}

    def without_exam(self) -> "RepairStep":
        """The step as if there were no exam."""
        return replace(self, exam_rmse={})


@dataclass(frozen=True)
class ChannelScale:
    """Units and noise of the channels, with which errors of different channels are compared.

    Attributes:
        units: SI unit by channel.
        noise: standard deviation of the noise by channel, in the channel's unit.
    """

    units: Mapping[str, str]
    noise: Mapping[str, float]

    @classmethod
    def of(cls, blocks: Sequence[ResidualBlock]) -> "ChannelScale":
        """Units and noise of some blocks' channels; the noise of several runs is the root of the mean variance."""
        channels = blocks_by_channel(blocks)
        noise = {c: float(np.sqrt(np.mean([block.noise**2 for block in mine]))) for c, mine in channels.items()}
        return cls({channel: mine[0].unit for channel, mine in channels.items()}, noise)


def explained_share(before: RepairStep, after: RepairStep, scale: ChannelScale) -> float:
    """Share of the squared error that a change of the model explains; the module defines it.

    It is at most 1, negative where the error grew, and 1 where there was no error above the noise.

    Args:
        before: errors of the model as given.
        after: errors of the changed model.
        scale: units and noise of the channels.
    """
    return explained_error_share(before.independent_errors(scale), after.independent_errors(scale), scale)


def explained_error_share(before: Mapping[str, float], after: Mapping[str, float], scale: ChannelScale) -> float:
    """Share of the squared error above the noise that is removed, from root mean square errors by channel."""
    first, last = (_above_noise(errors, scale) for errors in (before, after))
    if first <= 0.0:
        return 1.0 if last <= 0.0 else 0.0
    return 1.0 - last / first


def _above_noise(errors: Mapping[str, float], scale: ChannelScale) -> float:
    """Sum of the channels' squared errors above the noise."""
    one_unit = len({scale.units[channel] for channel in errors}) < 2
    total = 0.0
    for channel, error in errors.items():
        noise = scale.noise[channel]
        total += max(error**2 - noise**2, 0.0) / (1.0 if one_unit else noise**2)
    return total


def percent_text(share: float) -> str:
    """Format ``0.9994`` as ``99.9 %``, rounded down: 100 % means that no error is left."""
    if not math.isfinite(share):
        return "–"
    digits = 0 if share < 0.99 else 1
    cut = math.floor(round(share * 10 ** (digits + 2), 6)) / 10**digits
    return f"{100 if share >= 1.0 else cut:.{digits}f} %".replace(".0 %", " %").replace("-", "−")
