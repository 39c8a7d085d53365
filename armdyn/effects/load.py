"""Effects that act on the load."""

from armdyn.effects.effect import effect
from armdyn.parameter import quantity
from armdyn.pendulum.physics import Expression, Load


@effect(
    "linear_drag",
    acts_on="load",
    summary="Air drag in proportion to the load's speed.",
    source="Stokes 1851; Batchelor, An Introduction to Fluid Dynamics, 1967, §4.9",
)
def linear_drag(
    load: Load,
    coefficient: Expression = quantity("N s/m", typical=5e-3, lower=0.0, summary="force per speed"),
) -> Load:
    """F = -c v."""
    return load.with_force(-coefficient * load.velocity)
