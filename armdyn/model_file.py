"""Model files: readable TOML, the only state that is kept between commands."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

from armdyn import atomic
from armdyn.effects.catalogue import find
from armdyn.effects.effect import Effect
from armdyn.errors import InputError, UnknownNameError, at
from armdyn.model import Model
from armdyn.parameter import Parameter, Prior
from armdyn.toml_file import Entry, is_names, is_number, is_text, problems_in, read_toml
from armdyn.units import parse_quantity, si_factor
from urdf.bounds import LARGEST

BASES = {"pendulum": "armdyn.pendulum.model", "arm": "armdyn.arm.model"}
"""Where each base is read; a user's own is the path of a Python file."""
KEYS = ("base", "effects", "parameters", "history")
"""Keys of every model file; each base has its own besides."""
_NAMES = Entry(lambda given: isinstance(given, str) or is_names(given), "write a name, or a list of names")
_SIZES = Entry(
    lambda given: isinstance(given, dict) and all(is_number(size) and size >= 0.0 for size in given.values()),
    "write a table of numbers that are not negative",
)
_NUMBER = Entry(is_number, "write a number")
CHANGE = {
    "added": _NAMES, "removed": _NAMES, "runs": _NAMES, "held_out": _NAMES, "rmse": _SIZES, "held_out_rmse": _SIZES,
    "exam_rmse": _SIZES, "as_given_rmse": _SIZES, "contribution": _SIZES, "chi2_per_sample": _NUMBER, "bic": _NUMBER,
}  # fmt: skip
"""What the entries of a change in the history are; others are let pass."""
PARAMETER = {
    "value": Entry(lambda given: is_number(given) and abs(given) <= LARGEST, "write a number, in SI units"),
    "std": Entry(
        lambda given: is_number(given) and 0.0 <= given <= LARGEST,
        "write a finite number that is not negative, or none",
    ),
    "unit": Entry(is_text, 'write a text such as "kg"'),
    "fitted": Entry(lambda given: isinstance(given, bool), "write true or false"),
    "prior": Entry(is_text, 'write a text such as "0.08 +/- 0.0004"'),
}
"""What the fields of a parameter are."""


@dataclass(frozen=True)
class ModelFile:
    """A model and how it came to be.

    Attributes:
        model: with its effects and parameters.
        description: keys that belong to the base, such as which arm it is.
        history: one entry per change, as in the contract.
    """

    model: Model
    description: Mapping[str, Any]
    history: tuple[Mapping[str, Any], ...] = ()


def read_model(path: Path | str, extra: Iterable[Effect] = ()) -> Model:
    """The model in a file; see `read_model_file`."""
    return read_model_file(path, extra).model


def read_model_file(path: Path | str, extra: Iterable[Effect] = ()) -> ModelFile:
    """Read a model file.

    Args:
        path: TOML.
        extra: a user's own effects, which the model may have.

    Raises:
        InputError: names the file, the field, what is wrong and what to do.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path} is a directory: give the model's file")
    table = read_toml(path, f": make one with 'armdyn new pendulum {path}'")
    with at(path):
        return _parsed(table, path.parent, tuple(extra))


def write_model_file(path: Path | str, file: ModelFile) -> None:
    """Write a model file in one step.

    Raises:
        InputError: the directory is missing or cannot be written to.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path} is a directory: give the file to write")
    atomic.write_text(path, model_text(file, path.parent))


def model_text(file: ModelFile, folder: Path) -> str:
    """The model file as TOML; paths in it begin at the folder where it will lie."""
    import tomlkit

    model = file.model
    document = tomlkit.document()
    for key, value in {**model.described(folder), **file.description}.items():
        document[key] = value
    document["effects"] = [effect.label for effect in model.effects if not effect.wrong]
    parameters = tomlkit.table()
    usual = {p.name: p.prior for effect in model.effects for p in effect.parameters()}
    for name, parameter in model.parameters.items():
        if parameter.scope == "per_run":
            continue
        entry = tomlkit.inline_table()
        entry["value"] = float(parameter.value)
        if parameter.std is not None:
            entry["std"] = float(parameter.std)
        entry["unit"] = parameter.unit
        entry["fitted"] = parameter.fitted
        if parameter.prior is not None and parameter.prior != usual.get(name):
            entry["prior"] = f"{parameter.prior.mean!r} +/- {parameter.prior.std!r}"
        parameters[name] = entry
    document["parameters"] = parameters
    if file.history:
        entries = tomlkit.aot()
        for change in file.history:
            item = tomlkit.table()
            for key, value in change.items():
                if value is None:
                    continue
                if isinstance(value, Mapping):
                    inner = tomlkit.inline_table()
                    for k, v in value.items():
                        inner[k] = v
                    item[key] = inner
                else:
                    item[key] = list(value) if isinstance(value, tuple) else value
            entries.append(item)
        document["history"] = entries
    return tomlkit.dumps(document)


