"""Values over time and the bounds that they must keep."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.motion.trajectory import read_only

TOLERANCE = 1e-6
"""Share of a limit by which a value may be beyond it: rounding of a recording with seven digits."""

SMALL = 1e-3
"""Size of a bound below which rounding no longer shrinks with it, in the bound's unit."""

APART = 0.05
"""Time for which a limit must be kept between two violations, to count them as two [s]."""


@dataclass(frozen=True)
class Bounded:
    """One kind of limit: a value per time and joint, and its bounds.

    Attributes:
        limit: what is limited, such as ``"velocity"``.
        unit: SI unit of values and bounds.
        names: of the k columns: joints or parts.
        time: (n,) [s].
        value: (n, k).
        lower: lower bounds, (k,) or (n, k); -inf for none.
        upper: upper bounds, (k,) or (n, k); inf for none.
    """

    limit: str
    unit: str
    names: tuple[str, ...]
    time: NDArray[np.float64]
    value: NDArray[np.float64]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]

    @classmethod
    def between(
        cls,
        limit: str,
        unit: str,
        names: tuple[str, ...],
        time: ArrayLike,
        value: ArrayLike,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
    ) -> Bounded:
        """Values with bounds of any shape that fits; a value per time (n,) is one column."""
        values = np.array(value, dtype=float).reshape(-1, len(names))
        bounds = [np.broadcast_to(np.asarray(bound, dtype=float), values.shape) for bound in (lower, upper)]
        return cls(limit, unit, names, *map(read_only, (np.array(time, dtype=float), values, *bounds)))

    @property
    def margin(self) -> NDArray[np.float64]:
        """Distance from the nearer bound, negative beyond it (n, k)."""
        return np.minimum(self.value - self.lower, self.upper - self.value)

    def bound(self, i: int, k: int) -> float:
        """The nearer bound of sample `i`, column `k`."""
        lower, upper, value = (float(array[i, k]) for array in (self.lower, self.upper, self.value))
        return lower if value - lower < upper - value else upper

    def used(self, i: int, k: int) -> float:
        """Share of the limit that sample `i`, column `k` uses: 1 at the bound [1]."""
        lower, upper, value = (float(array[i, k]) for array in (self.lower, self.upper, self.value))
        if np.isfinite(lower) and np.isfinite(upper):
            middle, half = (lower + upper) / 2.0, (upper - lower) / 2.0
            return abs(value - middle) / half if half > 0.0 else float(value != middle)
        if not np.isfinite(lower) and not np.isfinite(upper):
            return 0.0
        if np.isfinite(upper):
            return value / upper if upper > 0.0 else float(value > upper)
        # With a lower bound alone, using the limit up means coming down to it.
        return lower / value if value > max(lower, 0.0) else 1.0 + max(lower - value, 0.0)

    @property
    def is_two_sided(self) -> bool:
        """Whether every value is bounded from below and above."""
        return bool(np.all(np.isfinite(self.lower)) and np.all(np.isfinite(self.upper)))

    def shares(self) -> NDArray[np.float64]:
        """Shares of two-sided limits that are used, counted from the middle (n, k) [1]."""
        middle, half = (self.lower + self.upper) / 2.0, (self.upper - self.lower) / 2.0
        return np.abs(self.value - middle) / np.maximum(half, np.finfo(float).tiny)

    def closest(self) -> list[tuple[int, int]]:
        """Sample and column where each column comes closest to a bound; columns without bounds are left out."""
        margin = self.margin
        bounded = np.flatnonzero(np.isfinite(margin).any(axis=0))
        return [(int(np.argmin(margin[:, k])), int(k)) for k in bounded]

    def violations(self) -> list[tuple[int, int]]:
        """Sample and column of the worst sample of every stretch beyond a bound; stretches `APART` are two."""
        scale = np.where(np.isfinite(self.lower), np.abs(self.lower), 0.0)
        scale = np.maximum(scale, np.where(np.isfinite(self.upper), np.abs(self.upper), 0.0))
        margin = self.margin
        beyond = margin < -TOLERANCE * np.maximum(scale, SMALL)
        found = []
        for k, column in enumerate(beyond.T):
            samples = np.flatnonzero(column)
            stretches = np.split(samples, np.flatnonzero(np.diff(self.time[samples]) > APART) + 1)
            found += [(int(stretch[np.argmin(margin[stretch, k])]), k) for stretch in stretches if stretch.size]
        return found
