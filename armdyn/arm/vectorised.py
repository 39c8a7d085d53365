"""A symbolic function at all samples of a run: one numpy operation per instruction instead of one call per sample."""

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from armdyn.errors import InputError

TRIGONOMETRIC = ("sin", "cos", "tan", "sinh", "cosh", "tanh")
SAME_NAME = (
    *TRIGONOMETRIC,
    "exp",
    "log",
    "log1p",
    "expm1",
    "sqrt",
    "floor",
    "ceil",
    "sign",
    "copysign",
    "fmod",
    "hypot",
)
"""Operations that CasADi and numpy call alike."""
OPERATIONS: Mapping[int, Callable[..., Any]] = {
    **{getattr(ca, f"OP_{name.upper()}"): getattr(np, name) for name in SAME_NAME},
    **{getattr(ca, f"OP_A{name.upper()}"): getattr(np, f"arc{name}") for name in TRIGONOMETRIC},
    ca.OP_ATAN2: np.arctan2,
    ca.OP_ASSIGN: lambda x: x,
    ca.OP_ADD: np.add,
    ca.OP_SUB: np.subtract,
    ca.OP_MUL: np.multiply,
    ca.OP_DIV: np.divide,
    ca.OP_NEG: np.negative,
    ca.OP_POW: np.power,
    ca.OP_CONSTPOW: np.power,
    ca.OP_SQ: np.square,
    ca.OP_TWICE: lambda x: x + x,
    ca.OP_INV: np.reciprocal,
    ca.OP_LT: lambda x, y: np.less(x, y) * 1.0,
    ca.OP_LE: lambda x, y: np.less_equal(x, y) * 1.0,
    ca.OP_EQ: lambda x, y: np.equal(x, y) * 1.0,
    ca.OP_NE: lambda x, y: np.not_equal(x, y) * 1.0,
    ca.OP_NOT: lambda x: np.logical_not(x) * 1.0,
    ca.OP_AND: lambda x, y: np.logical_and(x, y) * 1.0,
    ca.OP_OR: lambda x, y: np.logical_or(x, y) * 1.0,
    ca.OP_IF_ELSE_ZERO: lambda condition, x: np.where(condition, x, 0.0),
    ca.OP_FABS: np.abs,
    ca.OP_FMIN: np.minimum,
    ca.OP_FMAX: np.maximum,
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
