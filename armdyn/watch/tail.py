r"""How often a sound robot's statistic exceeds a threshold: from what was seen, to far beyond it.

The largest values of stretches of a sound recording that exceed their median u are exponential beyond it, as those of a
density with an exponential tail are (peaks over a threshold with the shape 0: Pickands, Ann. Stat. 3, 1975). A model's
error at one instant comes in bouts and is exponential itself; the root of a sum of squares over many instants is nearly
Gaussian, so that its square is. With n peaks of mean excess B, the probability that the next one exceeds u + x is not
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
        """Threshold that the statistic exceeds `per_hour` times an hour."""
        ...


@dataclass(frozen=True)
class Tail:
    """The law of this module.

    Attributes:
        start: u.
        excess: B.
        count: n.
        rate: how often a stretch exceeds u, per hour.
        power: of the statistic that is exponential, 1 or 2.
    """

    start: float
    excess: float
    count: int
    rate: float
    power: int

    @classmethod
    def of(cls, largest: np.ndarray, seconds: float, power: int) -> "Tail":
        """From the largest values (k,) of stretches of so many seconds each, `FEWEST` or more; see `Tail.power`."""
        values = np.sort(largest**power)
        count = len(values) // 2
        start = float(np.median(values))
        return cls(start, float(np.mean(values[-count:] - start)), count, 1800.0 / seconds, power)

    def threshold(self, per_hour: float) -> float:
        """See `Law`."""
        rarer = max(self.rate / per_hour, 1.0)
        beyond = self.excess * self.count * float(np.expm1(np.log(rarer) / self.count))
        return float((self.start + beyond) ** (1.0 / self.power))


@dataclass(frozen=True)
class Gaussian:
    """Of the root of the sum of `degrees` squares of Gaussian errors, as of a band whose errors nobody measured.

    Attributes:
        values: how many independent values there are per hour.
        degrees: of freedom.
    """

    values: float
    degrees: int = 1

    def threshold(self, per_hour: float) -> float:
        """See `Law`."""
        return float(chi(self.degrees).isf(min(per_hour / self.values, 1.0)))


def largest_of(values: np.ndarray, size: int) -> np.ndarray:
    """(k, m) largest values of stretches of `size` of (n, m) values; what is left over at the end is left out."""
    count = len(values) // size
    return np.asarray(values[: count * size].reshape(count, size, -1).max(axis=1))
