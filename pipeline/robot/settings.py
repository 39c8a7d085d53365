"""What the simulated robot is: load, string, servo, sensors, box; and which settings and postures are refused."""

import math
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
import numpy.typing as npt

import urdf
from armdyn.errors import InputError
from pipeline.box import Box
from pipeline.robot.protocol import Vector


class CellFault(Enum):
    """Faults of the simulated load cell."""

    UNPLUGGED = "no sample arrives any more"
    FROZEN = "the last sample is repeated"
    SATURATED = "the reading stands at full scale"


@dataclass(frozen=True)
class FaultAt:
    """A load cell fault and the time at which it sets in [s]."""

    fault: CellFault
    time: float


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
        _require_finite(self, ("stiffness", "damping", "armature", "friction"), at_least=0.0)
        _require_finite(self, ("filter_time", "hold_after"), at_least=0.0)


@dataclass(frozen=True)
class ReadingSettings:
    """Encoders and effort sensing, as on recordings of the real Baxter; one value per joint where several.

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
        _require_finite(self, ("resolution", "position_noise", "velocity_noise", "effort_noise"), at_least=0.0)


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
        faults: what breaks, and when.
    """

    period: float = 0.01
    noise: float = 5e-3
    resolution: float = 5e-4
    full_scale: float = 9.80665
    bias: float | None = None
    bias_spread: float = 0.01
    latency: float | None = None
    latency_up_to: float = 0.02
    faults: tuple[FaultAt, ...] = ()

    def __post_init__(self) -> None:
        _require_finite(self, ("noise", "resolution", "bias_spread", "latency_up_to"), at_least=0.0)
        _require_finite(self, ("period",), at_least=1e-3)
        _require_finite(self, ("full_scale",), at_least=1e-3)
        if self.latency is not None:
            _require_finite(self, ("latency",), at_least=0.0)
        if self.bias is not None:
            _require_finite(self, ("bias",))


@dataclass(frozen=True)
class PlantSettings:
    """The whole simulated robot. What is drawn per seed is in `SimulatedRobot.truth`.

    Attributes:
        length: from the string's upper end to the load's centre, hanging at rest [m].
        mass: what the load's label says [kg].
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
    load_radius: float = 0.014
    start_angle: float = 0.0
    inertia_spread: float = 0.1
    rigid_arm: bool = False
    servo: ServoSettings = field(default_factory=ServoSettings)
    readings: ReadingSettings = field(default_factory=ReadingSettings)
    cell: CellSettings = field(default_factory=CellSettings)
    box: Box | None = field(default_factory=Box)

    def __post_init__(self) -> None:
        _require_finite(self, ("length", "mass", "load_radius"), at_least=1e-3)
        _require_finite(self, ("mass_spread", "inertia_spread"), at_least=0.0, at_most=0.5)
        _require_finite(self, ("start_angle",), at_least=-math.pi / 2, at_most=math.pi / 2)
        if self.length <= self.load_radius:
            raise InputError(
                f"PlantSettings.length is {self.length:g} m: it must exceed load_radius, {self.load_radius:g} m"
            )

    @classmethod
    def exact(cls) -> "PlantSettings":
        """Nothing uncertain, nothing noisy: the label's mass, the URDF's inertias, no dry friction, ideal sensors."""
        default = cls()
        return cls(
            mass_spread=0.0,
            inertia_spread=0.0,
            servo=replace(default.servo, friction=(0.0,) * len(default.servo.friction)),
            readings=ReadingSettings(0.0, 0.0, 0.0, (0.0,) * len(default.readings.effort_noise)),
            cell=CellSettings(noise=0.0, resolution=0.0, bias=0.0, latency=0.0),
        )


def _require_finite(
    settings: object, names: tuple[str, ...], at_least: float = -math.inf, at_most: float = math.inf
) -> None:
    for name in names:
        value = getattr(settings, name)
        for number in value if isinstance(value, tuple) else (value,):
            if not (math.isfinite(number) and at_least <= number <= at_most):
                raise InputError(
                    f"{type(settings).__name__}.{name} is {number:g}: give a finite value of at least {at_least:g}"
                    + (f" and at most {at_most:g}" if at_most < math.inf else "")
                )


def checked_vector(values: npt.ArrayLike, joints: int, what: str) -> Vector:
    """A copy of a joint vector (n,).

    Raises:
        InputError: not a vector of that length, or not finite.
    """
    vector = np.array(values, dtype=float)
    if vector.shape != (joints,):
        raise InputError(f"{what} has the shape {vector.shape}: give one value for each of the {joints} joints")
    if not np.isfinite(vector).all():
        raise InputError(f"{what} of joint {int(np.argmin(np.isfinite(vector)))} is not finite: give numbers")
    return vector


def checked_start(robot: urdf.Robot, q_start: npt.ArrayLike, settings: PlantSettings) -> Vector:
    """Start posture (n,) [rad], within the limits of a robot for which the settings have a value per joint.

    Raises:
        InputError: which joint is beyond its limit, or which setting has the wrong number of values.
    """
    joints = len(robot.joint_names)
    servo, readings = settings.servo, settings.readings
    per_joint = {
        "servo.stiffness": servo.stiffness,
        "servo.damping": servo.damping,
        "servo.armature": servo.armature,
        "servo.friction": servo.friction,
        "readings.effort_noise": readings.effort_noise,
    }
    for name, values in per_joint.items():
        if len(values) != joints:
            raise InputError(f"PlantSettings.{name} has {len(values)} values: robot '{robot.name}' has {joints} joints")
    q = checked_vector(q_start, joints, "start posture")
    for name, angle, lower, upper in zip(robot.joint_names, q, robot.limits.lower, robot.limits.upper, strict=True):
        if not lower <= angle <= upper:
            raise InputError(f"start posture: {name} is {angle:.4g} rad, its limits are {lower:.4g} to {upper:.4g} rad")
    return q
