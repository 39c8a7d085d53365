"""Numbers as a person reads them."""

import math

_SMALL = {"m": "mm", "m/s": "mm/s", "N": "mN", "s": "ms", "rad": "mrad", "N m": "mN m"}


def number(value: float, unit: str = "", digits: int = 3) -> str:
    """``0.000312 m`` as ``0.312 mm``: `digits` significant ones, thousandths where the unit has a name for them."""
    if not math.isfinite(value):
        return "–"
    if unit in _SMALL and 0.0 < abs(value) < 0.0995:
        value, unit = value * 1e3, _SMALL[unit]
    return f"{_significant(value, digits)} {unit}".rstrip().replace("-", "−")


def percent(share: float) -> str:
    """``0.953`` as ``95 %``."""
    return f"{100 * share:.0f} %" if math.isfinite(share) else "–"


def _significant(value: float, digits: int) -> str:
    if value == 0.0:
        return "0"
    decimals = max(0, digits - 1 - math.floor(math.log10(abs(value))))
    return f"{value:.{min(decimals, 12)}f}"
