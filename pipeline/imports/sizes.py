"""Units of an arm's columns, judged by their numbers: ranges of joints, slopes of positions, efforts of motors."""

from collections.abc import Sequence

import numpy as np

from armdyn.channels import FloatArray
from armdyn.errors import InputError
from armdyn.units import si_factor
from pipeline.imports.foreign import Column
from pipeline.imports.joints import Range

TURNS = 7.0
"""rad; positions beyond are degrees, of an arm whose joints turn a little more than once."""
SURELY_DEGREES = 40.0
"""Numbers beyond are degrees: in rad a joint would have turned six times."""
FEW = 3
"""Joints; of fewer, degrees may all be as small as radians."""
OVER = 0.1
"""Share of its range by which a joint may be beyond it."""
AGREES = 0.15
"""Relative difference of speed and differentiated position from which their units are not the same."""
ALIKE = 0.7
"""Correlation of a speed with the slope of its position below which it may be another joint's, or no speed."""
STRONGEST, WEAKEST = 1.5, 0.01
"""Shares of the motors' efforts, the URDF's, above and below which all torques of an arm may be in another unit."""


def largest(columns: Sequence[Column]) -> float:
    """Largest size in any of some recordings."""
    with np.errstate(all="ignore"):
        return max((float(np.nanmax(np.abs(c.value))) for c in columns if np.isfinite(c.value).any()), default=0.0)


def angle_unit(sizes: Sequence[float]) -> tuple[str, str, str]:
    """Unit, reason and doubt of positions without a unit, by the size of each: one beyond two turns tells for all."""
    most = max(sizes, default=0.0)
    why = f"up to {most:.4g}"
    if most > TURNS:
        return "deg", why, "" if most > SURELY_DEGREES else "or rad, of a joint that turns on?"
    return "rad", why, "or deg?" if len(sizes) < FEW else ""


def length_unit(size: float, limits: Range) -> tuple[str, str, str]:
    """The same of a joint that slides."""
    return "m" if size <= (1 + OVER) * limits.reach else "mm", f"up to {size:.4g}", ""


def position_doubt(size: float, unit: str, limits: Range | None) -> str:
    """What is strange about the size of a position; empty for nothing."""
    try:
        size *= si_factor(unit, "m" if limits is not None and limits.slides else "rad")
    except InputError:
        return "does the joint turn, or slide?" if limits is not None else ""
    if limits is None:
        return "so many turns?" if size > SURELY_DEGREES else ""
    return f"beyond the joint's limit of {limits.reach:.3g}" if size > (1 + OVER) * limits.reach else ""


def rate_unit(written: str, of: str, slope: tuple[float, float] | None) -> tuple[str, str, str]:
    """Unit, reason and doubt of a speed: that in which it is the slope of its position.

    Args:
        written: its unit as the file says; empty for none.
        of: unit of the position.
        slope: see `slope`; None where it is not known.
    """
    assumed = written or f"{of}/s"
    if slope is None:
        return assumed, "unit as written" if written else "as the position", ""
    ratio, alike = slope
    why = f"{ratio:.3g} times the position's slope"
    if alike < ALIKE:
        return assumed, why, "it does not follow the position's slope"
    for unit in (assumed, "rad/s", "deg/s"):
        try:
            expected = si_factor(f"{of}/s", "rad/s") / si_factor(unit, "rad/s")
        except InputError:  # of a joint that slides
            expected = 1.0 if unit == f"{of}/s" else np.inf
        if abs(ratio / expected - 1.0) < AGREES:
            return unit, why, f"it is written {written}" if written and unit != written else ""
    return assumed, why, "the slope is not of that size"


def slope(time: FloatArray, position: FloatArray, speed: FloatArray) -> tuple[float, float] | None:
    """Ratio of a speed to the slope of a position, and their correlation; None where nothing moves.

    Args:
        time: (n,) stamps, which may repeat.
        position: (n,), nan where missing.
        speed: (n,), nan where missing.
    """
    kept = np.isfinite(time) & np.isfinite(position) & np.isfinite(speed)
    kept &= np.diff(time, prepend=-np.inf) > 0.0
    if kept.sum() < FEW:
        return None
    change, speed = np.gradient(position[kept], time[kept]), speed[kept]
    size, power = float(change @ change), float(speed @ speed)
    if size == 0.0 or power == 0.0:
        return None
    return float(change @ speed) / size, float(change @ speed) / np.sqrt(size * power)


def torque_doubt(shares: Sequence[float]) -> str:
    """What is strange about the largest torques of all joints, as shares of what the motors can do."""
    most = max(shares, default=1.0)
    if WEAKEST <= most <= STRONGEST:
        return ""
    return f"{'up to' if most > 1 else 'at most'} {most:.2g} times what the motors can do"
