"""Settings of the simulated robot: load, string, joint controller, sensors and box."""

import math
from dataclasses import dataclass, field, is_dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

import urdf
from armdyn.errors import InputError
from pipeline.box import LOAD_RADIUS, Box
from pipeline.robot.protocol import Vector

NON_NEGATIVE_RANGE = (0.0, math.inf)
POSITIVE_RANGE = (1e-3, math.inf)


def _check(settings: Any, **ranges: tuple[float, float]) -> None:
    """Refuse numbers that are not finite or outside their range; the default range is not negative."""
    for name, value in vars(settings).items():
        lower, upper = ranges.get(name, NON_NEGATIVE_RANGE)
        for number in () if value is None or is_dataclass(value) else np.atleast_1d(value):
            if not (math.isfinite(number) and lower <= number <= upper):
                raise InputError(
                    f"{type(settings).__name__}.{name} is {number:g}: give a finite value of at least {lower:g}"
                    + (f" and at most {upper:g}" if upper < math.inf else "")
                )


@dataclass(frozen=True)
class ServoSettings:
    """Settings of the simulated joint controller (PD with feed-forward torque), with one value per joint.

    Attributes:
        stiffness: proportional gain [N m/rad].
        damping: derivative gain [N m s/rad].
        armature: rotor inertia behind the gears [kg m^2].
        friction: dry friction of the joint, unknown to the controller [N m].
        command_filter_time_constant: time constant through which reference and feed-forward pass [s].
        hold_position_after_seconds: time without a command after which the arm brakes and holds [s].
        extrapolate: whether a commanded position continues along its velocity until the next command. If it is held
            instead, commanded velocity and acceleration are only used for the feed-forward.
    """

    stiffness: tuple[float, ...] = (800.0, 800.0, 600.0, 600.0, 120.0, 120.0, 60.0)
    damping: tuple[float, ...] = (40.0, 40.0, 25.0, 25.0, 5.0, 5.0, 2.5)
    armature: tuple[float, ...] = (0.05, 0.05, 0.05, 0.05, 0.01, 0.01, 0.01)
    friction: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0, 0.3, 0.3, 0.3)
    command_filter_time_constant: float = 0.015
    hold_position_after_seconds: float = 0.1
    extrapolate: bool = True

    def __post_init__(self) -> None:
        _check(self)


@dataclass(frozen=True)
class SimulatedJointSensorSettings:
    """Noise and resolution of the simulated encoders and effort sensors, as in recordings of the real Baxter.

    Attributes:
        resolution: step of the encoders [rad], 2 pi / 2^14 on Baxter.
        position_noise: standard deviation of positions before quantisation [rad].
        velocity_noise: standard deviation of velocities [rad/s].
        effort_noise: standard deviation of efforts, one per joint [N m].
    """

    resolution: float = 2 * math.pi / 2**14
    position_noise: float = 1e-4
    velocity_noise: float = 0.012
    effort_noise: tuple[float, ...] = (0.08, 0.08, 0.08, 0.08, 0.03, 0.03, 0.03)

    def __post_init__(self) -> None:
        _check(self)


@dataclass(frozen=True)
class CellSettings:
    """Settings of the simulated load cell and its connection to the computer.

    Attributes:
        period: time between samples [s].
        noise: standard deviation of one sample [N].
        resolution: step of the analogue-digital converter [N].
        full_scale: largest magnitude of a measured force [N]; that of a 1 kg cell by default.
        bias: zero error [N]; None for a random one with standard deviation `bias_std`.
        bias_std: standard deviation of a random zero error [N].
        latency: time from the force to the reception of its sample [s]; None for a random one, uniform from 0 to
            `max_random_latency`.
        max_random_latency: upper end of a random latency [s].
    """

    period: float = 0.01
    noise: float = 5e-3
    resolution: float = 5e-4
    full_scale: float = 9.80665
    bias: float | None = None
    bias_std: float = 0.01
    latency: float | None = None
    max_random_latency: float = 0.02

    def __post_init__(self) -> None:
        _check(self, period=POSITIVE_RANGE, full_scale=POSITIVE_RANGE, bias=(-math.inf, math.inf))


@dataclass(frozen=True)
class PlantSettings:
    """Settings of the simulated robot. Its random true values, which depend on a seed, are in `SimulatedRobot.truth`.

    Attributes:
        length: distance from the string's upper end to the load's centre, hanging at rest [m].
        mass: nominal mass of the load [kg].
        relative_mass_std: relative standard deviation of the true mass about the nominal mass.
        load_radius: radius of the load, a solid sphere [m].
        start_angle: swing angle at which the load is released at time 0 [rad].
        relative_inertia_std: largest relative error of mass and inertia of an arm link in the URDF, uniformly
            distributed.
        rigid_arm: whether the joints are immovable, so that the load is a pendulum with a fixed pivot.
        servo: joint controller and joint friction.
        readings: joint sensors.
        cell: load cell.
        box: box in which the load should come to rest; None for no box.
    """

    length: float = 0.368
    mass: float = 0.08
    relative_mass_std: float = 0.01
    load_radius: float = LOAD_RADIUS
    start_angle: float = 0.0
    relative_inertia_std: float = 0.1
    rigid_arm: bool = False
    servo: ServoSettings = field(default_factory=ServoSettings)
    readings: SimulatedJointSensorSettings = field(default_factory=SimulatedJointSensorSettings)
    cell: CellSettings = field(default_factory=CellSettings)
    box: Box | None = field(default_factory=Box)

    def __post_init__(self) -> None:
        spread, angle = (0.0, 0.5), (-math.pi / 2, math.pi / 2)
        positive = dict.fromkeys(("length", "mass", "load_radius"), POSITIVE_RANGE)
        _check(self, **positive, relative_mass_std=spread, relative_inertia_std=spread, start_angle=angle)
        if self.length <= self.load_radius:
            raise InputError(
                f"PlantSettings.length is {self.length:g} m: it must exceed load_radius, {self.load_radius:g} m"
            )


def checked_start_posture(robot: urdf.Robot, q_start: npt.ArrayLike, settings: PlantSettings) -> Vector:
    """The start posture as an array (n,) [rad], after a check of it and of the settings.

    Args:
        robot: description of the arm.
        q_start: start posture (n,) [rad].
        settings: settings of the simulated robot.

    Raises:
        InputError: a joint is beyond its limit, or a setting does not have one value per joint.
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
