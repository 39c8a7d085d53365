"""Hidden physics of the joints that depends on the state: frictions that vary, and gravity springs."""

from collections.abc import Mapping

import mujoco
import numpy as np
import numpy.typing as npt

import urdf
from armdyn.errors import InputError
from pipeline.robot.protocol import Vector
from pipeline.robot.scene import effort_share

_VARYING_FRICTION = ("joint_asymmetric_friction", "joint_stribeck_friction", "joint_load_friction")

STRIBECK_SPEED = 0.1
"""Joint speed over which the excess friction of standstill fades [rad/s]."""


class JointEffects:
    """Sets MuJoCo's dry friction and the spring torques for the state at which it stands.

    Dry friction stays a constraint of MuJoCo's solver, which holds a joint at rest exactly; only its bound changes.

    Args:
        model: the plant, whose dry friction is changed at every step.
        data: its state; spring torques go to ``qfrc_applied``.
        robot: names, limits and springs of the joints.
        hidden: value of every effect.
        dofs: index of each joint in MuJoCo's velocity (n,).

    Raises:
        InputError: a gravity spring is asked for and none is known for this robot.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        robot: urdf.Robot,
        hidden: Mapping[str, float],
        dofs: npt.NDArray[np.intp],
    ) -> None:
        self._model, self._data, self._hidden, self._dofs = model, data, hidden, dofs
        self._share = effort_share(robot)
        self._base = model.dof_frictionloss[dofs].copy()
        self._varying = any(hidden[name] != 0.0 for name in _VARYING_FRICTION)
        self._springs: list[tuple[int, float, float]] = []
        strength = hidden["gravity_spring"]
        if strength:
            for spring in robot.springs:
                dof = int(dofs[robot.joint_names.index(spring.joint)])
                # The robot's springs are given by the effort that they add to a measurement; they pull the other way.
                self._springs.append((dof, -strength * spring.sine, -strength * spring.cosine))
            if not self._springs:
                raise InputError(
                    f"hidden effect 'gravity_spring': no spring is known for robot '{robot.name}'; leave it out"
                )

    def apply(self) -> None:
        """Update friction bounds and spring torques; needs MuJoCo's bias force of this state."""
        for dof, sine, cosine in self._springs:
            angle = self._data.qpos[self._model.jnt_qposadr[self._model.dof_jntid[dof]]]
            self._data.qfrc_applied[dof] = sine * np.sin(angle) + cosine * np.cos(angle)
        if self._varying:
            self._model.dof_frictionloss[self._dofs] = self._base + self._extra_friction()

    def _extra_friction(self) -> Vector:
        hidden, share = self._hidden, self._share
        v = self._data.qvel[self._dofs]
        extra = hidden["joint_stribeck_friction"] * share * np.exp(-((v / STRIBECK_SPEED) ** 2))
        extra += hidden["joint_asymmetric_friction"] * share * (v > 0.0)
        extra += hidden["joint_load_friction"] * np.abs(self._data.qfrc_bias[self._dofs])
        total: Vector = extra
        return total
