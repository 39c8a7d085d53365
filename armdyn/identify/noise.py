"""Test whether a residual is white, and whiten one that is not."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from armdyn.identify.problem import Block, by_channel
from armdyn.linear.correlation import correlation_time, lagged_products

WHITENESS_LAGS = 20
"""Lags of the whiteness test."""
MAX_AUTOREGRESSION_ORDER = 4
"""Highest order of the autoregression that whitens coloured noise."""
MAX_CORRELATION_LAGS = 50
"""Largest number of lags that count in the variance of a mean."""


def ljung_box(residual: np.ndarray, lags: int = WHITENESS_LAGS) -> float:
    """Probability that white noise is as correlated as (n,) `residual` (Ljung & Box, Biometrika 65, 1978)."""
    n = len(residual)
    lags = min(lags, n // 5)
    if lags < 1:
        return 1.0
    products = lagged_products([residual - residual.mean()], lags)
    rho = products[1:] / products[0] if products[0] > 0.0 else np.zeros(lags)
    q = n * (n + 2) * float(np.sum(rho**2 / (n - np.arange(1, lags + 1))))
    return float(chdtrc(lags, q))


def variance_inflation(residuals: Sequence[np.ndarray]) -> float:
    """Factor by which a correlated residual, in units of the noise, widens the variance of a mean over white noise.

    It is chi2/N (1 + 2 sum of the autocorrelations up to the first that is not positive) (Bayley & Hammersley, J. R.
    Stat. Soc. 1946). It is below 1 where the stated noise is too large.
    """
    power = sum(float(residual @ residual) for residual in residuals)
    samples = sum(len(residual) for residual in residuals)
    if power == 0.0 or samples == 0:
        return 0.0
    return power / samples * correlation_time(residuals, MAX_CORRELATION_LAGS)


def autoregression(residuals: Sequence[np.ndarray], order: int = MAX_AUTOREGRESSION_ORDER) -> np.ndarray:
    """(order,) coefficients of e_t = sum a_k e_{t-k} + white, by Yule-Walker over several stretches.

    Yule-Walker's estimate is always stable (Box, Jenkins & Reinsel, Time Series Analysis, §7.3).
    """
    products = lagged_products(residuals, order)
    if products[0] <= 0.0:
        return np.zeros(order)
    index = np.abs(np.subtract.outer(np.arange(order), np.arange(order)))
    matrix = products[index] + 1e-9 * products[0] * np.eye(order)
    return np.linalg.solve(matrix, products[1:])


def likeliest_autoregression(residuals: Sequence[np.ndarray]) -> np.ndarray:
    """Coefficients (0 to `MAX_AUTOREGRESSION_ORDER`,) of the autoregression with the lowest BIC.

    Superfluous coefficients misjudge short runs: the sum of four of them over 60 white samples is wrong by 0.25, and
    every standard deviation of a constant with it.
    """
    samples = sum(len(residual) for residual in residuals)
    best, lowest = np.zeros(0), np.inf
    for order in range(MAX_AUTOREGRESSION_ORDER + 1):
        coefficients = autoregression(residuals, order) if order else np.zeros(0)
        left = np.concatenate([whitened(residual, coefficients) for residual in residuals])
        variance = max(float(np.mean(left**2)), np.finfo(float).tiny)
        bic = samples * np.log(variance) + order * np.log(samples)
        if bic < lowest:
            best, lowest = coefficients, bic
    return best


def whitened(rows: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """(n, ...) rows filtered by 1 - sum a_k z^-k; the first rows, whose past is unknown, are left out."""
    order = len(coefficients)
    if len(rows) <= order:
        return rows
    result = rows[order:].copy()
    for k, a in enumerate(coefficients, start=1):
        result -= a * rows[order - k : len(rows) - k]
    return result


@dataclass(frozen=True, eq=False)
class Whitening:
    """Filter that makes the residual of a channel white, with variance one.

    Attributes:
        coefficients: coefficients of the autoregression.
        std: standard deviation of the filtered residual, in units of the noise.
    """

    coefficients: np.ndarray
    std: float

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        """Filter (n, ...) rows and divide them by the noise; see `whitened`."""
        return whitened(rows, self.coefficients) / self.std


def whitening(blocks: Sequence[Block]) -> dict[str, Whitening]:
    """Whitening filters by channel, estimated from the residuals of a fit."""
    found = {}
    for channel, mine in by_channel(blocks).items():
        stretches = [block.residual for block in mine]
        coefficients = likeliest_autoregression(stretches)
        left = np.concatenate([whitened(stretch, coefficients) for stretch in stretches])
        found[channel] = Whitening(coefficients, float(np.sqrt(np.mean(left**2))))
    return found
