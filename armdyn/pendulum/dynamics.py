r"""Continuous equations of motion in a state that needs the gripper's velocity but not its acceleration.

With the load at q(phi, rho) = g + rho e(phi), the state is the angle and its canonical momentum,

    P = dL/dphi' = M(phi) phi' + b(phi, x, v),      P' = dL/dphi + Q_phi,

so that a measured gripper path is differentiated once. The string's tension is the force that keeps rho = l,

    T = dL/drho - d/dt dL/drho' + Q_rho,

and only this formula contains the acceleration. For the bare pendulum T = m (g cos phi + l phi'^2 + u sin phi). A
string with mass adds m_s [e . (g - g'') / 2 + l phi'^2 / 6] at its upper end, where the load cell is. (Goldstein,
Classical Mechanics, 3rd ed., §2.4 for constraint forces, §8.1 for momenta.)
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from armdyn.pendulum import transverse
from armdyn.pendulum.composition import (
    Composition,
    direction,
    gripper_at,
    lagrangian,
    load_at,
    quasi_static,
    sensor_at,
    string_at,
    tension_at,
    upwards,
)
from armdyn.pendulum.physics import Expression, smoothly_resisted
from armdyn.pendulum.yielding import slow_manifold
from armdyn.physics.dry import DryFriction
from armdyn.physics.simulate import System
from armdyn.physics.vibration import Vibration
from armdyn.readout import SensorReadout

PLANAR_STATE_SIZE = 2
PENDULUM_INPUTS = ("t", "x", "v", "a", "z", "vz", "az")
PENDULUM_OUTPUTS = ("load_force", "swing_angle", "swing_rate")


@dataclass(frozen=True, eq=False, kw_only=True)
class PendulumDynamics(System):
    """The equations as functions of state s = (phi, P), input w = (t, x, v, a, z, vz, az) and parameters theta.

    The gripper moves along its line with x, v, a and, where its height is measured, up and down with z, vz, az. Where
    the load also swings across the line, s goes on with the three moments of `transverse`; last come the states that
    effects bring. Where something yields, w goes on with the gripper's jerk, and the output ends in an impulse, kg m/s,
    whose time derivative adds to the force. Where effects read further recorded quantities, w goes on with the jerk as
    well, and ends in these.

    `initial` takes phi and p = P/M, the swing rate in a frame at rest: phi' = p + (v/l) cos(phi). A load at rest
    has p = 0 whatever the gripper does.

    Attributes:
        tension: ``(s, w, theta) -> ()`` tension before the sensor, N.
        rate: ``(s, w, theta) -> ()`` swing rate phi', rad/s.
    """

    tension: ca.Function
    rate: ca.Function


def derive_dynamics(composition: Composition, *, planar: bool = False) -> PendulumDynamics:
    """Derive the equations of motion, readings and tension of a composition.

    Args:
        composition: the pendulum with its effects.
        planar: for control: two states, seven inputs; lag and compliance to first order, no swing across the line, dry
            friction with a smooth sign; what effects remember stays as it is at the start of a run, and what they
            read of a recording has its usual value.
    """
    yields, crosses = composition.yields and not planar, composition.crosses and not planar
    theta = composition.theta
    t, x, v, a, z, vz, az = (ca.SX.sym(name) for name in PENDULUM_INPUTS)
    jerk, phi, rate, momentum = (ca.SX.sym(name) for name in ("jerk", "phi", "rate", "P"))
    moments = ca.SX.sym("moments", transverse.TRANSVERSE_MOMENTS)
    stretch, stretching, give, giving = (ca.SX.sym(s) for s in ("d", "dd", "e", "de"))

    def along_motion(expression: Expression, rate_of_rate: Expression = None) -> Expression:
        """Total time derivative, without the second derivatives of compliant parts."""
        total = (
            ca.jtimes(expression, phi, rate)
            + ca.jtimes(expression, x, v)
            + ca.jtimes(expression, v, a)
            + ca.jtimes(expression, z, vz)
            + ca.jtimes(expression, vz, az)
            + ca.jtimes(expression, t, ca.SX(1))
            + ca.jtimes(expression, stretch, stretching)
        )
        if yields:
            total += ca.jtimes(expression, give, giving)
        return total if rate_of_rate is None else total + ca.jtimes(expression, rate, rate_of_rate)

    recorded = {} if planar else composition.recorded
    at = composition.at(t, recorded)
    gripper = gripper_at(at, x - composition.gripper_lag * v if planar and composition.trails else x, v, z, phi)
    string = string_at(at, phi, rate)
    g, length, mass = gripper.position, string.length, at["mass"]
    if planar:
        g, length = quasi_static(composition, at, g, length, phi)
    if yields:
        g += ca.vertcat(give, 0, 0)
    q = g + (length + stretch) * direction(phi)
    gd, qd = along_motion(g), along_motion(q)
    load = load_at(at, q, qd, phi, rate)
    kinetic, potential = lagrangian(gripper, string, load, g, gd)

    def on_string(expression: Expression) -> Expression:
        """The expression with zero stretch where the string is rigid; otherwise the stretch is substituted later."""
        if yields or crosses:
            return expression
        return ca.substitute(expression, ca.vertcat(stretch, stretching), ca.SX.zeros(2))

    P = on_string(ca.gradient(kinetic - potential, rate))
    M = _without_needless(ca.jacobian(P, rate), phi)
    b = ca.substitute(P, rate, ca.SX(0))
    by_forces = on_string(ca.gradient(kinetic - potential, phi) + ca.dot(ca.jacobian(q, phi), load.force))
    P_dot = by_forces + on_string(smoothly_resisted(string.torque, string.dry, rate))
    rate_of_rate = (P_dot - along_motion(M) * rate - along_motion(b)) / M
    radial = _without_needless(on_string(ca.gradient(kinetic - potential, stretching)), rate)
    pulled = ca.gradient(kinetic - potential, stretch) + ca.dot(ca.jacobian(q, stretch), load.force)
    tension = on_string(pulled) - along_motion(radial, rate_of_rate)
    if composition.heavy:
        # The constraint force includes the string's mass by its stretching; the upper end carries all of the string.
        weight = string.mass * (-string.gravity * upwards(gripper) - along_motion(gd, rate_of_rate))
        tension += on_string(ca.dot(weight, direction(phi)) / 2 + string.mass * (length + stretch) * rate**2 / 6)
    rate_of_state = (momentum - b) / M

    s, w = [phi, momentum], [t, x, v, a, z, vz, az]
    displaced = {stretch: ca.SX(0), stretching: ca.SX(0), give: ca.SX(0), giving: ca.SX(0)}
    extra = impulse = ca.SX(0, 1)
    if yields or recorded:
        w.append(jerk)
    w += recorded.values()
    if yields:
        rigid = ca.substitute([rate_of_state], list(displaced), list(displaced.values()))[0]
        slow = slow_manifold(composition, at, phi, rigid, a, jerk)
        displaced = {stretch: slow.stretch, stretching: slow.stretching, give: slow.give, giving: slow.giving}
        tension, impulse = tension + slow.correction, slow.impulse
    if crosses:
        s.append(moments)
        extra, tension = transverse.tensions(moments, tension, mass, length)
        across = transverse.shortening(moments, length)
        displaced[stretch] += across.stretch
        displaced[stretching] += across.stretching
    tension = tension_at(at, tension, phi, rate, length, a)
    sensor = sensor_at(at, tension, phi, rate)
    if planar:
        displaced |= {m.symbol: m.start for m in at.memory}
    elif at.memory:
        s += [m.symbol for m in at.memory]
        extra = ca.vertcat(extra, *(m.rate for m in at.memory))
    state, given = ca.vertcat(*s), ca.vertcat(*w)

    def filled_in(expression: Expression) -> Expression:
        expression = ca.substitute(expression, rate, rate_of_state)
        return ca.substitute([expression], list(displaced), list(displaced.values()))[0]

    def function(name: str, expression: Expression) -> ca.Function:
        return ca.Function(name, [state, given, theta], [filled_in(expression)])

    friction = None
    if composition.rubs and not planar:
        P_dot = by_forces + on_string(string.torque)
        friction = DryFriction(
            sliding=function("sliding", momentum - b),
            inertia=function("inertia", M),
            size=function("size", on_string(string.dry)),
            linear=not ca.depends_on(filled_in(b), momentum),
            followed=composition.remembers > 0,
        )
    p = ca.SX.sym("p")
    start = [phi, filled_in(M) * p]
    if crosses:
        start.append(composition.transverse * length**2)
        start[1] = ca.substitute(start[1], moments, start[2])
    if not planar:
        start += [m.start for m in at.memory]
    bounce = None if composition.bounce is None else ca.Function("bounce", [theta], [composition.bounce])
    timing = zip(
        PENDULUM_OUTPUTS, ca.vertsplit(composition.sensor_lag), ca.vertsplit(composition.sensor_delay), strict=True
    )
    return PendulumDynamics(
        names=composition.names,
        states=state.numel(),
        starts=PLANAR_STATE_SIZE,
        inputs=given.numel(),
        columns=tuple(recorded),
        outputs=PENDULUM_OUTPUTS,
        impulse_adds_to="load_force" if yields else None,
        impulse_rings=Vibration(bounce) if yields and bounce is not None else None,
        input_lag=ca.Function("gripper_lag", [theta], [composition.gripper_lag]) if composition.trails else None,
        derivative=function("derivative", ca.vertcat(rate, P_dot, extra)),
        output=function("output", ca.vertcat(sensor.force, sensor.angle, sensor.rate, impulse)),
        tension=function("tension", tension),
        dry=friction,
        initial=_initial(phi, p, momentum, given, theta, start),
        rate=function("rate", rate),
        sensors={name: SensorReadout(theta, lag=lag, delay=delay) for name, lag, delay in timing},
    )


def _initial(
    phi: Expression, p: Expression, momentum: Expression, w: Expression, theta: Expression, start: list[Expression]
) -> ca.Function:
    """The start state from angle and p.

    Where the inertia depends on the tension, and so on the momentum, one step of fixed-point iteration is exact to
    second order in the compliance.
    """
    state = ca.vertcat(*start)
    if ca.depends_on(state, momentum):
        rigid = ca.substitute(state[1], momentum, ca.SX(0))
        state = ca.substitute(state, momentum, rigid)
    return ca.Function("initial", [phi, p, w, theta], [state])


def _without_needless(expression: Expression, variable: Expression) -> Expression:
    """The expression at variable = 0, where it does not depend on the variable, as in sin^2 + cos^2.

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
