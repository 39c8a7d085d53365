"""Effects that act on what is measured."""

from armdyn.effects.effect import effect
from armdyn.parameter import quantity
from armdyn.pendulum.physics import Expression, Sensor


@effect(
    "sensor_bias",
    acts_on="sensor",
    summary="The load cell reads a constant too much.",
    source="offset error: JCGM 200 (VIM), §4.20",
)
def sensor_bias(
    sensor: Sensor,
    force: Expression = quantity("N", typical=0.01, summary="reading at no load"),
) -> Sensor:
    """F = T + b."""
    return sensor.with_force(sensor.force + force)


@effect(
    "sensor_delay",
    acts_on="sensor",
    summary="The load cell's samples arrive late by a constant time.",
    source="pure dead time: Åström & Murray, Feedback Systems, 2008, §9.2",
)
def sensor_delay(
    sensor: Sensor,
    time: Expression = quantity("s", typical=0.01, lower=0.0, upper=0.5, summary="how late"),
) -> Sensor:
    """F(t) = T(t - tau)."""
    return sensor.with_delay(time)
