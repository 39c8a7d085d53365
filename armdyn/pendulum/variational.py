r"""The midpoint variational integrator of a pendulum with effects.

The load's Cartesian position at node k is q_k = g(x_k) + l e(phi_k); between nodes the Lagrangian is evaluated at
the midpoint (q_k + q_{k+1})/2 with velocity (q_{k+1} - q_k)/dt. The forced discrete Euler-Lagrange equations

    d/dphi_k [L_d(k-1, k) + L_d(k, k+1)] + Q_phi = 0,      T_k dt = d/drho_k [L_d(k-1, k) + L_d(k, k+1)] + Q_rho

give the next angle and the tension (Marsden & West, Acta Numerica 2001, §3.2; Johnson & Murphey, IEEE T-RO 2009).
Written in the node angles this is the same scheme as a Cartesian load with the constraint |q_k - g_k| = l.

State and control of step k, all by backward differences so that no momentum has to be carried:

    s_k = (x_k, (x_k - x_{k-1})/dt, phi_k, (phi_k - phi_{k-1})/dt),    u_k = (x_{k+1} - 2 x_k + x_{k-1})/dt^2.
"""

from dataclasses import dataclass

import casadi as ca

from armdyn.pendulum.composition import (
    PendulumComposition,
    gripper_stage,
    kinetic_and_potential_energy,
    load_stage,
    quasi_static_string,
    string_direction,
    string_stage,
)
from armdyn.pendulum.physics import Expression, Gripper, torque_with_smooth_friction

VARIATIONAL_STATE_SIZE = 4
VARIATIONAL_NEWTON_STEPS = 4
"""Number of Newton iterations per integration step; at dt <= 0.02 s three reach the rounding error."""


@dataclass(frozen=True)
class VariationalStep:
    """Discrete equations of a pendulum as functions of state s (4,), control u, time t, step dt and parameters theta.

    Attributes:
        names: names of the parameters in the order of theta.
        step: ``(s, u, t, dt, theta) -> s_next``.
        linearised: ``(s, u, t, dt, theta, s_next) -> A (4, 4), B (4,)`` exact, by the implicit function theorem.
        curvature: ``(s, u, t, dt, theta, s_next, p) -> (5, 5)`` Hessian of p' s_next(s, u) with respect to (s, u).
        tension: ``(s, u, t, dt, theta, s_next) -> ()`` tension at node k, N.
        load: ``(s, t, dt, theta) -> position (3,), velocity (3,)``, the velocity over the interval that ends at s.
        lag: ``theta -> ()`` lag of the string's upper end, whose position is x, behind the gripper, s.
    """

    names: tuple[str, ...]
    step: ca.Function
    linearised: ca.Function
    curvature: ca.Function
    tension: ca.Function
    load: ca.Function
    lag: ca.Function


