"""Data of a robot arm: kinematic model, joint limits, tool, springs and the straight line of its tool."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray


class UrdfError(Exception):
    """A robot description that cannot be used: the message says what, where and what to do, in one line."""


class DescriptionWarning(UserWarning):
    """The inertia of a link was replaced or is impossible, so that torques differ from those of the robot's file."""


MJCF_NOTE_PREFIX = "of an MJCF: "
"""First words of a sentence about an assumption that was made, or an element that was left out, in reading an MJCF."""

Array = NDArray[np.float64]


def read_only_copy(values: ArrayLike) -> Array:
    """A read-only copy of an array."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def freeze_arrays(instance: object, *names: str) -> None:
    """Replace the fields `names` of a frozen dataclass, which are arrays, by read-only copies."""
    for name in names:
        object.__setattr__(instance, name, read_only_copy(getattr(instance, name)))


def rotation_from_rpy(roll: float, pitch: float, yaw: float) -> Array:
    """Rotation matrix (3, 3) from roll, pitch and yaw [rad], rounded so that right angles are exact."""
    return np.asarray(np.round(pin.rpy.rpyToMatrix(roll, pitch, yaw), 15) + 0.0)


MAX_JOINT_LIMITS = {"velocity": 1e3, "acceleration": 1e5, "jerk": 1e8, "effort": 1e6}
"""Largest accepted joint limits of any arm, in rad or m, s, N m or N; a larger one in a file is an error."""


@dataclass(frozen=True)
class Limits:
    """Limits of the joints; every array has shape (n,).

    Attributes:
        lower: lowest position [rad or m].
        upper: highest position [rad or m].
        velocity: largest speed [rad/s or m/s].
        acceleration: largest acceleration [rad/s^2 or m/s^2].
        jerk: largest jerk [rad/s^3 or m/s^3].
        effort: largest torque or force [N m or N].

    Raises:
        UrdfError: a limit is nan, infinite or not above 0, or a position range is empty.
    """

    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    jerk: Array
    effort: Array

    def __post_init__(self) -> None:
        freeze_arrays(self, "lower", "upper", *MAX_JOINT_LIMITS)
        for name, largest in MAX_JOINT_LIMITS.items():
            values = getattr(self, name)
            wrong = np.flatnonzero(~((values > 0.0) & (values <= largest)))
            if values.shape != self.lower.shape or wrong.size:
                value = f"{values[wrong[0]]:g}" if wrong.size else f"given for {values.size} joints"
                raise UrdfError(f"the {name} limit of a joint is {value}; give one above 0 and at most {largest:g}")
        if not (np.isfinite(self.lower).all() and np.isfinite(self.upper).all() and np.all(self.lower < self.upper)):
            raise UrdfError("the position limits of a joint are not a range; give finite ones, the lower one first")

    def margin(self, q: Array) -> Array:
        """Distance of each joint from its nearer position limit [rad or m], negative beyond the limit.

        Joint positions q and the result have the shape (..., n).
        """
        return np.minimum(q - self.lower, self.upper - q)


@dataclass(frozen=True)
class Line:
    """The straight path of the tool point, in the robot's base frame: ``origin + s direction``.

    Attributes:
        origin: point with s = 0, (3,) [m].
        direction: unit vector of growing s, (3,).
        rotation: orientation of the tool frame, constant along the line, (3, 3).
        s_min: first line coordinate [m].
        s_max: last line coordinate [m].
        core: first and last line coordinate of the part on which a speed is required [m].
        core_speed: speed of the tool point that is required on the core [m/s].
    """

    origin: Array
    direction: Array
    rotation: Array
    s_min: float
    s_max: float
    core: tuple[float, float]
    core_speed: float

    def __post_init__(self) -> None:
        freeze_arrays(self, "origin", "direction", "rotation")
        if not self.s_min < self.s_max:
            raise UrdfError(f"line: range [{self.s_min}, {self.s_max}] is empty; give the smaller end first")
        if np.any(np.abs(self.direction) > 2.0) or abs(np.linalg.norm(self.direction) - 1.0) > 1e-9:
            raise UrdfError(f"line: direction {self.direction.tolist()} is not a unit vector; divide it by its length")

    def position(self, s: ArrayLike) -> Array:
        """Positions of the tool point [m]: (3,) for a scalar, (k, 3) for k line coordinates [m]."""
        return self.origin + np.multiply.outer(np.asarray(s, dtype=np.float64), self.direction)

    @property
    def axes(self) -> Array:
        """Unit vectors along a horizontal line, across it and upwards, as the columns of a matrix (3, 3)."""
        up = np.array([0.0, 0.0, 1.0])
        return np.column_stack([self.direction, np.cross(up, self.direction), up])

    def coordinates(self, point: Array) -> tuple[float, float]:
        """Line coordinate of a point (3,) [m], and the point's height above the line [m]."""
        away = point - self.origin
        along = float(away @ self.direction)
        return along, float(away[2] - along * self.direction[2])

    def pose(self, s: Array) -> tuple[Array, Array]:
        """Orientations (3, 3, k) and positions (3, k) [m] of the tool at line coordinates (k,) [m]."""
        return np.broadcast_to(self.rotation[:, :, None], (3, 3, len(s))), self.position(s).T

    def twist(self, s: Array) -> Array:
        """Velocity of the tool per unit of s, (6, k): three linear rows [1], then three angular rows [rad/m]."""
        return np.repeat(np.concatenate((self.direction, np.zeros(3)))[:, None], len(s), axis=1)

    def twist_rate(self, s: Array) -> Array:
        """Derivative of the twist with respect to s, (6, k) [1/m, rad/m^2]: zero."""
        return np.zeros((6, len(s)))

    def describe(self) -> dict[str, Any]:
        """The line as a dictionary of texts and numbers, from which `ik.pathfile.path_from_description` restores it."""
        return {
            "kind": "line",
            "origin": self.origin.tolist(),
            "direction": self.direction.tolist(),
            "rotation": self.rotation.tolist(),
            "range": [self.s_min, self.s_max],
            "core": list(self.core),
            "core_speed": self.core_speed,
        }


