"""Estimate the noise of a channel, test whether a residual is white, and whiten one that is not."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from armdyn.identify.problem import Block, by_channel
from armdyn.recording.channels import Channel
from armdyn.recording.differences import normalised_differences, quiet_std

WHITENESS_LAGS = 20
"""Lags of the whiteness test."""
DIFFERENCE_ORDERS = tuple(range(3, 9))
"""Orders of the differences from which the noise is estimated."""
MAX_SIGNAL_RATIO = 0.9
"""Ratio of the noise estimates of two successive orders below which the lower order contains the signal. For noise with
a correlation of 0.9 from sample to sample the ratio is 0.96; for a swing of 0.8 Hz at 20 Hz, a hundred times the noise,
it is 0.3."""
MAX_AUTOREGRESSION_ORDER = 4
"""Highest order of the autoregression that whitens coloured noise."""
MIN_NOISE_SHARE = 0.1
"""Least noise of a channel, as a share of its stated noise: an encoder at rest shows none."""
MAX_CORRELATION_LAGS = 50
"""Largest number of lags that count in the variance of a mean."""


NO_JUMPS = np.zeros(0)


def white_noise_std(time: np.ndarray, value: np.ndarray, jumps: np.ndarray = NO_JUMPS) -> float:
    """Standard deviation of white noise on smooth samples, from their differences of order 3 or higher.

    The divided difference of order k at any stamps removes every polynomial of lower degree; over sqrt(sum w^2) of its
    weights the variance of the result is that of the noise. A fast signal at a low rate is no parabola over four
    samples: as long as the next order gives a clearly smaller value, the difference contains the signal. For coloured
    noise the result is too small.

    Args:
        time: (n,) time stamps, s.
        value: (n,) samples.
        jumps: (j,) times, s, ascending, at which the signal itself may jump: differences across them are left out,
            unless all are.

    Returns:
        The standard deviation, in the unit of `value`; 0 where there are fewer than eight samples without a gap.
    """
    lowest, *higher = (_difference_std(time, value, order, jumps) for order in DIFFERENCE_ORDERS)
    for std in higher:
        if std is None or lowest is None or std > MAX_SIGNAL_RATIO * lowest:
            break
        lowest = std
    return lowest or 0.0


def _difference_std(time: np.ndarray, value: np.ndarray, order: int, jumps: np.ndarray) -> float | None:
    """Root mean square of the normalised differences of one order; None where there are fewer than five."""
    if len(value) < max(8, order + 5):
        return None
    differences = normalised_differences(time, value, order)
    whole, before = np.isfinite(differences), np.searchsorted(jumps, time, side="right")
    smooth = whole & (before[order:] == before[: len(before) - order])
    whole = differences[smooth if smooth.sum() >= 5 else whole]
    return float(np.sqrt(np.mean(whole**2))) if len(whole) >= 5 else None


def quiet_noise(channel: Channel, noise: float) -> float:
    """Smallest white noise that a channel can have, from its third differences; a few glitches do not change it.

    Args:
        channel: its samples.
        noise: noise as stated or estimated otherwise; an upper limit of the result.
    """
    return max(min(noise, quiet_std(channel.time, channel.value, unknown=noise)), MIN_NOISE_SHARE * noise)


def lagged_products(residuals: Iterable[np.ndarray], lags: int) -> np.ndarray:
    """(lags + 1,) sums of the products of samples that are 0, 1, ... apart, over stretches (n,)."""
    products = np.zeros(lags + 1)
    for residual in residuals:
        for k in range(min(lags + 1, len(residual))):
            products[k] += float(residual[k:] @ residual[: len(residual) - k])
    return products


def correlation_time(residuals: Sequence[np.ndarray], most_lags: int | None = None) -> float:
    """1 + twice the sum of the autocorrelations up to the first that is not positive, in samples; at least 1.

    The mean of N samples with that correlation time is as uncertain as the mean of N over it independent samples
    (Bayley & Hammersley, J. R. Stat. Soc. Suppl. 8, 1946).

    Args:
        residuals: stretches (n,) of the residual.
        most_lags: largest number of lags that count; None means all.
    """
    power = sum(float(residual @ residual) for residual in residuals)
    if power == 0.0:
        return 1.0
    longest = max(len(residual) for residual in residuals) - 1
    total = 1.0
    for lag in range(1, longest if most_lags is None else min(most_lags, longest)):
        products = sum(float(r[lag:] @ r[:-lag]) for r in residuals if len(r) > lag)
        if products <= 0.0:
            break
        total += 2.0 * products / power
    return total


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
