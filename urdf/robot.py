"""The class of a robot: kinematic model, limits, tool, line."""

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
    """A robot's torques are not those of its description as it was written: the message says of which links and why."""


ASSUMED_PREFIX = "of an MJCF: "
"""How sentences begin that say what was assumed of an MJCF, or left out."""

Array = NDArray[np.float64]


def read_only(values: ArrayLike) -> Array:
    """A read-only copy of an array."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def freeze(instance: object, *names: str) -> None:
    """Replace arrays of a frozen dataclass by read-only copies."""
    for name in names:
        object.__setattr__(instance, name, read_only(getattr(instance, name)))


def rotation_of(roll: float, pitch: float, yaw: float) -> Array:
    """Rotation matrix (3, 3) from roll, pitch and yaw [rad], rounded so that right angles are exact."""
    return np.asarray(np.round(pin.rpy.rpyToMatrix(roll, pitch, yaw), 15) + 0.0)


LARGEST_LIMITS = {"velocity": 1e3, "acceleration": 1e5, "jerk": 1e8, "effort": 1e6}
"""Largest limit that any arm has, in rad or m, s, N m or N: beyond it the file is wrong."""


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
        UrdfError: a limit is useless: nan, infinite, not above 0, or an empty range.
    """

    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    jerk: Array
    effort: Array

    def __post_init__(self) -> None:
        freeze(self, "lower", "upper", *LARGEST_LIMITS)
        for name, largest in LARGEST_LIMITS.items():
            values = getattr(self, name)
            wrong = np.flatnonzero(~((values > 0.0) & (values <= largest)))
            if values.shape != self.lower.shape or wrong.size:
                value = f"{values[wrong[0]]:g}" if wrong.size else f"given for {values.size} joints"
                raise UrdfError(f"the {name} limit of a joint is {value}; give one above 0 and at most {largest:g}")
        if not (np.isfinite(self.lower).all() and np.isfinite(self.upper).all() and np.all(self.lower < self.upper)):
            raise UrdfError("the position limits of a joint are no range; give finite ones, the lower one first")

    def margin(self, q: Array) -> Array:
        """Distance of each joint to its nearer position limit at postures (..., n), negative beyond it: (..., n)."""
        return np.minimum(q - self.lower, self.upper - q)


@dataclass(frozen=True)
class Line:
    """The straight path of the tool point, in the robot's base frame: ``origin + s direction``.

    Attributes:
        origin: point with s = 0, (3,) [m].
        direction: unit vector of growing s, (3,).
        rotation: orientation of the tool frame all along the line, (3, 3).
        s_min: first line coordinate [m].
        s_max: last line coordinate [m].
        core: stretch on which speed matters most [m].
        core_speed: required speed on the core [m/s].
    """

    origin: Array
    direction: Array
    rotation: Array
    s_min: float
    s_max: float
    core: tuple[float, float]
    core_speed: float

    def __post_init__(self) -> None:
        freeze(self, "origin", "direction", "rotation")
        if not self.s_min < self.s_max:
            raise UrdfError(f"line: range [{self.s_min}, {self.s_max}] is empty; give the smaller end first")
        if np.any(np.abs(self.direction) > 2.0) or abs(np.linalg.norm(self.direction) - 1.0) > 1e-9:
            raise UrdfError(f"line: direction {self.direction.tolist()} is not a unit vector; divide it by its length")

    def position(self, s: ArrayLike) -> Array:
        """Positions of the tool point [m]: (3,) for a scalar, (k, 3) for k line coordinates [m]."""
        return self.origin + np.multiply.outer(np.asarray(s, dtype=np.float64), self.direction)

    @property
    def axes(self) -> Array:
        """Unit vectors along a horizontal line, across it and up, the columns of (3, 3)."""
        up = np.array([0.0, 0.0, 1.0])
        return np.column_stack([self.direction, np.cross(up, self.direction), up])

    def coordinates(self, point: Array) -> tuple[float, float]:
        """Coordinate along the line and height above it [m], of a point (3,) [m]."""
        away = point - self.origin
        along = float(away @ self.direction)
        return along, float(away[2] - along * self.direction[2])

    def pose(self, s: Array) -> tuple[Array, Array]:
        """Orientations (3, 3, k) and positions (3, k) [m] of the tool at line coordinates (k,) [m]."""
        return np.broadcast_to(self.rotation[:, :, None], (3, 3, len(s))), self.position(s).T

    def twist(self, s: Array) -> Array:
        """Velocity of the tool per unit of s, linear rows first, (6, k) [1, rad/m]."""
        return np.repeat(np.concatenate((self.direction, np.zeros(3)))[:, None], len(s), axis=1)

    def twist_rate(self, s: Array) -> Array:
        """Derivative of the twist with respect to s, (6, k) [1/m, rad/m^2]: zero."""
        return np.zeros((6, len(s)))

    def describe(self) -> dict[str, Any]:
        """The line as a dictionary of numbers, from which `ik.pathfile.path_of` restores it."""
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
    """Springs on a joint, which change its motor's torque and which a URDF cannot contain.

    The motor gives gravity, inertia and ``sine sin(q) + cosine cos(q) + stiffness (q - rest)``; a spring that carries
    the arm has the sign against gravity's.

    Attributes:
        joint: name of the joint.
        sine: factor of sin(q) [N m].
        cosine: factor of cos(q) [N m].
        enabled: whether the robot's description or settings include the spring.
        source: where the values come from.
        stiffness: of a spring in the joint [N m/rad or N/m].
        rest: position at which that does not pull [rad or m].
    """

    joint: str
    sine: float
    cosine: float
    enabled: bool
    source: str
    stiffness: float = 0.0
    rest: float = 0.0

    def torque(self, q: ArrayLike) -> Array:
        """Torque [N m or N] that the motor adds for the spring at joint positions q [rad or m], of the shape of q."""
        at = np.asarray(q, dtype=np.float64)
        return self.sine * np.sin(at) + self.cosine * np.cos(at) + self.stiffness * (at - self.rest)


