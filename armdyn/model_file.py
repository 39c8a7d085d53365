"""Model files: readable TOML, the only state that is stored between commands."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

from armdyn import atomic
from armdyn.effects.catalogue import CATALOGUE, find
from armdyn.effects.effect import Effect
from armdyn.errors import InputError, UnknownNameError, error_location
from armdyn.model import Model
from armdyn.parameter import Parameter, Prior
from armdyn.recording.units import parse_quantity, si_factor
from armdyn.toml_file import read_toml
from urdf.bounds import MAX_INPUT_MAGNITUDE
from urdf.toml_tables import TomlValueCheck, table_to_dataclass

BASES = {"pendulum": "armdyn.pendulum.model", "arm": "armdyn.arm.model_entries"}
"""Module of each base model; in a model file, a user's own base is the path of a Python file."""
MODEL_FILE_KEYS = ("base", "effects", "parameters", "background", "history")
"""Keys that every model file may have; each base model adds its own, such as ``urdf``."""
_Names = str | tuple[str, ...]
_SiValues = dict[
    str,
    Annotated[float, TomlValueCheck(lambda value: abs(value) <= MAX_INPUT_MAGNITUDE, "write a number, in SI units")],
]
_Sizes = dict[str, Annotated[float, TomlValueCheck(lambda size: size >= 0.0, "write a number that is not negative")]]


@dataclass(frozen=True)
class _Change:
    """Entries of a change in the history that are checked; others are accepted."""

    added: _Names = ()
    removed: _Names = ()
    runs: _Names = ()
    held_out: _Names = ()
    rmse: _Sizes = field(default_factory=dict)
    held_out_rmse: _Sizes = field(default_factory=dict)
    exam_rmse: _Sizes = field(default_factory=dict)
    as_given_rmse: _Sizes = field(default_factory=dict)
    contribution: _Sizes = field(default_factory=dict)
    chi2_per_sample: float = 1.0
    bic: float = 0.0


@dataclass(frozen=True)
class _ParameterEntry:
    """The entries of a parameter; missing ones keep the model's value."""

    value: Annotated[
        float, TomlValueCheck(lambda value: abs(value) <= MAX_INPUT_MAGNITUDE, "write a number, in SI units")
    ]
    std: (
        Annotated[
            float, TomlValueCheck(lambda std: 0.0 <= std <= MAX_INPUT_MAGNITUDE, "write one that is not negative")
        ]
        | None
    ) = None
    unit: str | None = None
    fitted: bool | None = None
    prior: str | None = None


@dataclass(frozen=True)
class _BackgroundEntry:
    """The entries of the background; values are in SI units."""

    width: float
    values: _SiValues
    named_only: _SiValues = field(default_factory=dict)


@dataclass(frozen=True)
class ModelFile:
    """Content of a model file: a model, and the history of its changes.

    Attributes:
        model: the model, with its effects and parameters.
        description: entries of the file that define the base model, such as the path of the arm's URDF.
        history: one entry for each change of the model: the effects added, the runs used and the errors after it.
    """

    model: Model
    description: Mapping[str, Any]
    history: tuple[Mapping[str, Any], ...] = ()


def read_model(path: Path | str, extra: Iterable[Effect] = ()) -> Model:
    """Read the model in a file; see `read_model_file`."""
    return read_model_file(path, extra).model


def read_model_file(path: Path | str, extra: Iterable[Effect] = ()) -> ModelFile:
    """Read a model file.

    Args:
        path: path of the TOML file.
        extra: a user's own effects, which the model may have.

    Raises:
        InputError: the file is not valid; the message names the file, the field, the mistake and a remedy.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path} is a directory: give the model's file")
    if path.suffix.lower() in (".csv", ".mcap") and path.is_file():
        raise InputError(f"{path}: is a recording; the model's file comes first: M.toml {path.name}")
    if path.suffix.lower() in (".urdf", ".xacro", ".xml") and path.is_file():
        kind = "--mjcf" if path.suffix.lower() == ".xml" else "--urdf"
        raise InputError(f"{path}: describes a robot and is not a model's file: armdyn new arm M.toml {kind} {path}")
    table = read_toml(
        path,
        f": make one with 'armdyn new arm {path} --urdf ROBOT.urdf', 'armdyn new pendulum {path}' or "
        f"'armdyn new --base FILE.py {path}'",
    )
    with error_location(path):
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
    """Text of a model file, in TOML; paths in it are relative to `folder`, which will hold the file."""
    import tomlkit

    model, background = file.model.without_background(), file.model.background
    document = tomlkit.document()
    for key, value in {**model.file_entries(folder), **file.description}.items():
        document[key] = value
    document["effects"] = [effect.label for effect in model.effects]
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
    if background is not None:
        held = tomlkit.table()
        held["width"] = background.width
        if background.named_only:
            held["named_only"] = tomlkit.inline_table()
            held["named_only"].update(background.named_only)
        held["values"] = {name: file.model.value(name) for name in background.names}
        document["background"] = held
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
    """Make a pendulum's model without effects, with known values such as ``{"mass": "80 g +/- 0.4 g"}``."""
    from armdyn.pendulum.model import pendulum_model

    return with_known_values(pendulum_model(0.35, 0.1), known or {})


