r"""Joint torques of an arm: for a motion of its joints, and for a motion of its tool along a path.

Inverse dynamics with terms that Pinocchio's RNEA does not contain, the viscous damping d, the dry friction f that the
description states, and the robot's springs:

    \tau = M a + C v + g + d v + f sign(v) + \tau_spring.

Along a path, with v = q_s \dot s and a = q_s \ddot s + q_ss \dot s^2, it is linear in the path's acceleration:

    \tau = inertial \ddot s + centrifugal \dot s^2 + damping \dot s + gravity,

    inertial = M q_s,   centrifugal = M q_ss + C(q, q_s) q_s,   damping = d q_s,   gravity = g.

(Bobrow, Dubowsky, Gibson 1985, The International Journal of Robotics Research 4(3).) Dry friction has the sign of each
joint's velocity. At rest its direction is unknown, and limits hold for both.
"""

from dataclasses import dataclass, fields

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from armdyn.arm.rigid import inverse_dynamics
from armdyn.errors import InputError
from urdf import Robot
from urdf.robot import Array, freeze_arrays


class JointTorque:
    """Computes the motor torques for a motion of an arm that carries a load.

    Args:
        robot: the arm.
        load_mass: mass of the load, a point at the tool [kg].
        springs: True to include all springs of the robot, False for none; by default those that are enabled in the
            robot's settings.

    Raises:
        InputError: the mass is negative or not finite.
    """

    def __init__(self, robot: Robot, load_mass: float = 0.0, springs: bool | None = None) -> None:
        if not (np.isfinite(load_mass) and load_mass >= 0.0):
            raise InputError(f"load mass: {load_mass} kg is not a mass; give a number of kg, 0 or more")
        self._robot, self._model = robot, pin.Model(robot.model)
        frame = robot.model.frames[robot.tool_frame_id]
        lever = frame.placement.act(robot.tool_offset)
        self._model.inertias[frame.parentJoint] += pin.Inertia(load_mass, lever, np.zeros((3, 3)))
        self._springs = [spring for spring in robot.springs if (spring.enabled if springs is None else springs)]

    def __call__(self, q: Array, v: Array, a: Array) -> Array:
        """Motor torques (k, n) [N m] at joint positions q [rad], velocities v [rad/s] and accelerations a [rad/s^2].

        A joint that stands has no dry friction in them.
        """
        tau = inverse_dynamics(self._model, q, v, a) + np.asarray(self._robot.model.damping) * v
        rising, falling = self._dry_friction
        dry = np.where(v > 0.0, rising, np.where(v < 0.0, falling, 0.0))
        return tau + dry + self._robot.spring_torque(q, self._springs)

    @property
    def _dry_friction(self) -> tuple[Array, Array]:
        """Dry friction of each joint while its position rises and falls, (n,) each [N m or N]."""
        return np.asarray(self._model.upperDryFrictionLimit), np.asarray(self._model.lowerDryFrictionLimit)

    def path_torque_terms(self, q: Array, dq_ds: Array, d2q_ds2: Array) -> "PathTorque":
        """Terms of the torque for a motion along a path.

        Args:
            q: postures at path coordinates s, (k, n) [rad or m].
            dq_ds: first derivatives of q with respect to s, (k, n) [rad/m].
            d2q_ds2: second derivatives of q with respect to s, (k, n) [rad/m^2].
        """
        model, still, (rising, falling) = self._model, np.zeros_like(q), self._dry_friction
        gravity = inverse_dynamics(model, q, still, still)
        return PathTorque(
            inertial=inverse_dynamics(model, q, still, dq_ds) - gravity,
            centrifugal=inverse_dynamics(model, q, dq_ds, d2q_ds2) - gravity,
            damping=np.asarray(model.damping) * dq_ds,
            gravity=gravity,
            springs=self._robot.spring_torque(q, self._springs),
            forward=np.where(dq_ds > 0.0, rising, np.where(dq_ds < 0.0, falling, 0.0)),
            backward=np.where(dq_ds > 0.0, falling, np.where(dq_ds < 0.0, rising, 0.0)),
        )


