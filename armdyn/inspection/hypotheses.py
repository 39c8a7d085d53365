"""Common mistakes in recordings of arms, one function per kind; each yields corrections or changed descriptions."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from armdyn.inspection.arm import AS_DESCRIBED, IGNORED_MOMENTS_SHARE, ArmRun, Description
from armdyn.inspection.check import MODEL_PLACEHOLDER, Kind
from armdyn.inspection.correction import Correction, Reading

RAD_PER_DEGREE = np.pi / 180.0
TORQUE_UNITS: Mapping[str, tuple[float, float]] = {
    "mN m": (1e-3, 0.0), "N cm": (1e-2, 0.0), "kgf cm": (0.0980665, 2.0), "in lbf": (0.112984829, 2.0),
    "kgf m": (9.80665, 2.0), "ft lbf": (1.3558179483, 8.0),
}  # fmt: skip
"""Torque units in N m, and their price in nats: a foot-pound is close to the effect of gains and loads."""
SINGLE_JOINT_UNITS = ("mN m", "N cm")
"""Units that a single joint's column may have."""
TORQUE_CONSTANT_RANGE = (2.0, 400.0)
"""Range of torque constants with gears, N m/A: a smaller one is probably a gain, a larger one another unit."""
UNIT_TOLERANCE_FACTOR = 1.5
"""Factor from a known unit within which gains and loads may lie."""
MIN_OWN_FACTOR, OWN_FACTOR_PRICE_NATS = 3.0, 8.0
"""Factor from which a joint's own factor is no gain, and its price in nats compared with a known unit."""
MASS_UNITS: Mapping[str, float] = {"g": 1e-3, "lb": 0.45359237}
LENGTH_UNITS: Mapping[str, float] = {"mm": 1e-3, "cm": 1e-2, "in": 0.0254}
"""SI values of the units in which a description may have been written."""
ZERO_OFFSETS: Mapping[str, float] = {
    "a quarter turn": np.pi / 2,
    "minus a quarter turn": -np.pi / 2,
    "half a turn": np.pi,
}
TORQUE_CLOCK_SHIFTS = (-0.5, -0.3, -0.2, -0.15, -0.1, 0.1, 0.15, 0.2, 0.3, 0.5)
"""Clock shifts that are tried, s; a smaller delay is an effect, that of the torque sensor."""
SENSOR_LAGS = (0.03, 0.06, 0.09)
"""Lags of a gripper or a sensor, s, which are effects."""
CLOCK_RATE_ERRORS = (-0.03, -0.02, -0.01, 0.01, 0.02, 0.03)
"""Relative rate errors that are tried, of two computers' clocks or of a wrong sampling rate."""
TIME_CONSTANTS = (0.1, 0.2, 0.4)
"""Time constants of averaged torques that are tried, s."""
SINGLE_JOINT_PRICE_NATS = 2.0
"""Price, in nats, of a mistake on one joint alone."""
LATE_CLOCK_PRICE_NATS = 6.0
"""Price, in nats, of a late clock: torques of drives are low-passed and late in themselves."""
MIN_MOUNTING_ANGLE = np.deg2rad(12.0)
"""Angle between gravity and its description from which the arm is mounted differently, rather than on a tilted base,
rad.
"""


@dataclass(frozen=True)
class Hypothesis:
    """One hypothesis on how a recording was made.

    Attributes:
        kind: kind of the mistake.
        channels: channels concerned.
        said: the mistake in words, for a reader.
        remedy: what to do where the correction does not solve it.
        correction: correction of the recording.
        description: correction of the arm's description.
        price: log prior odds against it, nats.
        sure: whether the correction is known; one estimated with the model would hide what the model lacks.
        effect: whether it is an effect instead of a mistake; then nothing is reported where it explains best.
        clock: sentence on a clock, with a placeholder for its error, which is fitted; empty for other mistakes.
    """

    kind: Kind
    channels: tuple[str, ...]
    said: str
    remedy: str = ""
    correction: Correction = field(default_factory=Correction)
    description: Description = AS_DESCRIBED
    price: float = 0.0
    sure: bool = True
    effect: bool = False
    clock: str = ""

    @property
    def readings(self) -> tuple[Reading, ...]:
        """How the channels concerned are to be read."""
        return tuple(self.correction.readings.values())

    @property
    def family(self) -> tuple[object, ...]:
        """Key of the hypotheses that differ only in the fitted error of a clock."""
        return self.kind, self.channels, self.clock or self.said

    def with_clock(self, late: float, pace: float) -> "Hypothesis":
        """The hypothesis with another error of the clock of all its channels."""
        correction = Correction(
            {name: replace(r, late=late, pace=pace) for name, r in self.correction.readings.items()}
        )
        return replace(self, said=self.clock.format(stamps(late, pace)), correction=correction)


