"""Families of laws: shapes with a measured exponent, width or place, over the quantities on which a law may depend.

Each has several nonlinear values, so that families are searched only at the states where a simpler law was found, and
where that law leaves more than noise.
"""

from collections.abc import Iterator
from itertools import permutations

from armdyn.discovery.shapes import position_parameter
from armdyn.discovery.term import CandidateTerm, TermLocation, TermParameter, TermVariable
from armdyn.discovery.units import divide_units

FIRST_EXPONENT, EXPONENT_SPREAD, LEAST_EXPONENT, LARGEST_EXPONENT = 1.5, 1.0, 0.2, 6.0
"""Exponent with which a power law is first compared, standard deviation of its prior, and its bounds."""
SMOOTHED_SHARE = 0.01
"""Share of a quantity's scale over which a power or a switch is smoothed where it has no derivative."""
Terms = Iterator[CandidateTerm]


def family_terms(site: TermLocation, variables: list[TermVariable]) -> Terms:
    """Candidate terms of every family for the rate of one state, over states and inputs.

    Args:
        site: the rate of a state.
        variables: the quantities on which it may depend.
    """
    for v in variables:
        yield power_law(site, v, v.from_zero, v.name_in_sentence)
        yield from powers_beyond(site, v)
        yield switch(site, v)
        yield from saturating(site, v)
        yield from exponentials(site, v)
    for v, w in permutations(variables, 2):
        if v.unit == w.unit and v.name < w.name:
            says = f"{v.name_in_sentence} - {w.name_in_sentence}"
            yield power_law(site, v, f"({v.name} - {w.name})", says, w)
        size = _size(site, (v, 1), (w, 2))
        says = f"something in proportion to {v.name_in_sentence} times the square of {w.name_in_sentence}"
        yield CandidateTerm("product of powers", says, site, (v, w), {"k": f"{v.name} * {w.name}**2"}, size)


def power_law(
    site: TermLocation, v: TermVariable, of: str, spoken: str, other: TermVariable | None = None
) -> CandidateTerm:
    """Candidate term for k sign(x) |x|^n, x = `of` / scale, with a fitted exponent n: radiation, drag, a pipe.

    k is the rate at the scale, a round number near the largest x.
    """
    largest = max(abs(v.low - v.zero), abs(v.high - v.zero)) if other is None else v.span + other.span
    scale = float(f"{largest:.1g}")
    x = f"({of} / {scale:g})"
    shape = f"{x} * ({x}**2 + {SMOOTHED_SHARE**2:g})**((exponent - 1) / 2)"
    variables = (v,) if other is None else (v, other)
    says = f"something with a power of {spoken}"
    return CandidateTerm("power", says, site, variables, {"k": shape}, _sized(site, 1.0), {"exponent": _exponent()})


def powers_beyond(site: TermLocation, v: TermVariable) -> Terms:
    """Candidate terms for k x^n beyond a place, x the distance from it: a weir, a hole in the side, a rubber ball."""
    scale = float(f"{v.span:.1g}")
    for side, away, beyond in (("above", f"{v.name} - place", 1), ("below", f"place - {v.name}", -1)):
        x = f"(ca.fmax(0, {away}) / {scale:g})"
        shape = f"{x} * ({x} + {SMOOTHED_SHARE:g})**(exponent - 1)"
        says = f"something with a power of the way {side} a certain {v.name_in_sentence}"
        where = {"place": position_parameter(v), "exponent": _exponent()}
        size = _sized(site, 0.3)
        yield CandidateTerm(f"power {side}", says, site, (v,), {"k": shape}, size, where, acts_beyond=beyond)


def switch(site: TermLocation, v: TermVariable) -> CandidateTerm:
    """Candidate term for a constant that begins at a place: a fan, a siphon."""
    width = float(f"{SMOOTHED_SHARE * v.span:.1g}")
    says = f"something constant above a certain {v.name_in_sentence}"
    shape, where = f"(1 + ca.tanh(({v.name} - place) / {width:g})) / 2", {"place": position_parameter(v)}
    return CandidateTerm("switch", says, site, (v,), {"k": shape}, _sized(site, 0.5), where, acts_beyond=1)


def saturating(site: TermLocation, v: TermVariable) -> Terms:
    """Candidate terms for k x / (1 + |x|) and k x / (1 + x^2), x = v / width: a limit, and an eddy-current brake."""
    width = {"width": TermParameter(v.unit, v.size / 3, v.size / 3, 0.01 * v.size, 10.0 * v.size)}
    x = f"({v.name} / width)"
    for kind, shape in (("limit", f"{x} / ca.sqrt(1 + {x}**2)"), ("hump", f"{x} / (1 + {x}**2)")):
        says = f"something that {'tends to a limit' if kind == 'limit' else 'falls again'} with {v.name_in_sentence}"
        yield CandidateTerm(kind, says, site, (v,), {"k": shape}, _sized(site, 0.7), width)


def exponentials(site: TermLocation, v: TermVariable) -> Terms:
    """Candidate terms for k exp((v - middle) / width), rising and falling: evaporation, a diode, a reaction."""
    middle = float(f"{(v.low + v.high) / 2:.3g}")
    width = TermParameter(v.unit, v.span / 3, v.span / 3, 0.02 * v.span, 20.0 * v.span)
    for sign, kind in (("", "rising"), ("-", "falling")):
        shape = f"ca.exp({sign}({v.name} - {middle:g}) / width)"
        says = f"something that is {kind} exponentially with {v.name_in_sentence}"
        yield CandidateTerm("exponential", says, site, (v,), {"k": shape}, _sized(site, 1.0), {"width": width})


def _exponent() -> TermParameter:
    return TermParameter("1", FIRST_EXPONENT, EXPONENT_SPREAD, LEAST_EXPONENT, LARGEST_EXPONENT)


def _sized(site: TermLocation, shape: float) -> TermParameter:
    """The size of a shape without a unit, which is about as large as `shape` in the runs."""
    return TermParameter(site.unit, 0.0, 0.0, typical=site.typical / shape)


def _size(site: TermLocation, *powers: tuple[TermVariable, int]) -> TermParameter:
    unit, scale = divide_units(site.unit, *((v.unit, n) for v, n in powers)), 1.0
    for v, n in powers:
        scale *= v.size**n
    return TermParameter(unit, 0.0, 0.0, typical=site.typical / scale)
