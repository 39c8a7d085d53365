"""Calibrate a load cell with known weights: take samples with each weight, and fit a line through their means."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from armdyn.errors import InputError, TaskFailedError
from armdyn.recording.units import parse_quantity
from pipeline.loadcell.calibration import Calibration
from pipeline.loadcell.cell import LoadCell
from pipeline.loadcell.faults import LoadCellFault
from pipeline.loadcell.protocol import MAXIMUM_COUNTS, MINIMUM_COUNTS


@dataclass(frozen=True)
class KnownWeight:
    """A known weight for the calibration of a load cell.

    Attributes:
        text: the weight as the user wrote it.
        force: force of the weight [N].
        force_std: standard deviation of the force [N]; 0 if none was given.
    """

    text: str
    force: float
    force_std: float = 0.0


def parse_weights(text: str, gravity: float) -> tuple[KnownWeight, ...]:
    """Parse a list of known weights such as ``"0 g, 100 g, 200 g +/- 0.1 g"``; forces such as ``"1 N"`` are allowed.

    The empty cell (0 g) is the first weight, also if it was not listed. `gravity` is the free-fall acceleration
    [m/s^2].

    Raises:
        InputError: an entry is not a mass or force, or is negative, or there are fewer than two different weights.
    """
    weights = [_parse(part.strip(), gravity) for part in text.split(",") if part.strip()]
    if not weights or weights[0].force > 0.0:
        weights.insert(0, KnownWeight("0 g", 0.0))
    if len({weight.force for weight in weights}) < 2:
        raise InputError(f"--weights '{text}': give at least one weight besides the empty cell, such as '0 g, 200 g'")
    return tuple(weights)


def _parse(text: str, gravity: float) -> KnownWeight:
    for unit, pull in (("kg", gravity), ("N", 1.0)):
        try:
            known = parse_quantity(text, unit)
        except InputError:
            continue
        if known.value < 0.0:
            raise InputError(f"--weights: '{text}' is negative: hang it so that it pulls the way the load will")
        return KnownWeight(text, pull * known.value, pull * (known.std or 0.0))
    raise InputError(f"--weights: '{text}' is neither a mass nor a force: write '100 g', '100 g +/- 0.1 g' or '1 N'")


MIN_SAMPLES_PER_WEIGHT = 40
"""Smallest number of samples per weight."""
SAMPLE_OUTLIER_STANDARD_DEVIATIONS = 5.0
"""Distance from the median, in robust standard deviations, beyond which a sample is left out."""
MAX_OUTLIER_SHARE = 0.1
"""Largest share of samples that may be left out; with more, somebody probably touched the cell."""
DRIFT_TEST_BLOCKS = 10
"""Number of blocks into which the samples of a weight are divided, to detect a drift."""
MAX_BLOCK_TO_SAMPLE_STD_RATIO = 1.5
"""Ratio above which the samples of a weight are correlated.

