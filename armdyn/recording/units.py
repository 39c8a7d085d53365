"""Convert texts and numbers with units to numbers in SI units.

All numbers inside armdyn are in SI units and radians. Units are looked up only in this file, and pint is imported only
where a text is not already in the wanted unit.
"""

import math
import re
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

from armdyn.errors import InputError
from urdf.bounds import has_plausible_magnitude, parse_number, printable_excerpt

if TYPE_CHECKING:
    import pint

_NUMBER = re.compile(r"[-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?|[-+]?(?:nan|inf)\b", re.IGNORECASE)
_PLUS_MINUS = re.compile(r"\s*(?:\+/-|±|\+-)\s*")
# Robotics writes "Nm"; pint reads that as a measure of yarn.
_NEWTON_METRE = re.compile(r"\bNm\b")


ENERGY_UNITS = ("joule", "watt", "electron_volt", "calorie", "british_thermal_unit", "erg")
"""Names in pint of units of energy and power, which must not be used for a torque, whose dimensions are those of
energy."""
MAX_UNIT_TEXT_LENGTH = 80
"""Largest number of characters in the text of a unit."""
_POWER = re.compile(r"(?:\^|\*\*)\s*(?:[-+]?\d(?:\.\d{1,3})?|\([-+]?\d(?:\s*/\s*\d)?\))(?![\w.])(?!\s*(?:\^|\*\*))")
_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺", "0123456789-+")
_SUPERSCRIPT = re.compile(r"[⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺]+")


@dataclass(frozen=True)
class KnownQuantity:
    """A number with its unit and, where it was measured, its standard deviation.

    Attributes:
        value: value in `unit`.
        std: standard deviation in `unit`; None where the value is exact by convention.
        unit: an SI unit such as ``"kg"``.
    """

    value: float
    std: float | None
    unit: str

    def __str__(self) -> str:
        spread = "" if self.std is None else f" +/- {self.std!r} {self.unit}"
        return f"{self.value!r} {self.unit}{spread}"


def si_factor(unit: str, expected: str) -> float:
    """Factor that converts values in `unit` to `expected`.

    Args:
        unit: unit that a user wrote, such as ``"gram_force"``, ``"deg/s"`` or ``"ms"``.
        expected: SI unit of the quantity, such as ``"N"``.

    Raises:
        InputError: `unit` is unknown, is of another kind than `expected`, or is not an angle where one is expected.
    """
    unit = unit.strip()
    if unit == expected:
        return 1.0
    given, wanted = _from_zero(unit), _from_zero(expected)
    if expected == "N" and given.dimensions == _from_zero("kg").dimensions:
        force = "kilogram_force" if unit in ("kg", "kilogram") else "gram_force"
        raise InputError(f"'{unit}' is a unit of mass: write '{force}' for what a scale reads, or 'N'")
    if given.dimensions != wanted.dimensions:
        raise InputError(f"'{unit}' is of another kind than '{expected}': write it in '{expected}' or a multiple of it")
    if expected == "N m" and any(name in given.names for name in ENERGY_UNITS):
        raise InputError(f"'{unit}' is a unit of energy, and a torque is none: write it in 'N m', or leave it out")
    # To pint an angle, a cycle and a per cent are all plain numbers: 3 Hz would silently become 3 rad/s.
    plain = given.factor == 1.0 and "hertz" not in given.names
    if wanted.is_angle and not given.is_angle and not plain:
        raise InputError(f"'{unit}' does not say an angle: write '{expected}' or the same in 'deg'")
    return given.factor / wanted.factor


def parse_quantity(text: str, expected: str | None = None) -> KnownQuantity:
    """Parse a quantity such as ``"80 g +/- 0.4 g"``, ``"3 mN"`` or ``"0.368 ± 0.001 m"``.

    Args:
        text: a number with its unit, then optionally ``+/-`` (or ``±``) and the standard deviation with its unit, or in
            per cent of the value. A unit that stands only at the end holds for both numbers.
        expected: SI unit that the result shall have, ``"1"`` for a plain number; None takes any unit and converts it to
            SI.

    Returns:
        Value and standard deviation in `expected`, or in the SI unit of the text.

    Raises:
        InputError: no number, no unit, an unknown unit, a unit of another kind, or a standard deviation that is not
            positive.
    """
    parts = _PLUS_MINUS.split(text.strip())
    if len(parts) > 2:
        raise InputError(f"'{text}' holds more than one '+/-': write it as '80 g +/- 0.4 g'")
    numbers = [_number_and_unit(part, text) for part in parts]
    value, unit = numbers[0]
    unit = unit or numbers[-1][1] or ("1" if expected == "1" else "")
    if not unit:
        raise InputError(f"'{text}' has no unit: write it as '{text} {expected or 'kg'}'")
    si = expected if expected is not None else si_unit(unit)
    scale = si_factor(unit, si)
    if not has_plausible_magnitude(value * scale):
        raise InputError(f"'{text}' is too large or too small for anything: write a number, such as '80 g'")
    if len(numbers) == 1:
        return KnownQuantity(value * scale, None, si)
    spread, spread_unit = numbers[1]
    spread_unit = spread_unit or ("1" if expected == "1" else "")
    if "%" in spread_unit and spread_unit != "%":
        raise InputError(f"the standard deviation in '{text}' is in '{spread_unit}': write '%' alone, or '{unit}'")
    if not spread_unit:
        raise InputError(f"the standard deviation in '{text}' has no unit: write '{text} {unit}'")
    std = abs(value) * spread / 100 * scale if spread_unit == "%" else spread * si_factor(spread_unit, si)
    if not std > 0.0:
        raise InputError(f"the standard deviation in '{text}' is not positive: leave '+/-' out where a value is exact")
    if not has_plausible_magnitude(std):
        raise InputError(f"the standard deviation in '{text}' is impossibly large or small: correct it")
    return KnownQuantity(value * scale, std, si)


