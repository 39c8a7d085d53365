"""Residuals of a fit, by run and channel, and their sum of squares over the noise."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from armdyn.run import Channel


@dataclass(frozen=True, eq=False)
class ResidualBlock:
    """Measured samples of one channel in one run, with the residual of a prediction and its derivatives.

    Attributes:
        run: name of the run.
        channel: name of the channel.
        measured: (n,) samples.
        residual: (n,) measured minus predicted, in units of `noise`.
        sensitivities: (n, P) derivatives of the prediction over `noise`, one column per unknown.
        noise: standard deviation of the noise of one sample, in the channel's unit.
        moving: (P,) bool, False for unknowns on which the prediction cannot depend.
    """

    run: str
    channel: str
    measured: Channel
    residual: np.ndarray
    sensitivities: np.ndarray
    noise: float
    moving: np.ndarray

    @property
    def misfit(self) -> np.ndarray:
        """(n,) residual, measured minus predicted, in the channel's unit."""
        return self.residual * self.noise

    @property
    def predicted(self) -> np.ndarray:
        """(n,) predicted samples, in the channel's unit."""
        return self.measured.value - self.misfit

    @property
    def time(self) -> np.ndarray:
        """(n,) times of the samples, s."""
        return self.measured.time

    @property
    def unit(self) -> str:
        """Unit of the channel."""
        return self.measured.unit

    def with_noise(self, noise: float) -> "ResidualBlock":
        """The same residual in units of another noise."""
        ratio = self.noise / noise
        return replace(self, residual=ratio * self.residual, sensitivities=ratio * self.sensitivities, noise=noise)

    def interpolate(self, signal: Channel) -> np.ndarray:
        """(n,) values of another signal of the run, interpolated at the times of the samples."""
        return np.asarray(np.interp(self.time, signal.time, signal.value))


def blocks_by_channel(blocks: Sequence[ResidualBlock]) -> dict[str, list[ResidualBlock]]:
    """Group blocks by channel; channels keep the order of their first blocks."""
    found: dict[str, list[ResidualBlock]] = {}
    for block in blocks:
        found.setdefault(block.channel, []).append(block)
    return found


@np.errstate(all="ignore")  # the values of a diverging simulation are infinite
def chi2_sum(blocks: Sequence[ResidualBlock]) -> float:
    """Sum of the squared residuals of some blocks, over the noise variance; infinite where a simulation diverges."""
    found = float(sum(block.residual @ block.residual for block in blocks))
    return found if np.isfinite(found) else np.inf


def sample_count(blocks: Sequence[ResidualBlock]) -> int:
    """Number of samples in some blocks."""
    return sum(len(block.residual) for block in blocks)


def chi2_z_value(chi2: float, samples: int) -> float:
    """By how many standard deviations a sum of squares `chi2` exceeds that of so many samples of white noise."""
    return float((chi2 - samples) / np.sqrt(2 * samples))
