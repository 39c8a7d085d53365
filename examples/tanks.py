"""A base of your own: water is pumped into a tank, runs into a second one below it, and from there back.

```console
$ armdyn new --base examples/tanks.py tanks.toml
$ armdyn repair tanks.toml day_1.csv day_2.csv --held-out day_3.csv --output repaired.toml
```

The recordings hold ``time [s]``, ``extra.pump [V]`` and ``extra.level [V]``, what the sensor of the lower tank says.
"""

from dataclasses import dataclass, replace

import casadi as ca

from armdyn.effects.effect import effect
from armdyn.parameter import quantity
from armdyn.physics import Equations, Expression, Moment, Rate, Stage, constant, physics, state


@dataclass(frozen=True)
class Pump(Stage):
    """What is said to the pump, V."""

    voltage: Expression


@dataclass(frozen=True)
class Brim(Stage):
    """The edge of the upper tank: its level, V; what runs over, V/s; and what the lower tank catches of that, V/s."""

    level: Expression
    lost: Expression
    caught: Expression


@physics(
    "tanks", summary="Two tanks, one below the other.", source="Torricelli 1643",
    parameters=(
        constant("pump", "1/s", 0.05, lower=1e-3, summary="rise of the upper level per volt"),
        constant("upper_hole", "V^0.5/s", 0.07, lower=1e-3),
        constant("lower_hole", "V^0.5/s", 0.07, lower=1e-3),
    ),
    states=(
        state("upper", "V", typical=5.0, start=4.0, lower=0.0),
        state("lower", "V", typical=5.0, start=4.0, lower=0.0),
    ),
    inputs={"extra.pump": "V"}, outputs={"extra.level": "V"}, period=150.0,
)  # fmt: skip
def tanks(at: Moment) -> Equations:
    """Water runs out by the root of its level."""
    first = at["upper_hole"] * ca.sqrt(ca.fmax(at["upper"], 1e-4))
    second = at["lower_hole"] * ca.sqrt(ca.fmax(at["lower"], 1e-4))
    pump = at.stage("pump", Pump(at.input("extra.pump").value))
    brim = at.stage("brim", Brim(at["upper"], lost=0, caught=0))
    rates = {"upper": at["pump"] * pump.voltage - first - brim.lost, "lower": first + brim.caught - second}
    return Equations(rates, {"extra.level": at["lower"]})


@effect(summary="The pump begins to pump at a voltage.", source="of its own")
def dead_zone(pump: Pump, width: Expression = quantity("V", typical=0.5, lower=0.0)) -> Pump:
    """max(0, voltage - width)."""
    return replace(pump, voltage=pump.voltage - ca.fmin(pump.voltage, width))


SIZE = quantity("1/s", typical=0.1, lower=0.0, upper=1.0)  # at 1/s nothing stands above the edge for longer than 1 s
EDGE = quantity("V", typical=1.0, null=8.0, lower=0.0)


@effect(acts_on="rate", summary="A tank overflows beyond an edge.", source="of its own")
def overflow(rate: Rate, size: Expression = SIZE, edge: Expression = EDGE) -> Rate:
    """-size * max(0, level - edge)."""
    return rate.with_rate(-size * ca.fmax(rate[rate.state] - edge, 0))


@effect(summary="The upper tank overflows, and the lower one catches a share.", source="of its own")
def overflow_below(
    brim: Brim,
    size: Expression = SIZE,
    edge: Expression = EDGE,
    share: Expression = quantity("1", typical=0.5, null=0.5, lower=0.0, upper=1.0),
) -> Brim:
    """Two rates at once: size * max(0, level - edge) leaves the upper tank, a share of it comes into the lower one."""
    over = size * ca.fmax(brim.level - edge, 0)
    return replace(brim, lost=brim.lost + over, caught=brim.caught + share * over)