@dataclass(frozen=True)
class JointDynamics:
    """Torque on a joint's drive in addition to its links: ``armature a + damping v + friction sign(v)``.

    Attributes:
        damping: torque per speed [N m s/rad or N s/m].
        friction: size of the dry friction [N m or N].
        armature: inertia of the rotor at the joint, behind the gears [kg m^2 or kg].
    """

    damping: float
    friction: float
    armature: float


@dataclass(frozen=True)
class Dynamics:
    """Dynamics of an arm in a description that a URDF cannot contain, or which in a URDF has no meaning.

    Attributes:
        gravity: gravity in the frame of the base, (3,) [m/s^2].
        joints: dynamics of each joint by name.
        springs: springs of the joints.
    """

    gravity: Array
    joints: Mapping[str, JointDynamics] = field(default_factory=dict)
    springs: tuple[Spring, ...] = ()

    def __post_init__(self) -> None:
        freeze(self, "gravity")


IN_A_URDF = Dynamics(read_only((0.0, 0.0, -9.81)))
"""Gravity alone: the ``<dynamics>`` of public URDFs are placeholders. Of the 51 in the package example-robot-data that
have some, 19 hold zeros only, 14 one pair of values for all joints, and most others ones and powers of ten."""


def missing_limits(model: pin.Model) -> list[str]:
    """A sentence per joint without a limit of position, velocity or effort, which is infinite in the model."""
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
        given_limits: limits of the arm's joints, if its description gives all of them.
        home: a posture that picks the arm's branch, (n,) [rad or m].
        springs: known extra joint torques.
        joint_dynamics: additional dynamics by joint, from a description (MJCF) in which they have a meaning.
        collision_exclusions: pairs of links that need no collision check, besides those of the SRDF.
        defects: a sentence per choice that was made, and per defect that was found with what was done about it.
        notes: those of them that whoever makes a model must know, such as what an MJCF does not say.
        warnings: sentences on torques that differ from the file's, or that no body can have; every command shows them.
        fingerprint: sha256 over the mended URDF and the settings.
        given_line: the line of the settings, if they have one.
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
    given_limits: Limits | None
    home: Array
    springs: tuple[Spring, ...]
    joint_dynamics: Mapping[str, JointDynamics]
    collision_exclusions: tuple[tuple[str, str], ...]
    defects: tuple[str, ...]
    notes: tuple[str, ...]
    warnings: tuple[str, ...]
    fingerprint: str
    given_line: Line | None

    def __post_init__(self) -> None:
        freeze(self, "tool_offset", "home")

    @property
    def limits(self) -> Limits:
        """Limits of the arm's joints, for programs that move the arm.

        Raises:
            UrdfError: the description lacks one.
        """
        if self.given_limits is None:
            raise UrdfError(
                f"{self.urdf_path}: {missing_limits(self.model)[0]}: write it into its description, it is needed here"
            )
        return self.given_limits

    @property
    def line(self) -> Line:
        """The line on which the tool moves.

        Raises:
            UrdfError: the settings contain no line.
        """
        if self.given_line is None:
            raise UrdfError(f"robot '{self.name}' has no line yet: find one with 'armdyn ik build --search'")
        return self.given_line

    @property
    def tool_frame_id(self) -> int:
        """Index of the tool frame in the model."""
        return int(self.model.getFrameId(self.tool_frame))

    def spring_torque(self, q: Array, springs: Sequence[Spring] | None = None) -> Array:
        """Torque [N m] that the motors add for springs, all that are known by default, at postures q (..., n) [rad].

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
        """Pose of the tool frame at the tool point, in the base frame, at one posture (n,) [rad or m].

        Frequent callers may reuse `data`, Pinocchio's data of the model.
        """
        data = data or self.model.createData()
        pin.framesForwardKinematics(self.model, data, np.asarray(q, dtype=np.float64))
        return data.oMf[self.tool_frame_id] * pin.SE3(np.eye(3), self.tool_offset)
