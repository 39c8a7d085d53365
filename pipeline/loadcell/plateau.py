"""What a load cell said while one known weight hung on it."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from armdyn.errors import TaskFailedError
from pipeline.loadcell.protocol import MAXIMUM_COUNTS, MINIMUM_COUNTS
from pipeline.loadcell.weights import Weight

FEWEST_SAMPLES = 40
OUTLIER = 5.0
"""Robust standard deviations from the median beyond which a sample is left out."""
MOST_OUTLIERS = 0.1
"""Share of the samples; more means that somebody touched the cell."""
BLOCKS = 10
CORRELATED = 1.5
"""Times the standard deviation of the mean of independent samples; blocks of such exceed it once in 60 times."""


@dataclass(frozen=True)
class Plateau:
    """One weight and its counts.

    Attributes:
        weight: what hung there.
        mean: without outliers [counts].
        mean_std: standard deviation of the mean [counts]; larger than noise / sqrt(samples) where the cell drifts.
        noise: standard deviation of one sample [counts].
        samples: how many were used.
        outliers: how many were left out.
    """

    weight: Weight
    mean: float
    mean_std: float
    noise: float
    samples: int
    outliers: int

    @classmethod
    def of(cls, weight: Weight, counts: npt.ArrayLike) -> "Plateau":
        """Robust mean of `counts` (n,), in the order of their arrival.

        Samples farther than `OUTLIER` robust standard deviations (1.4826 times the median absolute deviation) from the
        median are left out. The standard deviation of the mean is that of independent samples, unless the means of
        `BLOCKS` consecutive blocks differ by clearly more than that allows: drift, creep, a slow swing.

        Raises:
            TaskFailedError: too few samples, a saturated or dead cell, or a cell that was touched.
        """
        values = np.asarray(counts, dtype=np.float64)
        if len(values) < FEWEST_SAMPLES:
            raise TaskFailedError(f"{weight.text}: {len(values)} samples are too few: take {FEWEST_SAMPLES} or more")
        if values.min() <= MINIMUM_COUNTS or values.max() >= MAXIMUM_COUNTS:
            raise TaskFailedError(f"{weight.text}: the HX711 is at the end of its range: take lighter weights")
        median = float(np.median(values))
        # A cell quieter than its counts has no median deviation: a step of the converter is the least that can be told.
        spread = max(1.4826 * float(np.median(np.abs(values - median))), 1.0)
        kept = values[np.abs(values - median) <= OUTLIER * spread]
        outliers = len(values) - len(kept)
        if np.ptp(values) == 0.0:
            raise TaskFailedError(
                f"{weight.text}: the counts stand still at {median:.0f}: check the wires between cell and HX711"
            )
        if outliers > MOST_OUTLIERS * len(values):
            raise TaskFailedError(
                f"{weight.text}: {outliers} of {len(values)} samples are far off: do not touch the cell, and try again"
            )
        noise = float(kept.std(ddof=1))
        blocks = [block.mean() for block in np.array_split(kept, BLOCKS)]
        mean_std = max(noise, _QUANTISATION) / math.sqrt(len(kept))
        block_std = float(np.std(blocks, ddof=1)) / math.sqrt(BLOCKS)
        if block_std > CORRELATED * mean_std:
            mean_std = block_std
        return cls(weight, float(kept.mean()), mean_std, noise, len(kept), outliers)


_QUANTISATION = 1.0 / math.sqrt(12.0)