def stamps(late: float, pace: float) -> str:
    """The error of stamps in words, for a sentence."""
    shift = f"{abs(late):.3g} s too {'late' if late > 0.0 else 'early'}"
    drift = f"by a clock that runs {100.0 * abs(pace):.2g} % {'fast' if pace > 0.0 else 'slow'}"
    return drift if pace and abs(late) < MIN_CLOCK_SHIFT else f"{shift} and {drift}" if pace else shift


MIN_CLOCK_SHIFT = 5e-3
"""Clock shift below which stamps count as right, s."""
Mistake = Callable[[ArmRun], Iterator[Hypothesis]]


def read_as(
    kind: Kind,
    channels: Iterable[str],
    said: str,
    factor: float = 1.0,
    *,
    offset: float = 0.0,
    late: float = 0.0,
    pace: float = 0.0,
    price: float = 0.0,
) -> Hypothesis:
    """Hypothesis that some channels have one factor, offset and clock error; a small delay is an effect."""
    channels = tuple(channels)
    correction = Correction({name: Reading(name, factor, offset, late, pace) for name in channels})
    return Hypothesis(kind, channels, said, correction=correction, price=price, effect=late in SENSOR_LAGS)


def stamped(channels: Iterable[str], times: Iterable[float], said: str, price: float) -> Iterator[Hypothesis]:
    """Hypotheses that channels' stamps are late or early; `said` is a sentence with a placeholder for the amount."""
    channels = tuple(channels)
    for late in (*SENSOR_LAGS, *times):
        found = read_as("clock_shift", channels, said.format(stamps(late, 0.0)), late=late, price=price)
        yield replace(found, clock=said)


def _recorded(run: ArmRun, kinds: str, joints: Iterable[str]) -> list[str]:
    return [name for kind in kinds for joint in joints if (name := f"{kind}.{joint}") in run.run.channels]


def _renamed(run: ArmRun, order: Mapping[str, str], kinds: str) -> tuple[tuple[str, ...], Correction]:
    """Joints recorded under another name, and the correction; `order` gives the column of each joint."""
    readings = {
        f"{kind}.{joint}": Reading(f"{kind}.{other}")
        for kind in kinds.split()
        for joint, other in order.items()
        if joint != other and f"{kind}.{joint}" in run.run.channels and f"{kind}.{other}" in run.run.channels
    }
    return tuple(readings), Correction(readings)


def angle_units(run: ArmRun) -> Iterator[Hypothesis]:
    """Hypotheses that degrees are declared as rad, or the reverse."""
    channels = _recorded(run, "qva", (j for j in run.model.arm.joints if not run.slides(j)))
    yield read_as("angle_unit", channels, "angles are in degrees and called rad", RAD_PER_DEGREE)
    yield read_as("angle_unit", channels, "angles are in rad and called degrees", 1 / RAD_PER_DEGREE)
    for joint in run.joints if len(run.joints) > 1 else ():
        own = () if run.slides(joint) else _recorded(run, "qva", (joint,))
        for factor, said in (RAD_PER_DEGREE, "degrees and called rad"), (1 / RAD_PER_DEGREE, "rad and called degrees"):
            if own:
                yield read_as("angle_unit", own, f"q.{joint} is in {said}", factor, price=SINGLE_JOINT_PRICE_NATS)


