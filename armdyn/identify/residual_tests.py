"""Is there anything left to explain?"""

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2 as chi2_distribution

from armdyn.identify.fit import Fit
from armdyn.identify.noise import ljung_box
from armdyn.identify.score import Score

LARGEST_Z = 5.0
SMALLEST_WHITENESS = 1e-4
SMALLEST_SCORE = 5e-3
"""0 false alarms in 360 clean runs with the first two. Effects resemble one another, so that the third, which counts
them all, is half as likely as it says."""


@dataclass(frozen=True)
class ResidualTests:
    """How a fit's residual compares with the noise.

    Attributes:
        z: standard deviations by which chi2 exceeds the number of samples, the largest over channels.
        whiteness: probability that white noise is as correlated, the smallest over runs and channels, times their
            number.
        score: probability that the best effect of the catalogue seems as good by chance, times the number of effects.
    """

    z: float
    whiteness: float
    score: float

    @property
    def fails(self) -> bool:
        """Whether something is left to explain."""
        return self.z > LARGEST_Z or self.whiteness < SMALLEST_WHITENESS or self.score < SMALLEST_SCORE


def residual_tests(fit: Fit, promised: list[Score]) -> ResidualTests:
    """Compare a fit's residual with the noise."""
    z = -np.inf
    for channel in dict.fromkeys(block.channel for block in fit.blocks):
        blocks = [block for block in fit.blocks if block.channel == channel]
        n = sum(len(block.residual) for block in blocks)
        z = max(z, (sum(float(b.residual @ b.residual) for b in blocks) - n) / np.sqrt(2 * n))
    whiteness = min(ljung_box(block.residual) for block in fit.blocks) * len(fit.blocks)
    chances = (float(chi2_distribution.sf(s.drop, max(1, len(s.candidate.names)))) for s in promised)
    score = min(chances, default=1.0) * max(1, len(promised))
    return ResidualTests(float(z), min(1.0, whiteness), min(1.0, score))