@dataclass(frozen=True)
class PathTorque:
    """Terms of the joint torques for a motion of the tool along a path, at k path coordinates; every array is (k, n).

    Attributes:
        inertial: torque per acceleration of the tool along the path [N m s^2/m].
        centrifugal: torque per squared speed of the tool [N m s^2/m^2].
        damping: torque per speed of the tool [N m s/m].
        gravity: torque at rest without springs [N m].
        springs: motor torque that the robot's springs cause [N m].
        forward: torque of dry friction while the tool moves along the path [N m].
        backward: the same while it moves back.
    """

    inertial: Array
    centrifugal: Array
    damping: Array
    gravity: Array
    springs: Array
    forward: Array
    backward: Array

    def __post_init__(self) -> None:
        freeze_arrays(self, *(item.name for item in fields(self)))

    def interpolate(self, s: Array, at: ArrayLike) -> "PathTorque":
        """Interpolate the terms linearly at path coordinates `at` [m], a scalar or (m,); s (k,) [m] are the nodes."""
        place = (np.asarray(at, dtype=np.float64) - s[0]) / (s[-1] - s[0]) * (len(s) - 1)
        node = np.clip(place.astype(int), 0, len(s) - 2)
        share = (place - node)[..., None]
        terms = (getattr(self, item.name) for item in fields(self))
        return PathTorque(*((1 - share) * term[node] + share * term[node + 1] for term in terms))

    def torque(self, v: ArrayLike, a: ArrayLike, springs: bool = False) -> Array:
        """Motor torques, (k, n) [N m], at tool speeds v [m/s] and accelerations a [m/s^2], scalars or (k,).

        With `springs`, the torque of the robot's springs is included. At rest there is no dry friction in them.
        """
        speed, acceleration = np.asarray(v, dtype=np.float64)[..., None], np.asarray(a, dtype=np.float64)[..., None]
        torque = self.inertial * acceleration + self.centrifugal * speed**2 + self.damping * speed + self.gravity
        torque = torque + np.where(speed > 0.0, self.forward, np.where(speed < 0.0, self.backward, 0.0))
        return torque + self.springs if springs else torque

    def holding_torque_shares(self, effort: Array) -> tuple[Array, Array]:
        """Largest share of a joint's torque limit that creeping either way takes, without and with springs, (k,) each.

        Without dry friction this is what holding still takes. `effort` has the torque limits of the joints, (n,) [N m].
        """
        still = [self.torque(0.0, 0.0, springs) for springs in (False, True)]
        without, helped = (np.abs([held + self.forward, held + self.backward]) / effort for held in still)
        return without.max(axis=(0, 2)), helped.max(axis=(0, 2))

    def acceleration_range(self, effort: Array, v: ArrayLike, springs: bool = False) -> tuple[Array, Array]:
        """Lowest and highest acceleration of the tool along the path within the torque limits, (k,) each [m/s^2].

        The range may exclude 0, where the tool cannot keep its speed, or be empty (lowest > highest). At rest it holds
        for dry friction in both directions.

        Args:
            effort: torque limits of the joints, (n,) [N m].
            v: speed of the tool, a scalar or (k,) [m/s].
            springs: whether to include the torque of the robot's springs.
        """
        taken, rests = self.torque(v, 0.0, springs), np.asarray(v, dtype=np.float64)[..., None] == 0.0
        inertial = np.where(np.abs(self.inertial) < 1e-12, 1e-12, self.inertial)
        least, most = (np.where(rests, worst(self.forward, self.backward), 0.0) for worst in (np.minimum, np.maximum))
        ends = np.array([(effort - taken - most) / inertial, (-effort - taken - least) / inertial])
        return ends.min(axis=0).max(axis=-1), ends.max(axis=0).min(axis=-1)