def torque_units(run: ArmRun) -> Iterator[Hypothesis]:
    """Hypotheses that torques of all joints or of one are in another unit, or are currents."""
    every = list(run.channels)
    for unit, (factor, price) in TORQUE_UNITS.items():
        yield read_as("torque_unit", every, f"torques are in {unit} and called N m", factor, price=price)
        for name in every if len(every) > 1 and unit in SINGLE_JOINT_UNITS else ():
            yield read_as("torque_unit", (name,), f"{name} is in {unit} and called N m", factor, price=2.0)
    described, measured = run.described(run.motion), run.measured
    constants = np.sum(described * measured, axis=1) / np.maximum(np.sum(measured**2, axis=1), 1e-300)
    likely = np.median(constants[constants > 0.0]) if np.any(constants > 0.0) else 0.0
    constants = np.where((constants > 0.02 * likely) & (constants < 50.0 * likely), constants, likely)
    whole = float(np.sum(described * measured) / max(float(np.sum(measured**2)), 1e-300))
    listed = any(
        1.0 / UNIT_TOLERANCE_FACTOR < whole / factor < UNIT_TOLERANCE_FACTOR for factor, _ in TORQUE_UNITS.values()
    )
    if not listed and (whole > MIN_OWN_FACTOR or 0.0 < whole < 1.0 / MIN_OWN_FACTOR):
        size = f"{whole:.3g} times too small" if whole > 1.0 else f"{1.0 / whole:.3g} times too large"
        yield Hypothesis(
            "torque_unit", tuple(every), f"torques are about {size}: those of the motors before their gears, or in a "
            "unit of their own",
            "give gear_ratio, or scale, in the map of 'armdyn import'",
            Correction({name: Reading(name, whole) for name in every}), price=OWN_FACTOR_PRICE_NATS, sure=False,
        )  # fmt: skip
    if TORQUE_CONSTANT_RANGE[0] < likely < TORQUE_CONSTANT_RANGE[1]:
        readings = {name: Reading(name, float(k)) for name, k in zip(every, constants, strict=True)}
        sizes = ", ".join(f"{k:.3g}" for k in constants)
        yield Hypothesis(
            "torque_unit", tuple(every), "torques are motor currents, in ampere, and called N m",
            f"give torque_constant and gear_ratio in the map of 'armdyn import'; the model says about {sizes} N m/A",
            Correction(readings), price=3.0 * len(every), sure=False,
        )  # fmt: skip


def signs(run: ArmRun) -> Iterator[Hypothesis]:
    """Hypotheses that torques or positions have the opposite sign."""
    every, several = list(run.channels), len(run.joints) > 1
    yield read_as("torque_sign", every, "all torques have the wrong sign", -1.0)
    for name in every if len(every) > 1 else ():
        yield read_as("torque_sign", (name,), f"{name} has the wrong sign", -1.0)
    yield read_as("position_sign", _recorded(run, "qva", run.joints), "all positions have the wrong sign", -1.0)
    for joint in run.joints if several else ():
        yield read_as("position_sign", _recorded(run, "qva", (joint,)), f"q.{joint} counts the other way", -1.0)


def orders(run: ArmRun) -> Iterator[Hypothesis]:
    """Hypotheses that the columns of two joints are exchanged, or that all joints are in another order."""
    joints = run.joints
    if len(joints) < 2:
        return
    what = {"tau": "torques", "q v a": "positions", "q v a tau": "columns"}
    orders = {f"{a} and {b} are exchanged": {a: b, b: a} for a, b in combinations(joints, 2)}
    if len(joints) > 2:
        orders["all joints are in reverse order"] = dict(zip(joints, joints[::-1], strict=True))
        orders["all joints are shifted by one"] = dict(zip(joints, joints[1:] + joints[:1], strict=True))
        orders["all joints are shifted by one to the other side"] = dict(
            zip(joints, joints[-1:] + joints[:-1], strict=True)
        )
        by_name = tuple(sorted(joints))
        if by_name not in (joints, joints[::-1]):
            orders["joints are in alphabetical order"] = dict(
                zip(joints, (by_name[joints.index(j)] for j in joints), strict=True)
            )
            orders["joints are in the robot's order under names in alphabetical order"] = dict(
                zip(joints, (joints[by_name.index(j)] for j in joints), strict=True)
            )
    for said, order in orders.items():
        for kinds, noun in what.items():
            channels, correction = _renamed(run, order, kinds)
            if channels:
                yield Hypothesis(
                    "joints_swapped", channels, f"{noun}: {said}", correction=correction, price=1.0 * (kinds != "tau")
                )


def zeros(run: ArmRun) -> Iterator[Hypothesis]:
    """Hypotheses that the zero of one joint is off by a quarter or half a turn."""
    for joint in run.joints:
        for said, offset in () if run.slides(joint) else ZERO_OFFSETS.items():
            name = f"q.{joint}"
            yield read_as("position_offset", (name,), f"the zero of {name} is off by {said}", offset=-offset)


def clocks(run: ArmRun) -> Iterator[Hypothesis]:
    """Hypotheses that torques have another clock than positions; early torques may be commands."""
    said = "torques are stamped {} against the positions"
    yield from stamped(run.channels, [late for late in TORQUE_CLOCK_SHIFTS if late > 0.0], said, LATE_CLOCK_PRICE_NATS)
    for pace in CLOCK_RATE_ERRORS:
        found = read_as(
            "clock_shift", run.channels, said.format(stamps(0.0, pace)), pace=pace, price=LATE_CLOCK_PRICE_NATS
        )
        yield replace(found, clock=said)
    commands = ", or are commands, which the drive follows later"
    for late in (late for late in TORQUE_CLOCK_SHIFTS if late < 0.0):
        found = read_as(
            "clock_shift",
            run.channels,
            said.format(stamps(late, 0.0)) + commands,
            late=late,
            price=LATE_CLOCK_PRICE_NATS,
        )
        yield replace(found, clock=said + commands)


