r"""Integrate the states that effects add to a joint, such as a bristle's deflection, along a recorded motion.

They obey z' = f(z, w(t), theta), with the recorded motion w of the joint linear between samples. A bristle relaxes in
less than a sample, so the steps are those of the L-stable diagonally implicit Runge-Kutta method of order 2 with two
stages (Alexander, SIAM J. Numer. Anal. 14, 1977), gamma = 1 - 1/sqrt(2):

    y1 = z + gamma h f(y1, t + gamma h),    z_next = z + (1 - gamma)/gamma (y1 - z) + gamma h f(z_next, t + h).
"""

from collections.abc import Sequence

import casadi as ca
import numpy as np

from armdyn.errors import InputError
from armdyn.physics.definition import AddedState, Expression

SDIRK_GAMMA = 1.0 - 1.0 / np.sqrt(2.0)
STATE_NEWTON_STEPS = 3
"""One step is exact where the rate is linear in the state, as in every bristle model."""


class InternalStates:
    """The states of one joint's effects over time, with exact derivatives.

    Args:
        memory: states of the joint's stage.
        inputs: (15,) symbols in the order of `composition.INPUTS`.
        load: the input on which no state may depend.
        theta: (k,) symbols of the parameters.

    Attributes:
        symbols: (m,) symbols of the states.
        depends: (k,) bool, whether a state depends on each parameter.

    Raises:
        InputError: a state depends on more than the joint's own motion.
    """

    def __init__(self, memory: Sequence[AddedState], inputs: Expression, load: Expression, theta: Expression) -> None:
        self.symbols = ca.vertcat(*(m.symbol for m in memory)) if memory else ca.SX(0, 1)
        rates, starts = (ca.vertcat(*(m[i] for m in memory)) if memory else ca.SX(0, 1) for i in (1, 2))
        if memory and (ca.depends_on(rates, load) or ca.depends_on(starts, ca.vertcat(inputs, self.symbols))):
            raise InputError("a state of an effect on a joint follows the joint's motion only, from a constant")
        both = ca.vertcat(rates, starts)
        self.depends = np.array([bool(memory) and bool(ca.depends_on(both, theta[i])) for i in range(theta.numel())])
        if memory:
            self._start = ca.Function("start", [theta], [ca.densify(starts), ca.densify(ca.jacobian(starts, theta))])
            self._step = _step(self.symbols, rates, inputs, theta)

    def over(self, inputs: np.ndarray, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(m, n) states over (15, n) inputs at (k,) theta, and (m, k, n) their derivatives."""
        m, k, n = self.symbols.numel(), len(theta), inputs.shape[1]
        if not m:
            return np.zeros((0, n)), np.zeros((0, k, n))
        first = np.concatenate([np.asarray(a).ravel(order="F") for a in self._start(theta)])
        steps = np.vstack([inputs[:, :-1], inputs[:, 1:]])
        later = np.asarray(self._step.mapaccum(n - 1)(first, steps, np.repeat(theta[:, None], n - 1, axis=1)))
        rows = np.column_stack([first, later])
        return rows[:m], rows[m:].reshape(k, m, n).transpose(1, 0, 2)


def _step(z: Expression, rates: Expression, inputs: Expression, theta: Expression) -> ca.Function:
    """One step of the states and of their derivatives."""
    m, k, wide = z.numel(), theta.numel(), inputs.numel()
    S, w = ca.SX.sym("S", m, k), ca.SX.sym("w", 2 * wide)
    before, after = w[:wide], w[wide:]
    h = after[0] - before[0]
    f = ca.Function("f", [z, inputs, theta], [rates, ca.jacobian(rates, z), ca.jacobian(rates, theta)])

    def stage(base: Expression, slopes: Expression, at: Expression) -> tuple[Expression, Expression]:
        """Solution of y = base + gamma h f(y), and its derivatives."""
        y = base
        for _ in range(STATE_NEWTON_STEPS):
            value, by_state, _ = f(y, at, theta)
            y = y - ca.solve(ca.SX.eye(m) - SDIRK_GAMMA * h * by_state, y - base - SDIRK_GAMMA * h * value)
        _, by_state, by_theta = f(y, at, theta)
        return y, ca.solve(ca.SX.eye(m) - SDIRK_GAMMA * h * by_state, slopes + SDIRK_GAMMA * h * by_theta)

    y, Y = stage(z, S, before + SDIRK_GAMMA * (after - before))
    share = (1.0 - SDIRK_GAMMA) / SDIRK_GAMMA
    following, derivatives = stage(z + share * (y - z), S + share * (Y - S), after)
    state = ca.vertcat(z, ca.vec(S))
    return ca.Function("step", [state, w, theta], [ca.densify(ca.vertcat(following, ca.vec(derivatives)))])
