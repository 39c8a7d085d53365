"""Judge the units of columns by their numbers: ranges of joints, slopes of positions, efforts of motors."""

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress

import numpy as np

from armdyn.errors import InputError
from armdyn.recording.channels import FloatArray, is_auxiliary
from armdyn.recording.units import si_factor, to_base_units
from pipeline.imports.claims import Claim
from pipeline.imports.foreign import ForeignColumn, ForeignRecording
from pipeline.imports.joints import UR_CURRENT_DOUBT, UR_JOINTS, JointRange, RobotJoints
from pipeline.imports.mapping import ColumnEntry
from pipeline.imports.words import is_unit_like, name_words

MAX_JOINT_ANGLE_IN_RADIANS = 7.0
"""Largest position of a joint that turns a little more than once [rad]; larger numbers are degrees."""
MIN_CERTAIN_DEGREES = 40.0
"""Position above which numbers are certainly degrees; in radians the joint would have turned six times."""
MIN_JOINTS_TO_INFER_RADIANS = 3
"""Smallest number of joints from whose positions radians are told from degrees; with fewer, all positions in degrees
may be as small as positions in radians."""
MAX_JOINT_RATE_RADIANS_PER_SECOND = 10.0 * MAX_JOINT_ANGLE_IN_RADIANS
"""Largest rate of a joint [rad/s]; without a recorded position, larger numbers are in degrees per second."""
MAX_PRISMATIC_POSITION_IN_METRES = 10.0
"""Largest position of a prismatic joint without limits [m]; larger numbers are in millimetres."""
MAX_EXCESS_SHARE_OF_JOINT_RANGE = 0.1
"""Largest distance of a joint's position from its range, as a share of the range."""
MAX_RELATIVE_SPEED_SLOPE_DIFFERENCE = 0.15
"""Largest relative difference of a speed from the slope of its position in the same unit."""
MIN_SPEED_SLOPE_CORRELATION = 0.7
"""Smallest correlation of a speed with the slope of its position; below, the speed may belong to another joint."""
MIN_PEAK_EFFORT_TO_LIMIT_RATIO, MAX_PEAK_EFFORT_TO_LIMIT_RATIO = 0.01, 1.5
"""Smallest and largest plausible ratio of the largest recorded torque to the motor's limit."""
UPRIGHT_MEAN_ANGLE_TOLERANCE = 0.5
"""Largest distance of the mean swing angle from half a turn at which the angle is measured from the upright [rad]."""
ASSUMED_UNIT_DOUBT = "unit assumed"
"""Doubt about a unit that neither the header nor the numbers determine."""
ANGLE_OR_SHARE_DOUBT = "degrees, radians or a share of the joint's range?"
"""Doubt about LeRobot's positions."""
SERVO_COUNTS_PER_TURN = (4096, 4095)
"""Counts of a servo's encoder in a turn, also as LeRobot divides them; in shares of a range they have other steps."""
ENCODER_COUNTS_DOUBT = "whole numbers: counts of an encoder, which need a scale? --drive KIND=all states a servo's"
"""Doubt about positions that are large whole numbers."""

LAST_WORD = re.compile(r"^(?P<name>.*[A-Za-z0-9])[ _(\[]+(?P<unit>[A-Za-zµ°%/]+)[)\]]?$")
"""A header whose last word may be a unit, such as ``heater_W``."""
USUAL_UNITS = {
    "C": "degC", "celsius": "degC", "F": "degF", "%": "percent", "pct": "percent", "lpm": "L/min", "volts": "V",
    "watts": "W", "amps": "A", **dict.fromkeys(("K", "W", "V", "A", "N", "J", "L", "m", "s", "g")),
}  # fmt: skip
"""Last words of headers that are units, and pint's name of each where it differs; no other single letter is one."""


def process_entries(columns: Mapping[str, ForeignColumn], time: str) -> dict[str, ColumnEntry]:
    """Mapping entry of every column that states a unit, as a further quantity of a process that the user describes.

    Args:
        columns: the columns of a table without joints and without a pendulum.
        time: name of the column with its time.
    """
    found, taken = dict[str, ColumnEntry](), set[str]()
    for header, column in columns.items():
        last = LAST_WORD.match(header)
        name, unit = (last["name"], last["unit"]) if last is not None and not column.unit else (header, column.unit)
        unit = USUAL_UNITS.get(unit) or unit
        own = "extra." + "_".join(name_words(name))
        if header == time or not unit or (len(unit) == 1 and unit not in USUAL_UNITS) or own in taken:
            continue
        with suppress(InputError):
            to_base_units(unit)
            if is_auxiliary(own):
                taken.add(own)
                found[header] = ColumnEntry(own, unit, why="a quantity of a process: a base of your own describes it")
    return found


