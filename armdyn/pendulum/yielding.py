r"""Elastic displacement of a compliant string or gripper, which follows the tension without inertia.

A compliant string or gripper oscillates far above the swing (13 Hz against 0.8 Hz for 2 mm/N and 80 g). Its
slow part (the slow manifold) follows the tension T0 of the rigid pendulum:

    sigma = c_s T0 along the string,      delta = -c_g T0 sin(phi) along the line,
    T0 = m (g cos phi + l phi'^2 + u sin phi),      dT0/dt = m (-3 g phi' sin phi + 3 u phi' cos phi + u' sin phi).

The displacement and its rate enter the equations of motion; its acceleration enters the tension alone,

    T = T_rigid + m (sin phi delta'' - sigma''),

where it is the derivative of a signal on the grid. At zero compliance all of it vanishes, and so does every error of
second order in it (Kevorkian & Cole, Multiple Scale and Singular Perturbation Methods, 1996, §4.1).

A jerk of the gripper makes the load bounce on an elastic string; the bounce changes the force, but hardly the swing.
With the damping d of the string m sigma'' + d sigma' + sigma/c_s = T0 is a vibration that c_s T0 passes; so the impulse
-m sigma', of which the tension has the derivative, is that of the slow manifold after the same vibration
(`armdyn.physics.vibration`). Below it the stretch is late by d c_s, which takes energy from the swing:
sigma = c_s (T0 - d c_s T0').
"""

from typing import NamedTuple

import casadi as ca

from armdyn.pendulum.composition import PendulumComposition
from armdyn.pendulum.physics import Expression
from armdyn.physics.definition import Moment

BOUNCE_TIME_ADDED_IN_QUADRATURE = 1e-4
"""Time, s, added in quadrature to the period of the load's bounce on the string over 2 pi, so that derivatives exist
for a rigid string."""


class CompliantDisplacement(NamedTuple):
    """Elastic displacements of string and gripper, as expressions of angle, rate, gripper acceleration and jerk.

    Attributes:
        stretch: stretch sigma of the string, m.
        stretch_rate: rate of the stretch, m/s.
        gripper_displacement: displacement delta of the gripper along its line, m.
        gripper_displacement_rate: rate of this displacement, m/s.
        impulse: impulse whose time derivative is added to the tension, kg m/s.
        added_force: force added to the tension directly, N.
    """

    stretch: Expression
    stretch_rate: Expression
    gripper_displacement: Expression
    gripper_displacement_rate: Expression
    impulse: Expression
    added_force: Expression


def compliant_displacement(
    composition: PendulumComposition, at: Moment, phi: Expression, rate: Expression, a: Expression, jerk: Expression
) -> CompliantDisplacement:
    """Elastic displacements of string and gripper for an angle phi, rad, rate, rad/s, acceleration a and jerk."""
    string, gripper = ca.vertsplit(composition.compliance)
    length, mass, gravity = at["length"], at["mass"], at["gravity"]
    sin, cos = ca.sin(phi), ca.cos(phi)
    tension = mass * (gravity * cos + length * rate**2 + a * sin)
    tension_rate = mass * (3 * rate * (a * cos - gravity * sin) + jerk * sin)
    stretching = string * tension_rate
    giving = -gripper * (tension_rate * sin + tension * cos * rate)
    late = ca.SX(0)
    if composition.bounce_vibration is not None:
        square, damping = ca.vertsplit(composition.bounce_vibration)
        late = 2 * damping * ca.sqrt(square + BOUNCE_TIME_ADDED_IN_QUADRATURE**2)
    return CompliantDisplacement(
        stretch=string * (tension - late * tension_rate),
        stretch_rate=stretching,
        gripper_displacement=-gripper * tension * sin,
        gripper_displacement_rate=giving,
        impulse=mass * (sin * giving - stretching),
        added_force=-mass * cos * rate * giving,
    )
