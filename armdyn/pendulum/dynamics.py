r"""Continuous equations of motion in a state that needs the gripper's velocity but not its acceleration.

With the load at q(phi, rho) = g + rho e(phi), the state is the angle and its canonical momentum,

    P = dL/dphi' = M(phi) phi' + b(phi, x, v),      P' = dL/dphi + Q_phi,

so that a measured gripper path is differentiated once. The string's tension is the force that keeps rho = l,

    T = dL/drho - d/dt dL/drho' + Q_rho,

and only there the acceleration enters. For the bare pendulum T = m (g cos phi + l phi'^2 + u sin phi).
(Goldstein, Classical Mechanics, 3rd ed., §2.4 for constraint forces, §8.1 for momenta.)
"""

from dataclasses import dataclass
from typing import Literal

import casadi as ca
import numpy as np

from armdyn.pendulum.composition import STANDARD_GRAVITY, Composition, direction
from armdyn.pendulum.physics import Expression

STATE_SIZE = 2
INPUTS = ("t", "x", "v", "a", "z", "vz", "az")
INPUT_SIZE = len(INPUTS)
TensionFormula = Literal["exact", "printed"]
OUTPUTS = ("load_force", "swing_angle", "swing_rate")


@dataclass(frozen=True)
class Dynamics:
    """Functions of state s = (phi, P), input w = (t, x, v, a, z, vz, az) and parameters theta.

    The gripper moves along its line with x, v, a and, where its height is measured, up and down with z, vz, az.

    Attributes:
        names: parameters in the order of theta.
        derivative: ``(s, w, theta) -> (2,)``.
        output: ``(s, w, theta) -> (3,)`` load_force N, swing_angle rad, swing_rate rad/s.
        tension: ``(s, w, theta) -> ()`` N, before the sensor.
        initial: ``(phi, p, w, theta) -> s`` where p = P/M is the swing rate seen from rest in space:
            phi' = p + (v/l) cos(phi). A load at rest has p = 0 whatever the gripper does.
        rate: ``(s, w, theta) -> ()`` phi', rad/s.
        energy: ``(s, w, theta) -> ()`` kinetic + potential, J.
        load_position: ``(s, w, theta) -> (3,)`` m.
        timing: see `Composition`.
    """

    names: tuple[str, ...]
    derivative: ca.Function
    output: ca.Function
    tension: ca.Function
    initial: ca.Function
    rate: ca.Function
    energy: ca.Function
    load_position: ca.Function
    timing: ca.Function


def derive_dynamics(composition: Composition, tension_formula: TensionFormula = "exact") -> Dynamics:
    """Equations of motion, readings and tension of a composition.

    Args:
        composition: the pendulum with its effects.
        tension_formula: ``"exact"``, or ``"printed"`` for the formula in the paper,
            m g cos(phi) - m l phi'^2 - u sin(phi), which has two wrong signs and one mass missing. It is kept so that
            a comparison can show how it fails; the equations of motion are right in both cases.
    """
    theta = ca.SX.sym("theta", len(composition.names))
    t, x, v, a, z, vz, az = (ca.SX.sym(name) for name in INPUTS)
    phi, rate, momentum = ca.SX.sym("phi"), ca.SX.sym("rate"), ca.SX.sym("P")
    stretch, stretching = ca.SX.sym("d"), ca.SX.sym("dd")

    def along_motion(expression: Expression, rate_of_rate: Expression = None) -> Expression:
        """Total time derivative."""
        total = (
            ca.jtimes(expression, phi, rate)
            + ca.jtimes(expression, x, v)
            + ca.jtimes(expression, v, a)
            + ca.jtimes(expression, z, vz)
            + ca.jtimes(expression, vz, az)
            + ca.jtimes(expression, t, ca.SX(1))
            + ca.jtimes(expression, stretch, stretching)
        )
        return total if rate_of_rate is None else total + ca.jtimes(expression, rate, rate_of_rate)

    g = composition.attachment(t, x, v, z, phi, theta)
    q = g + (composition.length(t, phi, theta) + stretch) * direction(phi)
    gd, qd = along_motion(g), along_motion(q)
    mechanics = (t, q, qd, g, gd, phi, rate, theta)
    kinetic, potential = composition.energies(*mechanics)
    lagrangian = kinetic - potential
    force, torque = composition.forces(*mechanics)

    def at_rest_length(expression: Expression) -> Expression:
        return ca.substitute(expression, ca.vertcat(stretch, stretching), ca.SX.zeros(2))

    P = at_rest_length(ca.gradient(lagrangian, rate))
    M = _without_needless(ca.jacobian(P, rate), phi)
    b = ca.substitute(P, rate, ca.SX(0))
    P_dot = at_rest_length(ca.gradient(lagrangian, phi) + ca.dot(ca.jacobian(q, phi), force)) + at_rest_length(torque)
    rate_of_rate = (P_dot - along_motion(M) * rate - along_motion(b)) / M
    radial = _without_needless(at_rest_length(ca.gradient(lagrangian, stretching)), rate)
    tension = at_rest_length(ca.gradient(lagrangian, stretch) + ca.dot(ca.jacobian(q, stretch), force)) - along_motion(
        radial, rate_of_rate
    )
    if tension_formula == "printed":
        mass = theta[composition.names.index("mass")]
        tension = (
            mass * STANDARD_GRAVITY * ca.cos(phi) - mass * composition.length(t, phi, theta) * rate**2 - a * ca.sin(phi)
        )
    reading = ca.vertcat(*composition.readings(t, tension, phi, rate, theta))

    s, w = ca.vertcat(phi, momentum), ca.vertcat(t, x, v, a, z, vz, az)
    rate_of_state = (momentum - b) / M

    def function(name: str, expression: Expression) -> ca.Function:
        return ca.Function(name, [s, w, theta], [ca.substitute(expression, rate, rate_of_state)])

    p = ca.SX.sym("p")
    return Dynamics(
        names=composition.names,
        derivative=function("derivative", ca.vertcat(rate, P_dot)),
        output=function("output", reading),
        tension=function("tension", tension),
        initial=ca.Function("initial", [phi, p, w, theta], [ca.vertcat(phi, M * p)]),
        rate=function("rate", rate),
        energy=function("energy", at_rest_length(kinetic + potential)),
        load_position=function("load_position", at_rest_length(q)),
        timing=composition.timing,
    )


def _without_needless(expression: Expression, variable: Expression) -> Expression:
    """The expression at variable = 0 where it does not depend on the variable, as in sin^2 + cos^2.

    CasADi does not see such identities; without this the sensitivities cost twice as much. A derivative that vanishes
    to rounding at random points is zero: the expressions are analytic.
    """
    slope = ca.gradient(expression, variable)
    symbols = ca.symvar(ca.vertcat(slope, expression))
    test = ca.Function("slope", symbols, [slope, expression])
    rng = np.random.default_rng(0)
    for _ in range(8):
        change, size = test(*(rng.uniform(0.2, 1.5) for _ in symbols))
        if abs(float(change)) > 1e-12 * max(1.0, abs(float(size))):
            return expression
    return ca.substitute(expression, variable, ca.SX(0))
