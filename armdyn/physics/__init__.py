"""Define a physics by its equations: everything that a user's own base needs.

For examples see ``examples/double_pendulum.py`` and ``examples/crane.py``.
"""

from armdyn.physics.definition import (
    Equations,
    Expression,
    Moment,
    Physics,
    Rate,
    Reading,
    Stage,
    constant,
    physics,
    state,
)

__all__ = ["Equations", "Expression", "Moment", "Physics", "Rate", "Reading", "Stage", "constant", "physics", "state"]