def entries_with_inferred_units(
    claims: Sequence[Claim],
    columns: Mapping[str, Sequence[ForeignColumn]],
    known: RobotJoints,
    first: ForeignRecording,
    time: FloatArray | None,
) -> dict[str, ColumnEntry]:
    """Mapping entry of every claimed column, with its written unit or the one that its numbers suggest, and all doubts.

    Args:
        claims: one claim per channel.
        columns: columns of all recordings, by name.
        known: joints of the robot, or parts of a pendulum, with their ranges where they are known.
        first: recording whose positions are differentiated.
        time: stamps of its rows (n,) [s]; None where every column has its own time.
    """
    positions = {c.body: c for c in claims if c.label.quantity == "q"}
    sizes = {c.column: largest_magnitude(columns[c.column]) for c in claims}
    angle = _angle_unit([sizes[c.column] for b, c in positions.items() if not (known.slides(b) or c.label.unit)])
    strange = _torque_doubt(claims, sizes, known)
    shares = [columns[c.column] for c in claims if ANGLE_OR_SHARE_DOUBT in c.doubts]
    counts = next((n for n in SERVO_COUNTS_PER_TURN if all(_in_steps(each, 360.0 / n) for each in shares)), None)
    entries: dict[str, ColumnEntry] = {}
    for c in sorted(claims, key=lambda claim: claim.label.quantity != "q"):
        written, size, limits = c.label.unit, sizes[c.column], known.ranges.get(c.body)
        at = positions.get(c.body)
        of = entries[at.column].unit if at is not None and at is not c else "m" if known.slides(c.body) else angle[0]
        unit, why, doubts, constant = written, "unit as written", list(c.doubts), ""
        if counts is not None and ANGLE_OR_SHARE_DOUBT in doubts:
            doubts.remove(ANGLE_OR_SHARE_DOUBT)
            unit, why = "deg", f"in steps of 1/{counts} turn, as its encoder counts"
        if c.label.quantity == "q":
            if not unit:
                unit, why, doubt = _length_unit(size, limits) if limits is not None and limits.slides else angle
                doubts += [
                    doubt,
                    ENCODER_COUNTS_DOUBT if _is_whole(columns[c.column]) and size > MAX_JOINT_ANGLE_IN_RADIANS else "",
                ]
            doubts.append(_position_doubt(size, unit, limits))
            if c.body == "swing":
                mean = float(np.nanmean(np.concatenate([column.value for column in columns[c.column]])))
                upside_down = abs(abs(mean * si_factor(unit, "rad")) - np.pi) < UPRIGHT_MEAN_ANGLE_TOLERANCE
                doubts.append("it hangs at half a turn; 0 is hanging, give an offset" if upside_down else "")
        elif c.label.quantity == "v":
            unit, why, doubt = _rate_unit(written, of, size, _slope(first, c, at, time), bool(positions))
            doubts.append(doubt)
        elif c.label.quantity == "a":
            if not unit:
                unit, why = f"{of}/s^2", "as the position"
                doubts.append("" if positions else ASSUMED_UNIT_DOUBT)
        elif c.label.quantity == "current":
            unit, constant, why = unit or "A", "1 N m/A", "a current"
            doubts.append("the torque constant and the gear")
        else:
            doubts.append(strange)
            if not unit:
                unit, why = _force_unit(c, known), ASSUMED_UNIT_DOUBT
                doubts.append("" if c.label.quantity == "tau" else f"up to {size:.4g}: in N?")
                doubts.append(UR_CURRENT_DOUBT if "effort" in c.label.words and UR_JOINTS & set(known.arm) else "")
        entries[c.column] = ColumnEntry(c.channel, unit, torque_constant=constant, check=joined_doubts(doubts), why=why)
    return entries


def joined_doubts(doubts: Sequence[str]) -> str:
    """Join doubts to one text, without empty and repeated ones."""
    return "; ".join(dict.fromkeys(filter(None, doubts)))


def _in_steps(columns: Sequence[ForeignColumn], step: float) -> bool:
    """Whether all values are multiples of half a step; a zero may lie between two counts."""
    steps = np.concatenate([2.0 * c.value[np.isfinite(c.value)] / step for c in columns])
    off, largest = (np.abs(part).max(initial=0.0) for part in (steps - np.round(steps), steps))
    return bool(off < 0.02 and largest > 2.0)


def _is_whole(columns: Sequence[ForeignColumn]) -> bool:
    return all(np.all(np.isnan(c.value) | (c.value == np.round(c.value))) for c in columns)


def largest_magnitude(columns: Sequence[ForeignColumn]) -> float:
    """Largest magnitude of the numbers in columns; 0 where there are none."""
    with np.errstate(all="ignore"):
        return max((float(np.nanmax(np.abs(c.value))) for c in columns if np.isfinite(c.value).any()), default=0.0)


def span(value: FloatArray) -> float:
    """Largest less smallest of the numbers (n,) of a column; 0 where there are none."""
    there = value[np.isfinite(value)]
    return float(np.ptp(there)) if len(there) else 0.0


