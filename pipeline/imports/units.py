"""Units of columns, judged by their numbers: ranges of joints, slopes of positions, efforts of motors."""

from collections.abc import Mapping, Sequence

import numpy as np

from armdyn.errors import InputError
from armdyn.recording.channels import FloatArray
from armdyn.recording.units import si_factor
from pipeline.imports.claims import Claim
from pipeline.imports.foreign import Column, Foreign
from pipeline.imports.joints import AMPERE, IN_AMPERE, Joints, Range
from pipeline.imports.mapping import Entry
from pipeline.imports.words import fits

TURNS = 7.0
"""rad; positions beyond are degrees, of an arm whose joints turn a little more than once."""
SURELY_DEGREES = 40.0
"""Numbers beyond are degrees: in rad a joint would have turned six times."""
FEW = 3
"""Joints; of fewer, degrees may all be as small as radians."""
FASTEST = 10.0 * TURNS
"""rad/s beyond which a rate without a position is in degrees."""
FARTHEST = 10.0
"""m beyond which a position without limits is in mm."""
OVER = 0.1
"""Share of its range by which a joint may be beyond it."""
AGREES = 0.15
"""Relative difference of speed and differentiated position from which their units are not the same."""
ALIKE = 0.7
"""Correlation of a speed with the slope of its position below which it may be another joint's, or no speed."""
STRONGEST, WEAKEST = 1.5, 0.01
"""Shares of the motors' efforts, the URDF's, above and below which all torques of an arm may be in another unit."""
UPSIDE_DOWN = 0.5
"""rad; within it of half a turn, the mean of a swing's angle shows that it is not counted from hanging."""
ASSUMED = "unit assumed"
COUNTS = "whole numbers: counts of an encoder, which need a scale?"


def judged_entries(
    claims: Sequence[Claim],
    columns: Mapping[str, Sequence[Column]],
    known: Joints,
    first: Foreign,
    time: FloatArray | None,
) -> dict[str, Entry]:
    """What becomes of every column, with its unit, as written or as its numbers say, and all that is doubtful.

    Args:
        claims: one to a channel.
        columns: of all recordings, by name.
        known: the bodies, with their ranges where they have some.
        first: recording, whose positions are differentiated.
        time: (n,) s, of its rows; None where every column has a time of its own.
    """
    positions = {c.body: c for c in claims if c.label.quantity == "q"}
    sizes = {c.column: _largest(columns[c.column]) for c in claims}
    angle = _angle_unit([sizes[c.column] for b, c in positions.items() if not (known.slides(b) or c.label.unit)])
    strange = _torque_doubt(claims, sizes, known)
    entries: dict[str, Entry] = {}
    for c in sorted(claims, key=lambda claim: claim.label.quantity != "q"):
        written, size, limits = c.label.unit, sizes[c.column], known.ranges.get(c.body)
        at = positions.get(c.body)
        of = entries[at.column].unit if at is not None and at is not c else "m" if known.slides(c.body) else angle[0]
        unit, why, doubts, constant = written, "unit as written", list(c.doubts), ""
        if c.label.quantity == "q":
            if not unit:
                unit, why, doubt = _length_unit(size, limits) if limits is not None and limits.slides else angle
                doubts += [doubt, COUNTS if _whole(columns[c.column]) else ""]
            doubts.append(_position_doubt(size, unit, limits))
            if c.body == "swing":
                doubts.append(_hanging_doubt(columns[c.column], unit))
        elif c.label.quantity == "v":
            unit, why, doubt = _rate_unit(written, of, size, _slope(first, c, at, time), bool(positions))
            doubts.append(doubt)
        elif c.label.quantity == "a":
            if not unit:
                unit, why = f"{of}/s^2", "as the position"
                doubts.append("" if positions else ASSUMED)
        elif c.label.quantity == "current":
            unit, constant, why = unit or "A", "1 N m/A", "a current"
            doubts.append("the torque constant and the gear")
        else:
            doubts.append(strange)
            if not unit:
                unit, why = _force_unit(c, known), ASSUMED
                doubts.append("" if c.label.quantity == "tau" else f"up to {size:.4g}: in N?")
                doubts.append(IN_AMPERE if "effort" in c.label.words and AMPERE & set(known.arm) else "")
        entries[c.column] = Entry(c.channel, unit, torque_constant=constant, check=in_one(doubts), why=why)
    return entries


def _whole(columns: Sequence[Column]) -> bool:
    """Whether all values are whole numbers, of which several are large."""
    return (
        all(np.all(np.isnan(c.value) | (c.value == np.round(c.value))) for c in columns) and _largest(columns) > TURNS
    )


def in_one(doubts: Sequence[str]) -> str:
    """What a person is asked who reads a guess."""
    return "; ".join(dict.fromkeys(filter(None, doubts)))


