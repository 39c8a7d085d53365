"""One parameter of one robot over time, and the scatter of its values from recording to recording.

A fit's own standard deviation is rarely all of the scatter: two kinds of motion give two values where the model is not
exact. So the scatter is estimated from the series itself.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.stats import norm

from armdyn.recording.channels import FloatArray

MIN_RECORDINGS_PER_SIDE_OF_STEP = 4
"""Smallest number of recordings before and after a step: fewer may be a temporary disturbance."""
MIN_SERIES_RECORDINGS = 10
"""Smallest number of recordings of a series that is tested."""
EQUAL_VALUES_RELATIVE_SPREAD = 1e-12
"""Relative spread below which all values of a series count as equal."""
SCATTER_QUANTILE = 0.8
"""Quantile of the distances from a median that gives the scatter: a fifth of the recordings may be outliers."""
NORMAL_SCATTER_QUANTILE = float(norm.ppf(0.5 + 0.5 * SCATTER_QUANTILE))
"""This quantile of normally distributed distances with a standard deviation of one."""
OUTLIER_STANDARD_DEVIATIONS = 3.0
"""Distance, in its standard deviations, up to which two values count as about the same."""


@dataclass(frozen=True)
class ParameterSeries:
    """Fitted values of one parameter of one robot, from n recordings.

    Attributes:
        time: times of the recordings, not decreasing, (n,) [s].
        value: values in the parameter's unit, (n,).
        std: standard deviations of the values, (n,); None if all are equally certain.
    """

    time: FloatArray
    value: FloatArray
    std: FloatArray | None = None

    def section(self, first: int, end: int) -> "ParameterSeries":
        """The series of the recordings with indices from `first` to before `end`."""
        std = None if self.std is None else self.std[first:end]
        return ParameterSeries(self.time[first:end], self.value[first:end], std)

    @property
    def testable(self) -> bool:
        """Whether the series is long enough for a step, and neither its values nor its times are all equal."""
        return bool(
            len(self.value) >= MIN_SERIES_RECORDINGS
            and self.time[-1] > self.time[0]
            and np.ptp(self.value) > EQUAL_VALUES_RELATIVE_SPREAD * np.abs(self.value).max()
            and len(self.splits()) > 0
        )

    @property
    def centred_time(self) -> FloatArray:
        """Times (n,) with a mean of zero and a range of one."""
        return np.asarray((self.time - self.time.mean()) / np.ptp(self.time))

    def splits(self) -> np.ndarray:
        """Index of the first recording after each possible step, (k,)."""
        count = len(self.value)
        places = np.arange(MIN_RECORDINGS_PER_SIDE_OF_STEP, count - MIN_RECORDINGS_PER_SIDE_OF_STEP + 1)
        return np.asarray(places[self.time[places] > self.time[places - 1]])

    def scale(self) -> FloatArray:
        """Standard deviation of each value, (n,), the scatter of the series about its median included."""
        off = self.value - np.median(self.value)
        own = np.zeros_like(off) if self.std is None else self.std
        size = np.abs(off)
        tiny = EQUAL_VALUES_RELATIVE_SPREAD * float(size.max()) + 1e-300

        def too_large(more: float) -> float:
            scaled = size / np.sqrt(own**2 + more**2 + tiny**2)
            return float(np.quantile(scaled, SCATTER_QUANTILE)) - NORMAL_SCATTER_QUANTILE

        more = brentq(too_large, 0.0, float(size.max())) if too_large(0.0) > 0.0 else 0.0
        return np.sqrt(own**2 + more**2 + tiny**2)

    def outliers(self) -> np.ndarray:
        """Which recordings are outliers, (n,) bool: fewer than a step needs on each side have about the same value.

        This does not depend on the order of the recordings: from its neighbours in time a recording of another kind of
        motion looks like an outlier, and without such outliers kinds in a random order look like a step.
        """
        scale = self.scale()
        apart = np.abs(self.value[:, None] - self.value) / np.hypot(scale[:, None], scale)
        alike = np.sum(apart <= OUTLIER_STANDARD_DEVIATIONS, axis=1)  # itself included
        return np.asarray(alike < MIN_RECORDINGS_PER_SIDE_OF_STEP)


def medians_of_five(values: FloatArray) -> FloatArray:
    """Median of each value of m series (m, n) and of two on each side, (m, n)."""
    padded = np.concatenate([values[:, 2:0:-1], values, values[:, -2:-4:-1]], axis=1)
    count = values.shape[1]
    a, b, c, d, e = (padded[:, k : k + count] for k in range(5))
    a, b, c, d = np.minimum(a, b), np.maximum(a, b), np.minimum(c, d), np.maximum(c, d)
    low, high = np.maximum(a, c), np.minimum(b, d)  # the median of five is that of these two and the fifth
    return np.maximum(np.minimum(low, high), np.minimum(np.maximum(low, high), e))