It compares the standard deviation of the mean, computed from blocks of samples, with that computed from single samples.
Independent samples exceed it once in 60 times.
"""
ROUNDING_STD_COUNTS = 1.0 / math.sqrt(12.0)
"""Standard deviation of rounding [counts]."""


@dataclass(frozen=True)
class WeightMeasurement:
    """The counts of a load cell that were measured with one known weight.

    Attributes:
        weight: known weight on the cell.
        mean: mean of the samples without outliers [counts].
        mean_std: standard deviation of the mean [counts]; larger than noise / sqrt(samples) if the cell drifts.
        noise: standard deviation of one sample [counts].
        samples: number of samples that were used.
        outliers: number of samples that were left out.
    """

    weight: KnownWeight
    mean: float
    mean_std: float
    noise: float
    samples: int
    outliers: int

    @classmethod
    def from_counts(cls, weight: KnownWeight, counts: npt.ArrayLike) -> "WeightMeasurement":
        """Compute the robust mean of the samples of one weight, `counts` (n,), in the order of their arrival.

        Samples farther than `SAMPLE_OUTLIER_STANDARD_DEVIATIONS` robust standard deviations (1.4826 times the median
        absolute deviation) from the median are left out. The standard deviation of the mean is that of independent
        samples, unless the means of `DRIFT_TEST_BLOCKS` successive blocks differ clearly more, because the cell drifts
        or the weight swings.

        Raises:
            TaskFailedError: there are too few samples, the cell is saturated or its counts do not change, or there are
                too many outliers.
        """
        values = np.asarray(counts, dtype=np.float64)
        if len(values) < MIN_SAMPLES_PER_WEIGHT:
            raise TaskFailedError(
                f"{weight.text}: {len(values)} samples are too few: take {MIN_SAMPLES_PER_WEIGHT} or more"
            )
        if values.min() <= MINIMUM_COUNTS or values.max() >= MAXIMUM_COUNTS:
            raise TaskFailedError(f"{weight.text}: the HX711 is at the end of its range: take lighter weights")
        median = float(np.median(values))
        # Where the noise is below one count, the median deviation is zero; the smallest measurable spread is one count.
        spread = max(1.4826 * float(np.median(np.abs(values - median))), 1.0)
        kept = values[np.abs(values - median) <= SAMPLE_OUTLIER_STANDARD_DEVIATIONS * spread]
        outliers = len(values) - len(kept)
        if np.ptp(values) == 0.0:
            raise TaskFailedError(
                f"{weight.text}: the counts stand still at {median:.0f}: check the wires between cell and HX711"
            )
        if outliers > MAX_OUTLIER_SHARE * len(values):
            raise TaskFailedError(
                f"{weight.text}: {outliers} of {len(values)} samples are far off: do not touch the cell, and try again"
            )
        noise = float(kept.std(ddof=1))
        blocks = [block.mean() for block in np.array_split(kept, DRIFT_TEST_BLOCKS)]
        mean_std = max(noise, ROUNDING_STD_COUNTS) / math.sqrt(len(kept))
        block_std = float(np.std(blocks, ddof=1)) / math.sqrt(DRIFT_TEST_BLOCKS)
        if block_std > MAX_BLOCK_TO_SAMPLE_STD_RATIO * mean_std:
            mean_std = block_std
        return cls(weight, float(kept.mean()), mean_std, noise, len(kept), outliers)


MAX_NOISE_SHARE_OF_WEIGHT_RANGE = 0.05
"""Largest noise, as a share of the difference between the heaviest and the lightest weight."""
MAX_NOISE_TO_SMALLEST_NOISE = 3.0
"""Largest ratio of the noise with one weight to the smallest noise; above it, the weight was probably swinging."""
MIN_UNSTEADY_SHARE_OF_WEIGHT_RANGE = 1e-3
"""Noise below which a weight is never called unsteady, as a share of the range of the weights."""
MIN_WEIGHT_STEP_STANDARD_DEVIATIONS = 5.0
"""Smallest difference of neighbouring weights, in standard deviations of one sample."""
MAX_RESIDUAL_SHARE_OF_WEIGHT_RANGE = 0.01
"""Largest residual of the line, as a share of the range of the weights.

