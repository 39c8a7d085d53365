"""Possible mistakes in recordings of arms, one function for each kind of mistake."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import chain, combinations

import numpy as np

from armdyn.inspection.arm import IGNORED_LIMIT_EXCESS_TIME_SHARE
from armdyn.inspection.check import MODEL_PLACEHOLDER
from armdyn.inspection.correction import CorrectedReading, Correction
from armdyn.inspection.description import DescriptionCorrection
from armdyn.inspection.missing_effects import MIN_MOUNTING_ANGLE
from armdyn.inspection.mistake import (
    TRIED_SENSOR_LAGS_SECONDS,
    Mistake,
    scaled_channels_mistake,
    shifted_clock_mistakes,
)
from armdyn.inspection.together import SampledArmRuns

WRONG_ANGLE_UNIT_FACTORS = ((np.pi / 180.0, "degrees and called rad"), (180.0 / np.pi, "rad and called degrees"))
"""Factors that correct a wrong unit of angles, each with the mistake in words."""
NO_MOTION_FACTOR = 1e-9
"""Factor after which angles are those of a joint at rest, and friction still has its direction."""
TORQUE_UNITS: Mapping[str, tuple[float, float]] = {
    "mN m": (1e-3, 0.0), "N cm": (1e-2, 0.0), "kgf cm": (0.0980665, 2.0), "in lbf": (0.112984829, 2.0),
    "kgf m": (9.80665, 2.0), "ft lbf": (1.3558179483, 8.0),
}  # fmt: skip
"""Units of torque in which torques may be recorded: the unit in N m, and log odds against it, nats."""
SINGLE_JOINT_UNITS = ("mN m", "N cm")
"""Units of torque that the column of a single joint may have."""
TORQUE_CONSTANT_RANGE = (2.0, 400.0)
"""Range of torque constants with gears, N m/A: a smaller one is probably a gain, a larger one another unit."""
CURRENT_UNITS: Mapping[str, tuple[str, float]] = {"ampere": ("A", 1.0), "milliampere": ("mA", 1e-3)}
"""Units of current in which the currents of motors may be recorded: their symbols, and sizes in A."""
MAX_KNOWN_UNIT_TORQUE_RATIO = 1.5
"""Largest factor between torques in a known unit and the model's torques, which gains and loads may cause."""
MIN_UNEXPLAINED_TORQUE_FACTOR, UNEXPLAINED_FACTOR_PRICE_NATS = 3.0, 8.0
"""Least factor on all torques that no gain explains, and the log odds against it, in nats, compared with a known
unit."""
MASS_UNITS: Mapping[str, float] = {"g": 1e-3, "lb": 0.45359237}
LENGTH_UNITS: Mapping[str, float] = {"mm": 1e-3, "cm": 1e-2, "in": 0.0254}
"""SI values of the units of mass and of length in which a description may have been written by mistake."""
ANGLE_ZERO_OFFSETS_TRIED: Mapping[str, float] = {
    "a quarter turn": np.pi / 2, "minus a quarter turn": -np.pi / 2, "half a turn": np.pi,
}  # fmt: skip
TORQUE_CLOCK_SHIFTS_TRIED_SECONDS = (0.1, 0.15, 0.2, 0.3, 0.5)
"""Clock shifts of torques that are tried in both directions, s; a smaller delay is an effect of the torque sensor."""
TRIED_CLOCK_RATE_ERRORS = (-0.03, -0.02, -0.01, 0.01, 0.02, 0.03)
"""Relative errors of a clock's rate that are tried, as of two computers or of a wrong sampling rate."""
MIN_TIME_FACTOR = 1.25
"""Factor on time stamps from which on a wrong time base is tried, as inertias are not known better."""
TRIED_TORQUE_LOW_PASS_SECONDS = (0.1, 0.2, 0.4)
"""Time constants of low-passed torques that are tried, s."""
MIN_VIBRATION_FREQUENCY_HZ, MAX_VIBRATION_POWER_RATIO = 8.0, 10.0
"""Frequency from which on a torque is vibration, and largest ratio of its power to that of the motion: 4 as recorded by
Baxter's elastic drives, 400 if these torques were low-passed."""
SINGLE_JOINT_PRICE_NATS = 2.0
"""Log odds, in nats, against a mistake on one joint alone."""
LATE_CLOCK_PRICE_NATS = 6.0
"""Log odds, in nats, against a late clock, because torques of drives are low-passed and late anyway."""