def mountings(run: ArmRun) -> Iterator[Hypothesis]:
    """Hypotheses that gravity has another direction than described, or was subtracted from the torques."""
    g = run.model.gravity()
    size = float(np.linalg.norm(g))
    if size == 0.0:
        return
    axes = [*np.eye(3), *-np.eye(3)]
    ways, found = list(axes), run.gravity(Correction())
    length = float(np.linalg.norm(found))
    if length > 0.3 * size and max(axis @ found for axis in axes) < np.cos(MIN_MOUNTING_ANGLE) * length:
        ways.append(found / length)
    for way in ways:
        if way @ g > np.cos(MIN_MOUNTING_ANGLE) * size:
            continue
        there = size * way + 0.0
        roll, pitch = rolled(there)
        recording = run.run.source or run.run.name
        yield Hypothesis(
            "gravity_direction", run.channels,
            f"gravity acts along ({there[0]:.3g}, {there[1]:.3g}, {there[2]:.3g}) m/s^2 in the frame of the base, "
            "not as described: the arm is mounted on a wall, a ceiling or a slope",
            f'mount the base in the URDF with rpy="{roll:.4g} {pitch:.4g} 0", or tell the model: '
            f"'armdyn add {MODEL_PLACEHOLDER} base_tilt {recording} --trust-data' "
            f"(roll {roll:.3g} rad, pitch {pitch:.3g} rad)",
            description=Description(gravity=tuple(there.tolist())), price=3.0,
        )  # fmt: skip
    for out in (Description(gravity=(0.0, 0.0, 0.0)), Description(compensated=True)):
        yield Hypothesis(
            "without_gravity", run.channels, "gravity is already taken out of the torques",
            "record the whole measured torque (libfranka: tau_J, not tau_J_d)", description=out,
        )  # fmt: skip


def rolled(gravity: np.ndarray) -> tuple[float, float]:
    """Roll and pitch of a base, rad, in whose frame gravity is (3,): g_base = (R_y(pitch) R_x(roll))' g."""
    up = -gravity / np.linalg.norm(gravity)
    # R_x(-roll) R_y(-pitch) e_z = (-sin p, cos p sin r, cos p cos r)
    return float(np.arctan2(up[1], up[2])), float(np.arctan2(-up[0], np.hypot(up[1], up[2])))


def readings(run: ArmRun) -> Iterator[Hypothesis]:
    """Hypotheses that torques were low-passed or lost their sign, which no correction can undo."""
    for lag in TIME_CONSTANTS:
        yield Hypothesis(
            "filtered", run.channels, f"torques are low-passed with a time constant of about {lag:g} s",
            "record torques as the drives measure them: averages over so long a time are late, and lack what is fast",
            description=Description(lag=lag), price=LATE_CLOCK_PRICE_NATS,
        )  # fmt: skip
    rows = run.measured
    if np.all(
        np.quantile(rows, IGNORED_MOMENTS_SHARE, axis=1) >= -IGNORED_MOMENTS_SHARE * np.max(np.abs(rows), axis=1)
    ):
        yield Hypothesis(
            "sign_missing", run.channels, "torques are magnitudes: their signs are lost",
            "record torques with their signs", description=Description(magnitudes=True),
        )  # fmt: skip


def descriptions(run: ArmRun) -> Iterator[Hypothesis]:
    """Hypotheses that masses or lengths of the description are in another unit."""
    for unit, factor in MASS_UNITS.items():
        yield Hypothesis(
            "scale", run.channels, f"masses of the description are in {unit} and read as kg",
            f"multiply every mass and inertia of the URDF by {factor:g}", description=Description(mass=factor),
        )  # fmt: skip
    for unit, factor in LENGTH_UNITS.items():
        yield Hypothesis(
            "scale", run.channels, f"lengths of the description are in {unit} and read as m",
            f"multiply every length of the URDF by {factor:g}", description=Description(length=factor),
        )  # fmt: skip


MISTAKES: tuple[Mistake, ...] = (
    angle_units,
    torque_units,
    signs,
    orders,
    zeros,
    clocks,
    mountings,
    readings,
    descriptions,
)
"""All kinds of mistakes; a new kind is a further function here."""
