"""Export of a model as functions in one C or Python file, with the values of its parameters.

The C file needs no library: it is CasADi's code, with a function of plain arrays around each of its functions. The
Python file needs only numpy and contains one line per operation of CasADi's expression graph; its functions take one
state, or many states in rows.
"""

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from shlex import quote
from typing import Any, NamedTuple

import casadi as ca

from armdyn import __version__
from armdyn.arm.composition import torque_functions_with_effects
from armdyn.arm.model import ArmModel
from armdyn.arm.slots import slots_of
from armdyn.effects.effect import recorded_columns
from armdyn.errors import InputError
from armdyn.model import Model
from armdyn.model_file import ModelFile
from armdyn.numpy_code import numpy_lines, unknown_operations
from armdyn.pendulum.model import PendulumModel
from armdyn.pendulum.variational import VARIATIONAL_STATE_SIZE
from armdyn.quoting import c_comment, python_docstring
from pipeline.exports.format import ExportedModelText, Format
from pipeline.exports.parts import inexpressible_background, inexpressible_effects


class ExportedFunction(NamedTuple):
    """One function of a model for export to C or Python.

    Attributes:
        function: the function, whose inputs and outputs are vectors or numbers.
        summary: its result in one line.
        inputs: meaning and unit of each input, by name.
        outputs: meaning and unit of each output, by name.
    """

    function: ca.Function
    summary: str
    inputs: dict[str, str]
    outputs: dict[str, str]


def exported_functions(model: Model, *, observer: bool = False) -> tuple[list[ExportedFunction], list[str]]:
    """Functions of a model for export, and sentences on effects that they lack.

    Args:
        model: the model.
        observer: whether the observer of `armdyn watch` is one of the functions of an arm.

    Raises:
        InputError: the base is a user's own, or an effect depends on the past.
    """
    if model.base not in FUNCTIONS_BY_BASE:
        raise InputError(
            f"a model of base '{model.base}' has no function for other languages: export its parameters, --output "
            "FILE.json"
        )
    functions, missing = FUNCTIONS_BY_BASE[model.base](model)
    missing += [
        f"{c.name}: it is held at {c.usual:g} {c.unit}, its usual value" for c in recorded_columns(model.effects)
    ]
    if observer and (arm := model.capability(ArmModel)) is not None:
        try:
            functions.append(_observer_of(arm))
        except InputError as error:
            missing.append(f"the observer of 'armdyn watch': {error}")
    return functions, missing


def _of_arm(model: ArmModel) -> tuple[list[ExportedFunction], list[str]]:
    from armdyn.arm.symbolic import (
        drive_command_function,
        gravity_compensation_function,
        inverse_dynamics_function,
        servo_torque_function,
    )

    per = ", ".join(
        f"{name} [{'m' if s else 'rad'}]" for name, s in zip(model.arm.joints, model.arm.slides, strict=True)
    )
    # A function lacks an effect with a memory: a small value of the background is left out, a named effect is refused.
    named = {effect.name for effect in model.named_effects}
    held = {
        effect.name
        for effect in model.effects
        if effect.name in named or not effect.in_joint or not torque_functions_with_effects([effect]).remembers
    }
    kept = model.with_only_effects(held)
    motion = {"q": f"positions: {per}", "v": "velocities, per s", "a": "accelerations, per s^2"}
    unit = "N m (forces, N, of joints that slide)"
    found = [
        ExportedFunction(
            inverse_dynamics_function(kept),
            "Torques that the drives give during a motion; dry friction has the sign of v.",
            motion,
            {"tau": f"torques, {unit}"},
        ),
        ExportedFunction(
            gravity_compensation_function(kept),
            "Torques that hold the arm where it is, and those of friction at a speed: no allocation.",
            {"q": motion["q"], "v": motion["v"]},
            {
                "gravity": f"of the arm, its load and its springs, {unit}; give these to hold it",
                "friction": f"of the joints, with the sign of v, {unit}; add a part of them to move it by hand",
            },
        ),
    ]
    if any(slots_of(effect).scales_reading for effect in kept.effects):
        found.append(
            ExportedFunction(
                drive_command_function(kept),
                "The drives' commands, or readings, while they give these torques: with their gains and offsets.",
                motion,
                {"command": f"torques to command, {unit}"},
            )
        )
    if model.drives:
        told = {"q_cmd": "commanded positions", "v_cmd": "commanded velocities, per s"}
        found.append(
            ExportedFunction(
                servo_torque_function(kept),
                "Torques of the servos; a joint moves so that inverse_dynamics gives the same.",
                {"q": motion["q"], "v": motion["v"], **told},
                {"tau": f"torques, {unit}"},
            )
        )
    instant = {effect.name for effect in kept.effects if not slots_of(effect).needs_more_than_motion}
    return found, inexpressible_effects(model, instant, "a function", symmetric=False)


