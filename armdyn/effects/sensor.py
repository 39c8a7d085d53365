"""Effects of a pendulum's sensors, in the order in which they act: mechanics of the load cell, then its electronics.

In the equations F is the load cell's reading, T the string's tension and phi the swing angle.
"""

from typing import Any

import casadi as ca

from armdyn.effects.effect import effect
from armdyn.parameter import quantity
from armdyn.pendulum.physics import Expression, Sensor

CHANNELS_WITH_OWN_CLOCK = ("gripper_x", "load_force", "swing_angle", "swing_rate")


def _late(channel: str, typical: float, most: float, summary: str) -> Any:
    """Parameter for the delay [s] of a channel's sensor; one sensor alone cannot show it in a free swing."""
    others = tuple(name for name in CHANNELS_WITH_OWN_CLOCK if name != channel)
    return quantity("s", typical=typical, lower=0.0, upper=most, summary=summary, needs=(channel,), beside=others)


@effect(
    summary="The load cell measures the vertical part of the string's pull instead of all of it.",
    source="projection on the sensing axis: Doebelin, Measurement Systems, 5th ed., §5.3",
    needs=("load_force",),
)
def vertical_sensing_axis(
    sensor: Sensor,
    share: Expression = quantity("1", typical=1.0, lower=0.0, upper=1.0, summary="1: vertical part only"),
) -> Sensor:
    """Reading F = T (1 - w (1 - cos phi)) of the load cell, T the string's tension, phi the swing angle."""
    return sensor.with_force(sensor.force - share * sensor.tension * (1 - ca.cos(sensor.true_angle)))


@effect(
    summary="The load cell also measures a share of the string's pull along the gripper's line.",
    source="cross-axis sensitivity: ISO 376; Doebelin, Measurement Systems, 5th ed., §5.3",
    needs=("load_force",),
)
def cross_axis_sensitivity(
    sensor: Sensor,
    share: Expression = quantity("1", typical=0.02, lower=-1.0, upper=1.0, summary="reading per force along the line"),
) -> Sensor:
    """Reading F = T + k T sin phi of the load cell, T the string's tension, phi the swing angle."""
    return sensor.with_force(sensor.force + share * sensor.tension * ca.sin(sensor.true_angle))


@effect(
    summary="The load cell's reading is not linear in the force.",
    source="second-order nonlinearity: Doebelin, Measurement Systems, 5th ed., §3.2",
    needs=("load_force",),
)
def sensor_nonlinearity(
    sensor: Sensor,
    curvature: Expression = quantity("1/N", typical=0.02, lower=-10.0, upper=10.0, summary="of the characteristic"),
) -> Sensor:
    """Reading F = T + k T^2 of the load cell, T the string's tension."""
    return sensor.with_force(sensor.force + curvature * sensor.force**2)


@effect(
    summary="The load cell reads a constant share too much.",
    source="scale error: JCGM 200 (VIM), §4.31",
    needs=("load_force",),
)
def sensor_gain(
    sensor: Sensor,
    error: Expression = quantity("1", typical=0.03, lower=-0.9, upper=10.0, summary="relative error of the reading"),
) -> Sensor:
    """Reading F = (1 + g) T of the load cell, T the string's tension."""
    return sensor.with_force((1 + error) * sensor.force)


@effect(
    summary="The load cell, or the rate gyro, reads a constant too much.",
    source="offset error: JCGM 200 (VIM), §4.20",
)
def sensor_bias(
    sensor: Sensor,
    force: Expression = quantity(
        "N", typical=0.01, summary="of a load cell: reading at no load", needs=("load_force",)
    ),
    rate: Expression = quantity(
        "rad/s", typical=0.05, summary="of a rate gyro: reading at rest", needs=("swing_rate",)
    ),
) -> Sensor:
    """Reading T + b of a load cell at the tension T, and phi' + b' of a rate gyro at the rate phi'.

    A sensor that was not recorded has no parameter.
    """
    return sensor.with_force(sensor.force + force).with_rate(sensor.rate + rate)


