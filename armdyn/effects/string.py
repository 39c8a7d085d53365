"""Effects that act on a pendulum's string and on the pivot at its upper end; phi is the swing angle."""

import casadi as ca

from armdyn.effects.effect import effect
from armdyn.parameter import quantity
from armdyn.pendulum.physics import Expression, String


@effect(
    summary="A torque at the upper end against the swing, in proportion to its rate.",
    source="Armstrong-Hélouvry, Dupont & Canudas de Wit, Automatica 30(7), 1994, §2",
)
def pivot_viscous_friction(
    string: String,
    coefficient: Expression = quantity("N m s/rad", typical=1e-3, lower=0.0, summary="torque per rate"),
) -> String:
    """M = -c phi'.

    M is the torque at the string's upper end, phi' the rate of the swing angle.
    """
    return string.with_torque(-coefficient * string.rate)


@effect(
    summary="Dry friction of constant size at the upper end: it acts against the swing and holds a load at rest.",
    source="Coulomb 1785; Armstrong-Hélouvry, Dupont & Canudas de Wit, Automatica 30(7), 1994, §2",
)
def pivot_coulomb_friction(
    string: String,
    torque: Expression = quantity("N m", typical=1e-3, lower=0.0, summary="size of the torque"),
) -> String:
    """Torque M = -c sign(phi') in a swing of rate phi'; at rest any torque up to c that keeps the load at rest."""
    return string.with_dry_torque(torque)


@effect(
    summary="The pivot is stiff: a torque at the upper end back to the vertical, in proportion to the angle.",
    source="Hooke 1678; torsional spring: Goldstein, Classical Mechanics, 3rd ed., §6.1",
)
def pivot_stiffness(
    string: String,
    stiffness: Expression = quantity("N m/rad", typical=0.01, lower=0.0, summary="torque per angle"),
) -> String:
    """Torque M = -k phi at the swing angle phi.

    As with a shorter string, every swing is quicker; the period of a swing depends less on its size.
    """
    return string.with_torque(-stiffness * string.angle)


@effect(
    summary="The string stretches in proportion to its tension, and the load bounces on it.",
    source="Hooke 1678; followed on its slow manifold, see armdyn.pendulum.yielding",
    needs=("load_force",),
)
def string_elasticity(
    string: String,
    compliance: Expression = quantity("m/N", typical=2e-3, lower=0.0, upper=0.1, summary="stretch per tension"),
    damping: Expression = quantity(
        "1", typical=0.1, null=0.1, lower=0.0, upper=0.9, spread=0.1, summary="of the bounce, over the critical one"
    ),
) -> String:
    """Length l = l0 + s with m s'' + 2 z sqrt(m/c) s' + s/c = T, T the string's tension, m the load's mass."""
    return string.with_compliance(compliance, damping)


@effect(
    summary="The string has mass, spread evenly along it.",
    source="physical pendulum: Goldstein, Classical Mechanics, 3rd ed., §5.3",
    needs=("load_force", "gripper_x"),
)
def string_mass(
    string: String,
    mass: Expression = quantity("kg", typical=5e-3, lower=0.0, upper=50.0, summary="of the whole string"),
) -> String:
    """The string is a uniform rod of this mass between gripper and load."""
    return string.with_mass(mass)


@effect(
    summary="The string grows longer at a constant rate.",
    source="secondary creep: Findley, Lai & Onaran, Creep and Relaxation, 1976, §2",
)
def string_creep(
    string: String,
    rate: Expression = quantity("m/s", typical=1e-4, lower=-0.01, upper=0.01, summary="growth of the length"),
) -> String:
    """Length l = l0 + r t, t the time since the start of the run."""
    return string.with_length(string.length + rate * string.time)


# The last of its stage, so that it feels the pull of the string with its mass.
@effect(
    summary="Dry friction at the upper end that grows with the string's pull; it holds a load at rest.",
    source="Coulomb 1785, with the friction torque of a journal bearing: Beer & Johnston, Statics, 12th ed., §8.3",
)
def pivot_load_friction(
    string: String,
    radius: Expression = quantity(
        "m", typical=1e-3, lower=0.0, upper=1.0, summary="of the bearing, times its friction coefficient"
    ),
) -> String:
    """Torque M = -r |T| sign(phi') with T = m (g cos phi + l phi'^2), the string's pull for a gripper at rest."""
    return string.with_dry_torque(radius * ca.fabs(string.pull))