def _recorded(runs: SampledArmRuns, kinds: str, joints: Iterable[str]) -> list[str]:
    return [name for kind in kinds for joint in joints if runs.has(name := f"{kind}.{joint}")]


def angle_unit_mistakes(runs: SampledArmRuns) -> Iterator[Mistake]:
    """Mistakes of angle units: degrees that are declared as rad, or the reverse."""
    turning = [joint for joint in runs.model.arm.joints if not runs.model.arm.sliding[joint]]
    beyond_limits = sum(run.cost_of_positions for run in runs.runs)
    for factor, said in WRONG_ANGLE_UNIT_FACTORS:
        yield scaled_channels_mistake("angle_unit", _recorded(runs, "qva", turning), f"angles are in {said}", factor)
        for joint in runs.joints if len(runs.joints) > 1 else ():
            if not runs.model.arm.sliding[joint] and (own := _recorded(runs, "qva", (joint,))):
                alone = scaled_channels_mistake(
                    "angle_unit", own, f"q.{joint} is in {said}", factor, price=SINGLE_JOINT_PRICE_NATS
                )
                # An elastic joint's motor may move otherwise than its link: then a smaller motion is not another unit.
                still = scaled_channels_mistake(
                    "angle_unit", own, f"q.{joint} tells no motion", NO_MOTION_FACTOR, price=beyond_limits
                )
                yield from (alone, replace(still, is_effect=True)) if factor < 1.0 else (alone,)


def torque_unit_mistakes(runs: SampledArmRuns) -> Iterator[Mistake]:
    """Mistakes of torque units: torques of all joints or of one joint in another unit, or currents."""
    every = tuple(runs.channels)
    for unit, (factor, price) in TORQUE_UNITS.items():
        yield scaled_channels_mistake(
            "torque_unit", every, f"torques are in {unit} and called N m", factor, price=price
        )
        for name in every if len(every) > 1 and unit in SINGLE_JOINT_UNITS else ():
            said = f"{name} is in {unit} and called N m"
            yield scaled_channels_mistake("torque_unit", (name,), said, factor, price=SINGLE_JOINT_PRICE_NATS)
    products, squares = (
        np.array([f @ y for f, y in zip(runs.described, runs.measured, strict=True)]),
        np.array([y @ y for y in runs.measured]),
    )
    constants = products / np.maximum(squares, 1e-300)
    likely = np.median(constants[constants > 0.0]) if np.any(constants > 0.0) else 0.0
    constants = np.where((constants > 0.02 * likely) & (constants < 50.0 * likely), constants, likely)
    whole = float(np.sum(products) / max(float(np.sum(squares)), 1e-300))
    listed = any(
        1.0 / MAX_KNOWN_UNIT_TORQUE_RATIO < whole / factor < MAX_KNOWN_UNIT_TORQUE_RATIO
        for factor, _ in TORQUE_UNITS.values()
    )
    if not listed and (whole > MIN_UNEXPLAINED_TORQUE_FACTOR or 0.0 < whole < 1.0 / MIN_UNEXPLAINED_TORQUE_FACTOR):
        size = f"{whole:.3g} times too small" if whole > 1.0 else f"{1.0 / whole:.3g} times too large"
        said = f"torques are about {size}: those of the motors before their gears, or in a unit of their own"
        yield replace(
            scaled_channels_mistake("torque_unit", every, said, whole, price=UNEXPLAINED_FACTOR_PRICE_NATS),
            remedy="give gear_ratio, or scale, in the map of 'armdyn import'", correctable=False,
        )  # fmt: skip
    for unit, (symbol, amperes) in CURRENT_UNITS.items():
        if not TORQUE_CONSTANT_RANGE[0] < likely / amperes < TORQUE_CONSTANT_RANGE[1]:
            continue
        readings = {name: CorrectedReading(name, float(k)) for name, k in zip(every, constants, strict=True)}
        sizes = ", ".join(f"{k:.3g}" for k in constants)
        yield Mistake(
            "torque_unit", every, f"torques are motor currents, in {unit}, and called N m",
            f"give torque_constant and gear_ratio in the map of 'armdyn import'; the model says about {sizes} "
            f"N m/{symbol}",
            Correction(readings), prior_odds_nats=3.0 * len(every), correctable=False,
        )  # fmt: skip