@effect(
    summary="The load cell's zero drifts at a constant rate.",
    source="zero drift: JCGM 200 (VIM), §4.21",
    needs=("load_force",),
)
def sensor_drift(
    sensor: Sensor,
    rate: Expression = quantity("N/s", typical=1e-3, summary="change of the reading at no load"),
) -> Sensor:
    """Reading F = T + r t of the load cell, T the string's tension, t the time since the start of the run."""
    return sensor.with_force(sensor.force + rate * sensor.time)


@effect(
    summary="A sensor follows what it measures as a first-order lag.",
    source="first-order instrument: Doebelin, Measurement Systems, 5th ed., §3.3",
)
def sensor_lag(
    sensor: Sensor,
    time: Expression = _late("load_force", 0.02, 1.0, "of a load cell: time constant"),
    angle_time: Expression = _late("swing_angle", 0.02, 1.0, "of an angle sensor: time constant"),
    rate_time: Expression = _late("swing_rate", 0.02, 1.0, "of a rate gyro: time constant"),
) -> Sensor:
    """First-order lag: tau dy/dt + y = x, y the reading, x the reading without lag.

    A sensor that was not recorded has no parameter.
    """
    return sensor.with_lag(time, angle_time, rate_time)


@effect(
    summary="A sensor's samples arrive late by a constant time.",
    source="pure dead time: Åström & Murray, Feedback Systems, 2008, §9.2",
)
def sensor_delay(
    sensor: Sensor,
    time: Expression = _late("load_force", 0.01, 0.5, "of a load cell: delay"),
    angle_time: Expression = _late("swing_angle", 0.01, 0.5, "of a camera or an encoder: delay"),
    rate_time: Expression = _late("swing_rate", 0.01, 0.5, "of a rate gyro: delay"),
) -> Sensor:
    """y(t) = x(t - tau), y the reading, x the reading without delay.

    A sensor that was not recorded has no parameter.
    """
    return sensor.with_delay(time, angle_time, rate_time)


@effect(
    summary="The angle sensor reads a constant share too much.",
    source="scale error: JCGM 200 (VIM), §4.31",
    needs=("swing_angle",),
)
def angle_gain(
    sensor: Sensor,
    error: Expression = quantity("1", typical=0.03, lower=-0.9, upper=5.0, summary="relative error of the reading"),
) -> Sensor:
    """Reading = (1 + g) phi at the swing angle phi; the reading of a rate gyro does not change."""
    return sensor.with_angle(sensor.angle + error * sensor.true_angle)


@effect(
    summary="The angle sensor reads more on one side than on the other, as a camera does beside the pivot's axis.",
    source="perspective of a plane seen obliquely, second order: Hartley & Zisserman, Multiple View Geometry, §2.3",
    needs=("swing_angle",),
)
def angle_skew(
    sensor: Sensor,
    curvature: Expression = quantity("1/rad", typical=0.05, lower=-1.0, upper=1.0, summary="reading per angle^2"),
) -> Sensor:
    """Reading = phi + c phi^2 at the swing angle phi; the reading of a rate gyro does not change."""
    return sensor.with_angle(sensor.angle + curvature * sensor.true_angle**2)


@effect(
    summary="The angle sensor's reading is not linear, alike on both sides, as behind a lens or with a worn track.",
    source="radial distortion, first term: Brown, Photogrammetric Engineering 37(8), 1971",
    needs=("swing_angle",),
)
def angle_distortion(
    sensor: Sensor,
    cubic: Expression = quantity("1/rad^2", typical=0.05, lower=-1.0, upper=1.0, summary="reading per angle^3"),
) -> Sensor:
    """Reading = phi + c phi^3 at the swing angle phi; the reading of a rate gyro does not change."""
    return sensor.with_angle(sensor.angle + cubic * sensor.true_angle**3)


@effect(
    summary="The angle sensor's reading has a constant offset.",
    source="offset error: JCGM 200 (VIM), §4.20",
    needs=("swing_angle",),
)
def angle_offset(
    sensor: Sensor,
    angle: Expression = quantity("rad", typical=0.01, lower=-1.0, upper=1.0, summary="reading when hanging"),
) -> Sensor:
    """Reading = phi + a of the angle sensor at the swing angle phi."""
    return sensor.with_angle(sensor.angle + angle)
