r"""Dry friction that holds a load at rest, in Runge-Kutta steps.

The friction -D sign(p) jumps where the momentum p of the sliding changes its sign, and at rest it takes any value up to
D that holds the load. Within a step the sign is that of p at the step's start, so that the equations are smooth; then
the step is corrected where the sliding came to an end h before the step's end:

    h = dt p1/(p1 - p0),      p = soft(p1, 2 D h),      q = q1 + (p - p1) h/(2 M),

with soft(p, d) = sign(p) max(|p| - d, 0): after the reversal the friction acted with the wrong sign, by 2 D h. A load
at rest at the start of a step feels no friction in it, and p = soft(p1, D dt) at its end; where that is 0 nothing has
moved. The scheme is exact to second order in dt, continuous in the state and the parameters, and has exact derivatives.

(Moreau, Unilateral Contact and Dry Friction in Finite Freedom Dynamics, 1988, for the soft threshold of impulses;
Acary & Brogliato, Numerical Methods for Nonsmooth Dynamical Systems, 2008, §10 for time-stepping, §8 for events.)
"""

from dataclasses import dataclass

import casadi as ca

from armdyn.physics.definition import Expression

COORDINATE_ROW, MOMENTUM_ROW = 0, 1
"""Rows of the state vector with the sliding coordinate and with its momentum."""
REST_MOMENTUM_SHARE_OF_IMPULSE = 1e-6
"""Momentum that counts as zero, as a share of the friction's impulse in one step: it is far above rounding errors, and
friction stops such a motion within a millionth of a step."""
FIXED_POINT_STEPS = 3
"""Number of steps of the fixed-point iteration for a nonlinear momentum; each step gains more than two digits."""


@dataclass(frozen=True, eq=False)
class DryFriction:
    """Dry friction on the first state, whose momentum is the second state.

    Its functions have the arguments states s, inputs w and parameters theta.

    Attributes:
        sliding_momentum: ``(s, w, theta) -> ()`` the part of the momentum that is 0 at rest.
        inertia: ``(s, w, theta) -> ()`` this momentum over the rate of the first state.
        friction_force: ``(s, w, theta) -> ()`` size of the friction, >= 0.
        momentum_is_linear: whether `sliding_momentum` is the momentum minus a term without the momentum.
        has_friction_states: whether there are further states that change while the load slides and must not change
            while it sticks. Otherwise their rates may include one step's impulse of friction, D dt, before it sticks.
    """

    sliding_momentum: ca.Function
    inertia: ca.Function
    friction_force: ca.Function
    momentum_is_linear: bool
    has_friction_states: bool

    def sliding_direction(self, s: Expression, w: Expression, theta: Expression, dt: Expression) -> Expression:
        """Direction of sliding at the start of a step: -1 or 1, and 0 at rest."""
        p = self.sliding_momentum(s, w, theta)
        return ca.if_else(self._rests(p, s, w, theta, dt), 0, ca.sign(p))

    def rates_with_friction(
        self, rate: Expression, direction: Expression, s: Expression, w: Expression, theta: Expression
    ) -> Expression:
        """Add the friction that opposes sliding in `direction` to the rates of the states, all as expressions.

        `rate` are the rates without friction, s the states, w the inputs, theta the parameters.
        """
        slowed = ca.SX(rate)
        slowed[MOMENTUM_ROW] -= direction * self.friction_force(s, w, theta)
        return slowed

    def state_at_rest(self, s: Expression, w: Expression, theta: Expression) -> Expression:
        """The state s with the momentum of a load that does not slide."""
        return self._with_sliding(0, s, w, theta)

    def corrected_state(
        self,
        before: Expression,
        after: Expression,
        held: Expression,
        here: Expression,
        there: Expression,
        theta: Expression,
        dt: Expression,
    ) -> Expression:
        """Correct the state after a step for the times at which friction stopped the load or changed its direction.

        Args:
            before: (n,) state at the start of the step.
            after: (n,) state at the end of the step, with the direction of friction at its start.
            held: (n,) state at the end of the step if the load sticks; only used with friction states.
            here: inputs at the start of the step.
            there: inputs at the end of the step.
            theta: parameters.
            dt: length of the step, s.
        """
        p0, p1 = self.sliding_momentum(before, here, theta), self.sliding_momentum(after, there, theta)
        rests = self._rests(p0, before, here, theta, dt)
        turns = ca.logic_and(ca.logic_not(rests), p0 * p1 < 0)
        remaining = ca.if_else(rests, dt, ca.if_else(turns, dt * p1 / ca.if_else(turns, p1 - p0, 1), 0))
        size = self.friction_force(after, there, theta)
        impulse = ca.if_else(rests, 1, 2) * remaining * size
        stops = ca.fabs(p1) < impulse
        sticks = ca.logic_and(rests, stops)
        p = ca.if_else(stops, 0, p1 - ca.sign(p1) * impulse)
        state = ca.if_else(sticks, held, after) if self.has_friction_states else ca.SX(after)
        moved = after[COORDINATE_ROW] + (p - p1) * remaining / (2 * self.inertia(after, there, theta))
        state[COORDINATE_ROW] = ca.if_else(sticks, before[COORDINATE_ROW], moved)
        state[MOMENTUM_ROW] = after[MOMENTUM_ROW]
        return self._with_sliding(p, state, there, theta)

    def _rests(self, p: Expression, s: Expression, w: Expression, theta: Expression, dt: Expression) -> Expression:
        return ca.fabs(p) <= REST_MOMENTUM_SHARE_OF_IMPULSE * dt * self.friction_force(s, w, theta)

    def _with_sliding(self, p: Expression, s: Expression, w: Expression, theta: Expression) -> Expression:
        state = ca.SX(s)
        for _ in range(1 if self.momentum_is_linear else FIXED_POINT_STEPS):
            state[MOMENTUM_ROW] += p - self.sliding_momentum(state, w, theta)
        return state
