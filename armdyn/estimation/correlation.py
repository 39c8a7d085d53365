"""Autocorrelation of residuals: how many independent samples there are among correlated ones."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

INDEPENDENT_STRETCH_SECONDS = 2.0
"""Length of a stretch of a robot's motion, s, whose errors are independent of the next one's: servos react far faster,
and so do friction and momentum residuals."""


def lagged_products(residuals: Iterable[np.ndarray], lags: int) -> np.ndarray:
    """(lags + 1,) sums of products of residuals that are 0, 1, ... samples apart.

    Args:
        residuals: stretches (n,) of the residual; no product spans two stretches.
        lags: largest distance, in samples.
    """
    products = np.zeros(lags + 1)
    for residual in residuals:
        for k in range(min(lags + 1, len(residual))):
            products[k] += float(residual[k:] @ residual[: len(residual) - k])
    return products


def autocorrelations(
    residuals: Sequence[np.ndarray], most_lags: int | None = None, least: float = 0.0, stride: int = 1
) -> Iterator[tuple[int, float]]:
    """Lags, in samples, and the autocorrelation at each, up to the first that is not above `least`.

    Args:
        residuals: stretches (n,) of the residual; no product spans two stretches.
        most_lags: largest lag, which is left out; None means that of the longest stretch.
        least: autocorrelation that ends them: those of few samples are never exactly zero.
        stride: interval between the lags.
    """
    power = sum(float(residual @ residual) for residual in residuals)
    longest = max(len(residual) for residual in residuals) - 1
    for lag in range(stride, longest if most_lags is None else min(most_lags, longest), stride):
        share = sum(float(r[lag:] @ r[:-lag]) for r in residuals if len(r) > lag) / power if power else 0.0
        if share <= least:
            return
        yield lag, share


def correlation_time(
    residuals: Sequence[np.ndarray], most_lags: int | None = None, least: float = 0.0, stride: int = 1
) -> float:
    """Correlation time of a residual, in samples, at least 1.

    It is 1 + twice the sum of the autocorrelations up to the first that is not above `least`. The mean of N samples
    with correlation time tau is as uncertain as the mean of N / tau independent samples (Bayley & Hammersley, J. R.
    Stat. Soc. Suppl. 8, 1946).

    Args:
        residuals: stretches (n,) of the residual.
        most_lags: largest number of lags that count; None means all.
        least: autocorrelation that ends the sum.
        stride: interval between the lags that are evaluated; each represents its neighbours.
    """
    return sum((2.0 * stride * share for _, share in autocorrelations(residuals, most_lags, least, stride)), start=1.0)
