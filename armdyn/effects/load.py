"""Effects that act on the load of a pendulum; v is its velocity."""

import casadi as ca

from armdyn.effects.effect import effect
from armdyn.parameter import quantity
from armdyn.pendulum.physics import Expression, Load


@effect(
    summary="Air drag in proportion to the load's speed.",
    source="Stokes 1851; Batchelor, An Introduction to Fluid Dynamics, 1967, §4.9",
)
def linear_drag(
    load: Load,
    coefficient: Expression = quantity("N s/m", typical=5e-3, lower=0.0, summary="force per speed"),
) -> Load:
    """F = -c v.

    F is the force on the load, v its velocity.
    """
    return load.with_force(-coefficient * load.velocity)


@effect(
    summary="Air drag growing with the square of the load's speed.",
    source="Batchelor, An Introduction to Fluid Dynamics, 1967, §5.11",
)
def quadratic_drag(
    load: Load,
    coefficient: Expression = quantity("N s^2/m^2", typical=3e-3, lower=0.0, summary="force per squared speed"),
) -> Load:
    """F = -c |v| v.

    F is the force on the load, v its velocity.
    """
    return load.with_force(-coefficient * load.speed * load.velocity)


@effect(
    summary="A constant horizontal force on the load, along the line.",
    source="drag of a steady stream much faster than the load: Batchelor 1967, §5.11",
)
def wind(
    load: Load,
    force: Expression = quantity("N", typical=5e-3, lower=-5.0, upper=5.0, summary="towards +"),
) -> Load:
    """F = (f, 0, 0).

    F is the force on the load; its first component is along the gripper's line.
    """
    return load.with_force(ca.vertcat(force, 0, 0))


@effect(
    summary="The load is an extended body that turns with the string, not a point.",
    source="physical pendulum: Goldstein, Classical Mechanics, 3rd ed., §5.3",
    needs=("load_force", "gripper_x"),
)
def load_inertia(
    load: Load,
    inertia: Expression = quantity("kg m^2", typical=2e-4, lower=0.0, upper=1.0, summary="about the load's centre"),
) -> Load:
    """Kinetic energy of the load + I phi'^2 / 2, phi' the rate of the swing angle."""
    return load.with_inertia(inertia)


@effect(
    summary="The load also swings across the line, which the angle does not show but the tension does.",
    source="spherical pendulum: Landau & Lifshitz, Mechanics, 3rd ed., §14; see armdyn.pendulum.transverse",
    needs=("load_force",),
)
def out_of_plane_swing(
    load: Load,
    square_angle: Expression = quantity(
        "rad^2", typical=2.5e-3, lower=0.0, upper=0.5, scope="per_run", summary="angle across, squared, at the start"
    ),
    square_rate: Expression = quantity(
        "rad^2/s^2", typical=0.05, lower=0.0, upper=20.0, scope="per_run", summary="rate across, squared, at the start"
    ),
    product: Expression = quantity(
        "rad^2/s", typical=0.01, lower=-5.0, upper=5.0, scope="per_run", summary="angle across times rate, at the start"
    ),
) -> Load:
    """Tension of a spherical pendulum that starts with the given squares of angle and rate across the line.

    Squares are fitted, because an angle and its opposite give the same tension.
    """
    return load.with_transverse(square_angle, product, square_rate)
