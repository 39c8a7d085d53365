"""`--hidden EFFECT[=VALUE]`, as several commands take it."""

from math import isfinite

from armdyn.errors import InputError


def parse_hidden(given: list[str]) -> dict[str, float | None]:
    """Effects by name; None stands for the typical size.

    Raises:
        InputError: a value that is not a finite number, or an effect that is named twice.
    """
    hidden: dict[str, float | None] = {}
    for entry in given:
        name, equals, text = entry.partition("=")
        if name in hidden:
            raise InputError(f"--hidden {entry}: '{name}' is given twice: give each effect once")
        try:
            value = float(text) if equals else None
        except ValueError:
            value = float("nan")
        if value is not None and not isfinite(value):
            raise InputError(
                f"--hidden {entry}: '{text}' is not a number: write {name}=0.01, or {name} for its typical size"
            )
        hidden[name] = value
    return hidden
