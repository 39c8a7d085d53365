"""Search for start values of thresholds: parameters such as the position of a stop at which an effect begins.

While the effect is at its null value, the derivative of every prediction with respect to its threshold is zero, so that
no gradient leads to the threshold. For a given threshold, however, the predictions are linear in the size of the
effect. So thresholds over a wide range are tried, and the evidence of the effect's size is compared. Afterwards the
threshold is fitted like any other parameter.
"""

from collections.abc import Callable

import numpy as np

THRESHOLD_RANGE_TYPICAL_SIZES, TRIED_THRESHOLD_COUNT = 10.0, 21
"""Largest distance of a tried threshold from the declared one, in typical sizes, and number of thresholds tried."""
THRESHOLD_HALVINGS = 3
"""Number of times that the distance between tried thresholds is halved around the best one, before a fit starts from
it."""
MIN_THRESHOLD_EVIDENCE_NATS = 1e-6
"""Range of the log evidence over the tried thresholds, nats, up to which the threshold has no influence."""


def likeliest_thresholds(
    evidence: Callable[[np.ndarray], np.ndarray],
    declared: np.ndarray,
    typical: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
) -> np.ndarray:
    """Find the likeliest thresholds of n effects, each independently of the others.

    Args:
        evidence: function from (n,) thresholds to their (n,) log evidence, nats; minus infinity where there is none.
        declared: (n,) thresholds in the middle of the tried range; of equally likely ones the nearest is taken.
        typical: (n,) typical sizes of the thresholds.
        lower: (n,) lower bounds.
        upper: (n,) upper bounds.

    Returns:
        (n,) thresholds, NaN where they have no influence.
    """
    step = 2.0 * THRESHOLD_RANGE_TYPICAL_SIZES / (TRIED_THRESHOLD_COUNT - 1) * typical
    tried, found = list[np.ndarray](), list[np.ndarray]()

    def attempt(at: np.ndarray) -> None:
        tried.append(np.clip(at, lower, upper))
        found.append(evidence(tried[-1]))

    def best() -> np.ndarray:
        at, worth = np.array(tried), np.array(found)
        away = np.where(worth == worth.max(axis=0), np.abs(at - declared), np.inf)
        return np.take_along_axis(at, away.argmin(axis=0)[None], axis=0)[0]

    for k in np.arange(TRIED_THRESHOLD_COUNT) - TRIED_THRESHOLD_COUNT // 2:
        attempt(declared + k * step)
    worth = np.array(found)
    with np.errstate(invalid="ignore"):
        matters = worth.max(axis=0) - worth.min(axis=0) > MIN_THRESHOLD_EVIDENCE_NATS
    for _ in range(THRESHOLD_HALVINGS if matters.any() else 0):
        step, around = 0.5 * step, best()
        attempt(around - step)
        attempt(around + step)
    return np.where(matters, best(), np.nan)
