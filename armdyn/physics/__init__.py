"""Define a physics, simulate it, read it with sensors, and compare it with recordings.

A user's own base needs only what is named here; see ``examples/double_pendulum.py`` and ``examples/crane.py``.
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
