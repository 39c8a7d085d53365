"""Effects of drives that do what they are told, see `[drives]` of a model file; one value a joint.

Gain, supply, limit and delay are what a drive *is* and stand in its table. What it adds while it is on is here.
"""

from armdyn.arm.physics import Expression, Joint
from armdyn.effects.effect import effect
from armdyn.parameter import quantity


@effect(
    acts_on="drive",
    summary="While the drive is on, its motor brakes in proportion to the speed; with open windings it does not.",
    source="k_t^2/R behind the gears: Siciliano, Sciavicco, Villani & Oriolo, Robotics, 2009, §5.2.1; while the drive "
    "is always on, it is joint_viscous_friction",
    needs=("enabled",),
)
def back_emf(
    joint: Joint,
    coefficient: Expression = quantity("N m s/rad", typical=2.0, lower=0.0, summary="torque per speed"),
) -> Joint:
    """Tau = c v while on."""
    return joint.with_torque(coefficient * joint.velocity * joint.on)