def sign_mistakes(runs: SampledArmRuns) -> Iterator[Mistake]:
    """Mistakes of signs: torques or positions with the opposite sign."""
    torques, several = list(runs.channels), len(runs.joints) > 1
    yield scaled_channels_mistake("torque_sign", torques, "all torques have the wrong sign", -1.0)
    for name in torques if len(torques) > 1 else ():
        yield scaled_channels_mistake("torque_sign", (name,), f"{name} has the wrong sign", -1.0)
    yield scaled_channels_mistake(
        "position_sign", _recorded(runs, "qva", runs.joints), "all positions have the wrong sign", -1.0
    )
    for joint in runs.joints if several else ():
        yield scaled_channels_mistake(
            "position_sign", _recorded(runs, "qva", (joint,)), f"q.{joint} counts the other way", -1.0
        )


def joint_order_mistakes(runs: SampledArmRuns) -> Iterator[Mistake]:
    """Mistakes of the order of columns: two joints exchanged, or all joints in another order."""
    joints = runs.joints
    by_name = tuple(sorted(joints))
    columns = {f"{a} and {b} are exchanged": {a: b, b: a} for a, b in combinations(joints, 2)}
    whole: dict[str, tuple[str, ...]] = {}
    if len(joints) > 2:
        whole["all joints are in reverse order"] = joints[::-1]
        whole["all joints are shifted by one"] = joints[1:] + joints[:1]
        whole["all joints are shifted by one to the other side"] = joints[-1:] + joints[:-1]
        if by_name not in (joints, joints[::-1]):
            whole["joints are in alphabetical order"] = tuple(by_name[joints.index(j)] for j in joints)
            said = "joints are in the robot's order under names in alphabetical order"
            whole[said] = tuple(joints[by_name.index(j)] for j in joints)
    columns |= {said: dict(zip(joints, order, strict=True)) for said, order in whole.items()}
    for said, column in columns.items():
        for kinds, noun in {"tau": "torques", "q v a": "positions", "q v a tau": "columns"}.items():
            readings = {
                f"{kind}.{joint}": CorrectedReading(f"{kind}.{other}")
                for kind in kinds.split()
                for joint, other in column.items()
                if joint != other and runs.has(f"{kind}.{joint}") and runs.has(f"{kind}.{other}")
            }
            if readings:
                yield Mistake(
                    "joints_swapped", tuple(readings), f"{noun}: {said}", correction=Correction(readings),
                    prior_odds_nats=1.0 * (kinds != "tau"),
                )  # fmt: skip


def zero_position_mistakes(runs: SampledArmRuns) -> Iterator[Mistake]:
    """Mistakes of a joint's zero position by a quarter or half a turn."""
    for joint in runs.joints:
        for said, offset in () if runs.model.arm.sliding[joint] else ANGLE_ZERO_OFFSETS_TRIED.items():
            name = f"q.{joint}"
            middle = float(np.median([np.median(run.run.channels[name].value) for run in runs.runs]))
            # The corrected angle is within half a turn: a joint that goes round has no other.
            whole = middle - offset - np.remainder(middle - offset + np.pi, 2.0 * np.pi) + np.pi
            yield scaled_channels_mistake(
                "position_offset", (name,), f"the zero of {name} is off by {said}", offset=-offset - whole
            )


