r"""How often a sound robot's statistic exceeds a threshold: from what was seen, to far beyond it.

The statistics are roots of sums of squares over their variance. Their squares are exponential far out where many small
errors add up, as the square of a Gaussian one is. So the squares' largest values in stretches of a sound recording that
exceed their median u are taken to be exponential beyond it (peaks over a threshold with the shape 0: Pickands, Ann.
Stat. 3, 1975). With n of them, of the mean excess B, the probability that the next one exceeds u + x is not
exp(-x / B), which takes B for known, but what is left when B is integrated out (Gamma posterior, prior 1 / B):

    (1 + x / (n B))^-n.

So a short recording asks for a high threshold by itself, and a long one for the exponential's.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.stats import chi

FEWEST = 7
"""Stretches of which a tail is made at least; with three excesses the threshold is a hundred times their mean."""


class Law(Protocol):
    """How often a statistic of a sound robot exceeds a threshold."""

    def threshold(self, per_hour: float) -> float:
        """What it exceeds so often, in times per hour."""
        ...


@dataclass(frozen=True)
class Tail:
    """The law of this module.

    Attributes:
        start: u.
        excess: B.
        count: n.
        rate: how often a stretch exceeds u, per hour.
    """

    start: float
    excess: float
    count: int
    rate: float

    @classmethod
    def of(cls, largest: np.ndarray, seconds: float) -> "Tail":
        """From the largest values (k,) of stretches of so many seconds each, `FEWEST` or more."""
        squares = np.sort(largest**2)
        count = len(squares) // 2
        start = float(np.median(squares))
        return cls(start, float(np.mean(squares[-count:] - start)), count, 1800.0 / seconds)

    def threshold(self, per_hour: float) -> float:
        """See `Law`."""
        rarer = max(self.rate / per_hour, 1.0)
        return float(np.sqrt(self.start + self.excess * self.count * np.expm1(np.log(rarer) / self.count)))


@dataclass(frozen=True)
class Gaussian:
    """Of the root of the sum of `degrees` squares of Gaussian errors, as of a band whose errors nobody measured.

    Attributes:
        looks: how many independent values there are per hour.
        degrees: of freedom.
    """

    looks: float
    degrees: int = 1

    def threshold(self, per_hour: float) -> float:
        """See `Law`."""
        return float(chi(self.degrees).isf(min(per_hour / self.looks, 1.0)))


def largest_of(values: np.ndarray, size: int) -> np.ndarray:
    """(k, m) largest values of stretches of `size` of (n, m) values; what is left over at the end is left out."""
    count = len(values) // size
    return np.asarray(values[: count * size].reshape(count, size, -1).max(axis=1))
