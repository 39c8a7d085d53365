r"""Continuous equations of motion of a load on a string, with a momentum as state.

The momentum needs the gripper's velocity, but not its acceleration.

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
    PendulumComposition,
    gripper_stage,
    kinetic_and_potential_energy,
    load_stage,
    quasi_static_string,
    sensor_stage,
    string_direction,
    string_stage,
    tension_with_effects,
    up_direction,
)
from armdyn.pendulum.physics import Expression, torque_with_smooth_friction
from armdyn.pendulum.yielding import compliant_displacement
from armdyn.physics.dry import DryFriction
from armdyn.physics.simulate import System
from armdyn.physics.vibration import Vibration
from armdyn.readout import SensorReadout

PLANAR_STATE_SIZE = 2
PENDULUM_INPUTS = ("t", "x", "v", "a", "z", "vz", "az")
PENDULUM_OUTPUTS = ("load_force", "swing_angle", "swing_rate")


@dataclass(frozen=True, eq=False, kw_only=True)
class PendulumDynamics(System):
    """Equations of a pendulum as functions of s = (phi, P), w = (t, x, v, a, z, vz, az) and parameters theta.

    The gripper moves along its line with x, v, a and, where its height is measured, up and down with z, vz, az. If
    the load also swings across the line, s continues with the three moments of `transverse`; the last entries are the
    states that effects add. If the string or gripper is compliant, w continues with the gripper's jerk, and the output
    ends in an impulse, kg m/s, whose time derivative adds to the force. If effects read further recorded quantities, w
    continues with the jerk and ends in these quantities.

    `initial` takes phi and p = P/M, the swing rate in a frame at rest: phi' = p + (v/l) cos(phi). A load at rest
    has p = 0 for every motion of the gripper.

    Attributes:
        tension: ``(s, w, theta) -> ()`` tension before the sensor, N.
        rate: ``(s, w, theta) -> ()`` swing rate phi', rad/s.
    """

    tension: ca.Function
    rate: ca.Function


def derive_dynamics(composition: PendulumComposition, *, planar: bool = False) -> PendulumDynamics:
    """Derive the equations of motion, the sensor readings and the tension of a pendulum with effects.

    Args:
        composition: the pendulum with its effects.
        planar: whether to simplify the equations for control: two states and seven inputs, lag and compliance to
            first order, no swing across the line, dry friction with a smooth sign. States that effects add keep their
            start values, and recorded quantities that they read have their usual values.
    """
    yields, crosses = composition.is_compliant and not planar, composition.swings_across_line and not planar
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
    at = composition.moment(t, recorded)
    gripper = gripper_stage(
        at, x - composition.gripper_lag * v if planar and composition.gripper_has_lag else x, v, z, phi
    )
    string = string_stage(at, phi, rate)
    g, length, mass = gripper.position, string.length, at["mass"]
    if planar:
        g, length = quasi_static_string(composition, at, g, length, phi)
    if yields:
        g += ca.vertcat(give, 0, 0)
    q = g + (length + stretch) * string_direction(phi)
    gd, qd = along_motion(g), along_motion(q)
    load = load_stage(at, q, qd, phi, rate)
    kinetic, potential = kinetic_and_potential_energy(gripper, string, load, g, gd)

    def on_string(expression: Expression) -> Expression:
        """The expression with zero stretch where the string is rigid; otherwise the stretch is substituted later."""
        if yields or crosses:
            return expression
        return ca.substitute(expression, ca.vertcat(stretch, stretching), ca.SX.zeros(2))

    P = on_string(ca.gradient(kinetic - potential, rate))
    M = _without_needless(ca.jacobian(P, rate), phi)
    b = ca.substitute(P, rate, ca.SX(0))
    by_forces = on_string(ca.gradient(kinetic - potential, phi) + ca.dot(ca.jacobian(q, phi), load.force))
    P_dot = by_forces + on_string(torque_with_smooth_friction(string.torque, string.dry, rate))
    rate_of_rate = (P_dot - along_motion(M) * rate - along_motion(b)) / M
    radial = _without_needless(on_string(ca.gradient(kinetic - potential, stretching)), rate)
    pulled = ca.gradient(kinetic - potential, stretch) + ca.dot(ca.jacobian(q, stretch), load.force)
    tension = on_string(pulled) - along_motion(radial, rate_of_rate)
    if composition.string_has_mass:
        # The constraint force includes the string's mass by its stretching; the upper end carries all of the string.
        weight = string.mass * (-string.gravity * up_direction(gripper) - along_motion(gd, rate_of_rate))
        tension += on_string(ca.dot(weight, string_direction(phi)) / 2 + string.mass * (length + stretch) * rate**2 / 6)
    rate_of_state = (momentum - b) / M

    s, w = [phi, momentum], [t, x, v, a, z, vz, az]
    displaced = {stretch: ca.SX(0), stretching: ca.SX(0), give: ca.SX(0), giving: ca.SX(0)}
    extra = impulse = ca.SX(0, 1)
    if yields or recorded:
        w.append(jerk)
    w += recorded.values()
    if yields:
        rigid = ca.substitute([rate_of_state], list(displaced), list(displaced.values()))[0]
        slow = compliant_displacement(composition, at, phi, rigid, a, jerk)
        displaced = {
            stretch: slow.stretch,
            stretching: slow.stretch_rate,
            give: slow.gripper_displacement,
            giving: slow.gripper_displacement_rate,
        }
        tension, impulse = tension + slow.added_force, slow.impulse
    if crosses:
        s.append(moments)
        extra, tension = transverse.moment_rates_and_tension(moments, tension, mass, length)
        across = transverse.string_shortening(moments, length)
        displaced[stretch] += across.stretch
        displaced[stretching] += across.stretch_rate
    tension = tension_with_effects(at, tension, phi, rate, length, a)
    sensor = sensor_stage(at, tension, phi, rate)
    if planar:
        displaced |= {m.symbol: m.start for m in at.added_states}
    elif at.added_states:
        s += [m.symbol for m in at.added_states]
        extra = ca.vertcat(extra, *(m.rate for m in at.added_states))
    state, given = ca.vertcat(*s), ca.vertcat(*w)

    def filled_in(expression: Expression) -> Expression:
        expression = ca.substitute(expression, rate, rate_of_state)
        return ca.substitute([expression], list(displaced), list(displaced.values()))[0]

    def function(name: str, expression: Expression) -> ca.Function:
        return ca.Function(name, [state, given, theta], [filled_in(expression)])

    friction = None
    if composition.has_dry_friction and not planar:
        P_dot = by_forces + on_string(string.torque)
        friction = DryFriction(
            sliding_momentum=function("sliding", momentum - b),
            inertia=function("inertia", M),
            friction_force=function("size", on_string(string.dry)),
            momentum_is_linear=not ca.depends_on(filled_in(b), momentum),
            has_friction_states=composition.added_state_count > 0,
        )
    p = ca.SX.sym("p")
    start = [phi, filled_in(M) * p]
    if crosses:
        start.append(composition.transverse * length**2)
        start[1] = ca.substitute(start[1], moments, start[2])
    if not planar:
        start += [m.start for m in at.added_states]
    bounce = (
        None if composition.bounce_vibration is None else ca.Function("bounce", [theta], [composition.bounce_vibration])
    )
    timing = zip(
        PENDULUM_OUTPUTS, ca.vertsplit(composition.sensor_lag), ca.vertsplit(composition.sensor_delay), strict=True
    )
    return PendulumDynamics(
        names=composition.names,
        state_count=state.numel(),
        start_value_count=PLANAR_STATE_SIZE,
        input_count=given.numel(),
        recorded_columns=tuple(recorded),
        outputs=PENDULUM_OUTPUTS,
        output_with_impulse_rate="load_force" if yields else None,
        impulse_vibration=Vibration(bounce) if yields and bounce is not None else None,
        input_lag=ca.Function("gripper_lag", [theta], [composition.gripper_lag])
        if composition.gripper_has_lag
        else None,
        derivative=function("derivative", ca.vertcat(rate, P_dot, extra)),
        output=function("output", ca.vertcat(sensor.force, sensor.angle, sensor.rate, impulse)),
        tension=function("tension", tension),
        dry_friction=friction,
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
