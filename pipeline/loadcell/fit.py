"""Offset, scale and noise of a load cell from the counts at known weights."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import pairwise

import numpy as np

from armdyn.errors import TaskFailedError
from pipeline.loadcell.calibration import Calibration
from pipeline.loadcell.plateau import Plateau

LARGEST_NOISE = 0.05
"""Share of the span of the weights."""
UNSTEADY = 3.0
"""Times the noise of the quietest plateau."""
VISIBLE = 1e-3
"""Share of the span; less than this is not worth a word."""
SMALLEST_STEP = 5.0
"""Standard deviations of one sample by which two neighbouring weights must differ."""
LARGEST_RESIDUAL = 0.01
"""Share of the span; cells are linear to 0.05 %, so this is a wrong weight or a cell that touches something."""
SIGNIFICANT = 5.0
"""Standard deviations."""


@dataclass(frozen=True)
class CalibrationFit:
    """A straight line through the plateaus.

    Attributes:
        plateaus: one per weight.
        offset: counts of the empty cell.
        offset_std: [counts].
        scale: [N/count].
        scale_std: [N/count].
        noise: standard deviation of one sample [N].
        residuals: force by the fit minus force of the weight, per plateau [N].
    """

    plateaus: tuple[Plateau, ...]
    offset: float
    offset_std: float
    scale: float
    scale_std: float
    noise: float
    residuals: tuple[float, ...]

    def calibration(self, date: datetime, source: str) -> Calibration:
        """The calibration to be stored."""
        return Calibration(self.offset, self.offset_std, self.scale, self.scale_std, self.noise, date, source)


def fit_calibration(plateaus: Sequence[Plateau]) -> CalibrationFit:
    r"""Fit counts = offset + F / scale by weighted least squares.

    The weights are :math:`1 / (\sigma_i^2 + b^2 \sigma_{F,i}^2)` with the mean's and the known weight's standard
    deviations and :math:`b` = 1 / scale (effective variance; Orear, Am. J. Phys. 50, 912, 1982). Where the line fits
    worse than these say, the standard deviations grow by :math:`\sqrt{\chi^2 / (n - 2)}`.

    Args:
        plateaus: two or more different weights.

    Raises:
        TaskFailedError: the counts are no calibration: too noisy, weights that cannot be told apart, or not on a line.
    """
    _require_order(plateaus)
    force = np.array([plateau.weight.force for plateau in plateaus])
    force_std = np.array([plateau.weight.force_std for plateau in plateaus])
    mean = np.array([plateau.mean for plateau in plateaus])
    mean_std = np.array([plateau.mean_std for plateau in plateaus])

    design = np.column_stack([np.ones_like(force), force])  # (n, 2)
    slope = float(np.polyfit(force, mean, 1)[0])
    for _ in range(3):  # the weights depend on the slope, weakly
        std = np.hypot(mean_std, slope * force_std)
        covariance = np.linalg.inv(design.T @ (design / std[:, None] ** 2))
        offset, slope = covariance @ (design.T @ (mean / std**2))
    residual = mean - design @ np.array([offset, slope])  # counts
    free = len(plateaus) - 2
    if free > 0:
        covariance *= max(1.0, float(np.sum((residual / std) ** 2)) / free)

    scale = 1.0 / float(slope)
    residuals = residual * scale
    noise = math.sqrt(float(np.mean([plateau.noise**2 for plateau in plateaus]))) * abs(scale)
    _require_line(plateaus, residuals, std * abs(scale))
    return CalibrationFit(
        plateaus=tuple(plateaus),
        offset=float(offset),
        offset_std=math.sqrt(covariance[0, 0]),
        scale=scale,
        scale_std=math.sqrt(covariance[1, 1]) * scale**2,
        noise=noise,
        residuals=tuple(float(value) for value in residuals),
    )


def _require_order(plateaus: Sequence[Plateau]) -> None:
    """More weight must mean more counts, or less, all along, by far more than the noise."""
    ordered = sorted(plateaus, key=lambda plateau: plateau.weight.force)
    first, last = ordered[0], ordered[-1]
    span = abs(last.mean - first.mean)
    steps = [(a, b) for a, b in pairwise(ordered) if b.weight.force > a.weight.force]
    for a, b in steps:
        if abs(b.mean - a.mean) < SIGNIFICANT * math.hypot(a.mean_std, b.mean_std):
            raise TaskFailedError(
                f"{a.weight.text} and {b.weight.text} give the same counts ({a.mean:.0f}, {b.mean:.0f}): "
                "was the weight changed? If so, take weights farther apart"
            )
    if len({b.mean > a.mean for a, b in steps}) > 1:
        readings = ", ".join(f"{plateau.weight.text}: {plateau.mean:.0f}" for plateau in ordered)
        raise TaskFailedError(f"the counts do not follow the weights ({readings}): hang them in the order asked for")
    noisiest = max(plateaus, key=lambda plateau: plateau.noise)
    if noisiest.noise > LARGEST_NOISE * span:
        share = 100 * noisiest.noise / span
        raise TaskFailedError(
            f"{noisiest.weight.text}: the noise is {share:.0f} % of the weights' span: "
            "let the weight come to rest, shield the wires, or take heavier weights"
        )
    quietest = min(plateau.noise for plateau in plateaus)
    if noisiest.noise > max(UNSTEADY * quietest, VISIBLE * span):
        raise TaskFailedError(
            f"{noisiest.weight.text}: the counts move {noisiest.noise / quietest:.0f} times more than at the quietest "
            "weight: let it come to rest before you go on"
        )
    for a, b in steps:
        if abs(b.mean - a.mean) < SMALLEST_STEP * max(a.noise, b.noise):
            raise TaskFailedError(
                f"{a.weight.text} and {b.weight.text} cannot be told apart in the noise: take weights farther apart"
            )


def _require_line(plateaus: Sequence[Plateau], residuals: np.ndarray, std: np.ndarray) -> None:
    """The means must lie on a line, to what a load cell can do."""
    forces = [plateau.weight.force for plateau in plateaus]
    span = max(forces) - min(forces)
    worst = int(np.argmax(np.abs(residuals)))
    if abs(residuals[worst]) > max(LARGEST_RESIDUAL * span, SIGNIFICANT * std[worst]):
        raise TaskFailedError(
            f"the counts do not lie on a line: {plateaus[worst].weight.text} is off by "
            f"{1e3 * residuals[worst]:.1f} mN: check the weights, and that nothing touches the cell"
        )