def _largest(columns: Sequence[Column]) -> float:
    """Largest size in any of some recordings."""
    with np.errstate(all="ignore"):
        return max((float(np.nanmax(np.abs(c.value))) for c in columns if np.isfinite(c.value).any()), default=0.0)


def _angle_unit(sizes: Sequence[float]) -> tuple[str, str, str]:
    """Unit, reason and doubt of positions without a unit, by the size of each: one beyond two turns tells for all."""
    most = max(sizes, default=0.0)
    why = f"up to {most:.4g}"
    if most > TURNS:
        return "deg", why, "" if most > SURELY_DEGREES else "or rad, of a joint that turns on?"
    return "rad", why, "or deg?" if len(sizes) < FEW else ""


def _length_unit(size: float, limits: Range) -> tuple[str, str, str]:
    """The same of a joint that slides."""
    unit = "m" if size <= (1 + OVER) * min(limits.reach, FARTHEST) else "mm"
    return unit, f"up to {size:.4g}", "" if np.isfinite(limits.reach) else ASSUMED


def _position_doubt(size: float, unit: str, limits: Range | None) -> str:
    """What is strange about the size of a position; empty for nothing."""
    try:
        size *= si_factor(unit, "m" if limits is not None and limits.slides else "rad")
    except InputError:
        return "does the joint turn, or slide?" if limits is not None else ""
    if limits is None:
        return "so many turns?" if size > SURELY_DEGREES else ""
    return f"beyond the joint's limit of {limits.reach:.3g}" if size > (1 + OVER) * limits.reach else ""


def _hanging_doubt(columns: Sequence[Column], unit: str) -> str:
    mean = float(np.nanmean(np.concatenate([column.value for column in columns]))) * si_factor(unit, "rad")
    upside_down = abs(abs(mean) - np.pi) < UPSIDE_DOWN
    return "it hangs at half a turn; 0 is hanging, give an offset" if upside_down else ""


def _rate_unit(
    written: str, of: str, size: float, slope: tuple[float, float] | None, positions: bool
) -> tuple[str, str, str]:
    """Unit, reason and doubt of a speed: that in which it is the slope of its position.

    Args:
        written: its unit as the file says; empty for none.
        of: unit of the position.
        size: of the largest.
        slope: see `_slope`; None where it is not known.
        positions: whether the file has any, whose unit may be the speed's.
    """
    assumed = written or f"{of}/s"
    if slope is None:
        if written or positions:
            return assumed, "unit as written" if written else "as the position", ""
        degrees = of == "rad" and size > FASTEST
        return "deg/s" if degrees else assumed, f"up to {size:.4g}", "" if degrees else ASSUMED
    ratio, alike = slope
    why = f"{ratio:.3g} times the position's slope"
    if alike < ALIKE:
        return assumed, why, "it does not follow the position's slope"
    si, *others = ("rad/s", "deg/s") if fits(of, "rad") else ("m/s", "mm/s")
    for unit in (assumed, si, *others):
        if fits(unit, si) and abs(ratio * si_factor(unit, si) / si_factor(f"{of}/s", si) - 1.0) < AGREES:
            return unit, why, f"it is written {written}" if written and unit != written else ""
    return assumed, why, "the slope is not of that size"


def _slope(first: Foreign, speed: Claim, position: Claim | None, time: FloatArray | None) -> tuple[float, float] | None:
    """Ratio of a speed to the slope of its position, and their correlation; None where nothing moves or is known."""
    if position is None or not {speed.column, position.column} <= first.columns.keys():
        return None
    x, v = first.columns[position.column], first.columns[speed.column].value
    stamps = time if time is not None else x.time
    if stamps is None or len(x.value) != len(v):
        return None
    kept = np.isfinite(stamps) & np.isfinite(x.value) & np.isfinite(v)
    kept &= np.diff(stamps, prepend=-np.inf) > 0.0
    if kept.sum() < FEW:
        return None
    change, v = np.gradient(x.value[kept], stamps[kept]), v[kept]
    size, power = float(change @ change), float(v @ v)
    if size == 0.0 or power == 0.0:
        return None
    return float(change @ v) / size, float(change @ v) / np.sqrt(size * power)


def _force_unit(claim: Claim, known: Joints) -> str:
    return "N" if claim.label.quantity == "force" or known.slides(claim.body) else "N m"


def _torque_doubt(claims: Sequence[Claim], sizes: Mapping[str, float], known: Joints) -> str:
    """What is strange about the largest torques of all joints, as shares of what the motors can do."""
    shares = [
        sizes[c.column]
        * (si_factor(c.label.unit, _force_unit(c, known)) if c.label.unit else 1.0)
        / known.ranges[c.body].effort
        for c in claims
        if c.label.quantity == "tau" and c.body in known.ranges and fits(c.label.unit or "N m", "N m", "N")
    ]
    most = max(shares, default=1.0)
    if WEAKEST <= most <= STRONGEST:
        return ""
    return f"{'up to' if most > 1 else 'at most'} {most:.2g} times what the motors can do"
