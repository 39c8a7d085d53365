"""What can be wrong with a robot description."""


class UrdfError(Exception):
    """A robot description that cannot be used: the message says what, where and what to do, in one line."""
