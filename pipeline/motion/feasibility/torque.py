"""The torque that the motors must give: inverse dynamics with what the URDF leaves out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import urdf
from armdyn.errors import InputError, UnknownNameError

Array = NDArray[np.float64]
ExtraTorque = Callable[[Array, Array, Array], Array]
"""Torque that acts on the joints besides the motors (n,), of positions, speeds and accelerations (n,)."""


class JointTorque:
    """Motor torques for a motion of the arm.

    ``tau = RNEA(q, v, a) + d v + tau_spring(q) - tau_extra(q, v, a)``, with the load as a point mass at the tool point
    and the viscous damping d of the URDF, which Pinocchio's RNEA leaves out.

    Args:
        robot: the arm.
        load_mass: hanging from the tool point [kg].
        springs: count the springs of the robot's settings; by default those that the settings switch on.
        extra: further torques on the joints.

    Raises:
        InputError: if the mass is negative or not a number.
    """

    def __init__(
        self,
        robot: urdf.Robot,
        load_mass: float = 0.0,
        springs: bool | None = None,
        extra: Sequence[ExtraTorque] = (),
    ) -> None:
        if not (np.isfinite(load_mass) and load_mass >= 0.0):
            raise InputError(f"load mass: {load_mass} kg is no mass; give a number of kg, 0 or more")
        self._model = pin.Model(robot.model)
        frame = robot.model.frames[robot.tool_frame_id]
        lever = frame.placement.act(np.asarray(robot.tool_offset))
        self._model.inertias[frame.parentJoint] += pin.Inertia(load_mass, lever, np.zeros((3, 3)))
        self._data = self._model.createData()
        self._springs = tuple(
            (_index(robot, spring.joint), spring)
            for spring in robot.springs
            if (spring.enabled if springs is None else springs)
        )
        self._extra = tuple(extra)
        self.damping = np.array(robot.model.damping, dtype=float)

    def __call__(self, q: Array, v: Array, a: Array) -> Array:
        """Torques for postures in motion.

        Args:
            q: positions (k, n) [rad].
            v: speeds (k, n) [rad/s].
            a: accelerations (k, n) [rad/s^2].

        Returns:
            (k, n) [N m].
        """
        tau = np.array([pin.rnea(self._model, self._data, *row) for row in zip(q, v, a, strict=True)])
        tau = tau.reshape(len(q), self._model.nv) + self.damping * v
        for joint, spring in self._springs:
            tau[:, joint] += spring.torque(q[:, joint])
        for extra in self._extra:
            tau -= np.array([extra(*row) for row in zip(q, v, a, strict=True)])
        return tau


@dataclass(frozen=True)
class LineTorque:
    """Joint torques along a line, ``tau(s, v, a) = m(s) a + c(s) v^2 + d(s) v + g(s)``.

    Attributes:
        s: nodes (k,) [m].
        inertia: m (k, n) [N m s^2/m].
        coriolis: c (k, n) [N m s^2/m^2].
        damping: d (k, n) [N m s/m].
        gravity: g (k, n) [N m].
        limit: largest torque (n,) [N m].
    """

    s: Array
    inertia: Array
    coriolis: Array
    damping: Array
    gravity: Array
    limit: Array

    @classmethod
    def of(cls, s: Array, q: Array, dq_ds: Array, d2q_ds2: Array, torque: JointTorque, limit: Array) -> LineTorque:
        """Coefficients from the postures of a table.

        Args:
            s: nodes (k,) [m].
            q: postures (k, n) [rad].
            dq_ds: their derivatives (k, n) [rad/m].
            d2q_ds2: their second derivatives (k, n) [rad/m^2].
            torque: of the joints.
            limit: largest torque (n,) [N m].
        """
        still = np.zeros_like(q)
        gravity = torque(q, still, still)
        damping = torque.damping * dq_ds
        inertia = torque(q, still, dq_ds) - gravity
        coriolis = torque(q, dq_ds, d2q_ds2) - gravity - damping
        return cls(s, inertia, coriolis, damping, gravity, np.asarray(limit, dtype=float))


def _index(robot: urdf.Robot, joint: str) -> int:
    if joint not in robot.joint_names:
        raise UnknownNameError(f"joint of a spring of {robot.name}", joint, robot.joint_names)
    return robot.joint_names.index(joint)