def _observer_of(model: ArmModel) -> ExportedFunction:
    """The observer of `armdyn watch` for one sample; see `armdyn.watch.observer`."""
    from armdyn.watch.channels import WatchedChannels
    from armdyn.watch.observer import (
        DEFAULT_OBSERVER_BANDWIDTH,
        MAX_SAMPLE_GAP_SECONDS,
        observer_function,
        without_past_dependent_effects,
    )

    channels = WatchedChannels.of(model)
    function = observer_function(without_past_dependent_effects(model), channels)
    read = f"{len(channels.joints)} joints" + "".join(f", and 6 axes of {name}" for name in channels.sensors)
    inputs = {
        "state": f"the last call's state_next; {function.numel_in('state')} zeros at first, n = {read}",
        "step": f"since the last sample [s]; 0, less, or more than {MAX_SAMPLE_GAP_SECONDS:g} begins anew",
        "hold": "1 while something acts that the running mean must not take for usual, else 0",
        "bandwidth": f"of the low-pass, the same in every call [1/s]; {DEFAULT_OBSERVER_BANDWIDTH:g} is usual, "
        "0.8 / step the most",
        "q": "positions [rad or m]; leave a sample out where something is missing",
        "tau": "torques that the drives read [N m or N]"
        + "".join(f", then forces [N] and torques [N m] of {name}" for name in channels.sensors),
        "shift": "what of these is known and no model's matter, usually zeros",
    }
    outputs = {
        "state_next": "for the next call; its last entry is how long the filters run [s]",
        "predicted": "torques that the model expects, as of 3 / bandwidth ago",
        "residual": "read, less predicted",
        "contrast": "residual, less its mean of the last half second",
        "sources": "4 n numbers: the variance of a sound error beyond sticking is their sum, by factors of recordings",
        "sticking": "what dry friction of unknown value, near a reversal, may add or take [N m or N]",
        "friction": "2 n numbers: dry friction that the model predicts, and its mean as in contrast [N m or N]",
        "motion": "positions, then velocities and accelerations behind the low-pass",
    }
    summary = "One sample of the observer of outside torques: no allocation, the same time for every sample."
    return ExportedFunction(function, summary, inputs, outputs)


def _of_pendulum(model: PendulumModel) -> tuple[list[ExportedFunction], list[str]]:
    variational = model.variational()
    theta = ca.DM([model.parameters[name].value for name in variational.names])
    s, u, t, dt = ca.SX.sym("s", VARIATIONAL_STATE_SIZE), ca.SX.sym("u"), ca.SX.sym("t"), ca.SX.sym("dt")
    following = variational.step(s, u, t, dt, theta)
    tension = variational.tension(s, u, t, dt, theta, following)
    names = ["s", "u", "t", "dt"], ["s_next", "tension"]
    found = ExportedFunction(
        ca.Function("step", [s, u, t, dt], [ca.densify(following), ca.densify(tension)], *names),
        "One step of the midpoint variational integrator.",
        {
            "s": "gripper position [m], its velocity over the last step [m/s], swing angle [rad], its rate likewise "
            "[rad/s]",
            "u": "acceleration of the gripper [m/s^2]",
            "t": "time of s [s]",
            "dt": "length of the step [s]",
        },
        {"s_next": "the state after the step", "tension": "of the string at s [N]"},
    )
    why = dict.fromkeys(("gripper_lag", "out_of_plane_swing"), "a step along the line of motion leaves it out")
    sensors = [effect.name for effect in model.effects if effect.acts_on == "sensor"]
    why |= dict.fromkeys(sensors, "belongs to the sensor, not to the pendulum")
    notes = [f"{effect.name}: {why[effect.name]}" for effect in model.named_effects if effect.name in why]
    held = {effect.name for effect in model.effects} - why.keys()
    return [found], [*notes, *inexpressible_background(model, held, "a step along the line of motion")]


FUNCTIONS_BY_BASE: Mapping[str, Callable[[Any], tuple[list[ExportedFunction], list[str]]]] = {
    "arm": _of_arm,
    "pendulum": _of_pendulum,
}


def c_text(functions: list[ExportedFunction], about: list[str]) -> str:
    """C code of functions, after the lines `about` as a comment."""
    generator = ca.CodeGenerator("model.c", {"with_header": False, "avoid_stack": False})
    for each in functions:
        generator.add(each.function)
    prototypes = (f"  {_signature(each)};" for each in functions)
    head = c_comment([*about, "", "Compile with -lm, and call", "", *prototypes])
    return f"{head}\n{_all_used(generator.dump())}\n" + "\n".join(map(_wrapper, functions))


