"""Divide units, written as text."""

import re
from collections import defaultdict

_PART = re.compile(r"(?P<symbol>[^\W\d]+|%)(?:\^(?P<power>-?[\d.]+))?")
_DIFFERENCES = {"degC": "K", "degF": "delta_degF"}
"""Unit of differences, by units whose zero is elsewhere: only differences of them have multiples and powers."""


def divide_units(unit: str, *others: tuple[str, int]) -> str:
    """A unit divided by powers of others: ``over("N m", ("rad/s", 3))`` is ``"N m s^3/rad^3"``."""
    powers = _powers(unit)
    for other, power in others:
        for symbol, n in _powers(other).items():
            powers[symbol] -= power * n
    above = [_text(symbol, n) for symbol, n in powers.items() if n > 0]
    below = [_text(symbol, -n) for symbol, n in powers.items() if n < 0]
    bottom = f"({' '.join(below)})" if len(below) > 1 else "".join(below)
    return (" ".join(above) or "1") + (f"/{bottom}" if below else "")


def _powers(unit: str) -> dict[str, float]:
    found = defaultdict[str, float](float)
    above, _, below = unit.partition("/")
    for part, sign in ((above, 1), (below, -1)):
        for match in _PART.finditer(part):
            found[_DIFFERENCES.get(match["symbol"], match["symbol"])] += sign * float(match["power"] or 1)
    return found


def _text(symbol: str, power: float) -> str:
    return symbol if power == 1 else f"{symbol}^{power:g}"
