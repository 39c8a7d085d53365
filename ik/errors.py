"""What can go wrong between a path and a table."""

from typing import TYPE_CHECKING

from armdyn.errors import InputError, TaskFailedError

if TYPE_CHECKING:
    from ik.solver import Miss


class StaleTableError(InputError):
    """A table that was built for another robot or other settings, or whose file is damaged."""


class UnreachableError(TaskFailedError):
    """A path that the arm cannot follow.

    Args:
        message: what, where and what to do.
        misses: the targets that cannot be held, where single targets are to blame.
    """

    def __init__(self, message: str, misses: "tuple[Miss, ...]" = ()) -> None:
        self.misses = misses
        super().__init__(message)
