"""Autocorrelation of residuals: how many independent samples there are among correlated ones."""

from collections.abc import Iterable, Sequence

import numpy as np


def lagged_products(residuals: Iterable[np.ndarray], lags: int) -> np.ndarray:
    """(lags + 1,) sums of the products of samples that are 0, 1, ... apart, over stretches (n,)."""
    products = np.zeros(lags + 1)
    for residual in residuals:
        for k in range(min(lags + 1, len(residual))):
            products[k] += float(residual[k:] @ residual[: len(residual) - k])
    return products


def correlation_time(
    residuals: Sequence[np.ndarray], most_lags: int | None = None, least: float = 0.0, stride: int = 1
) -> float:
    """1 + twice the sum of the autocorrelations up to the first that is not above `least`, in samples; at least 1.

    The mean of N samples with that correlation time is as uncertain as the mean of N over it independent samples
    (Bayley & Hammersley, J. R. Stat. Soc. Suppl. 8, 1946).

    Args:
        residuals: stretches (n,) of the residual.
        most_lags: largest number of lags that count; None means all.
        least: autocorrelation that ends the sum: those of few samples are never exactly zero.
        stride: interval between the lags that are evaluated; each represents its neighbours.
    """
    power = sum(float(residual @ residual) for residual in residuals)
    if power == 0.0:
        return 1.0
    longest = max(len(residual) for residual in residuals) - 1
    total = 1.0
    for lag in range(stride, longest if most_lags is None else min(most_lags, longest), stride):
        share = sum(float(r[lag:] @ r[:-lag]) for r in residuals if len(r) > lag) / power
        if share <= least:
            break
        total += 2.0 * stride * share
    return total
