"""A model as a TOML file: base, effects, parameters and the history of what was added; the only state there is."""

import math
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

import tomlkit

from armdyn import atomic
from armdyn.effects.catalogue import find
from armdyn.effects.effect import Effect
from armdyn.errors import InputError, UnknownNameError
from armdyn.model import Model
from armdyn.parameter import Parameter, Prior
from armdyn.pendulum.dynamics import TensionFormula
from armdyn.pendulum.model import PendulumModel, pendulum_model
from armdyn.units import si_factor

BASES = ("pendulum", "arm")
TOP_LEVEL = ("base", "effects", "parameters", "history", "tension", "urdf", "robot", "joints", "tool")
FIELDS = ("value", "std", "unit", "fitted", "prior", "prior_std")


@dataclass(frozen=True)
class ModelFile:
    """What a model file holds.

    Attributes:
        model: with its effects and parameters.
        history: one entry per change, as in the file; the error falling.
        place: entries that say which robot it is (``urdf``, ``robot``, ``joints``), as in the file.
    """

    model: Model
    history: tuple[Mapping[str, Any], ...] = ()
    place: Mapping[str, Any] | None = None

    def changed(self, model: Model, entries: Iterable[Mapping[str, Any]]) -> "ModelFile":
        """The file with another model and more history."""
        return replace(self, model=model, history=(*self.history, *entries))


def read_model(path: Path | str, extra: Iterable[Effect] = ()) -> Model:
    """The model in a file; see `read_model_file`."""
    return read_model_file(path, extra).model


def read_model_file(path: Path | str, extra: Iterable[Effect] = ()) -> ModelFile:
    """Read a model file.

    Args:
        path: of the TOML file.
        extra: a user's own effects.

    Raises:
        InputError: names the file, the field, what is wrong and what to do.
        UnknownNameError: an effect or parameter that does not exist; the message names the closest.
    """
    path = Path(path)
    try:
        content = tomllib.loads(path.read_text())
    except FileNotFoundError:
        raise InputError(f"{path}: no such file: make one with 'armdyn new pendulum {path}'") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as a model file: {_reason(error)}") from error
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: is no TOML: {error}") from error
    for key in content:
        if key not in TOP_LEVEL:
            raise InputError(str(UnknownNameError(f"entry of {path}", key, TOP_LEVEL)))
    try:
        model = _with_effects(_base(path, content), content.get("effects", []), tuple(extra))
        return ModelFile(
            model=_with_parameters(path, model, content.get("parameters", {})),
            history=tuple(content.get("history", ())),
            place={key: content[key] for key in ("urdf", "robot", "joints", "tool") if key in content},
        )
    except InputError as error:
        text = str(error)
        raise InputError(text if text.startswith(str(path)) else f"{path}: {text}") from error


def write_model_file(file: ModelFile, path: Path | str) -> None:
    """Write a model file in one step.

    Raises:
        InputError: it cannot be written.
    """
    model = file.model
    document = tomlkit.document()
    document["base"] = model.base
    for key, value in (file.place or {}).items():
        document[key] = value
    if isinstance(model, PendulumModel) and model.tension != "exact":
        document["tension"] = model.tension
    document["effects"] = [effect.label for effect in model.effects]
    parameters = tomlkit.table()
    for name, parameter in model.parameters.items():
        parameters[name] = _entry(parameter)
    document["parameters"] = parameters
    if file.history:
        history = tomlkit.aot()
        for entry in file.history:
            history.append(tomlkit.item({k: v for k, v in _plain(entry).items() if v is not None}))
        document["history"] = history
    atomic.write_text(Path(path), tomlkit.dumps(document))


def _base(path: Path, content: Mapping[str, Any]) -> Model:
    base = content.get("base")
    if base == "pendulum":
        tension = content.get("tension", "exact")
        if tension not in get_args(TensionFormula):
            raise UnknownNameError("tension formula", str(tension), get_args(TensionFormula))
        return pendulum_model(0.3, 0.1, tension=tension)
    if base == "arm":
        from armdyn.arm.model import arm_model

        urdf = content.get("urdf")
        if urdf is not None and not Path(urdf).is_absolute():
            urdf = path.parent / urdf  # a model file and its URDF travel together
        return arm_model(urdf, content.get("robot"), content.get("joints"), tool=content.get("tool"))
    if base is None:
        raise InputError('has no base: write base = "pendulum" or base = "arm"')
    raise UnknownNameError("base", str(base), BASES)


def _with_effects(model: Model, names: object, extra: tuple[Effect, ...]) -> Model:
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise InputError('effects must be a list of names, such as effects = ["quadratic_drag"]')
    for name in names:
        model = model.with_effect(find(name, extra))
    return model


def _with_parameters(path: Path, model: Model, entries: Mapping[str, Any]) -> Model:
    changed = {}
    for name, entry in entries.items():
        if name not in model.parameters:
            raise UnknownNameError("parameter", name, model.names)
        parameter = model.parameters[name]
        if not isinstance(entry, Mapping) or "value" not in entry:
            raise InputError(f"{path}: [parameters] {name}: write {{ value = 0.1, unit = \"{parameter.unit}\" }}")
        for key in entry:
            if key not in FIELDS:
                raise UnknownNameError(f"field of parameter {name}", key, FIELDS)
        unit = entry.get("unit", parameter.unit)
        scale = si_factor(unit, parameter.unit) if unit != parameter.unit else 1.0
        numbers = {key: _number(path, name, key, entry[key]) * scale for key in FIELDS if key in entry and key[0] in "vsp"}
        prior = Prior(numbers.get("prior", numbers["value"]), numbers["prior_std"]) if "prior_std" in numbers else None
        null = numbers["value"] if parameter.null == parameter.value and "." not in name else parameter.null
        changed[name] = replace(
            parameter,
            value=numbers["value"],
            null=null,
            std=numbers.get("std"),
            fitted=bool(entry.get("fitted", parameter.fitted)),
            prior=prior,
        )
    return model.with_parameters(changed)


def _number(path: Path, name: str, key: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{path}: [parameters] {name}: {key} = {value} is not a finite number: write a plain number")
    return float(value)


def _entry(parameter: Parameter) -> Any:
    entry = tomlkit.inline_table()
    entry["value"] = parameter.value
    if parameter.std is not None and math.isfinite(parameter.std):
        entry["std"] = parameter.std
    entry["unit"] = parameter.unit
    entry["fitted"] = parameter.fitted
    if parameter.prior is not None:
        entry["prior"], entry["prior_std"] = parameter.prior.mean, parameter.prior.std
    return entry


def _plain(entry: Mapping[str, Any]) -> dict[str, Any]:
    return {key: dict(value) if isinstance(value, Mapping) else value for key, value in entry.items()}


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)
