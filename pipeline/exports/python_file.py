"""A model as one Python file that needs numpy alone: CasADi's expression graph, an operation per line.

The functions take one state or many at once, in rows: all operations are numpy's.
"""

import casadi as ca

from armdyn.errors import InputError
from pipeline.exports.functions import Function

BINARY = {
    ca.OP_ADD: "{} + {}", ca.OP_SUB: "{} - {}", ca.OP_MUL: "{} * {}", ca.OP_DIV: "{} / {}", ca.OP_POW: "{} ** {}",
    ca.OP_CONSTPOW: "{} ** {}", ca.OP_FMIN: "np.minimum({}, {})", ca.OP_FMAX: "np.maximum({}, {})",
    ca.OP_ATAN2: "np.arctan2({}, {})", ca.OP_LT: "np.less({}, {}) * 1.0", ca.OP_LE: "np.less_equal({}, {}) * 1.0",
    ca.OP_EQ: "np.equal({}, {}) * 1.0", ca.OP_NE: "np.not_equal({}, {}) * 1.0",
    ca.OP_AND: "np.logical_and({}, {}) * 1.0", ca.OP_OR: "np.logical_or({}, {}) * 1.0",
    ca.OP_IF_ELSE_ZERO: "np.where({}, {}, 0.0)", ca.OP_FMOD: "np.fmod({}, {})", ca.OP_HYPOT: "np.hypot({}, {})",
    ca.OP_COPYSIGN: "np.copysign({}, {})",
}  # fmt: skip
UNARY = {
    ca.OP_ASSIGN: "{}", ca.OP_NEG: "-{}", ca.OP_EXP: "np.exp({})", ca.OP_LOG: "np.log({})", ca.OP_SQRT: "np.sqrt({})",
    ca.OP_SQ: "{0} * {0}", ca.OP_TWICE: "2.0 * {}", ca.OP_SIN: "np.sin({})", ca.OP_COS: "np.cos({})",
    ca.OP_TAN: "np.tan({})", ca.OP_ASIN: "np.arcsin({})", ca.OP_ACOS: "np.arccos({})", ca.OP_ATAN: "np.arctan({})",
    ca.OP_SINH: "np.sinh({})", ca.OP_COSH: "np.cosh({})", ca.OP_TANH: "np.tanh({})", ca.OP_FABS: "np.abs({})",
    ca.OP_SIGN: "np.sign({})", ca.OP_INV: "1.0 / {}", ca.OP_FLOOR: "np.floor({})", ca.OP_CEIL: "np.ceil({})",
    ca.OP_NOT: "np.logical_not({}) * 1.0", ca.OP_LOG1P: "np.log1p({})", ca.OP_EXPM1: "np.expm1({})",
}  # fmt: skip


def python_text(functions: list[Function], about: str) -> str:
    """The file's text; `about` stands in its first lines."""
    head = '"""' + about.replace("\\", "\\\\").replace('"""', "'''") + '\n"""\n\nimport numpy as np\n'
    return head + "".join(f"\n\n{_function(each)}" for each in functions)


def _function(each: Function) -> str:
    f = each.function.expand() if not each.function.is_a("SXFunction") else each.function
    inputs, outputs = f.name_in(), f.name_out()
    lines = [f"def {f.name()}({', '.join(inputs)}):", f'    """{each.summary}', "", "    Args:"]
    lines += [f"        {name}: {_shape(f.numel_in(i))}{each.inputs[name]}." for i, name in enumerate(inputs)]
    lines += ["", "    Returns:"]
    lines += [f"        {name}: {_shape(f.numel_out(i))}{each.outputs[name]}." for i, name in enumerate(outputs)]
    lines += ["", "    Many states are rows of two-dimensional inputs.", '    """']
    lines += [f"    {name} = np.asarray({name}, dtype=float)" for name in inputs]
    results: dict[tuple[int, int], str] = {}
    for k in range(f.n_instructions()):
        line = _instruction(f, k, inputs, results)
        if line:
            lines.append(f"    {line}")
    returned = []
    for i, name in enumerate(outputs):
        entries = [results.get((i, j), "0.0") for j in range(f.numel_out(i))]
        if len(entries) == 1:
            lines.append(f"    {name} = {entries[0]}")
        else:
            lines.append(f"    {name} = np.stack(np.broadcast_arrays({', '.join(entries)}), axis=-1)")
        returned.append(name)
    lines.append(f"    return {', '.join(returned)}")
    return "\n".join(lines) + "\n"


def _shape(size: int) -> str:
    return "" if size == 1 else f"(..., {size}) "


def _instruction(f: ca.Function, k: int, inputs: list[str], results: dict[tuple[int, int], str]) -> str:
    """One operation as a line; what is an output is remembered instead."""
    operation, into, out_of = f.instruction_id(k), f.instruction_output(k), f.instruction_input(k)
    if operation == ca.OP_OUTPUT:
        results[into[0], into[1]] = f"r{into[0]}_{into[1]}"
        return f"r{into[0]}_{into[1]} = w{out_of[0]}"  # its place is used again
    if operation == ca.OP_INPUT:
        name = inputs[out_of[0]]
        return f"w{into[0]} = {name}[..., {out_of[1]}]" if f.numel_in(out_of[0]) > 1 else f"w{into[0]} = {name}"
    if operation == ca.OP_CONST:
        return f"w{into[0]} = {f.instruction_constant(k)!r}"
    template = UNARY.get(operation) or BINARY.get(operation)
    if template is None:
        raise InputError(f"CasADi's operation {operation} has no line in Python: export the model as .c")
    return f"w{into[0]} = {template.format(*(f'w{i}' for i in out_of))}"
