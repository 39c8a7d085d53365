"""What can go wrong between a path and a table."""

from armdyn.errors import InputError, TaskFailedError


class StaleTableError(InputError):
    """A table that was built for another robot or other settings, or whose file is damaged."""


class UnreachableError(TaskFailedError):
    """A path that the arm cannot follow: the message says where, why and what to do."""
