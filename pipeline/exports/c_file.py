"""A model as one C file without dependencies: CasADi's code, and a function with plain arrays around it."""

import casadi as ca

from pipeline.exports.functions import Function


def c_text(functions: list[Function], about: str) -> str:
    """The file's text; `about` stands in its first lines."""
    generator = ca.CodeGenerator("model.c", {"with_header": False, "avoid_stack": False})
    for each in functions:
        generator.add(each.function)
    comment = "\n".join(f" * {line}" for line in about.splitlines())
    prototypes = "\n".join(f" *   {_signature(each)};" for each in functions)
    head = f"/*\n{comment}\n *\n * Compile with -lm, and call\n *\n{prototypes}\n */\n"
    return head + generator.dump() + "\n" + "\n".join(map(_wrapper, functions))


def _signature(each: Function) -> str:
    f = each.function
    inputs = [_argument(f.name_in(i), f.numel_in(i), constant=True) for i in range(f.n_in())]
    outputs = [_argument(f.name_out(i), f.numel_out(i)) for i in range(f.n_out())]
    return f"int armdyn_{f.name()}({', '.join([*inputs, *outputs])})"


def _argument(name: str, size: int, *, constant: bool = False) -> str:
    return f"{'const ' if constant else ''}double {name}[{size}]"


def _wrapper(each: Function) -> str:
    f = each.function
    lines = [f"/* {each.summary}"]
    lines += [f" * {name}: {what}" for name, what in (*each.inputs.items(), *each.outputs.items())]
    lines += [" * Returns 0 when it succeeded. */"]
    arguments = ", ".join(f.name_in(i) for i in range(f.n_in()))
    results = ", ".join(f.name_out(i) for i in range(f.n_out()))
    lines += [
        f"{_signature(each)} {{",
        f"  const casadi_real* arg[{f.sz_arg()}] = {{{arguments}}};",
        f"  casadi_real* res[{f.sz_res()}] = {{{results}}};",
        f"  casadi_int iw[{max(f.sz_iw(), 1)}];",
        f"  casadi_real w[{max(f.sz_w(), 1)}];",
        f"  return {f.name()}(arg, res, iw, w, 0);",
        "}",
    ]
    return "\n".join(lines) + "\n"