def _all_used(code: str) -> str:
    """CasADi's code without a compiler's warnings of unused parameters."""

    def cast(head: re.Match[str]) -> str:
        return head[0] + "".join(f" (void){name};" for name in re.findall(r"\b(iw|w|mem|i)(?=[,)])", head[0]))

    return re.sub(r"^\w[^\n;#]*\([^\n;]*\) *\{", cast, code, flags=re.MULTILINE)


def _signature(each: ExportedFunction) -> str:
    f = each.function
    inputs = [f"const double {f.name_in(i)}[{f.numel_in(i)}]" for i in range(f.n_in())]
    outputs = [f"double {f.name_out(i)}[{f.numel_out(i)}]" for i in range(f.n_out())]
    return f"int armdyn_{f.name()}({', '.join([*inputs, *outputs])})"


def _wrapper(each: ExportedFunction) -> str:
    f = each.function
    explained = (f"{name}: {what}" for name, what in (*each.inputs.items(), *each.outputs.items()))
    arguments, results = ", ".join(f.name_in()), ", ".join(f.name_out())
    lines = [
        c_comment([each.summary, *explained, "Returns 0 when it succeeded."]),
        f"{_signature(each)} {{",
        f"  const casadi_real* arg[{f.sz_arg()}] = {{{arguments}}};",
        f"  casadi_real* res[{f.sz_res()}] = {{{results}}};",
        f"  casadi_int iw[{max(f.sz_iw(), 1)}];",
        f"  casadi_real w[{max(f.sz_w(), 1)}];",
        f"  return {f.name()}(arg, res, iw, w, 0);",
        "}",
    ]
    return "\n".join(lines) + "\n"


def python_text(functions: list[ExportedFunction], about: list[str]) -> str:
    """Python code of functions, after the lines `about` as a comment."""
    return f"{python_docstring(about)}\n\nimport numpy as np\n" + "".join(
        f"\n\n{_function(each)}" for each in functions
    )


def _function(each: ExportedFunction) -> str:
    f = each.function.expand() if not each.function.is_a("SXFunction") else each.function
    for operation in unknown_operations(f):
        raise InputError(f"CasADi's operation {operation} has no line in Python: export the model as .c")
    inputs, outputs = f.name_in(), f.name_out()
    explained = [each.summary, "", "Args:"]
    explained += [f"    {name}: {_shape(f.numel_in(i))}{each.inputs[name]}." for i, name in enumerate(inputs)]
    explained += ["", "Returns:"]
    explained += [f"    {name}: {_shape(f.numel_out(i))}{each.outputs[name]}." for i, name in enumerate(outputs)]
    explained += ["", "Many states are rows of two-dimensional inputs."]
    lines = [f"def {f.name()}({', '.join(inputs)}):", python_docstring(explained, "    ")]
    lines += [f"    {name} = np.asarray({name}, dtype=float)" for name in inputs]
    work = numpy_lines(
        f, lambda i, j: f"{inputs[i]}[..., {j}]" if f.numel_in(i) > 1 else inputs[i], lambda i, j: f"r{i}_{j}"
    )
    lines += [f"    {line}" for line in work]
    for i, name in enumerate(outputs):
        entries = [f"r{i}_{j}" for j in range(f.numel_out(i))]
        if len(entries) == 1:
            lines.append(f"    {name} = {entries[0]}")
        else:
            lines.append(f"    {name} = np.stack(np.broadcast_arrays({', '.join(entries)}), axis=-1)")
    lines.append(f"    return {', '.join(outputs)}")
    return "\n".join(lines) + "\n"


def _shape(size: int) -> str:
    return "" if size == 1 else f"(..., {size}) "


def _exported(
    file: ModelFile, about: str, write: Callable[[list[ExportedFunction], list[str]], str], **of: bool
) -> ExportedModelText:
    """The functions in one language, with a comment on what they lack; `of` are the options of `exported_functions`."""
    functions, notes = exported_functions(file.model, **of)
    lines = [f"{about}, by armdyn {__version__}.", *(f"Not in it: {note}." for note in notes)]
    held = {effect.name for effect in file.model.effects if not slots_of(effect).needs_more_than_motion}
    return ExportedModelText(write(functions, lines), notes, held, functions[0].function.name())


def _export_c(file: ModelFile, output: Path, about: str) -> ExportedModelText:
    usage = f"cc -O2 -shared -fPIC {quote(str(output))} -o {quote(str(output.with_suffix('.so')))} -lm"
    return _exported(file, about, c_text, observer=True)._replace(usage=usage)


def _export_python(file: ModelFile, output: Path, about: str) -> ExportedModelText:
    found = _exported(file, about, python_text)
    return found._replace(usage=f"from {output.stem} import {found.usage}")


FORMATS = (Format(".c", "C functions", _export_c), Format(".py", "Python functions", _export_python))
