"""How noisy a channel is, whether what is left is white, and how to whiten what is not."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from armdyn.identify.problem import Block, by_channel
from armdyn.recording.channels import Channel
from armdyn.recording.differences import normalised_differences, quiet_std

LAGS = 20
"""Lags of the whiteness test."""
ORDERS = tuple(range(3, 9))
"""Of the differences that show the noise."""
CLEARLY_LESS = 0.9
"""Ratio of the noise that two orders show below which the lower one shows the signal. For noise with a correlation of
0.9 from sample to sample the ratio is 0.96; for a swing of 0.8 Hz at 20 Hz, a hundred times the noise, it is 0.3."""
ORDER = 4
"""Highest order of the autoregression that whitens coloured noise."""
FAINTEST = 0.1
"""Share of its stated noise that a channel has at least: an encoder at rest shows none."""
MOST_LAGS = 50
"""Lags that count for the variance of a mean."""


NONE = np.zeros(0)


def white_noise_std(time: np.ndarray, value: np.ndarray, jumps: np.ndarray = NONE) -> float:
    """Standard deviation of white noise on smooth samples, from their differences of order 3 or higher.

    The divided difference of order k at any stamps removes every polynomial of lower degree; over sqrt(sum w^2) of its
    weights it has the variance of the noise. A fast signal at a low rate is no parabola over four samples: as long as
    the next order shows clearly less, it is the signal that is seen. For coloured noise the result is too small.

    Args:
        time: (n,) s.
        value: (n,).
        jumps: (j,) s; times at which the signal itself may jump, ascending: no difference is taken across one, unless
            none were left.

    Returns:
        In the unit of `value`; 0 where there are fewer than eight samples without a gap.
    """
    lowest, *higher = (_difference_std(time, value, order, jumps) for order in ORDERS)
    for std in higher:
        if std is None or lowest is None or std > CLEARLY_LESS * lowest:
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
    """The least that white noise of a channel can be: of its third differences, whose median few glitches change.

    Args:
        channel: its samples.
        noise: as stated or estimated otherwise; the result is at most that.
    """
    return max(min(noise, quiet_std(channel.time, channel.value, unknown=noise)), FAINTEST * noise)


def lagged_products(residuals: Iterable[np.ndarray], lags: int) -> np.ndarray:
    """(lags + 1,) sums over stretches (n,) of the products of samples that are 0, 1, ... apart."""
    products = np.zeros(lags + 1)
    for residual in residuals:
        for k in range(min(lags + 1, len(residual))):
            products[k] += float(residual[k:] @ residual[: len(residual) - k])
    return products


def correlation_time(residuals: Sequence[np.ndarray], most_lags: int | None = None) -> float:
    """1 + twice the sum of the autocorrelations up to the first that is not positive, in samples; at least 1.

    N samples with that correlation time tell a mean as well as N over it independent ones (Bayley & Hammersley, J. R.
    Stat. Soc. Suppl. 8, 1946).

    Args:
        residuals: stretches (n,).
        most_lags: at most so many count; all when None.
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


def ljung_box(residual: np.ndarray, lags: int = LAGS) -> float:
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
    """Factor by which stretches of a residual, in units of the noise, spoil a mean more than white noise would.

    chi2/N (1 + 2 sum of the autocorrelations up to the first that is not positive): the mean of correlated errors has
    that much more variance (Bayley & Hammersley, J. R. Stat. Soc. 1946). It is below 1 where the noise is overstated.
    """
    power = sum(float(residual @ residual) for residual in residuals)
    samples = sum(len(residual) for residual in residuals)
    if power == 0.0 or samples == 0:
        return 0.0
    return power / samples * correlation_time(residuals, MOST_LAGS)


def autoregression(residuals: Sequence[np.ndarray], order: int = ORDER) -> np.ndarray:
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
    """(0 to `ORDER`,) coefficients of the order with the lowest BIC; superfluous ones misjudge short runs.

    The sum of four superfluous coefficients over 60 white samples is wrong by 0.25, and every standard deviation of a
    constant with it.
    """
    samples = sum(len(residual) for residual in residuals)
    best, lowest = np.zeros(0), np.inf
    for order in range(ORDER + 1):
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
    """What makes a channel's residual white, of variance one.

    Attributes:
        coefficients: of the autoregression.
        std: of what it leaves, over the noise.
    """

    coefficients: np.ndarray
    std: float

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        """(n, ...) rows over the noise, filtered; see `whitened`."""
        return whitened(rows, self.coefficients) / self.std


def whitening(blocks: Sequence[Block]) -> dict[str, Whitening]:
    """By channel, from what a fit leaves of it."""
    found = {}
    for channel, mine in by_channel(blocks).items():
        stretches = [block.residual for block in mine]
        coefficients = likeliest_autoregression(stretches)
        left = np.concatenate([whitened(stretch, coefficients) for stretch in stretches])
        found[channel] = Whitening(coefficients, float(np.sqrt(np.mean(left**2))))
    return found