def base_pendulum(known: Mapping[str, str] | None = None) -> Model:
    """A bare pendulum with what is known of it; see `with_known`."""
    from armdyn.pendulum.model import pendulum_model

    return with_known(pendulum_model(0.35, 0.1), known or {})


def with_known(model: Model, known: Mapping[str, str]) -> Model:
    """A model with what is known of its parameters.

    Args:
        model: without it.
        known: such as ``{"mass": "80 g +/- 0.4 g"}``; without a standard deviation a value is only a first guess.

    Raises:
        InputError: an unknown name, unit or value.
    """
    settable = [name for name, p in model.parameters.items() if p.scope == "shared"]
    for name, text in known.items():
        if name not in settable:
            raise UnknownNameError("parameter", name, settable)
        parameter = model.parameters[name]
        with at(name):
            value = parse_quantity(text, parameter.unit)
        if value.std is None:
            model = model.with_values({name: value.value})
        else:
            model = model.with_prior(name, value.value, value.std)
    return model


def _parsed(table: Mapping[str, Any], folder: Path, extra: Sequence[Effect]) -> ModelFile:
    base = table.get("base")
    if base is None:
        raise InputError('there is no base: write base = "pendulum" or base = "arm" on the first line')
    own = str(base).endswith(".py")
    if not isinstance(base, str) or (base not in BASES and not own):
        raise UnknownNameError("base", str(base), BASES)
    reader = import_module("armdyn.physics.user" if own else BASES[base])
    keys = (*KEYS, *reader.KEYS)
    for key in table:
        if key not in keys:
            raise UnknownNameError("key", key, keys)
    model, description = reader.read_base(table, folder)
    extra = (*extra, *model.own_effects)
    effects = table.get("effects", [])
    if not isinstance(effects, list) or not all(isinstance(name, str) for name in effects):
        raise InputError('effects: write a list of names, such as effects = ["linear_drag"]')
    for name in effects:
        try:
            model = model.with_effect(find(name, extra))
        except UnknownNameError as error:
            remedy = "; for an effect of your own give the file that defines it, --effects FILE.py"
            raise InputError(f"{error}{remedy if error.kind == 'effect' else ''}") from error
    parameters = table.get("parameters", {})
    if not isinstance(parameters, dict):
        raise InputError("[parameters]: write a table")
    changed = {name: _parameter(model, name, entry) for name, entry in parameters.items()}
    history = table.get("history", [])
    if not isinstance(history, list) or not all(isinstance(entry, dict) for entry in history):
        raise InputError("[[history]]: write a list of tables")
    for number, entry in enumerate(history, start=1):
        for problem in problems_in({key: value for key, value in entry.items() if key in CHANGE}, CHANGE):
            raise InputError(f"[[history]] {number}: {problem}")
    return ModelFile(model.with_parameters(changed), description, tuple(history))


def _parameter(model: Model, name: str, entry: Any) -> Parameter:
    shared = [n for n, p in model.parameters.items() if p.scope == "shared"]
    if name not in shared:
        raise UnknownNameError("parameter", name, shared)
    if not isinstance(entry, dict) or "value" not in entry:
        raise InputError(f'parameter {name}: write it as {{ value = 1.0, unit = "{model.parameters[name].unit}" }}')
    parameter = model.parameters[name]
    for problem in problems_in(entry, PARAMETER):
        raise InputError(f"parameter {name}: {problem}")
    factor = si_factor(entry["unit"], parameter.unit) if "unit" in entry else 1.0
    value = float(entry["value"]) * factor
    std = float(entry["std"]) * factor if "std" in entry else None
    fitted = entry.get("fitted", parameter.fitted)
    prior = parameter.prior
    if "prior" in entry:
        known = parse_quantity(f"{entry['prior']} {parameter.unit}", parameter.unit)
        if known.std is None:
            raise InputError(f'parameter {name}: write its prior as "0.08 +/- 0.0004", in {parameter.unit}')
        prior = Prior(known.value, known.std)
        if not parameter.lower <= prior.mean <= parameter.upper:
            raise InputError(f"parameter {name}: the mean of its prior, {prior.mean:g}, is outside its physical range")
    return replace(parameter, value=value, std=std, fitted=fitted, prior=prior)
