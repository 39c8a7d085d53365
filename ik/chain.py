"""Kinematics of a serial arm for many postures at once, in plain numpy.

Pinocchio evaluates one posture per call, and from Python the call costs more than the arithmetic. Here the last axis of
every array is the batch of postures, so that one numpy operation computes all of them.
"""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from armdyn.errors import InputError
from urdf import Robot
from urdf.robot import Array

POSE_EQUATIONS = 6  # equations for the position and orientation of a tool


@dataclass(frozen=True)
class ToolKinematics:
    """Pose of the tool for b postures, with the joint axes and levers that the Jacobian is computed from.

    Attributes:
        rotation: orientation of the tool frame in the base frame, (3, 3, b).
        position: tool point in the base frame, (3, b) [m].
        axes: joint axes in the base frame, (n, 3, b).
        levers: vector from each joint to the tool point in the base frame, (n, 3, b) [m].
    """

    rotation: Array
    position: Array
    axes: Array
    levers: Array

    def pose_error(self, rotation: Array, position: Array) -> Array:
        """Position and rotation errors of the tool with respect to target poses, (6, b) [m and rad].

        Target orientations have the shape (3, 3, b), or (3, 3, 1) for a common one; target positions (3, b) [m].
        """
        return np.concatenate((position - self.position, rotation_error(rotation, self.rotation)))


@dataclass(frozen=True)
class KinematicChain:
    """A serial chain of revolute and prismatic joints: alternately a fixed transform and a joint that moves along z.

    Attributes:
        rotations: fixed rotation in front of each joint, then that of the tool, (n + 1, 3, 3).
        offsets: fixed translation in front of each joint, then that of the tool, (n + 1, 3) [m].
        prismatic: whether each joint is prismatic, (n,).
    """

    rotations: Array
    offsets: Array
    prismatic: NDArray[np.bool_]

    @classmethod
    def from_robot(cls, robot: Robot) -> "KinematicChain":
        """The chain from the base of a robot to its tool point.

        Raises:
            InputError: the arm branches, has a joint with more than one axis, or too few joints to hold a tool.
        """
        model = robot.model
        if model.nv < POSE_EQUATIONS:
            raise InputError(
                f"robot '{robot.name}': {model.nv} joints cannot hold a tool in place and orientation; "
                "choose an arm of at least six"
            )
        data = model.createData()
        if model.nq != model.nv or model.nv != model.njoints - 1 or list(model.parents)[1:] != list(range(model.nv)):
            raise InputError(f"robot '{robot.name}': the arm is not a chain of one-axis joints; list such joints only")
        pin.computeJointJacobians(model, data, pin.neutral(model))
        frame = model.frames[robot.tool_frame_id]
        if frame.parentJoint != model.njoints - 1:
            raise InputError(f"robot '{robot.name}': frame '{frame.name}' is not behind the last joint; choose another")
        rotations, offsets, prismatic = [], [], []
        turned_back = np.eye(3)
        for joint in range(1, model.njoints):
            twist = pin.getJointJacobian(model, data, joint, pin.ReferenceFrame.LOCAL)[:, joint - 1]
            slides = bool(np.allclose(twist[3:], 0.0))
            # Turn z onto the joint's axis, so that every joint is one about or along z.
            align = pin.Quaternion.FromTwoVectors(
                np.array([0.0, 0.0, 1.0]), twist[:3] if slides else twist[3:]
            ).matrix()
            placement = model.jointPlacements[joint]
            rotations.append(turned_back @ placement.rotation @ align)
            offsets.append(turned_back @ placement.translation)
            prismatic.append(slides)
            turned_back = align.T
        rotations.append(turned_back @ frame.placement.rotation)
        offsets.append(turned_back @ frame.placement.act(robot.tool_offset))
        return cls(np.array(rotations), np.array(offsets), np.array(prismatic))

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.prismatic)

    def forward_kinematics(self, q: Array) -> ToolKinematics:
        """Forward kinematics at postures (b, n) [rad or m]."""
        angles = np.ascontiguousarray(q.T)
        sines, cosines = np.sin(angles), np.cos(angles)
        batch = angles.shape[1]
        rotation = np.broadcast_to(np.eye(3)[:, :, None], (3, 3, batch))
        position = np.zeros((3, batch))
        axes, origins = np.empty((self.joints, 3, batch)), np.empty((self.joints, 3, batch))
        for joint in range(self.joints):
            position = position + self.offsets[joint] @ rotation
            rotation = self.rotations[joint].T @ rotation
            axes[joint] = rotation[:, 2]
            if self.prismatic[joint]:
                position = position + angles[joint] * rotation[:, 2]
            else:
                s, c = sines[joint], cosines[joint]
                x, y = rotation[:, 0], rotation[:, 1]
                rotation = np.stack((c * x + s * y, c * y - s * x, rotation[:, 2]), axis=1)
            origins[joint] = position
        position = position + self.offsets[-1] @ rotation
        return ToolKinematics(self.rotations[-1].T @ rotation, position, axes, position - origins)

    def jacobian(self, motion: ToolKinematics) -> Array:
        """Jacobian of the tool point in base axes, (6, n, b): three linear rows [m/rad], then three angular rows."""
        linear = np.where(self.prismatic[:, None, None], motion.axes, cross(motion.axes, motion.levers))
        angular = np.where(self.prismatic[:, None, None], 0.0, motion.axes)
        return np.concatenate((linear, angular), axis=1).transpose(1, 0, 2)

    def velocity_product(self, motion: ToolKinematics, rate: Array) -> Array:
        r"""The part of the tool's acceleration that joint velocities cause, $\dot J \dot q$.

        Args:
            motion: result of `forward_kinematics` for the postures.
            rate: joint velocities, (b, n).

        Returns:
            Three linear rows, then three angular rows, (6, b), in the unit of the squared velocities.
        """
        rates = rate.T
        turning = np.where(self.prismatic[:, None], 0.0, rates)
        sliding = rates - turning
        omega = np.zeros_like(motion.position)
        linear, angular = np.zeros_like(omega), np.zeros_like(omega)
        for joint in range(self.joints):
            axis, lever = motion.axes[joint], motion.levers[joint]
            spin = turning[joint] * axis
            # A body turning at omega carries the axis along; Coriolis and centripetal terms follow.
            linear += 2 * cross(omega, sliding[joint] * axis + cross(spin, lever)) + cross(spin, cross(spin, lever))
            angular += cross(omega, spin)
            omega = omega + spin
        return np.concatenate((linear, angular))


