r"""Compute thresholds for a rate of false alarms, by extrapolation of the largest values without a fault.

A fault-free recording is cut into stretches. Of their largest values, those above the median u are exponential beyond
u, as for a density with an exponential tail (peaks over a threshold with shape 0: Pickands, Ann. Stat. 3, 1975). The
model's error at one instant comes in bursts and has such a tail; the root of a sum of squares over many instants is
nearly Gaussian, so that its square has one. For n peaks of mean excess B, the probability that the next peak exceeds
u + x would be exp(-x / B) if B were the true mean. With B integrated out (Gamma posterior, prior 1 / B) it is

    (1 + x / (n B))^-n.

So a short recording gives a high threshold, and a long one that of the exponential. Peaks that resemble their
neighbours, such as those of a model's error in one posture, are fewer than they seem: n is their number divided by the
correlation time of the largest values.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.stats import chi, norm, rankdata

from armdyn.estimation.correlation import correlation_time

MIN_STRETCHES_FOR_TAIL = 7
"""Least number of stretches of fault-free recordings from which the tail of the errors is fitted; with three excesses
the threshold is a hundred times their mean."""

MIN_CORRELATION_DEVIATES = 2.0
"""Standard deviations by which a correlation must exceed that of independent values to count."""


class StatisticDistribution(Protocol):
    """Distribution of a statistic of a fault-free robot, which gives thresholds."""

    def threshold(self, per_hour: float) -> float:
        """Threshold that the statistic exceeds `per_hour` times per hour."""
        ...


@dataclass(frozen=True)
class ExponentialTail:
    """Exponential tail of a distribution; its equation is at the top of this module.

    Attributes:
        start: u, in the statistic's unit to the `power`.
        excess: B, in the same unit.
        count: n.
        rate: stretches per hour that exceed u.
        power: power of the statistic that has an exponential tail, 1 or 2.
    """

    start: float
    excess: float
    count: float
    rate: float
    power: int

    @classmethod
    def of(cls, largest: np.ndarray, seconds: float, power: int) -> "ExponentialTail":
        """Fitted to the maxima (k,) of k >= `MIN_STRETCHES_FOR_TAIL` stretches of `seconds`; for `power` see above."""
        values = largest**power
        level = norm.ppf((rankdata(values) - 0.5) / len(values))
        alike = correlation_time([level], least=MIN_CORRELATION_DEVIATES / np.sqrt(len(values)))
        values = np.sort(values)
        count = len(values) // 2
        start = float(np.median(values))
        return cls(start, float(np.mean(values[-count:] - start)), max(count / alike, 1.0), 1800.0 / seconds, power)

    @classmethod
    def of_rare(cls, largest: np.ndarray, seconds: float, power: int) -> "ExponentialTail":
        """As `of`, for a statistic that is 0 in stretches where it does not exist; infinite if it hardly ever does."""
        values = largest[largest > 0.0]
        if len(values) < MIN_STRETCHES_FOR_TAIL:
            return cls(np.inf, 0.0, 1, 1.0, power)
        return cls.of(values, seconds * len(largest) / len(values), power)

    def threshold(self, per_hour: float) -> float:
        """Threshold that the statistic exceeds `per_hour` times per hour on a fault-free robot."""
        rarer = max(self.rate / per_hour, 1.0)
        beyond = self.excess * self.count * float(np.expm1(np.log(rarer) / self.count))
        return float((self.start + beyond) ** (1.0 / self.power))


@dataclass(frozen=True)
class GaussianDistribution:
    """Distribution of the root of the sum of `degrees` squared unit Gaussian errors; used without calibration.

    Attributes:
        values: independent values per hour.
        degrees: degrees of freedom.
    """

    values: float
    degrees: int = 1

    def threshold(self, per_hour: float) -> float:
        """Threshold that the statistic exceeds `per_hour` times per hour on a fault-free robot."""
        return float(chi(self.degrees).isf(min(per_hour / self.values, 1.0)))


def block_maxima(values: np.ndarray, size: int) -> np.ndarray:
    """(k, m) largest of (n, m) values in each of k successive stretches of `size` values."""
    count = len(values) // size
    return np.asarray(values[: count * size].reshape(count, size, -1).max(axis=1))
