"""The string in MuJoCo: its length, its pull, and the inner damping of an elastic one."""

import math

import mujoco

STRING_DAMPING_RATIO = 0.05
"""Damping of an elastic string's own vibration, relative to critical: an ordinary value for cotton and nylon cords."""


class LoadString:
    """The tendon between gripper and load: nearly rigid (a limit) or elastic (a spring), never pushing.

    Args:
        model: the plant; `length` changes it.
        mass: of the load [kg], from which the damping of an elastic string follows.
    """

    def __init__(self, model: mujoco.MjModel, mass: float) -> None:
        self._model, self._tendon = model, model.tendon("string").id
        self._sensor = model.sensor("tension").adr[0]
        self._elastic = not model.tendon_limited[self._tendon]
        self._stiffness = float(model.tendon_stiffness.reshape(model.ntendon, -1)[self._tendon, 0])
        self._damping = 2.0 * STRING_DAMPING_RATIO * math.sqrt(mass * self._stiffness) if self._elastic else 0.0

    @property
    def length(self) -> float:
        """Length at which the string begins to pull [m]."""
        return float(self._model.tendon_range[self._tendon, 1])

    @length.setter
    def length(self, length: float) -> None:
        self._model.tendon_range[self._tendon, 1] = length
        self._model.tendon_lengthspring[self._tendon, 1] = length

    def pull(self, data: mujoco.MjData) -> float:
        """What MuJoCo's tendon pulls with [N] at the state that it last evaluated."""
        if not self._elastic:
            return float(data.sensordata[self._sensor])
        return max(0.0, self._stiffness * (float(data.ten_length[self._tendon]) - self.length))

    def damping(self, data: mujoco.MjData) -> float:
        """What inner damping adds to the pull of an elastic string [N]; it may slacken it but never push."""
        pull = self.pull(data) if self._elastic else 0.0
        return max(self._damping * float(data.ten_velocity[self._tendon]), -pull) if pull > 0.0 else 0.0

    def tension(self, data: mujoco.MjData) -> float:
        """Whole pull of the string [N]; 0 when slack."""
        return self.pull(data) + self.damping(data)
