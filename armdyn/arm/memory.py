r"""States that effects bring to a joint, such as a bristle's deflection, along the recorded motion.

z' = f(z, w(t), theta), w being what was recorded of the joint, linear between samples. A bristle relaxes within less
than a sample, so each step is one of the L-stable diagonally implicit Runge-Kutta method of order 2 with two stages
(Alexander, SIAM J. Numer. Anal. 14, 1977), gamma = 1 - 1/sqrt(2):

    y1 = z + gamma h f(y1, t + gamma h),    z_next = z + (1 - gamma)/gamma (y1 - z) + gamma h f(z_next, t + h).

Symbolic functions are computed at all samples of a run at once: one numpy operation per instruction.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from armdyn.errors import InputError
from armdyn.physics.definition import Expression, Memory

GAMMA = 1.0 - 1.0 / np.sqrt(2.0)
NEWTON_STEPS = 3
"""One is exact where the rate is linear in the state, as of every bristle model."""


class Remembered:
    """The states of one joint's effects over time, with exact derivatives.

    Args:
        memory: of the joint's stage.
        inputs: (9,) symbols in the order of `composition.INPUTS`.
        load: the one of them that a state cannot follow.
        theta: (k,) symbols.

    Attributes:
        symbols: (m,) of the states.
        depends: (k,) bool, the parameters on which a state depends.

    Raises:
        InputError: a state follows something else than the joint's own motion.
    """

    def __init__(self, memory: Sequence[Memory], inputs: Expression, load: Expression, theta: Expression) -> None:
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
        """(m, n) states over (9, n) inputs at (k,) theta, and (m, k, n) their derivatives."""
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
        """The solution of y = base + gamma h f(y), and its derivatives."""
        y = base
        for _ in range(NEWTON_STEPS):
            value, by_state, _ = f(y, at, theta)
            y = y - ca.solve(ca.SX.eye(m) - GAMMA * h * by_state, y - base - GAMMA * h * value)
        _, by_state, by_theta = f(y, at, theta)
        return y, ca.solve(ca.SX.eye(m) - GAMMA * h * by_state, slopes + GAMMA * h * by_theta)

    y, Y = stage(z, S, before + GAMMA * (after - before))
    share = (1.0 - GAMMA) / GAMMA
    following, derivatives = stage(z + share * (y - z), S + share * (Y - S), after)
    state = ca.vertcat(z, ca.vec(S))
    return ca.Function("step", [state, w, theta], [ca.densify(ca.vertcat(following, ca.vec(derivatives)))])


OPERATIONS: Mapping[int, Callable[..., Any]] = {
    ca.OP_ASSIGN: lambda x: x,
    ca.OP_ADD: np.add,
    ca.OP_SUB: np.subtract,
    ca.OP_MUL: np.multiply,
    ca.OP_DIV: np.divide,
    ca.OP_NEG: np.negative,
    ca.OP_EXP: np.exp,
    ca.OP_LOG: np.log,
    ca.OP_LOG1P: np.log1p,
    ca.OP_EXPM1: np.expm1,
    ca.OP_POW: np.power,
    ca.OP_CONSTPOW: np.power,
    ca.OP_SQRT: np.sqrt,
    ca.OP_SQ: np.square,
    ca.OP_TWICE: lambda x: x + x,
    ca.OP_INV: np.reciprocal,
    ca.OP_SIN: np.sin,
    ca.OP_COS: np.cos,
    ca.OP_TAN: np.tan,
    ca.OP_ASIN: np.arcsin,
    ca.OP_ACOS: np.arccos,
    ca.OP_ATAN: np.arctan,
    ca.OP_ATAN2: np.arctan2,
    ca.OP_SINH: np.sinh,
    ca.OP_COSH: np.cosh,
    ca.OP_TANH: np.tanh,
    ca.OP_ASINH: np.arcsinh,
    ca.OP_ACOSH: np.arccosh,
    ca.OP_ATANH: np.arctanh,
    ca.OP_LT: lambda x, y: np.less(x, y) * 1.0,
    ca.OP_LE: lambda x, y: np.less_equal(x, y) * 1.0,
    ca.OP_EQ: lambda x, y: np.equal(x, y) * 1.0,
    ca.OP_NE: lambda x, y: np.not_equal(x, y) * 1.0,
    ca.OP_NOT: lambda x: np.logical_not(x) * 1.0,
    ca.OP_AND: lambda x, y: np.logical_and(x, y) * 1.0,
    ca.OP_OR: lambda x, y: np.logical_or(x, y) * 1.0,
    ca.OP_IF_ELSE_ZERO: lambda condition, x: np.where(condition, x, 0.0),
    ca.OP_FLOOR: np.floor,
    ca.OP_CEIL: np.ceil,
    ca.OP_FABS: np.abs,
    ca.OP_SIGN: np.sign,
    ca.OP_COPYSIGN: np.copysign,
    ca.OP_FMOD: np.fmod,
    ca.OP_FMIN: np.minimum,
    ca.OP_FMAX: np.maximum,
    ca.OP_HYPOT: np.hypot,
}


class OverTime:
    """Evaluates expressions of inputs that change over time and of parameters that do not.

    Args:
        expressions: (m,).
        inputs: (9,) symbols.
        theta: (k,) symbols.

    Raises:
        InputError: an expression holds an operation without a numpy counterpart.
    """

    def __init__(self, expressions: Any, inputs: Any, theta: Any) -> None:
        self._function = ca.Function("over_time", [inputs, theta], [ca.densify(expressions)])
        unknown = {self._function.instruction_id(k) for k in range(self._function.n_instructions())}
        unknown -= {*OPERATIONS, ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT}
        if unknown:
            raise InputError(
                f"an effect uses CasADi operation {min(unknown)}, which cannot be evaluated over a run: write it with "
                "elementary functions"
            )

    @cached_property
    def _instructions(self) -> list[tuple[int, list[int], list[int], float]]:
        """Operation, registers or positions it writes and reads, and the constant."""
        f = self._function
        constants = [f.instruction_constant(k) if f.instruction_id(k) == ca.OP_CONST else 0.0 for k in self._range]
        return [
            (f.instruction_id(k), list(f.instruction_output(k)), list(f.instruction_input(k)), constants[k])
            for k in self._range
        ]

    @property
    def _range(self) -> range:
        return range(self._function.n_instructions())

    def __call__(self, inputs: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """(m, n) for (9, n) inputs and (k,) parameters."""
        result = np.zeros((self._function.size1_out(0), inputs.shape[1]))
        given = (inputs, theta)
        work: list[Any] = [None] * self._function.sz_w()
        with np.errstate(all="ignore"):  # a fit tries values where nothing is finite, and sees it in the result
            for operation, to, of, constant in self._instructions:
                if operation == ca.OP_CONST:
                    work[to[0]] = constant
                elif operation == ca.OP_INPUT:
                    work[to[0]] = given[of[0]][of[1]]
                elif operation == ca.OP_OUTPUT:
                    result[to[1]] = work[of[0]]
                else:
                    work[to[0]] = OPERATIONS[operation](*(work[i] for i in of))
        return result
