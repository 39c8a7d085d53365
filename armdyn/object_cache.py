"""Cache results in the object from which they were computed, so that they are deleted together with it."""

from collections.abc import Callable, Hashable
from functools import wraps
from typing import Concatenate, ParamSpec, TypeVar, cast

First = TypeVar("First")
Others = ParamSpec("Others")
Found = TypeVar("Found")


def cached_with_first_argument(
    function: Callable[Concatenate[First, Others], Found],
) -> Callable[Concatenate[First, Others], Found]:
    """Decorator: cache a function's results in the object that is its first argument, as long as that object exists.

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
