"""The part of a residual that repeats itself where the motion is the same: an error of the model.

Noise does not repeat itself, whether it is white, coloured or quantised; what a model lacks does. For each quantity on
which a torque may depend, the mean residual by bins of this quantity is learnt from some samples and subtracted from
others. What this removes of their squared residual is structure (cross-validation: Stone, J. R. Stat. Soc. B 36, 1974).
"""

from collections.abc import Sequence

import numpy as np

from armdyn.estimation.correlation import correlation_time
from armdyn.identify.fit import Fit

BIN_COUNT = 20
"""Number of bins of a quantity, with as many samples each."""
STRETCH_COUNT = 10
"""Number of stretches into which a run is cut where there is no other one; every second one is learnt."""
CHANCE_STDS = 3.0
"""Standard deviations within which what the bins of the best of some twenty quantities remove is chance."""


def repeated_square(channel: str, learnt: Sequence[Fit], others: Sequence[Fit]) -> float:
    """Reproducible part of a channel's mean squared residual, which other runs show again, in its squared unit.

    Args:
        channel: the channel of a joint's torque.
        learnt: fits of the runs from which the mean residual is learnt.
        others: predictions of other runs; where there are none, every second stretch of a run is predicted from the
            rest.
    """
    names, here = _samples(channel, learnt)
    if others:
        there = _samples(channel, others)[1]
    else:
        odd = np.arange(len(here)) * STRETCH_COUNT // max(len(here), 1) % 2 == 1
        here, there = here[~odd], here[odd]
    if not (len(here) and len(there)):
        return 0.0
    found = max(_removed(here[:, i], here[:, -1], there[:, i], there[:, -1]) for i in range(len(names)))
    return max(found - _removed_by_chance(here[:, -1], there[:, -1]), 0.0)


def _samples(channel: str, fits: Sequence[Fit]) -> tuple[list[str], np.ndarray]:
    """Names of m quantities, and (n, m + 1) samples of them and, last, of the residual of one channel."""
    joint, rows, names = channel.partition(".")[2], list[np.ndarray](), list[str]()
    for fit in fits:
        signals = fit.covariates()
        for block in fit.blocks:
            if block.channel == channel:
                found = {name: block.interpolate(signal) for name, signal in signals[block.run].items()}
                place = found.get(f"q.{joint}")
                products = {
                    n: v * (place - np.mean(place)) for n, v in found.items() if place is not None and n[0] == "v"
                }
                found |= {f"{name} q": value for name, value in products.items()}
                names = list(found)
                rows.append(np.column_stack([*found.values(), block.misfit]))
    return names, np.vstack(rows) if rows else np.zeros((0, 1))


def _removed(x: np.ndarray, residual: np.ndarray, other: np.ndarray, left: np.ndarray) -> float:
    """Mean square that the mean of `residual` (n,) by bins of `x` (n,) removes of `left` (m,) at `other` (m,)."""
    edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, BIN_COUNT + 1)[1:-1]))
    place = np.digitize(x, edges)
    count = np.bincount(place, minlength=len(edges) + 1)
    mean = np.bincount(place, weights=residual, minlength=len(edges) + 1) / np.maximum(count, 1)
    return max(float(np.mean(left**2) - np.mean((left - mean[np.digitize(other, edges)]) ** 2)), 0.0)


def _removed_by_chance(residual: np.ndarray, left: np.ndarray) -> float:
    """Mean square that bins with noise (n,) may remove of noise (m,): `CHANCE_STDS` deviations above the expectation.

    With B bins and n', m' independent samples, the share removed has the expectation -B / n' and the variance
    4 B / (n' m') + 2 B / n'^2.
    """
    time = correlation_time([residual - residual.mean()], len(residual) // 4)
    n, m = len(residual) / time, len(left) / time
    share = CHANCE_STDS * np.sqrt(4.0 * BIN_COUNT / (n * m) + 2.0 * BIN_COUNT / n**2) - BIN_COUNT / n
    return float(max(share, 0.0) * np.mean(left**2))
