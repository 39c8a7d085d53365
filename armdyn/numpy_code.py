"""Write a CasADi function as lines of Python that need only numpy: one operation of the expression graph per line."""

from collections.abc import Callable, Mapping
from math import isfinite

import casadi as ca

OPERATIONS: Mapping[int, str] = {
    ca.OP_ASSIGN: "{}", ca.OP_ADD: "{} + {}", ca.OP_SUB: "{} - {}", ca.OP_MUL: "{} * {}", ca.OP_DIV: "{} / {}",
    ca.OP_NEG: "-{}", ca.OP_INV: "1.0 / {}", ca.OP_SQ: "{0} * {0}", ca.OP_TWICE: "2.0 * {}",
    ca.OP_POW: "{} ** {}", ca.OP_CONSTPOW: "{} ** {}", ca.OP_SQRT: "np.sqrt({})", ca.OP_HYPOT: "np.hypot({}, {})",
    ca.OP_EXP: "np.exp({})", ca.OP_LOG: "np.log({})", ca.OP_EXPM1: "np.expm1({})", ca.OP_LOG1P: "np.log1p({})",
    ca.OP_SIN: "np.sin({})", ca.OP_COS: "np.cos({})", ca.OP_TAN: "np.tan({})",
    ca.OP_ASIN: "np.arcsin({})", ca.OP_ACOS: "np.arccos({})", ca.OP_ATAN: "np.arctan({})",
    ca.OP_ATAN2: "np.arctan2({}, {})",
    ca.OP_SINH: "np.sinh({})", ca.OP_COSH: "np.cosh({})", ca.OP_TANH: "np.tanh({})",
    ca.OP_ASINH: "np.arcsinh({})", ca.OP_ACOSH: "np.arccosh({})", ca.OP_ATANH: "np.arctanh({})",
    ca.OP_FABS: "np.abs({})", ca.OP_SIGN: "np.sign({})", ca.OP_COPYSIGN: "np.copysign({}, {})",
    ca.OP_FLOOR: "np.floor({})", ca.OP_CEIL: "np.ceil({})", ca.OP_FMOD: "np.fmod({}, {})",
    ca.OP_FMIN: "np.minimum({}, {})", ca.OP_FMAX: "np.maximum({}, {})",
    ca.OP_LT: "np.less({}, {}) * 1.0", ca.OP_LE: "np.less_equal({}, {}) * 1.0",
    ca.OP_EQ: "np.equal({}, {}) * 1.0", ca.OP_NE: "np.not_equal({}, {}) * 1.0",
    ca.OP_AND: "np.logical_and({}, {}) * 1.0", ca.OP_OR: "np.logical_or({}, {}) * 1.0",
    ca.OP_NOT: "np.logical_not({}) * 1.0", ca.OP_IF_ELSE_ZERO: "np.where({}, {}, 0.0)",
}  # fmt: skip
"""Numpy expression of each CasADi operation, by its number, with ``{}`` for each operand."""


def unknown_operations(f: ca.Function) -> set[int]:
    """Numbers of the operations of a CasADi SX function that cannot be written as numpy code."""
    used = {f.instruction_id(k) for k in range(f.n_instructions())}
    return used - {*OPERATIONS, ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT}


def numpy_lines(f: ca.Function, read: Callable[[int, int], str], write: Callable[[int, int], str]) -> list[str]:
    """Lines of Python code that compute a CasADi SX function, all of whose operations are in `OPERATIONS`.

    Args:
        f: the function.
        read: function from the number of an input, and of an entry of it, to the expression for its value.
        write: function from the number of an output, and of an entry of it, to the variable to assign.
    """
    lines = []
    for k in range(f.n_instructions()):
        operation, to, of = f.instruction_id(k), f.instruction_output(k), f.instruction_input(k)
        if operation == ca.OP_OUTPUT:
            lines.append(f"{write(*to)} = w{of[0]}")
        elif operation == ca.OP_INPUT:
            lines.append(f"w{to[0]} = {read(*of)}")
        elif operation == ca.OP_CONST:
            value = f.instruction_constant(k)
            lines.append(f"w{to[0]} = {value!r}" if isfinite(value) else f'w{to[0]} = float("{value}")')
        else:
            lines.append(f"w{to[0]} = {OPERATIONS[operation].format(*(f'w{i}' for i in of))}")
    return lines