@dataclass(frozen=True)
class Spring:
    """Torque of springs on one joint, which a URDF cannot contain.

    In addition to gravity and inertia, the motor must give ``sine sin(q) + cosine cos(q) + stiffness (q - rest)``; for
    a spring that helps to carry the arm, this torque has the opposite sign of gravity's.

    Attributes:
        joint: name of the joint.
        sine: factor of sin(q) [N m].
        cosine: factor of cos(q) [N m].
        enabled: whether the robot's description or settings include the spring.
        source: where the values come from.
        stiffness: stiffness of a spring in the joint [N m/rad or N/m].
        rest: joint position at which the spring in the joint gives no torque [rad or m].
    """

    joint: str
    sine: float
    cosine: float
    enabled: bool
    source: str
    stiffness: float = 0.0
    rest: float = 0.0

    def torque(self, q: ArrayLike) -> Array:
        """Torque [N m or N] that the motor must give because of the springs, at joint positions q [rad or m].

        The result has the shape of q.
        """
        at = np.asarray(q, dtype=np.float64)
        return self.sine * np.sin(at) + self.cosine * np.cos(at) + self.stiffness * (at - self.rest)


@dataclass(frozen=True)
class JointDynamics:
    """Torque of a joint's drive beyond that of the rigid links: ``armature a + damping v + friction sign(v)``.

    Here v and a are the joint's velocity and acceleration.

    Attributes:
        damping: viscous damping [N m s/rad or N s/m].
        friction: dry (Coulomb) friction [N m or N].
        armature: inertia of the rotor, reflected to the joint through the gears [kg m^2 or kg].
    """

    damping: float
    friction: float
    armature: float


@dataclass(frozen=True)
class ArmDynamics:
    """Dynamics of an arm beyond its rigid links, as read from a robot description.

    Attributes:
        gravity: gravity in the frame of the base, (3,) [m/s^2].
        joints: damping, dry friction and rotor inertia by name of the joint.
        springs: springs on the joints.
    """

    gravity: Array
    joints: Mapping[str, JointDynamics] = field(default_factory=dict)
    springs: tuple[Spring, ...] = ()

    def __post_init__(self) -> None:
        freeze_arrays(self, "gravity")


URDF_DYNAMICS = ArmDynamics(read_only_copy((0.0, 0.0, -9.81)))
"""Dynamics of every URDF: gravity alone. ``<dynamics>`` elements are ignored, because public URDFs hold placeholders.

Of the 51 URDFs in the package example-robot-data with ``<dynamics>``, 19 contain zeros only, 14 one pair of values for
all joints, and most of the others ones and powers of ten.
"""


def missing_limit_sentences(model: pin.Model) -> list[str]:
    """One sentence per joint whose limit of position, velocity or effort is unknown, that is, infinite in the model."""
    kinds = {
        "position": np.isinf(model.lowerPositionLimit), "velocity": np.isinf(model.velocityLimit),
        "effort": np.isinf(model.effortLimit),
    }  # fmt: skip
    lacking = {name: [kind for kind, none in kinds.items() if none[i]] for i, name in enumerate(list(model.names)[1:])}
    return [f"joint '{name}' has no limit of {' and '.join(which)}" for name, which in lacking.items() if which]


