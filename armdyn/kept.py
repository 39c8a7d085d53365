"""Cache results with the object from which they were computed; they are deleted with the object."""

from collections.abc import Callable, Hashable
from functools import wraps
from typing import Concatenate, ParamSpec, TypeVar, cast

First = TypeVar("First")
Others = ParamSpec("Others")
Found = TypeVar("Found")


def cached_with_first_argument(
    function: Callable[Concatenate[First, Others], Found],
) -> Callable[Concatenate[First, Others], Found]:
    """Decorate a function so that its results are cached with its first argument, as long as that exists.

    The motion of an arm at the stamps of one recording is 100 MB: a cache that outlives the recordings would fill the
    memory where hundreds of them are read one after the other.

    Args:
        function: its first argument has a dictionary of attributes, such as a run; the others are hashable.
    """

    @wraps(function)
    def kept(first: First, *others: Others.args, **named: Others.kwargs) -> Found:
        found: dict[Hashable, Found] = first.__dict__.setdefault("_kept", {})
        key = (function, *others, *named.items())
        if key not in found:
            found[key] = function(first, *others, **named)
        return found[key]

    return cast(Callable[Concatenate[First, Others], Found], kept)
