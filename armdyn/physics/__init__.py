"""What a physics is, and how any of them is simulated, read by sensors and held against recordings.

A user's own base needs only what is named here; see ``examples/double_pendulum.py`` and ``examples/crane.py``.
"""

from armdyn.physics.definition import Equations, Expression, Moment, Physics, Reading, Stage, constant, physics, state

__all__ = ["Equations", "Expression", "Moment", "Physics", "Reading", "Stage", "constant", "physics", "state"]
