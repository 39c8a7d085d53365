"""Test whether a residual is white noise, and whiten a residual that is correlated in time."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from armdyn.estimation.correlation import correlation_time, lagged_products
from armdyn.estimation.solve import solve_positive
from armdyn.identify.residual.block import ResidualBlock, blocks_by_channel

WHITENESS_LAGS = 20
"""Number of lags, in samples, that the whiteness test uses."""
MAX_AUTOREGRESSION_ORDER = 4
"""Highest order of the autoregression that whitens coloured noise."""
MAX_LAGS_IN_VARIANCE_OF_MEAN = 50
"""Largest number of lags, in samples, whose autocorrelation counts in the variance of a mean."""


def ljung_box(residual: np.ndarray) -> float:
    """Probability that white noise is at least as correlated as a residual (n,) (Ljung & Box, Biometrika 65, 1978)."""
    n = len(residual)
    lags = min(WHITENESS_LAGS, n // 5)
    if lags < 1:
        return 1.0
    products = lagged_products([residual - residual.mean()], lags)
    rho = products[1:] / products[0] if products[0] > 0.0 else np.zeros(lags)
    q = n * (n + 2) * float(np.sum(rho**2 / (n - np.arange(1, lags + 1))))
    return float(chdtrc(lags, q))


def variance_inflation(residuals: Sequence[np.ndarray]) -> float:
    """Factor by which the variance of a mean grows because a residual is not white noise of variance one.

    It is chi2/N (1 + 2 sum of the autocorrelations up to the first that is not positive) (Bayley & Hammersley, J. R.
    Stat. Soc. 1946); below 1 where the assumed noise is too large.

    Args:
        residuals: stretches (n,) of the residual, in units of the assumed noise.
    """
    power = sum(float(residual @ residual) for residual in residuals)
    samples = sum(len(residual) for residual in residuals)
    if power == 0.0 or samples == 0:
        return 0.0
    return power / samples * correlation_time(residuals, MAX_LAGS_IN_VARIANCE_OF_MEAN)


def autoregression(residuals: Sequence[np.ndarray], order: int = MAX_AUTOREGRESSION_ORDER) -> np.ndarray:
    """(order,) coefficients a_k of the autoregression e_t = sum_k a_k e_{t-k} + white noise, from several stretches e.

    They are the Yule-Walker estimate, which is always stable (Box, Jenkins & Reinsel, Time Series Analysis, §7.3).
    """
    products = lagged_products(residuals, order)
    if products[0] <= 0.0:
        return np.zeros(order)
    index = np.abs(np.subtract.outer(np.arange(order), np.arange(order)))
    matrix = products[index] + 1e-9 * products[0] * np.eye(order)
    return solve_positive(matrix, products[1:])


def likeliest_autoregression(residuals: Sequence[np.ndarray]) -> np.ndarray:
    """Coefficients of the autoregression with the lowest BIC, of an order from 0 to `MAX_AUTOREGRESSION_ORDER`.

    Superfluous coefficients are harmful for short runs: from 60 white samples the sum of four coefficients is wrong by
    0.25, and with it the standard deviation of a constant.
    """
    samples = sum(len(residual) for residual in residuals)
    best, lowest = np.zeros(0), np.inf
    for order in range(MAX_AUTOREGRESSION_ORDER + 1):
        coefficients = autoregression(residuals, order) if order else np.zeros(0)
        left = np.concatenate([whiten(residual, coefficients) for residual in residuals])
        variance = max(float(np.mean(left**2)), np.finfo(float).tiny)
        bic = samples * np.log(variance) + order * np.log(samples)
        if bic < lowest:
            best, lowest = coefficients, bic
    return best


def whiten(rows: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Whiten (n, ...) samples: subtract from each what an autoregression predicts from the samples before it.

    The first samples, as many as there are coefficients, are left out.
    """
    order = len(coefficients)
    if len(rows) <= order:
        return rows
    result = rows[order:].copy()
    for k, a in enumerate(coefficients, start=1):
        result -= a * rows[order - k : len(rows) - k]
    return result


@dataclass(frozen=True, eq=False)
class WhiteningFilter:
    """Filter that turns the residual of a channel into white noise of variance one.

    Attributes:
        coefficients: coefficients of the autoregression.
        std: standard deviation of the residual after the autoregression, in units of the assumed noise.
    """

    coefficients: np.ndarray
    std: float

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        """Whiten (n, ...) samples and scale them to variance one; see `whiten`."""
        return whiten(rows, self.coefficients) / self.std


def whitening_filters(blocks: Sequence[ResidualBlock]) -> dict[str, WhiteningFilter]:
    """Estimate whitening filters, by channel, from the residuals of a fit."""
    found = {}
    for channel, mine in blocks_by_channel(blocks).items():
        stretches = [block.residual for block in mine]
        coefficients = likeliest_autoregression(stretches)
        left = np.concatenate([whiten(stretch, coefficients) for stretch in stretches])
        found[channel] = WhiteningFilter(coefficients, float(np.sqrt(np.mean(left**2))))
    return found
