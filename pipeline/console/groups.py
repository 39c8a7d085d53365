"""Declare options that commands share in a dataclass: each field becomes an option of the command."""

import inspect
from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, get_args, get_origin, get_type_hints

from typer.models import ArgumentInfo


def with_flattened_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Convert a function to a command for Typer: each parameter that is a dataclass is replaced by the class's fields.

    For example, ``def repair(inputs: StudyInputs, output: OutputOption = None)`` becomes a command with the arguments
    and options that `StudyInputs` declares; the function is called with a `StudyInputs` made from their values. An
    argument that takes any number of words comes last.
    """
    groups: dict[str, tuple[Any, list[str]]] = {}
    flat: list[inspect.Parameter] = []
    for parameter in inspect.signature(command).parameters.values():
        group = parameter.annotation
        if not is_dataclass(group):
            flat.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY))
            continue
        hints, declared = get_type_hints(group, include_extras=True), [each for each in fields(group) if each.init]
        groups[parameter.name] = group, [each.name for each in declared]
        for each in declared:
            default = inspect.Parameter.empty if each.default is MISSING else each.default
            kind = inspect.Parameter.KEYWORD_ONLY
            flat.append(inspect.Parameter(each.name, kind, default=default, annotation=hints[each.name]))

    def called(**given: Any) -> Any:
        made = {name: group(**{each: given.pop(each) for each in names}) for name, (group, names) in groups.items()}
        return command(**made, **given)

    called.__name__, called.__doc__ = command.__name__, command.__doc__
    called.__annotations__ = {parameter.name: parameter.annotation for parameter in flat}

    def takes_the_rest(parameter: inspect.Parameter) -> bool:
        kind, *declared = get_args(parameter.annotation) or (None,)
        return get_origin(kind) is list and any(isinstance(each, ArgumentInfo) for each in declared)

    # Typer reads a command by `inspect.signature`, which takes this signature in place of the function's own.
    vars(called)["__signature__"] = inspect.Signature(sorted(flat, key=takes_the_rest))
    return called
