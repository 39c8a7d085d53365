"""Candidate terms of many shapes: how a force may depend on one or two quantities, with start values to fit from."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from armdyn.discovery.term import CandidateTerm, TermLocation, TermParameter, TermVariable
from armdyn.discovery.units import divide_units
from armdyn.identify.thresholds import THRESHOLD_RANGE_TYPICAL_SIZES

VALUES_PER_CURVE = 7
"""Number of values that define a smooth curve: fewer cannot follow the force of a magnet along its way, and each value
makes the penalty of the term larger."""
FORCE_STEP_WIDTH_BY_UNIT: Mapping[str, float] = {"rad": 0.01, "m": 3e-3}
"""Width over which a step from one force to another is smoothed, by the unit of the quantity: samples resolve no
sharper step. It is equal for all recordings, so that compiled equations can be used again."""
FORCE_STEP_WIDTH_SHARE_OF_MAX = 0.01
"""Width of a step at zero for a quantity whose unit is not in `FORCE_STEP_WIDTH_BY_UNIT`, over its largest value."""
MAGNET_WIDTH_SHARES_OF_RANGE = (1.0 / 7.0, 1.0 / 25.0)
"""Widths of a magnet's pull with which its position is searched, as shares of the range of the positions: the position
of a pull that is six times narrower than the searched one is not found."""
PLAY_EXPONENT = 8
"""Exponent n with which the force of a gear's play approaches its limit; see `gear_play_terms`. Compared with a spring
that slips at its limit, 1 leaves 0.8 to 1.4 times the noise of a torque in the benchmark's hidden laws, 4 leaves 0.3, 8
leaves 0.15."""
Shapes = Iterator[CandidateTerm]


def power_term(site: TermLocation, v: TermVariable, n: int, kind: str, says: str) -> CandidateTerm:
    """Candidate term for a force k v^n, with a fitted size k.

    Args:
        site: where the force acts in the equations.
        v: the quantity on which the force depends.
        n: the exponent.
        kind: kind of the law in a word or two.
        says: what the force does, for a sentence.
    """
    return _single(site, kind, says, (v,), v.name if n == 1 else f"{v.name}**{n}", [(v, n)])


def product_term(site: TermLocation, kind: str, says: str, *parts: tuple[TermVariable, int]) -> CandidateTerm:
    """Candidate term for a force k v^n w^m, with a fitted size k; `parts` are the quantities with their exponents."""
    shape = " * ".join(v.name if n == 1 else f"{v.name}**{n}" for v, n in parts)
    return _single(site, kind, says, tuple(v for v, _ in parts), shape, parts)


def constant_term(site: TermLocation) -> CandidateTerm:
    """Candidate term for a constant force."""
    return _single(site, "constant", "something constant", (), "1", [])


def rate_terms(site: TermLocation, v: TermVariable) -> Shapes:
    """Candidate terms for the rate of a state: powers of a quantity, a threshold beyond which it acts, and a step."""
    spoken = v.name_in_sentence
    yield power_term(site, v, 1, "proportion", f"something in proportion to {spoken}")
    signed = f"{v.name} * ca.fabs({v.name})" if v.low < 0.0 < v.high else f"{v.name}**2"
    yield _single(site, "square", f"something with the square of {spoken}", (v,), signed, [(v, 2)])
    yield power_term(site, v, 3, "cube", f"something with the cube of {spoken}")
    yield _single(site, "fourth power", f"something with the fourth power of {spoken}", (v,), f"{v.from_zero}**4",
                  [(v, 4)], scale=max(v.size, v.high - v.zero) ** 4)  # fmt: skip
    if v.low >= v.zero:
        yield _single(site, "square root", f"something with the square root of {spoken}", (v,),
                      f"ca.sqrt(ca.fmax({v.from_zero}, 0) + {1e-4 * (v.high - v.zero):.1g})", [],
                      scale=float(np.sqrt(v.high - v.zero)))  # fmt: skip
    where = {"place": position_parameter(v)}
    for side, least, beyond in (("above", "ca.fmax", 1), ("below", "ca.fmin", -1)):
        says = f"something that begins {side} a certain {spoken}"
        yield _single(site, f"threshold {side}", says, (v,), f"{least}(0, {v.name} - place)", [(v, 1)], where,
                      scale=0.3 * v.span, acts_beyond=beyond)  # fmt: skip
    if v.low < 0.0 < v.high:
        narrow = float(f"{FORCE_STEP_WIDTH_SHARE_OF_MAX * v.size:.2g}")
        yield _single(site, "step", f"something that turns round with {spoken}", (v,),
                      f"ca.tanh({v.name} / {narrow:g})", [], scale=1.0)  # fmt: skip


def hinge_terms(
    site: TermLocation, at: TermVariable, speed: TermVariable, time: TermVariable, widths: Sequence[float],
    drag: str = "friction", damping: str = "friction",
) -> Shapes:  # fmt: skip
    """Candidate terms for anything that turns: drag, springs, stops, one-sided and sticky friction, warming grease.

    Args:
        site: where the torque acts in the equations.
        at: angle or position.
        speed: rate of the angle or position.
        time: time since the start of the run.
        widths: speeds that are tried for the width of sticky friction; see `sticky_friction_terms`.
        drag: a word for a force against the speed.
        damping: a word for a force against the speed that depends on the position.
    """
    yield power_term(site, speed, 3, "cubic drag", f"{drag} with the cube of the speed")
    yield power_term(site, at, 2, "crooked spring", f"a torque with the square of the {at.name}")
    yield power_term(site, at, 3, "flexure", f"a spring that stiffens with the cube of the {at.name}")
    grows = f"{damping} that grows with the {at.name}"
    yield product_term(site, f"damping by {at.name}", grows, (at, 2), (speed, 1))
    yield from stop_terms(site, at)
    yield from one_sided_friction_terms(site, at, speed)
    yield from sticky_friction_terms(site, speed, widths)
    yield from warming_friction_terms(site, speed, time)


def recorded_terms(site: TermLocation, recorded: Sequence[TermVariable], speed: TermVariable) -> Shapes:
    """Candidate terms for frictions and torques that depend on recorded quantities, such as a temperature."""
    for v in recorded:
        yield from recorded_friction_terms(site, v, speed)
        yield from recorded_torque_terms(site, v)


def curve_terms(
    site: TermLocation, variables: Sequence[TermVariable], recorded: Sequence[TermVariable], speed: TermVariable
) -> Shapes:
    """Candidate smooth curves of a force over each quantity, and of a friction coefficient over each recorded one."""
    for v in variables:
        yield curve_term(site, v)
    for v in recorded:
        yield curve_term(site, v)
        yield curve_term(site, v, speed)


def position_parameter(v: TermVariable) -> TermParameter:
    """Declare a position that is searched over the whole range of a quantity in the runs; see `identify.thresholds`."""
    middle, typical = (v.low + v.high) / 2, v.span / (2.0 * THRESHOLD_RANGE_TYPICAL_SIZES)
    return TermParameter(v.unit, middle, 0.0, v.low, v.high, typical=typical)


def stop_terms(site: TermLocation, v: TermVariable) -> Shapes:
    """Candidate terms for stops: springs k max(0, v - place) beyond a position, and k min(0, v - place) below one."""
    for side, least, beyond in (("above", "ca.fmax", 1), ("below", "ca.fmin", -1)):
        says = f"a spring that is touched {side} a certain {v.name}"
        yield _single(
            site, "stop", says, (v,), f"{site.resisting_sign}{least}(0, {v.name} - place)", [(v, 1)],
            {"place": position_parameter(v)},
            size="stiffness", positive=True, scale=0.3 * v.span, acts_beyond=beyond,
        )  # fmt: skip


def one_sided_friction_terms(site: TermLocation, v: TermVariable, speed: TermVariable) -> Shapes:
    """Candidate terms for friction, viscous or dry, on one side only of a position."""
    for side, sign, beyond in (("above", "+", 1), ("below", "-", -1)):
        step = f"(1 {sign} ca.tanh(({v.name} - place) / {FORCE_STEP_WIDTH_BY_UNIT[v.unit]:g})) / 2"
        says = f"friction only {side} a certain {v.name}"
        where = {"place": position_parameter(v)}
        yield from _frictions(site, "one-sided rub", says, v, speed, step, where, acts_beyond=beyond)


def magnet_terms(site: TermLocation, v: TermVariable) -> Shapes:
    """Candidate terms for a magnet: a pull k u / (1 + u^2)^2, u = (v - place) / width, towards a position.

    Where the site's expression contains ``{away}``, the force also has a component across the way. There is one term
    for each of the widths with which a position is searched.
    """
    u = f"({v.name} - place) / width"
    across = "{away}" in site.code
    shapes = {"pull": f"{site.resisting_sign}1 / (1 + ({u})**2)**2" + ("" if across else f" * {u}")}
    here = replace(site, code=site.code.replace("{away}", u), formula_pattern=site.formula_pattern.replace("{away}", u))
    says = f"something at a certain {v.name} pulls or pushes, as a magnet does"
    for share in MAGNET_WIDTH_SHARES_OF_RANGE:
        width = share * v.span
        where = {
            "place": position_parameter(v),
            "width": TermParameter(v.unit, width, width / 2, 0.1 * width, 4.0 * v.span),
        }
        yield CandidateTerm("magnet", says, here, (v,), shapes, _size(site), where)


def sticky_friction_terms(site: TermLocation, v: TermVariable, widths: Sequence[float]) -> Shapes:
    """Candidate terms for sticky dry friction k exp(-|v| / width), largest near standstill, one for each width."""
    assert site.dry_friction_site is not None
    for width in widths:
        where = {"width": _width(v.unit, width)}
        yield _single(
            site.dry_friction_site, "sticky seal", "dry friction that is largest near standstill", (v,),
            f"ca.exp(-ca.fabs({v.name}) / width)", [], where,
            size="friction", positive=True, scale=0.5,
        )  # fmt: skip


def cable_terms(site: TermLocation, v: TermVariable) -> Shapes:
    """Candidate terms for a cable or hose that tightens: k (exp(max(0, v - place) / width) - 1), and mirrored."""
    toward = "" if site.resisting_sign else "-"
    where = {"place": position_parameter(v), "width": _width(v.unit, 0.4 * v.span, 0.05, 10.0)}
    above, below = (site.resisting_sign, f"{v.name} - place", 1), (toward, f"place - {v.name}", -1)
    for back, away, beyond in (above, below):
        yield _single(
            site, "tightening cable", f"a cable that tightens with {v.name}", (v,),
            f"{back}(ca.exp(ca.fmax(0, {away}) / width) - 1)", [], where,
            size="tension", positive=True, scale=1.0, acts_beyond=beyond,
        )  # fmt: skip


def gear_play_terms(
    site: TermLocation, speed: TermVariable, position: TermVariable, travels: Sequence[float]
) -> Shapes:
    """Candidate terms for a gear's play: a hysteresis force k z, z' = speed (1 - max(0, z sign(speed))^n) / travel.

    After a reversal the force grows over the travel to its limit, where z is 1 or -1, and stays there until the motion
    reverses (Bouc's hysteresis, as Wen, J. Eng. Mech. Div. 102, 1976, writes it). n is `PLAY_EXPONENT`; there is one
    term for each of `travels`.
    """
    rate = f"speed * (1 - ca.fmax(0, z * ca.sign(speed))**{PLAY_EXPONENT}) / travel"
    state = f"{site.stage}, turned = {site.stage}.with_state(lambda z: {rate}, start)"
    says = "a torque that turns round over some travel after every turn: backlash, the play of a gear"
    start = TermParameter("1", 0.0, 1.0, -1.0, 1.0, scope="per_run")  # no recording contains the motion before it
    for travel in travels:
        where = {"travel": _width(position.unit, travel), "start": start}
        size = _size(site, positive=True)
        yield CandidateTerm(
            "backlash", says, site, (speed,), {"k": f"{site.resisting_sign}turned"}, size, where, (state,)
        )


def cogging_terms(site: TermLocation, v: TermVariable, periods: Sequence[float]) -> Shapes:
    """Candidate terms for cogging or an eccentric gear: a sine and a cosine of v, one term for each period."""
    for period in periods:
        where = {"period": TermParameter(v.unit, period, 0.15 * period, 0.7 * period, 1.4 * period)}
        turn = f"(2 * ca.pi * {v.name} / period)"
        shapes = {"sine": f"ca.sin{turn}", "cosine": f"ca.cos{turn}"}
        says = f"a force that repeats along {v.name}: cogging or an eccentric gear"
        yield CandidateTerm("cogging", says, site, (v,), shapes, _size(site), where)


def warming_friction_terms(site: TermLocation, v: TermVariable, time: TermVariable) -> Shapes:
    """Candidate terms for friction that decreases with time, as grease warms up; `v` is the speed."""
    where = {"warm_up": _width(time.unit, time.span / 2)}
    fade = f"ca.exp(-{time.name} / warm_up)"
    says = "friction that fades over the run, as of grease that warms up"
    yield from _frictions(site, "warming friction", says, time, v, fade, where)


def recorded_friction_terms(site: TermLocation, v: TermVariable, speed: TermVariable) -> Shapes:
    """Candidate terms for friction in proportion to exp(c / width) or exp(-c / width) of a recorded quantity c.

    Where c comes near zero, there are terms in proportion to c as well; friction in proportion to a temperature in K
    would be nearly constant.
    """
    assert v.column is not None
    kind, says = f"friction by {v.name_in_sentence}", f"friction that depends on the {v.name_in_sentence}"
    width = {"width": TermParameter(v.unit, v.span / 2, v.span / 4, 0.02 * v.span, 20.0 * v.span)}
    for sign in ("-", ""):
        share = f"ca.exp({sign}({v.name} - {v.column.usual!r}) / width)"
        yield from _frictions(site, kind, says, v, speed, share, width)
    if v.comes_near_zero and v.low >= 0.0:
        yield from _frictions(site, kind, says, v, speed, f"ca.fmax(0, {v.name})", {}, (v, 1))


def recorded_torque_terms(site: TermLocation, v: TermVariable) -> Shapes:
    """Candidate terms for a torque k c or k c^2 of a recorded quantity c; k (c - place) where c is far from zero."""
    kind, says = f"torque by {v.name_in_sentence}", f"a torque that depends on the {v.name_in_sentence}"
    if v.comes_near_zero:
        yield power_term(site, v, 1, kind, says)
        yield power_term(site, v, 2, kind, says)
    else:
        place = {"place": TermParameter(v.unit, (v.low + v.high) / 2, v.span, v.low - v.span, v.high + v.span)}
        yield _single(site, kind, says, (v,), f"({v.name} - place)", [(v, 1)], place, scale=v.span / 2)


def curve_term(site: TermLocation, v: TermVariable, speed: TermVariable | None = None) -> CandidateTerm:
    """Candidate term for any smooth force over v: a cubic spline with evenly spaced knots.

    With `speed`, the spline is the coefficient of a friction in proportion to that speed.
    """
    step = v.span / (VALUES_PER_CURVE - 3)
    centres = v.low + step * (np.arange(VALUES_PER_CURVE) - 1)
    lines = (
        "",
        "def near(centre):  # 2/3 there, nothing from two knots on",
        f"    away = ca.fabs({v.name} - centre) / {step:.6g}",
        "    return (ca.fmax(0, 2 - away) ** 3 - 4 * ca.fmax(0, 1 - away) ** 3) / 6",
        "",
    )
    shapes = {f"value_{i}": f"near({centre:.6g})" for i, centre in enumerate(centres)}
    if speed is None:
        says = f"a smooth function of {v.name_in_sentence}"
        return CandidateTerm(
            f"curve over {v.name_in_sentence}", says, site, (v,), shapes, _size(site), preceding_code=lines
        )
    shapes = {size: f"{site.resisting_sign}{speed.name} * {shape}" for size, shape in shapes.items()}
    says = f"friction in proportion to {speed.name}, by a smooth function of {v.name_in_sentence}"
    size = _size(site, [(speed, 1)])
    return CandidateTerm(
        f"curve of friction over {v.name_in_sentence}", says, site, (v, speed), shapes, size, preceding_code=lines
    )


def _frictions(
    site: TermLocation,
    kind: str,
    says: str,
    by: TermVariable,
    speed: TermVariable,
    share: str,
    where: Mapping[str, TermParameter],
    *counted: tuple[TermVariable, int],
    acts_beyond: int = 0,
) -> Shapes:
    """Viscous friction, and dry friction, each times a factor that depends on the quantity `by`.

    A factor that is not a plain number has the unit of the powers `counted`.
    """
    share_scale = float(np.prod([v.size**n for v, n in counted]))
    yield _single(
        site, kind, says, (by, speed), f"{site.resisting_sign}{speed.name} * {share}", [(speed, 1), *counted], where,
        size="coefficient", positive=True, scale=speed.size * share_scale, acts_beyond=acts_beyond,
    )  # fmt: skip
    if site.dry_friction_site is not None:
        yield _single(
            site.dry_friction_site, kind, f"dry {says}", (by,), share, counted, where,
            size="friction", positive=True, scale=share_scale, acts_beyond=acts_beyond,
        )  # fmt: skip


def _single(
    site: TermLocation,
    kind: str,
    says: str,
    variables: tuple[TermVariable, ...],
    shape: str,
    powers: Sequence[tuple[TermVariable, int]],
    constants: Mapping[str, TermParameter] | None = None,
    *,
    size: str = "k",
    positive: bool = False,
    scale: float | None = None,
    acts_beyond: int = 0,
) -> CandidateTerm:
    """A term of one shape; see `_size`."""
    sized = _size(site, powers, scale, positive=positive)
    return CandidateTerm(kind, says, site, variables, {size: shape}, sized, constants or {}, acts_beyond=acts_beyond)


def _size(
    site: TermLocation,
    powers: Sequence[tuple[TermVariable, int]] = (),
    scale: float | None = None,
    *,
    positive: bool = False,
) -> TermParameter:
    """The size of a shape with the unit of these powers; `scale` is the shape in the runs, by default the powers."""
    of_powers = float(np.prod([v.size**n for v, n in powers]))
    unit = divide_units(site.unit, *((v.unit, n) for v, n in powers))
    typical = site.typical / (of_powers if scale is None else scale)
    return TermParameter(unit, 0.0, 0.0, 0.0 if positive else -np.inf, typical=typical)


def _width(unit: str, width: float, narrowest: float = 0.05, widest: float = 20.0) -> TermParameter:
    """A width, with its bounds as multiples of it."""
    return TermParameter(unit, width, width / 2, narrowest * width, widest * width)
