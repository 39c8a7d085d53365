"""Which postures of an arm are free of collisions with itself and of singularities, as its feasibility check asks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

import urdf
from urdf.robot import Array

FAR = 0.1
"""m, and singular value of the tool's Jacobian: a posture that is so much freer than asked for is far from trouble."""
ASKED_MORE = 1.5
"""Times what the check asks for: a motion is designed on a grid, and checked in between."""


@dataclass(frozen=True, eq=False)
class FreePostures:
    """Postures that the check allows; for `armdyn.excitation`.

    Attributes:
        robot: the arm.
        clearance: asked for between its links [m].
        singular_value: smallest one asked of the tool's Jacobian [1].
    """

    robot: urdf.Robot
    clearance: float
    singular_value: float

    @cached_property
    def _collision(self) -> urdf.CollisionModel:
        return urdf.CollisionModel(self.robot)

    @cached_property
    def _data(self) -> pin.Data:
        return self.robot.model.createData()

    @cached_property
    def _side(self) -> float:
        """Sign of the Jacobian's determinant at home; a motion that changes it goes through a singularity."""
        return float(np.sign(np.linalg.det(self._jacobian(self.robot.home)))) if len(self.robot.home) == 6 else 1.0

    @cached_property
    def _shapes(self) -> bool:
        """Whether there is anything to collide with; a URDF whose meshes are missing has nothing."""
        return bool(self._collision.pairs)

    @cached_property
    def _tool(self) -> int:
        return self.robot.tool_frame_id

    def free(self, q: Array) -> bool:
        """Whether no links touch and the posture is on the home's side of all singularities."""
        if self._singular_value(q) < self.singular_value:
            return False
        return not self._shapes or self._collision.touching(q) is None

    def margins(self, q: Array) -> Array:
        """(2,) distance between links and singular value beyond what is asked for, in units of `FAR`."""
        apart = self._collision.clearance(q).distance if self._shapes else np.inf
        beyond = (apart - ASKED_MORE * self.clearance, self._singular_value(q) - ASKED_MORE * self.singular_value)
        return np.minimum(np.array(beyond) / FAR, 10.0)

    def _singular_value(self, q: Array) -> float:
        """Smallest singular value of the tool's Jacobian; negative beyond a singularity of an arm of six joints."""
        jacobian = self._jacobian(q)
        smallest = float(np.linalg.svd(jacobian, compute_uv=False)[-1])
        if jacobian.shape[1] != 6:
            return smallest
        return float(np.copysign(smallest, self._side * np.linalg.det(jacobian)))

    def _jacobian(self, q: Array) -> Array:
        q, axes = np.asarray(q, dtype=float), pin.LOCAL_WORLD_ALIGNED
        jacobian = pin.computeFrameJacobian(self.robot.model, self._data, q, self._tool, axes)
        return np.asarray(jacobian).reshape(6, -1)
