"""Which postures of an arm are free of collisions with itself, as its feasibility check asks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

import urdf
from urdf.robot import Array

FAR = 0.1
"""m; links that are so much further apart than asked for are far from touching."""
ASKED_MORE = 1.5
"""Times what the check asks for: a motion is designed on a grid, and checked in between."""

REMEMBERED = 5000
"""Postures whose distances are kept."""


@dataclass(frozen=True, eq=False)
class FreePostures:
    """Postures that the check allows; for `armdyn.excitation`.

    Attributes:
        robot: the arm.
        clearance: asked for between its links [m].
    """

    robot: urdf.Robot
    clearance: float

    @cached_property
    def _collision(self) -> urdf.CollisionModel:
        return urdf.CollisionModel(self.robot)

    @cached_property
    def _shapes(self) -> bool:
        """Whether there is anything to collide with; a URDF whose meshes are missing has nothing."""
        return bool(self._collision.pairs)

    @cached_property
    def _known(self) -> dict[bytes, float]:
        """Margins of the last postures: a motion is looked at twice, and meshes take milliseconds each time."""
        return {}

    def free(self, q: Array) -> bool:
        """Whether no links touch."""
        return not self._shapes or self._collision.touching(q) is None

    def margins(self, q: Array) -> Array:
        """(1,) distance between links beyond what is asked for, in units of `FAR`."""
        if not self._shapes:
            return np.array([np.inf])
        key = q.tobytes()
        if key not in self._known:
            if len(self._known) >= REMEMBERED:
                self._known.clear()
            self._known[key] = (self._collision.clearance(q).distance - ASKED_MORE * self.clearance) / FAR
        return np.array([self._known[key]])