def clock_mistakes(runs: SampledArmRuns) -> Iterator[Mistake]:
    """Mistakes of the clock of torques against that of positions; early torques may be commands."""
    said, price = "torques are stamped {} against the positions", LATE_CLOCK_PRICE_NATS
    yield from shifted_clock_mistakes(
        runs.channels,
        said,
        price,
        (*TRIED_SENSOR_LAGS_SECONDS, *TORQUE_CLOCK_SHIFTS_TRIED_SECONDS),
        TRIED_CLOCK_RATE_ERRORS,
    )
    commands = f"{said}, or are commands, which the drive follows later"
    yield from shifted_clock_mistakes(
        runs.channels, commands, price, (-late for late in TORQUE_CLOCK_SHIFTS_TRIED_SECONDS)
    )


def time_base_mistakes(runs: SampledArmRuns) -> Iterator[Mistake]:
    """Mistakes of the time base: stamps of another rate than that of the samples, by the size of inertial torques."""
    square = runs.inertial_factor
    if square <= 0.0 or 1.0 / MIN_TIME_FACTOR < (factor := float(np.sqrt(square))) < MIN_TIME_FACTOR:
        return
    names = [*_recorded(runs, "qva", runs.model.arm.joints), *runs.channels]

    def of_pace(factor: float) -> Correction:
        return Correction({name: CorrectedReading(name, clock_rate_error=factor - 1.0) for name in names})

    slow = f"{factor:.3g} times too far apart" if factor > 1.0 else f"{1.0 / factor:.3g} times too close together"
    found = Mistake(
        "rate", tuple(names), f"time stamps are about {slow}: accelerations do not fit the torques",
        "look up the rate of the samples, or the unit of 'time', and divide the stamps",
        correction=of_pace(factor), prior_odds_nats=UNEXPLAINED_FACTOR_PRICE_NATS, correctable=False,
    )  # fmt: skip
    # Where inertial torques are lost in others, slower ones fit as well.
    yield from (found, replace(found, correction=of_pace(0.1 * factor), is_effect=True)) if factor < 1.0 else (found,)


def gravity_mistakes(runs: SampledArmRuns) -> Iterator[Mistake]:
    """Mistakes of gravity: another direction than described, or gravity subtracted from the torques."""
    g = runs.model.gravity()
    size = float(np.linalg.norm(g))
    if size == 0.0:
        return
    axes = [*np.eye(3), *-np.eye(3)]
    ways, found = list(axes), runs.gravity
    length = float(np.linalg.norm(found))
    if length > 0.3 * size and max(axis @ found for axis in axes) < np.cos(MIN_MOUNTING_ANGLE) * length:
        ways.append(found / length)
    for way in ways:
        if way @ g > np.cos(MIN_MOUNTING_ANGLE) * size:
            continue
        there = size * way + 0.0
        roll, pitch = roll_and_pitch(there)
        recording = runs.runs[0].run.source or runs.runs[0].run.name
        yield Mistake(
            "gravity_direction", runs.channels,
            f"gravity acts along ({there[0]:.3g}, {there[1]:.3g}, {there[2]:.3g}) m/s^2 in the frame of the base, "
            "not as described: the arm is mounted on a wall, a ceiling or a slope",
            f'mount the base in the URDF with rpy="{roll:.4g} {pitch:.4g} 0", or tell the model: '
            f"'armdyn add {MODEL_PLACEHOLDER} base_tilt {recording} --trust-data' "
            f"(roll {roll:.3g} rad, pitch {pitch:.3g} rad)",
            description=DescriptionCorrection(gravity=tuple(there.tolist())), prior_odds_nats=3.0,
        )  # fmt: skip
    for out in (DescriptionCorrection(gravity=(0.0, 0.0, 0.0)), DescriptionCorrection(compensated=True)):
        yield Mistake(
            "without_gravity", runs.channels, "gravity is already taken out of the torques",
            "record the whole measured torque (libfranka: tau_J, not tau_J_d)", description=out,
        )  # fmt: skip


