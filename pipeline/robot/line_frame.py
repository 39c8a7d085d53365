"""The line in MuJoCo's world: where it is, and which way is along, across and up."""

from dataclasses import dataclass

import numpy as np

import urdf
from armdyn.errors import InputError
from pipeline.robot.protocol import Vector


@dataclass(frozen=True)
class LineFrame:
    """Axes of the line.

    Attributes:
        origin: the string's upper end at s = 0 (3,) [m].
        along: unit vector of increasing s (3,).
        across: horizontal unit vector at right angles to it (3,).
    """

    origin: Vector
    along: Vector
    across: Vector

    @staticmethod
    def of(robot: urdf.Robot) -> "LineFrame":
        """Frame of a robot's line.

        Raises:
            InputError: the line is not horizontal, so that a swing along it is not the paper's.
        """
        along = np.asarray(robot.line.direction, dtype=float)
        along = along / np.linalg.norm(along)
        if abs(along[2]) > 1e-6:
            raise InputError(
                f"robot '{robot.name}': the line's direction {along} is not horizontal; give one with z = 0"
            )
        across = np.cross([0.0, 0.0, 1.0], along)
        return LineFrame(np.asarray(robot.line.origin, dtype=float), along, across)

    def coordinate(self, point: Vector) -> float:
        """Line coordinate s of a point (3,) [m]."""
        return float((point - self.origin) @ self.along)