def derive_variational(composition: PendulumComposition) -> VariationalStep:
    """Derive the variational integrator of a pendulum, with its exact first and second derivatives.

    Compliance is included to first order (`quasi_static_string`), and dry friction has a smooth sign. A swing across
    the line and states that effects add are left out. Recorded quantities that effects read have their usual values.
    """
    theta = composition.theta
    s, u, t, dt = ca.SX.sym("s", VARIATIONAL_STATE_SIZE), ca.SX.sym("u"), ca.SX.sym("t"), ca.SX.sym("dt")
    following = ca.SX.sym("phi_next")
    before, here, after = ca.SX.sym("phi_b"), ca.SX.sym("phi_h"), ca.SX.sym("phi_a")
    stretch = ca.SX.sym("d")  # of the string at node k, for the tension
    x, v, phi, rate = ca.vertsplit(s)
    v_next = v + dt * u
    x_next = x + dt * v_next

    def gripper(time: Expression, position: Expression, velocity: Expression, angle: Expression) -> Gripper:
        return gripper_stage(composition.moment(time), position, velocity, ca.SX(0), angle)

    def node(time: Expression, position: Expression, velocity: Expression, angle: Expression) -> Expression:
        at = composition.moment(time)
        length = string_stage(at, angle, ca.SX(0)).length
        g = gripper(time, position, velocity, angle).position
        return *quasi_static_string(composition, at, g, length, angle), angle

    def interval(first: Expression, second: Expression, time: Expression) -> tuple[Expression, Expression, Expression]:
        """Discrete Lagrangian, and midpoint position and angle with the force and torque that act there."""
        (g0, l0, phi0), (g1, l1, phi1) = first, second
        q0, q1 = g0 + l0 * string_direction(phi0), g1 + l1 * string_direction(phi1)
        middle, angle, rate = (q0 + q1) / 2, (phi0 + phi1) / 2, (phi1 - phi0) / dt
        at = composition.moment(time)
        string, load = string_stage(at, angle, rate), load_stage(at, middle, (q1 - q0) / dt, angle, rate)
        kinetic, potential = kinetic_and_potential_energy(
            gripper(time, x, v, angle), string, load, (g0 + g1) / 2, (g1 - g0) / dt
        )
        displaced = ca.vertcat(middle, angle)
        impulse = dt * ca.vertcat(load.force, torque_with_smooth_friction(string.torque, string.dry, rate))
        for memory in at.added_states:
            impulse = ca.substitute(impulse, memory.symbol, memory.start)
        return dt * (kinetic - potential), displaced, impulse

    g_h, l_h, _ = node(t, x, v, here)
    past = interval(node(t - dt, x - dt * v, v, before), (g_h, l_h + stretch, here), t - dt / 2)
    ahead = interval((g_h, l_h + stretch, here), node(t + dt, x_next, v_next, after), t + dt / 2)

    def balance(variable: Expression) -> Expression:
        total = 0
        for action, displaced, impulse in (past, ahead):
            total += ca.gradient(action, variable) + ca.jtimes(displaced, variable, ca.SX(1)).T @ impulse
        return total

    def at(expression: Expression, next_angle: Expression) -> Expression:
        return ca.substitute(
            expression, ca.vertcat(before, here, after, stretch), ca.vertcat(phi - dt * rate, phi, next_angle, 0)
        )

    residual = at(balance(here), following)
    slope = ca.gradient(residual, following)
    newton = ca.Function("newton", [following, s, u, t, dt, theta], [following - residual / slope])
    solution = phi + dt * rate
    for _ in range(VARIATIONAL_NEWTON_STEPS):
        solution = newton(solution, s, u, t, dt, theta)
    arguments = [s, u, t, dt, theta]
    step = ca.Function("step", arguments, [_advance(x_next, v_next, phi, solution, dt)])

    s_next = ca.SX.sym("s_next", VARIATIONAL_STATE_SIZE)
    z = ca.vertcat(s, u)
    next_of_z = _advance(x_next, v_next, phi, following, dt)

    def at_solution(expression: Expression) -> Expression:
        return ca.substitute(expression, following, s_next[2])

    sensitivity = -ca.jacobian(residual, z) / slope  # d phi_next / dz, (1, 5)
    total = at_solution(ca.jacobian(next_of_z, z) + ca.jacobian(next_of_z, following) @ sensitivity)  # (4, 5)

    # p' s_next is linear in phi_next; its curvature is that of the residual, by differentiating R(z, phi(z)) = 0 twice.
    p = ca.SX.sym("p", VARIATIONAL_STATE_SIZE)
    weight = -ca.gradient(ca.dot(p, next_of_z), following) / slope
    joint = ca.vertcat(z, following)
    second, _ = ca.hessian(residual, joint)
    lift = ca.vertcat(ca.SX.eye(5), sensitivity)
    curvature = at_solution(weight * (lift.T @ second @ lift))

    load_now = node(t, x, v, phi)
    load_before = node(t - dt, x - dt * v, v, phi - dt * rate)
    q_now, q_before = (g + length * string_direction(angle) for g, length, angle in (load_now, load_before))
    return VariationalStep(
        names=composition.names,
        step=step,
        linearised=ca.Function("linearised", [*arguments, s_next], [total[:, :4], total[:, 4]]),
        curvature=ca.Function("curvature", [*arguments, s_next, p], [curvature]),
        tension=ca.Function("tension", [*arguments, s_next], [at(balance(stretch), s_next[2]) / dt]),
        load=ca.Function("load", [s, t, dt, theta], [q_now, (q_now - q_before) / dt]),
        lag=ca.Function("lag", [theta], [composition.gripper_lag]),
    )


def _advance(
    x_next: Expression, v_next: Expression, phi: Expression, phi_next: Expression, dt: Expression
) -> Expression:
    return ca.vertcat(x_next, v_next, phi_next, (phi_next - phi) / dt)