def cross(a: Array, b: Array) -> Array:
    """Cross product of vectors along the second-last axis; `numpy.cross` is several times slower on this layout."""
    ax, ay, az = a[..., 0, :], a[..., 1, :], a[..., 2, :]
    bx, by, bz = b[..., 0, :], b[..., 1, :], b[..., 2, :]
    return np.stack((ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx), axis=-2)


def scale_down_steps(step: Array, longest: float) -> Array:
    """Scale each of k steps (k, n) down so that its largest absolute entry is at most `longest`."""
    return step * np.minimum(1.0, longest / np.maximum(np.abs(step).max(axis=1), 1e-300))[:, None]


def rotation_error(target: Array, current: Array) -> Array:
    """Rotation vectors in base axes that turn the current orientations (3, 3, b) into the targets: (3, b) [rad].

    `target` has the shape (3, 3, b), or (3, 3, 1) for a common one. The result is exact for angles below half a turn;
    at half a turn only its direction is right.
    """
    r = np.einsum("ikb,jkb->ijb", np.broadcast_to(target, current.shape), current)
    sine_axis = 0.5 * np.stack((r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]))
    sine = np.sqrt((sine_axis**2).sum(axis=0))
    angle = np.arctan2(sine, 0.5 * (r[0, 0] + r[1, 1] + r[2, 2] - 1.0))
    return sine_axis * np.where(sine > 1e-8, angle / np.maximum(sine, 1e-8), 1.0)
