"""Forces that MuJoCo's model does not have: an elastic string's damping, drag, wind, friction and springs."""

import math
from collections.abc import Mapping

import mujoco
import numpy as np
import numpy.typing as npt

import urdf
from armdyn.errors import InputError
from pipeline.robot.hidden import Stage, terms
from pipeline.robot.protocol import Vector
from pipeline.robot.scene import effort_share

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
        self._model, self._data, self._string = model, data, string
        self._load, self._pivot = model.body("load").id, model.site("pivot").id
        self._wind = hidden["wind"] * along
        self._force = data.xfrc_applied[self._load][:3]
        self._force[:] = self._wind
        self._on_load, self._at_pivot = terms(hidden, Stage.LOAD), terms(hidden, Stage.PIVOT)
        self._active = bool(self._on_load or self._at_pivot or hidden["string_elasticity"])
        self._velocity = np.zeros((2, 6))
        self._reversal = model.opt.timestep / (mass * length**2)

    def apply(self) -> None:
        """Set the forces for the state at which MuJoCo stands."""
        if not self._active:
            return
        pivot, load = self._velocities()
        force = self._wind + sum(term(load) for term in self._on_load)
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
        resistance = sum(term(rate, self._reversal) for term in self._at_pivot)
        force: Vector = self._string.damping(self._data) * string - resistance / length**2 * across
        return force

    def _velocities(self) -> tuple[Vector, Vector]:
        """Velocities of pivot and load (3,) [m/s]."""
        site, body = mujoco.mjtObj.mjOBJ_SITE, mujoco.mjtObj.mjOBJ_BODY
        mujoco.mj_objectVelocity(self._model, self._data, site, self._pivot, self._velocity[0], 0)
        mujoco.mj_objectVelocity(self._model, self._data, body, self._load, self._velocity[1], 0)
        return self._velocity[0, 3:], self._velocity[1, 3:]


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
        self._model, self._data, self._dofs = model, data, dofs
        self._share = effort_share(robot)
        self._base = model.dof_frictionloss[dofs].copy()
        self._friction = terms(hidden, Stage.JOINTS)
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
        if self._friction:
            v, gravity = self._data.qvel[self._dofs], self._data.qfrc_bias[self._dofs]
            extra = sum(term(self._share, v, gravity) for term in self._friction)
            self._model.dof_frictionloss[self._dofs] = self._base + extra
