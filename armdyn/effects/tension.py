"""Formulas of the string's tension that were published and are wrong.

They are not in the catalogue: nobody looks for them. A model file asks for one with ``tension = "printed"``, and a
comparison then shows where it fails.
"""

import casadi as ca

from armdyn.effects.effect import effect
from armdyn.pendulum.physics import STANDARD_GRAVITY, Tension


@effect(
    wrong=True,
    summary="The tension as printed in the paper: two wrong signs, and one mass is missing.",
    source="Wilson, Schultz, Ansari & Murphey, IEEE T-ASE 2016; the right one is in armdyn.pendulum.dynamics",
)
def printed_tension(tension: Tension) -> Tension:
    """T = m g cos(phi) - m l phi'^2 - u sin(phi); the equations of motion stay right."""
    m, phi = tension.mass, tension.angle
    return tension.with_value(
        m * STANDARD_GRAVITY * ca.cos(phi) - m * tension.length * tension.rate**2 - tension.acceleration * ca.sin(phi)
    )