Load cells are linear to 0.05 %, so that a larger residual means a wrong weight, or a cell that touches something.
"""
SIGNIFICANT_STANDARD_DEVIATIONS = 5.0
"""Standard deviations beyond which a difference is significant."""


@dataclass(frozen=True)
class CalibrationFit(Calibration):
    """A calibration of a load cell, with the measurements from which it was computed.

    Attributes:
        plateaus: the measured counts of each weight.
        residuals: force by the calibration minus force of the weight, for each weight [N].
    """

    measurements: tuple[WeightMeasurement, ...]
    residuals: tuple[float, ...]


def fit_calibration(plateaus: Sequence[WeightMeasurement], source: str) -> CalibrationFit:
    r"""Fit the line counts = offset + F / scale to the measurements of two or more weights, by weighted least squares.

    The statistical weights are :math:`1 / (\sigma_i^2 + b^2 \sigma_{F,i}^2)` with the standard deviations of the mean
    and of the known weight, and :math:`b` = 1 / scale (effective variance; Orear, Am. J. Phys. 50, 912, 1982). If the
    residuals are larger than expected, the standard deviations are multiplied by :math:`\sqrt{\chi^2 / (n - 2)}`.

    Args:
        plateaus: measured counts of each weight.
        source: how the measurements were made, for the calibration's file.

    Raises:
        TaskFailedError: the counts are too noisy, are equal for different weights, or do not lie on a line.
    """
    _require_order(plateaus)
    force = np.array([plateau.weight.force for plateau in plateaus])
    force_std = np.array([plateau.weight.force_std for plateau in plateaus])
    mean = np.array([plateau.mean for plateau in plateaus])
    mean_std = np.array([plateau.mean_std for plateau in plateaus])
    slope, offset = np.polyfit(force, mean, 1)
    for _ in range(3):  # the fit's weights depend weakly on the slope
        std = np.hypot(mean_std, slope * force_std)
        (slope, offset), covariance = np.polyfit(force, mean, 1, w=1.0 / std, cov="unscaled")
    residual = mean - offset - slope * force  # counts
    free = len(plateaus) - 2
    if free > 0:
        covariance *= max(1.0, float(np.sum((residual / std) ** 2)) / free)
    scale, (slope_std, offset_std) = 1.0 / float(slope), np.sqrt(np.diag(covariance))
    residuals = residual * scale
    worst = int(np.argmax(np.abs(residuals)))
    if abs(residuals[worst]) > max(
        MAX_RESIDUAL_SHARE_OF_WEIGHT_RANGE * float(np.ptp(force)),
        SIGNIFICANT_STANDARD_DEVIATIONS * std[worst] * abs(scale),
    ):
        raise TaskFailedError(
            f"the counts do not lie on a line: {plateaus[worst].weight.text} is off by "
            f"{1e3 * residuals[worst]:.1f} mN: check the weights, and that nothing touches the cell"
        )
    return CalibrationFit(
        offset=float(offset),
        offset_std=float(offset_std),
        scale=scale,
        scale_std=float(slope_std) * scale**2,
        noise=math.sqrt(float(np.mean([plateau.noise**2 for plateau in plateaus]))) * abs(scale),
        date=datetime.now().astimezone().replace(microsecond=0),
        source=source,
        measurements=tuple(plateaus),
        residuals=tuple(map(float, residuals)),
    )


def _require_order(plateaus: Sequence[WeightMeasurement]) -> None:
    """Check that the counts rise or fall with the weight, by far more than the noise."""
    ordered = sorted(plateaus, key=lambda plateau: plateau.weight.force)
    first, last = ordered[0], ordered[-1]
    span = abs(last.mean - first.mean)
    steps = [(a, b) for a, b in pairwise(ordered) if b.weight.force > a.weight.force]
    for a, b in steps:
        if abs(b.mean - a.mean) < SIGNIFICANT_STANDARD_DEVIATIONS * math.hypot(a.mean_std, b.mean_std):
            raise TaskFailedError(
                f"{a.weight.text} and {b.weight.text} give the same counts ({a.mean:.0f}, {b.mean:.0f}): "
                "was the weight changed? If so, take weights farther apart"
            )
    if len({b.mean > a.mean for a, b in steps}) > 1:
        readings = ", ".join(f"{plateau.weight.text}: {plateau.mean:.0f}" for plateau in ordered)
        raise TaskFailedError(f"the counts do not follow the weights ({readings}): hang them in the order asked for")
    noisiest = max(plateaus, key=lambda plateau: plateau.noise)
    if noisiest.noise > MAX_NOISE_SHARE_OF_WEIGHT_RANGE * span:
        share = 100 * noisiest.noise / span
        raise TaskFailedError(
            f"{noisiest.weight.text}: the noise is {share:.0f} % of the weights' span: "
            "let the weight come to rest, shield the wires, or take heavier weights"
        )
    quietest = min(plateau.noise for plateau in plateaus)
    if noisiest.noise > max(MAX_NOISE_TO_SMALLEST_NOISE * quietest, MIN_UNSTEADY_SHARE_OF_WEIGHT_RANGE * span):
        raise TaskFailedError(
            f"{noisiest.weight.text}: the counts move {noisiest.noise / quietest:.0f} times more than at the quietest "
            "weight: let it come to rest before you go on"
        )
    for a, b in steps:
        if abs(b.mean - a.mean) < MIN_WEIGHT_STEP_STANDARD_DEVIATIONS * max(a.noise, b.noise):
            raise TaskFailedError(
                f"{a.weight.text} and {b.weight.text} cannot be distinguished in the noise: take weights farther apart"
            )


FILTER_SETTLING_SAMPLES = 8
"""Number of samples that are dropped after a weight was changed; the HX711's filter needs four (datasheet, "Settling
Time")."""


def calibrate_cell(
    cell: LoadCell,
    weights: Sequence[KnownWeight],
    samples: int,
    source: str,
    ask: Callable[[KnownWeight], None],
    progress: Callable[[KnownWeight, int], None],
    wait: Callable[[float], None],
) -> CalibrationFit:
    """Calibrate a load cell with known weights.

    Args:
        cell: the load cell.
        weights: the known weights, in the order of the measurement.
        samples: number of samples per weight.
        source: how the measurements are made, for the calibration's file.
        ask: function that asks the user to hang a weight, and returns when the weight is at rest.
        progress: function that is called with the weight and the number of its samples so far.
        wait: function that waits for a time [s].

    Raises:
        TaskFailedError: the cell fails, or no line can be fitted to its counts.
    """
    while not cell.status().samples:
        _require_alive(cell)
        wait(0.02)
    plateaus = []
    for weight in weights:
        ask(weight)
        cell.read_counts()  # drop the samples that were received while the weight was changed
        counts: list[int] = []
        while len(counts) < FILTER_SETTLING_SAMPLES + samples:
            counts += [sample.counts for sample in cell.read_counts()]
            _require_alive(cell)
            progress(weight, min(max(len(counts) - FILTER_SETTLING_SAMPLES, 0), samples))
            wait(0.02)
        plateaus.append(
            WeightMeasurement.from_counts(weight, counts[FILTER_SETTLING_SAMPLES : FILTER_SETTLING_SAMPLES + samples])
        )
    return fit_calibration(plateaus, source)


def _require_alive(cell: LoadCell) -> None:
    status = cell.status()
    for fault in (LoadCellFault.DISCONNECTED, LoadCellFault.SILENT):
        if fault in status.active:
            seen = status.counts[LoadCellFault.MALFORMED]
            hint = f" ({seen} lines came that are not samples: is the baud rate right?)" if seen else ""
            raise TaskFailedError(f"load cell: {fault.value}{hint}")
