"""Laws that no catalogue has, for the simulated robot: `armdyn trial --hidden examples/hidden_laws.py:leaf`.

The first parameter of each is what `=VALUE` gives, its typical size otherwise; the others are as they are here.
"""

import casadi as ca

from armdyn import effect, quantity


@effect(summary="Drag at the pivot that grows with the cube of the rate.", source="an oil-filled hinge")
def oily_hinge(string, coefficient=quantity("N m s^3/rad^3", typical=1e-3, lower=0, upper=0.1)):
    """M = -c rate^3."""
    return string.with_torque(-coefficient * string.rate**3)


@effect(summary="The string rubs on an edge, on one side only.", source="a guide that stands too close")
def edge_rub(
    string, friction=quantity("N m", typical=3e-3, lower=0, upper=0.1), place=quantity("rad", typical=0.1, null=0.1)
):
    """Dry friction beyond an angle."""
    return string.with_dry_torque(ca.if_else(string.angle > place, friction, 0))


@effect(summary="Dry friction that is largest near standstill.", source="a seal of rubber")
def rubber_seal(
    string, friction=quantity("N m", typical=4e-3, lower=0, upper=0.1), width=quantity("rad/s", typical=0.5, null=0.5)
):
    """Dry friction f exp(-(rate / width)^2): the catalogue's does not depend on the rate."""
    return string.with_dry_torque(friction * ca.exp(-((string.rate / width) ** 2)))


@effect(summary="A leaf of steel in place of a hinge: it stiffens as it bends.", source="a flexure")
def leaf(string, stiffness=quantity("N m/rad^3", typical=0.06, lower=0, upper=1.0)):
    """M = -k angle^3."""
    return string.with_torque(-stiffness * string.angle**3)


@effect(summary="The string touches a soft stop at an angle.", source="a pad of foam")
def pad(
    string, stiffness=quantity("N m/rad", typical=0.2, lower=0, upper=5.0), place=quantity("rad", typical=0.1, null=0.2)
):
    """M = -k (angle - place) beyond the place."""
    return string.with_torque(-stiffness * ca.fmax(0, string.angle - place))