def _angle_unit(sizes: Sequence[float]) -> tuple[str, str, str]:
    """Unit, reason and doubt of all angles without a unit, from the largest magnitude of each."""
    most = max(sizes, default=0.0)
    if most > MAX_JOINT_ANGLE_IN_RADIANS:
        return "deg", f"up to {most:.4g}", "" if most > MIN_CERTAIN_DEGREES else "or rad, of a joint that turns on?"
    return "rad", f"up to {most:.4g}", "or deg?" if len(sizes) < MIN_JOINTS_TO_INFER_RADIANS else ""


def _length_unit(size: float, limits: JointRange) -> tuple[str, str, str]:
    """Unit, reason and doubt of the position of a prismatic joint."""
    unit = (
        "m"
        if size <= (1 + MAX_EXCESS_SHARE_OF_JOINT_RANGE) * min(limits.reach, MAX_PRISMATIC_POSITION_IN_METRES)
        else "mm"
    )
    return unit, f"up to {size:.4g}", "" if np.isfinite(limits.reach) else ASSUMED_UNIT_DOUBT


def _position_doubt(size: float, unit: str, limits: JointRange | None) -> str:
    """Doubt on the largest magnitude of a position; empty for none."""
    try:
        size *= si_factor(unit, "m" if limits is not None and limits.slides else "rad")
    except InputError:
        return "does the joint turn, or slide?" if limits is not None else ""
    if limits is None:
        return "so many turns?" if size > MIN_CERTAIN_DEGREES else ""
    return (
        f"beyond the joint's limit of {limits.reach:.3g}"
        if size > (1 + MAX_EXCESS_SHARE_OF_JOINT_RANGE) * limits.reach
        else ""
    )


def _rate_unit(
    written: str, of: str, size: float, slope: tuple[float, float] | None, positions: bool
) -> tuple[str, str, str]:
    """Unit, reason and doubt of a speed: the unit in which it is the slope of its position."""
    assumed = written or f"{of}/s"
    if slope is None:
        if written or positions:
            return assumed, "unit as written" if written else "as the position", ""
        degrees = of == "rad" and size > MAX_JOINT_RATE_RADIANS_PER_SECOND
        return "deg/s" if degrees else assumed, f"up to {size:.4g}", "" if degrees else ASSUMED_UNIT_DOUBT
    ratio, correlation = slope
    why = f"{ratio:.3g} times the position's slope"
    if correlation < MIN_SPEED_SLOPE_CORRELATION:
        return assumed, why, "it does not follow the position's slope"
    si, *others = ("rad/s", "deg/s") if is_unit_like(of, "rad") else ("m/s", "mm/s")
    for unit in (assumed, si, *others):
        if (
            is_unit_like(unit, si)
            and abs(ratio * si_factor(unit, si) / si_factor(f"{of}/s", si) - 1.0) < MAX_RELATIVE_SPEED_SLOPE_DIFFERENCE
        ):
            return unit, why, f"it is written {written}" if written and unit != written else ""
    return assumed, why, "the slope is not of that size"


def _slope(
    first: ForeignRecording, speed: Claim, position: Claim | None, time: FloatArray | None
) -> tuple[float, float] | None:
    """Ratio of a speed to the slope of its position, and their correlation; None where it moves not or is unknown."""
    if position is None or not {speed.column, position.column} <= first.columns.keys():
        return None
    x, v = first.columns[position.column], first.columns[speed.column].value
    stamps = time if time is not None else x.time
    return None if stamps is None else speed_to_slope(x.value, v, stamps)


def speed_to_slope(position: FloatArray, speed: FloatArray, time: FloatArray) -> tuple[float, float] | None:
    """Ratio of a speed (n,) to the slope of its position (n,), and their correlation; None where nothing moves."""
    if len(position) != len(speed):
        return None
    kept = np.isfinite(time) & np.isfinite(position) & np.isfinite(speed)
    kept &= np.diff(time, prepend=-np.inf) > 0.0
    if kept.sum() < MIN_JOINTS_TO_INFER_RADIANS:
        return None
    change, v = np.gradient(position[kept], time[kept]), speed[kept]
    size, power, common = float(change @ change), float(v @ v), float(change @ v)
    return (common / size, common / np.sqrt(size * power)) if size and power else None


def _force_unit(claim: Claim, known: RobotJoints) -> str:
    return "N" if claim.label.quantity == "force" or known.slides(claim.body) else "N m"


def _torque_doubt(claims: Sequence[Claim], sizes: Mapping[str, float], known: RobotJoints) -> str:
    """Doubt on the largest torques of all joints, compared with the motors' limits; empty for none."""
    shares = [
        sizes[c.column]
        * (si_factor(c.label.unit, _force_unit(c, known)) if c.label.unit else 1.0)
        / known.ranges[c.body].effort
        for c in claims
        if c.label.quantity == "tau" and c.body in known.ranges and is_unit_like(c.label.unit or "N m", "N m", "N")
    ]
    most = max(shares, default=1.0)
    if MIN_PEAK_EFFORT_TO_LIMIT_RATIO <= most <= MAX_PEAK_EFFORT_TO_LIMIT_RATIO:
        return ""
    return f"{'up to' if most > 1 else 'at most'} {most:.2g} times what the motors can do"