def si_unit(unit: str) -> str:
    """SI unit of the same kind as `unit`: the unit itself if it is SI, such as ``"N s^2/m^2"``, else its base units.

    Raises:
        InputError: the unit is unknown.
    """
    parsed = _from_zero(unit)
    return _NEWTON_METRE.sub("N m", unit) if parsed.factor == 1.0 else parsed.base


def to_base_units(unit: str) -> tuple[str, float, float]:
    """SI base units of a unit (``"1"`` for a plain number), and factor and offset of the conversion to them.

    Raises:
        InputError: the unit is unknown, or is not a multiple of its base units, such as a decibel.
    """
    if unit.strip() == "1":
        return "1", 1.0, 0.0
    parsed = _parse(unit.strip())
    return parsed.base or "1", parsed.factor, parsed.zero


def sliding_unit(unit: str) -> str:
    """Unit for a prismatic joint from the unit for a revolute joint, such as ``"N/m"`` from ``"N m/rad"``."""
    if unit == "kg m^2":
        return "kg"
    return re.sub(r"\brad\b", "m", re.sub(r"\bN m\b", "N", unit))


def _from_zero(unit: str) -> "_Unit":
    """A unit whose zero is that of its base units; that of a degree Celsius is not."""
    parsed = _parse(unit)
    if parsed.zero != 0.0:
        raise InputError(f"unit '{unit}' does not start at zero: write 'K'")
    return parsed


@dataclass(frozen=True)
class _Unit:
    """A unit as pint knows it: ``factor * value + zero`` is in SI base units.

    It also has the name of these base units, their dimensions, and whether it counts radians.
    """

    factor: float
    zero: float
    base: str
    dimensions: str
    is_angle: bool
    names: str


@lru_cache(maxsize=1)
def _registry() -> "pint.UnitRegistry[float]":
    import pint  # takes longer to import than everything else that reads a recording

    return pint.UnitRegistry()


@lru_cache(maxsize=256)
def _parse(unit: str) -> _Unit:
    _check_size(unit)
    registry = _registry()
    text = _NEWTON_METRE.sub("N m", unit)
    # A bad unit surfaces as one of a dozen exceptions of pint and of Python's tokenizer; the remedy is always the same.
    try:
        parsed = registry.parse_units(text)
        base = registry.Quantity(1.0, parsed).to_base_units()
        zero, two = (registry.Quantity(x, parsed).to_base_units().magnitude for x in (0.0, 2.0))
    except Exception as error:
        raise InputError(f"unknown unit '{unit}': write one such as 's', 'mm', 'deg/s', 'mN', 'N m'") from error
    factor = base.magnitude if zero == 0.0 else base.magnitude - zero
    if not math.isclose(two - zero, 2.0 * factor, rel_tol=1e-9):
        raise InputError(f"unit '{unit}' is not a multiple of anything: write what it counts, as a plain number in '1'")
    if not (math.isfinite(factor) and factor > 0.0):
        raise InputError(
            f"unit '{unit}' is too large or too small to compute with: write one such as 's', 'mm', 'deg/s', 'mN', "
            "'N m'"
        )
    return _Unit(
        factor=factor,
        zero=zero,
        base=f"{base.units:~C}".replace("**", "^").replace("*", " "),
        dimensions=str(base.dimensionality),
        is_angle="radian" in str(base.units),
        names=str(parsed),
    )


def _check_size(unit: str) -> None:
    """Refuse units that take too long to evaluate, such as ``N**9**9**9**9``: pint computes every number in a unit."""
    plain = _SUPERSCRIPT.sub(lambda match: "^" + match.group().translate(_SUPERSCRIPTS), unit)
    powers = plain.count("^") + plain.count("**")
    depth = deepest = 0
    for character in plain:
        depth += (character == "(") - (character == ")")
        deepest = max(deepest, depth)
    if len(unit) > MAX_UNIT_TEXT_LENGTH or deepest > 2 or len(_POWER.findall(plain)) != powers:
        shown = unit if len(unit) <= MAX_UNIT_TEXT_LENGTH else f"{unit[:40]}..."
        raise InputError(f"unknown unit '{shown}': write powers of one digit, such as 's', 'mm', 'm/s^2', 'N s^2/m^2'")


def _number_and_unit(part: str, text: str) -> tuple[float, str]:
    match = _NUMBER.match(part)
    if match is None:
        raise InputError(f"'{text}' does not start with a number: write it as '80 g' or '80 g +/- 0.4 g'")
    unit = part[match.end() :].strip()
    try:
        value = parse_number(match.group())
    except ValueError as error:
        raise InputError(f"'{printable_excerpt(text)}' is not finite: write a number, such as '80 g'") from error
    if unit.startswith(","):
        raise InputError(f"'{text}' has a decimal comma: write a decimal point")
    if unit.startswith("_"):
        raise InputError(f"'{printable_excerpt(text)}' has digits that are set apart: write them without '_'")
    return value, unit
