"""Search for thresholds of absent effects: values on which nothing depends while their effect is at null.

A tank that never overflows contains no sign of its edge: while the effect is at its null value, the derivative with
respect to its threshold is zero, and no descent finds it. For a given threshold, however, the predictions are linear in
the size of the effect. So thresholds over a wide range are tried, and the evidence of the size alone is compared;
afterwards the threshold is an unknown like any other, and counts as one.
"""

from collections.abc import Callable

import numpy as np

PLACE_RANGE_SIZES, PLACES_TRIED = 10.0, 21
"""Distance to either side of the declared threshold, in typical sizes, and number of thresholds tried there, evenly."""
PLACE_HALVINGS = 3
"""Number of times that the distance between tried thresholds is halved around the best one; a descent continues from
there."""
EQUAL_PLACE_NATS = 1e-6
"""Smallest difference of log evidence, nats, between thresholds that have any influence."""


def likeliest(
    evidence: Callable[[np.ndarray], np.ndarray],
    declared: np.ndarray,
    typical: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
) -> np.ndarray:
    """(n,) likeliest thresholds of n effects, each by itself; of equal ones the next to the declared one.

    Args:
        evidence: (n,) log evidence at (n,) thresholds, nats; minus infinity where there is none.
        declared: (n,) thresholds in the middle of the range.
        typical: (n,) typical sizes.
        lower: (n,) lower bounds.
        upper: (n,) upper bounds.

    Returns:
        (n,) thresholds, NaN where they have no influence.
    """
    step = 2.0 * PLACE_RANGE_SIZES / (PLACES_TRIED - 1) * typical
    tried, found = list[np.ndarray](), list[np.ndarray]()

    def attempt(at: np.ndarray) -> None:
        tried.append(np.clip(at, lower, upper))
        found.append(evidence(tried[-1]))

    def best() -> np.ndarray:
        at, worth = np.array(tried), np.array(found)
        away = np.where(worth == worth.max(axis=0), np.abs(at - declared), np.inf)
        return np.take_along_axis(at, away.argmin(axis=0)[None], axis=0)[0]

    for k in np.arange(PLACES_TRIED) - PLACES_TRIED // 2:
        attempt(declared + k * step)
    worth = np.array(found)
    with np.errstate(invalid="ignore"):
        matters = worth.max(axis=0) - worth.min(axis=0) > EQUAL_PLACE_NATS
    for _ in range(PLACE_HALVINGS if matters.any() else 0):
        step, around = 0.5 * step, best()
        attempt(around - step)
        attempt(around + step)
    return np.where(matters, best(), np.nan)