@dataclass(frozen=True)
class Robot:
    """A validated robot arm; build it with `urdf.load`.

    Attributes:
        name: short name, such as ``"baxter"``.
        urdf_path: file that was read.
        package_dirs: directories in which ``package://`` names are searched.
        urdf_xml: the URDF after mending, as text.
        srdf_path: the file that lists pairs of links which need no collision check, if there is one.
        joint_names: the arm's joints from base to tool.
        model: Pinocchio model of the arm alone, with rotors and gravity; every other joint is locked at its neutral
            position. A limit that its description does not give is infinite.
        tool_frame: frame that carries the tool.
        tool_offset: tool point (string attachment) in the tool frame, (3,) [m].
        limits_or_none: limits of the arm's joints, if its description gives all of them.
        home: posture from which planning starts, (n,) [rad or m]; it selects one of the postures (elbow up or down)
            that hold the tool at the same place.
        springs: springs on the arm's joints.
        joint_dynamics: damping, dry friction and rotor inertia by joint, from an MJCF; empty for a URDF.
        collision_exclusions: pairs of links that need no collision check, besides those of the SRDF.
        defects: one sentence per choice that was made, and one per fault of the description and its repair.
        notes: the sentences among `defects` that a user who makes a model must know, such as assumed speed limits.
        warnings: one sentence per impossible or replaced inertia that changes torques; every command shows them.
        fingerprint: SHA-256 digest of the mended URDF and the settings.
        line_or_none: the line of the settings, if they have one.
        assumed_limits: names of limits that no description or settings file gives.
    """

    name: str
    urdf_path: Path
    package_dirs: tuple[Path, ...]
    urdf_xml: str
    srdf_path: Path | None
    joint_names: tuple[str, ...]
    model: pin.Model
    tool_frame: str
    tool_offset: Array
    limits_or_none: Limits | None
    home: Array
    springs: tuple[Spring, ...]
    joint_dynamics: Mapping[str, JointDynamics]
    collision_exclusions: tuple[tuple[str, str], ...]
    defects: tuple[str, ...]
    notes: tuple[str, ...]
    warnings: tuple[str, ...]
    fingerprint: str
    line_or_none: Line | None
    assumed_limits: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        freeze_arrays(self, "tool_offset", "home")

    @property
    def limits(self) -> Limits:
        """Limits of the arm's joints.

        Raises:
            UrdfError: the robot's description lacks a limit.
        """
        if self.limits_or_none is None:
            raise UrdfError(
                f"{self.urdf_path}: {missing_limit_sentences(self.model)[0]}: "
                "write it into its description, it is needed here"
            )
        return self.limits_or_none

    @property
    def line(self) -> Line:
        """The straight line on which the tool moves.

        Raises:
            UrdfError: the settings contain no line.
        """
        if self.line_or_none is None:
            raise UrdfError(f"robot '{self.name}' has no line yet: find one with 'armdyn ik build --search'")
        return self.line_or_none

    @property
    def tool_frame_id(self) -> int:
        """Index of the tool frame in the model."""
        return int(self.model.getFrameId(self.tool_frame))

    def spring_torque(self, q: Array, springs: Sequence[Spring] | None = None) -> Array:
        """Torque [N m or N] that the motors must give because of springs, at joint positions q (..., n) [rad or m].

        By default all springs of the robot are included. The result has the shape of q.

        Raises:
            UrdfError: a spring is on a joint that the arm does not have.
        """
        torque = np.zeros_like(q)
        for spring in self.springs if springs is None else springs:
            if spring.joint not in self.joint_names:
                raise UrdfError(f"robot '{self.name}': a spring is on joint '{spring.joint}', which the arm lacks")
            joint = self.joint_names.index(spring.joint)
            torque[..., joint] += spring.torque(q[..., joint])
        return torque

    def tool_pose(self, q: Array, data: pin.Data | None = None) -> pin.SE3:
        """Pose of the tool frame, with its origin at the tool point, in the base frame, at joint positions q (n,).

        Positions are in rad or m. `data` is Pinocchio's workspace of the model; pass it in frequent calls to save time.
        """
        data = data or self.model.createData()
        pin.framesForwardKinematics(self.model, data, np.asarray(q, dtype=np.float64))
        return data.oMf[self.tool_frame_id] * pin.SE3(np.eye(3), self.tool_offset)
