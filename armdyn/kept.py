"""What is worked out of an object is kept with it, and goes when it goes."""

from collections.abc import Callable, Hashable
from functools import wraps
from typing import Concatenate, ParamSpec, TypeVar, cast

First = TypeVar("First")
Others = ParamSpec("Others")
Found = TypeVar("Found")


def cached_with_first_argument(
    function: Callable[Concatenate[First, Others], Found],
) -> Callable[Concatenate[First, Others], Found]:
    """Work out once what a function makes of its first argument, and keep it as long as that lives.

    The motion of an arm at the stamps of one recording is 100 MB: a table that outlives the recordings would fill the
    memory where hundreds of them are read one after the other.

    Args:
        function: of an object that has a dictionary of attributes, such as a run, and of hashable arguments.
    """

    @wraps(function)
    def kept(first: First, *others: Others.args, **named: Others.kwargs) -> Found:
        found: dict[Hashable, Found] = first.__dict__.setdefault("_kept", {})
        key = (function, *others, *named.items())
        if key not in found:
            found[key] = function(first, *others, **named)
        return found[key]

    return cast(Callable[Concatenate[First, Others], Found], kept)
