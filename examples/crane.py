"""A base of your own: an overhead crane. Its trolley and its hoist move as recorded; the payload sways below.

```console
$ armdyn new --base examples/crane.py crane.toml --set mass="12 kg +/- 0.05 kg"
$ armdyn diagnose crane.toml lift_1.csv lift_2.csv
```

The recordings hold ``time [s]``, ``gripper_x [m]`` (the trolley), ``q.hoist [m]`` (rope paid out),
``swing_angle [rad]`` and, where there is a load cell, ``load_force [N]``. The payload is where the catalogue's drag,
wind and other forces on a load act, and the load cell where its sensor effects do: they need no line here.
"""

from dataclasses import dataclass, replace

import casadi as ca

from armdyn.effects.effect import effect
from armdyn.parameter import quantity
from armdyn.pendulum.physics import Load, Sensor
from armdyn.physics import Equations, Expression, Moment, Reading, Stage, constant, physics, state

GRAVITY = 9.81
STANDSTILL = 1e-3
"""m/s; friction in the sheave changes its sign over about this speed of the rope."""


@dataclass(frozen=True)
class Sheave(Stage):
    """The wheel over which the rope runs: the rope's speed downwards (m/s) and its pull on the drum (N)."""

    speed: Expression
    pull: Expression

    def with_pull(self, pull: Expression) -> "Sheave":
        """Let the rope pull the drum, and with it the load cell, with another force, N."""
        return replace(self, pull=pull)


@physics(
    "crane",
    summary="A payload on a rope below a trolley that moves, the rope being paid out and hauled in.",
    source="Newton in the frame of the rope; Abdel-Rahman, Nayfeh & Masoud, J. Vibration and Control 9, 2003, §2",
    parameters=(
        constant("mass", "kg", 10.0, lower=1e-3, upper=1e5, summary="of the payload with its hook"),
        constant("hook", "m", 0.0, typical=0.1, lower=-1.0, upper=5.0, summary="rope that the hoist does not count"),
    ),
    states=(
        state("sway", "rad", typical=0.1, lower=-3.2, upper=3.2),
        state("sway_rate", "rad/s", typical=0.3),
    ),
    inputs={"gripper_x": "m", "q.hoist": "m"},
    outputs={"swing_angle": "rad", "load_force": "N"},
    period=2.0,
)
def crane(at: Moment) -> Equations:
    mass, phi, rate = at["mass"], at["sway"], at["sway_rate"]
    trolley, hoist = at.input("gripper_x"), at.input("q.hoist")
    length, paid_out = at["hook"] + hoist.value, hoist.rate

    # The payload is at trolley + length * down, and moves along `across` when it sways.
    down, across = ca.vertcat(-ca.sin(phi), 0, -ca.cos(phi)), ca.vertcat(-ca.cos(phi), 0, ca.sin(phi))
    position = ca.vertcat(trolley.value, 0, 0) + length * down
    velocity = ca.vertcat(trolley.rate, 0, 0) + paid_out * down + length * rate * across
    load = at.stage("load", Load(at.time, mass, position, velocity, phi, rate))
    given = load.force / load.mass - ca.vertcat(trolley.acceleration, 0, GRAVITY)
    turning = (ca.dot(given, across) - 2 * paid_out * rate) / length
    tension = load.mass * (ca.dot(given, down) + length * rate**2 - hoist.acceleration)

    sheave = at.stage("sheave", Sheave(paid_out, tension))
    cell = at.stage("sensor", Sensor(at.time, tension, phi, sheave.pull, phi, rate))
    return Equations(
        rates={"sway": rate, "sway_rate": turning},
        outputs={"swing_angle": cell.angle, "load_force": Reading(cell.force, lag=cell.lag, delay=cell.delay)},
        against={
            "swing_angle": (phi, "rad"), "swing_rate": (rate, "rad/s"), "gripper_v": (trolley.rate, "m/s"),
            "hoist": (hoist.value, "m"), "hoist_speed": (paid_out, "m/s"),
        },
    )  # fmt: skip


@effect(
    "sheave_friction",
    acts_on="sheave",
    summary="The sheave holds the rope back by a share of its pull.",
    source="friction of a rope on a sheave: Feyrer, Wire Ropes, 2nd ed., §3.3",
)
def sheave_friction(
    sheave: Sheave, share: Expression = quantity("1", typical=0.01, lower=0.0, upper=0.5, summary="of the pull")
) -> Sheave:
    return sheave.with_pull(sheave.pull * (1 - share * ca.tanh(sheave.speed / STANDSTILL)))
