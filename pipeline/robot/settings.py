"""Settings of the simulated robot (load, string, servo, sensors, box), and checks of settings and postures."""

import math
from dataclasses import dataclass, field, is_dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

import urdf
from armdyn.errors import InputError
from pipeline.box import LOAD_RADIUS, Box
from pipeline.robot.protocol import Vector

NOT_NEGATIVE = (0.0, math.inf)
POSITIVE = (1e-3, math.inf)


def _check(settings: Any, **ranges: tuple[float, float]) -> None:
    """Refuse a number that is not finite, or outside its range where one is given, else negative; None is no value."""
    for name, value in vars(settings).items():
        lower, upper = ranges.get(name, NOT_NEGATIVE)
        for number in () if value is None or is_dataclass(value) else np.atleast_1d(value):
            if not (math.isfinite(number) and lower <= number <= upper):
                raise InputError(
                    f"{type(settings).__name__}.{name} is {number:g}: give a finite value of at least {lower:g}"
                    + (f" and at most {upper:g}" if upper < math.inf else "")
                )


@dataclass(frozen=True)
class ServoSettings:
    """The joint controller: PD on a filtered reference plus the nominal model's torque; one value per joint.

    Attributes:
        stiffness: proportional gain [N m/rad].
        damping: derivative gain [N m s/rad].
        armature: rotor inertia behind the gears [kg m^2].
        friction: dry friction of the joint, unknown to the controller [N m].
        filter_time: time constant through which reference and feed-forward pass [s].
        hold_after: without a command for this long the arm brakes and holds [s].
        extrapolate: whether a position is carried on along its velocity until the next command, or held; then its
            velocity and acceleration are feed-forward only.
    """

    stiffness: tuple[float, ...] = (800.0, 800.0, 600.0, 600.0, 120.0, 120.0, 60.0)
    damping: tuple[float, ...] = (40.0, 40.0, 25.0, 25.0, 5.0, 5.0, 2.5)
    armature: tuple[float, ...] = (0.05, 0.05, 0.05, 0.05, 0.01, 0.01, 0.01)
    friction: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0, 0.3, 0.3, 0.3)
    filter_time: float = 0.015
    hold_after: float = 0.1
    extrapolate: bool = True

    def __post_init__(self) -> None:
        _check(self)


@dataclass(frozen=True)
class ReadingSettings:
    """Encoders and effort sensors, as in recordings of the real Baxter; a value for all joints or one per joint.

    Attributes:
        resolution: step of the encoder [rad], 2 pi / 2^14 on Baxter.
        position_noise: standard deviation before quantisation [rad].
        velocity_noise: standard deviation [rad/s].
        effort_noise: standard deviation [N m].
    """

    resolution: float = 2 * math.pi / 2**14
    position_noise: float = 1e-4
    velocity_noise: float = 0.012
    effort_noise: tuple[float, ...] = (0.08, 0.08, 0.08, 0.08, 0.03, 0.03, 0.03)

    def __post_init__(self) -> None:
        _check(self)


@dataclass(frozen=True)
class CellSettings:
    """The load cell and its line to the computer.

    Attributes:
        period: time between samples [s].
        noise: standard deviation of one sample [N].
        resolution: step of the converter [N].
        full_scale: largest force that it can report, either sign [N]; a 1 kg cell by default.
        bias: zero error [N]; drawn with standard deviation `bias_spread` where None.
        bias_spread: see `bias` [N].
        latency: from the force to the reception of its sample [s]; drawn evenly from 0 to `latency_up_to` where None.
        latency_up_to: see `latency` [s].
    """

    period: float = 0.01
    noise: float = 5e-3
    resolution: float = 5e-4
    full_scale: float = 9.80665
    bias: float | None = None
    bias_spread: float = 0.01
    latency: float | None = None
    latency_up_to: float = 0.02

    def __post_init__(self) -> None:
        _check(self, period=POSITIVE, full_scale=POSITIVE, bias=(-math.inf, math.inf))


@dataclass(frozen=True)
class PlantSettings:
    """Settings of the whole simulated robot. Values that are drawn per seed are in `SimulatedRobot.truth`.

    Attributes:
        length: from the string's upper end to the load's centre, hanging at rest [m].
        mass: nominal mass of the load [kg].
        mass_spread: relative standard deviation of the true mass about the label.
        load_radius: radius of the load, a solid sphere [m].
        start_angle: swing angle at which the load is released at time 0 [rad].
        inertia_spread: mass and inertia of each arm link differ from the URDF by up to this share, drawn evenly.
        rigid_arm: joints that do not move at all: a pendulum with a fixed pivot.
        servo: joint controller and friction.
        readings: joint sensors.
        cell: load cell.
        box: where the load should end; None for no box.
    """

    length: float = 0.368
    mass: float = 0.08
    mass_spread: float = 0.01
    load_radius: float = LOAD_RADIUS
    start_angle: float = 0.0
    inertia_spread: float = 0.1
    rigid_arm: bool = False
    servo: ServoSettings = field(default_factory=ServoSettings)
    readings: ReadingSettings = field(default_factory=ReadingSettings)
    cell: CellSettings = field(default_factory=CellSettings)
    box: Box | None = field(default_factory=Box)

    def __post_init__(self) -> None:
        spread, angle = (0.0, 0.5), (-math.pi / 2, math.pi / 2)
        positive = dict.fromkeys(("length", "mass", "load_radius"), POSITIVE)
        _check(self, **positive, mass_spread=spread, inertia_spread=spread, start_angle=angle)
        if self.length <= self.load_radius:
            raise InputError(
                f"PlantSettings.length is {self.length:g} m: it must exceed load_radius, {self.load_radius:g} m"
            )


def checked_start(robot: urdf.Robot, q_start: npt.ArrayLike, settings: PlantSettings) -> Vector:
    """Start posture (n,) [rad], within the limits of a robot for which the settings have a value per joint.

    Raises:
        InputError: which joint is beyond its limit, or which setting has the wrong number of values.
    """
    q, joints, servo = np.array(q_start, dtype=float), len(robot.joint_names), settings.servo
    for name, values in (
        ("PlantSettings.servo.stiffness", servo.stiffness),
        ("PlantSettings.servo.damping", servo.damping),
        ("PlantSettings.servo.armature", servo.armature),
        ("PlantSettings.servo.friction", servo.friction),
        ("PlantSettings.readings.effort_noise", settings.readings.effort_noise),
        ("the start posture", q),
    ):
        if np.shape(values) != (joints,):
            raise InputError(f"{name} has {np.size(values)} values: robot '{robot.name}' has {joints} joints")
    for name, angle, lower, upper in zip(robot.joint_names, q, robot.limits.lower, robot.limits.upper, strict=True):
        if not lower <= angle <= upper:
            raise InputError(f"start posture: {name} is {angle:.4g} rad, its limits are {lower:.4g} to {upper:.4g} rad")
    return q
