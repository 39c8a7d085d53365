"""A base of your own: two links that swing freely below a fixed point, the angle of each hinge measured.

```console
$ armdyn new --base examples/double_pendulum.py double.toml --set upper_mass="0.5 kg +/- 1 g"
$ armdyn repair double.toml swing_1.csv swing_2.csv --held-out swing_3.csv --output repaired.toml
```

The recordings hold ``time [s]``, ``q.upper [rad]`` and ``q.lower [rad]``: the angle of the upper link against the
vertical, and that of the lower link against the upper one. Only the ratio of the masses shows in a free swing, so weigh
one of the links.
"""

from dataclasses import dataclass, replace

import casadi as ca

from armdyn.effects.effect import effect
from armdyn.parameter import quantity
from armdyn.physics import Equations, Expression, Moment, Reading, Stage, constant, physics, state

GRAVITY = 9.81
STANDSTILL = 0.02
"""rad/s; dry friction changes its sign over about this rate."""


@dataclass(frozen=True)
class Hinge(Stage):
    """A hinge: its angle (rad), its rate (rad/s), and the torque on the link below it (N m)."""

    angle: Expression
    rate: Expression
    torque: Expression = 0

    def with_torque(self, torque: Expression) -> "Hinge":
        """Add a torque on the link below, N m."""
        return replace(self, torque=self.torque + torque)


@physics(
    "double_pendulum",
    summary="Two uniform rods on hinges, swinging freely below a fixed point.",
    source="Lagrange's equations of two rigid links: Siciliano et al., Robotics, 2009, §7.3.2",
    parameters=(
        constant("upper_length", "m", 0.3, lower=0.02, upper=5.0, summary="hinge to hinge"),
        constant("lower_length", "m", 0.3, lower=0.02, upper=5.0, summary="hinge to end"),
        constant("upper_mass", "kg", 0.5, lower=1e-3, upper=50.0, summary="of the upper rod"),
        constant("lower_mass", "kg", 0.5, lower=1e-3, upper=50.0, summary="of the lower rod"),
    ),
    states=(
        state("upper_angle", "rad", typical=0.5),
        state("upper_rate", "rad/s", typical=2.0),
        state("lower_angle", "rad", typical=0.5),
        state("lower_rate", "rad/s", typical=2.0),
    ),
    outputs={"q.upper": "rad", "q.lower": "rad"},
    period=1.0,
    step=0.005,
)
def double_pendulum(at: Moment) -> Equations:
    l1, l2, m1, m2 = at["upper_length"], at["lower_length"], at["upper_mass"], at["lower_mass"]
    q1, v1, q2, v2 = at["upper_angle"], at["upper_rate"], at["lower_angle"], at["lower_rate"]
    upper = at.stage("hinge", Hinge(q1, v1), "upper")
    lower = at.stage("hinge", Hinge(q2, v2), "lower")

    # B(q) a + C(q, v) v + g(q) = torques, the lower angle counted from the upper link.
    own, coupled = m2 * l2**2 / 3, m2 * l1 * l2 / 2 * ca.cos(q2)
    whole = m1 * l1**2 / 3 + m2 * l1**2 + own + 2 * coupled
    sling = m2 * l1 * l2 / 2 * ca.sin(q2)
    weight = m2 * GRAVITY * l2 / 2 * ca.sin(q1 + q2)
    first = upper.torque + sling * v2 * (2 * v1 + v2) - (m1 / 2 + m2) * GRAVITY * l1 * ca.sin(q1) - weight
    second = lower.torque - sling * v1**2 - weight
    mixed = own + coupled
    a1 = (own * first - mixed * second) / (whole * own - mixed**2)
    a2 = (second - mixed * a1) / own

    readings = {name: at.stage("encoder", Reading(q), name) for name, q in (("upper", q1), ("lower", q2))}
    return Equations(
        rates={"upper_angle": v1, "upper_rate": a1, "lower_angle": v2, "lower_rate": a2},
        outputs={f"q.{name}": reading for name, reading in readings.items()},
        against={
            "q.upper": (q1, "rad"), "v.upper": (v1, "rad/s"), "a.upper": (a1, "rad/s^2"),
            "q.lower": (q2, "rad"), "v.lower": (v2, "rad/s"), "a.lower": (a2, "rad/s^2"),
        },
    )  # fmt: skip


@effect(
    "hinge_viscous_friction",
    acts_on="hinge",
    summary="Friction in proportion to the hinge's rate.",
    source="Siciliano, Sciavicco, Villani & Oriolo, Robotics, 2009, §7.1",
)
def hinge_viscous_friction(
    hinge: Hinge, coefficient: Expression = quantity("N m s/rad", typical=1e-3, lower=0.0, summary="torque per rate")
) -> Hinge:
    return hinge.with_torque(-coefficient * hinge.rate)


@effect(
    "hinge_coulomb_friction",
    acts_on="hinge",
    summary="Dry friction of constant size against the motion.",
    source="Coulomb 1785; Armstrong-Hélouvry, Dupont & Canudas de Wit, Automatica 30, 1994",
)
def hinge_coulomb_friction(
    hinge: Hinge, torque: Expression = quantity("N m", typical=1e-3, lower=0.0, summary="size of the friction")
) -> Hinge:
    return hinge.with_torque(-torque * ca.tanh(hinge.rate / STANDSTILL))


@effect(
    "encoder_offset",
    acts_on="encoder",
    summary="The hinge's encoder does not say 0 where the links hang.",
    source="offset error: JCGM 200 (VIM), §4.20",
)
def encoder_offset(
    encoder: Reading, angle: Expression = quantity("rad", typical=0.01, summary="reading when hanging")
) -> Reading:
    return encoder.with_value(encoder.value + angle)
