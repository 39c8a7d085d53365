"""What can go wrong between a path and a table."""

from armdyn.errors import InputError, TaskFailedError


class StaleTableError(InputError):
    """A table that was built for another robot, or whose file is damaged."""


class UnreachableError(TaskFailedError):
    """A target that the arm cannot reach: the message names it and says how far off the arm stays and why."""
