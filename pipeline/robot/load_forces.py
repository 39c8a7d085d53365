"""Hidden forces on the load, evaluated at every step from MuJoCo's own state."""

import math
from collections.abc import Mapping

import mujoco
import numpy as np

from pipeline.robot.load_string import LoadString
from pipeline.robot.protocol import Vector

_NEEDS_STATE = (
    "linear_drag",
    "quadratic_drag",
    "pivot_viscous_friction",
    "pivot_coulomb_friction",
    "string_elasticity",
)

STANDSTILL_RATE = 1e-3
"""Swing rate within which dry friction at the pivot grows to its full value [rad/s]."""


class LoadForces:
    """Drag, wind, friction at the pivot and the inner damping of an elastic string.

    The reaction of these forces of some millinewton on the arm is left out; the string passes the rest on.

    Args:
        model: the plant.
        data: its state; the forces go to ``xfrc_applied`` of the load.
        string: between gripper and load.
        hidden: value of every effect.
        along: unit vector of the line (3,).
        mass: true mass of the load [kg].
        length: pivot to the load's centre [m].
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        string: LoadString,
        hidden: Mapping[str, float],
        along: Vector,
        mass: float,
        length: float,
    ) -> None:
        self._model, self._data, self._string, self._hidden = model, data, string, hidden
        self._load, self._pivot = model.body("load").id, model.site("pivot").id
        self._wind = hidden["wind"] * along
        self._force = data.xfrc_applied[self._load][:3]
        self._force[:] = self._wind
        self._active = any(hidden[name] != 0.0 for name in _NEEDS_STATE)
        self._velocity = np.zeros((2, 6))
        # A regularised sign is stable when it cannot turn the motion round within a step.
        reversal = hidden["pivot_coulomb_friction"] * model.opt.timestep / (mass * length**2)
        self._standstill = max(STANDSTILL_RATE, 2.0 * reversal)

    def apply(self) -> None:
        """Set the forces for the state at which MuJoCo stands."""
        if not self._active:
            return
        hidden = self._hidden
        pivot, load = self._velocities()
        speed = math.sqrt(load @ load)
        force = self._wind - (hidden["linear_drag"] + hidden["quadratic_drag"] * speed) * load
        if self._string.pull(self._data) > 0.0:
            force = force + self._from_string(load - pivot)
        self._force[:] = force

    def _from_string(self, relative: Vector) -> Vector:
        """Friction at the pivot and inner damping (3,) [N] at the load's velocity relative to the pivot (3,) [m/s]."""
        string = self._data.site_xpos[self._pivot] - self._data.xpos[self._load]
        length = math.sqrt(string @ string)
        string = string / length
        across = relative - (relative @ string) * string
        rate = math.sqrt(across @ across) / length
        resistance = self._hidden["pivot_viscous_friction"]
        if rate > 0.0:
            resistance += self._hidden["pivot_coulomb_friction"] * math.tanh(rate / self._standstill) / rate
        force: Vector = self._string.damping(self._data) * string - resistance / length**2 * across
        return force

    def _velocities(self) -> tuple[Vector, Vector]:
        """Velocities of pivot and load (3,) [m/s]."""
        site, body = mujoco.mjtObj.mjOBJ_SITE, mujoco.mjtObj.mjOBJ_BODY
        mujoco.mj_objectVelocity(self._model, self._data, site, self._pivot, self._velocity[0], 0)
        mujoco.mj_objectVelocity(self._model, self._data, body, self._load, self._velocity[1], 0)
        return self._velocity[0, 3:], self._velocity[1, 3:]