def with_known_values(model: Model, known: Mapping[str, str]) -> Model:
    """Return a copy of a model with known values of parameters.

    Args:
        model: the model without known values.
        known: values such as ``{"mass": "80 g +/- 0.4 g"}``. A value without a standard deviation is a first guess for
            a parameter that is fitted, and exact for one that is not.

    Raises:
        InputError: a name, unit or value is not valid.
    """
    settable = [name for name, p in model.parameters.items() if p.scope == "shared"]
    for name, text in known.items():
        if name not in settable:
            raise UnknownNameError("parameter", name, settable)
        parameter = model.parameters[name]
        with error_location(name):
            value = parse_quantity(text, parameter.unit)
        if value.std is not None:
            model = model.with_prior(name, value.value, value.std)
        elif not parameter.fitted:
            exact = replace(parameter, value=value.value, prior=None)
            model = model.with_parameters({name: exact})
        else:
            model = model.with_values({name: value.value})
    return model


def _parsed(table: Mapping[str, Any], folder: Path, extra: Sequence[Effect]) -> ModelFile:
    base = table.get("base")
    if base is None:
        raise InputError('there is no base: write base = "pendulum" or base = "arm" on the first line')
    own = str(base).endswith(".py")
    if not isinstance(base, str) or (base not in BASES and not own):
        raise UnknownNameError("base", str(base), BASES)
    reader = import_module("armdyn.physics.user" if own else BASES[base])
    keys = (*MODEL_FILE_KEYS, *reader.KEYS)
    for key in table:
        if key not in keys:
            raise UnknownNameError("key", key, keys)
    model, description = reader.read_base(table, folder)
    extra = (*extra, *model.own_effects)
    effects = table.get("effects", [])
    if not isinstance(effects, list) or not all(isinstance(name, str) for name in effects):
        raise InputError('effects: write a list of names, such as effects = ["linear_drag"]')
    for name in effects:
        with _own_effects_in_a_file():
            model = model.with_effect(find(name, extra))
    parameters = table.get("parameters", {})
    if not isinstance(parameters, dict):
        raise InputError("[parameters]: write a table")
    model = model.with_parameters({name: _parameter(model, name, entry) for name, entry in parameters.items()})
    if "background" in table:
        held = table_to_dataclass(_BackgroundEntry, table["background"], "[background]")
        with error_location("[background]"), _own_effects_in_a_file():
            known = {**CATALOGUE, **{item.name: item for item in extra}}
            model = model.with_background(held.width, held.values, known.values(), held.named_only)
    history = table.get("history", [])
    if not isinstance(history, list) or not all(isinstance(entry, dict) for entry in history):
        raise InputError("[[history]]: write a list of tables")
    declared = {each.name for each in fields(_Change)}
    for number, change in enumerate(history, start=1):
        table_to_dataclass(
            _Change, {key: value for key, value in change.items() if key in declared}, f"[[history]] {number}"
        )
    return ModelFile(model, description, tuple(history))


@contextmanager
def _own_effects_in_a_file() -> Iterator[None]:
    """Add a hint to the error of an unknown effect: it may be in a file of the user's effects."""
    try:
        yield
    except UnknownNameError as error:
        remedy = "; for an effect of your own give the file that defines it, --effects FILE.py"
        raise InputError(f"{error}{remedy if error.kind == 'effect' else ''}") from error


def _parameter(model: Model, name: str, entry: Any) -> Parameter:
    shared = [n for n, p in model.parameters.items() if p.scope == "shared"]
    if name not in shared:
        raise UnknownNameError("parameter", name, shared)
    if not isinstance(entry, dict) or "value" not in entry:
        raise InputError(f'parameter {name}: write it as {{ value = 1.0, unit = "{model.parameters[name].unit}" }}')
    parameter = model.parameters[name]
    said = table_to_dataclass(_ParameterEntry, entry, f"parameter {name}")
    factor = si_factor(said.unit, parameter.unit) if said.unit is not None else 1.0
    prior = parameter.prior if parameter.effect else None
    if said.prior is not None:
        known = parse_quantity(f"{said.prior} {parameter.unit}", parameter.unit)
        if known.std is None:
            raise InputError(f'parameter {name}: write its prior as "0.08 +/- 0.0004", in {parameter.unit}')
        prior = Prior(known.value, known.std)
        if not parameter.lower <= prior.mean <= parameter.upper:
            raise InputError(f"parameter {name}: the mean of its prior, {prior.mean:g}, is outside its physical range")
    return replace(
        parameter,
        value=factor * said.value,
        std=None if said.std is None else factor * said.std,
        fitted=parameter.fitted if said.fitted is None else said.fitted,
        prior=prior,
    )