def roll_and_pitch(gravity: np.ndarray) -> tuple[float, float]:
    """Roll and pitch of a base, rad, from `gravity` (3,) in the frame of the base."""
    up = -gravity / np.linalg.norm(gravity)
    # R_x(-roll) R_y(-pitch) e_z = (-sin p, cos p sin r, cos p cos r)
    return float(np.arctan2(up[1], up[2])), float(np.arctan2(-up[0], np.hypot(up[1], up[2])))


def torque_reading_mistakes(runs: SampledArmRuns) -> Iterator[Mistake]:
    """Mistakes of recorded torques that cannot be corrected: low-passed, or without sign."""
    for lag in (lag for lag in TRIED_TORQUE_LOW_PASS_SECONDS if could_be_low_passed(runs, lag)):
        yield Mistake(
            "filtered", runs.channels, f"torques are low-passed with a time constant of about {lag:g} s",
            "record torques as the drives measure them: averages over so long a time are late, and lack what is fast",
            description=DescriptionCorrection(lag=lag), prior_odds_nats=LATE_CLOCK_PRICE_NATS,
        )  # fmt: skip
    share = IGNORED_LIMIT_EXCESS_TIME_SHARE
    if all(np.quantile(y, share) >= -share * np.max(np.abs(y)) for y in runs.measured):
        yield Mistake(
            "sign_missing", runs.channels, "torques are magnitudes: their signs are lost",
            "record torques with their signs", description=DescriptionCorrection(magnitudes=True),
            prior_odds_nats=-len(runs.channels) * float(np.log(2.0)),  # otherwise each has one sign by chance
        )  # fmt: skip


def could_be_low_passed(runs: SampledArmRuns, lag: float) -> bool:
    """Whether torques may be behind a low-pass with a time constant `lag`, s, by their spectra.

    Before it they had the power of y + lag y', which at high frequencies is vibration.
    """
    ratios = []
    for run in runs.runs:
        for channel in (run.run.channels[name] for name in run.channels):
            time = np.linspace(channel.time[0], channel.time[-1], len(channel))
            value = np.interp(time, channel.time, channel.value)
            frequency = np.fft.rfftfreq(len(time), time[1] - time[0])
            power = np.abs(np.fft.rfft((value - value.mean()) * np.hanning(len(time)))) ** 2
            power *= 1.0 + (2.0 * np.pi * lag * frequency) ** 2
            low = frequency < MIN_VIBRATION_FREQUENCY_HZ
            ratios.append(float(power[~low].sum() / max(power[low].sum(), np.finfo(float).tiny)))
    return float(np.median(ratios)) < MAX_VIBRATION_POWER_RATIO


def description_mistakes(runs: SampledArmRuns) -> Iterator[Mistake]:
    """Mistakes of the description: masses or lengths in another unit."""
    for unit, factor in MASS_UNITS.items():
        yield Mistake(
            "scale", runs.channels, f"masses of the description are in {unit} and read as kg",
            f"multiply every mass and inertia of the URDF by {factor:g}",
            description=DescriptionCorrection(mass=factor),
        )  # fmt: skip
    for unit, factor in LENGTH_UNITS.items():
        yield Mistake(
            "scale", runs.channels, f"lengths of the description are in {unit} and read as m",
            f"multiply every length of the URDF by {factor:g}", description=DescriptionCorrection(length=factor),
        )  # fmt: skip


ARM_MISTAKES = (
    angle_unit_mistakes,
    torque_unit_mistakes,
    sign_mistakes,
    joint_order_mistakes,
    zero_position_mistakes,
    clock_mistakes,
    time_base_mistakes,
    gravity_mistakes,
    torque_reading_mistakes,
    description_mistakes,
)
"""Functions that yield the possible mistakes in a recording of an arm; a new kind of mistake is a further function."""


def arm_mistakes(runs: SampledArmRuns) -> Iterator[Mistake]:
    """All possible mistakes in recordings of an arm."""
    return chain.from_iterable(kind(runs) for kind in ARM_MISTAKES)
