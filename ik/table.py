"""The table of a path: postures, their derivatives, Jacobians and limits, with exact lookup between nodes."""

from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path as File
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from armdyn.errors import InputError
from ik.errors import StaleTableError, check_owner
from ik.path import Path
from ik.pathfile import path_of
from ik.tablefile import REBUILD, check_motion, check_robot, check_shapes, read_arrays, reading, write_arrays
from ik.torque import PathTorque
from urdf import Limits, Line, Robot, UrdfError
from urdf.robot import Array, freeze, read_only

LOOKUP_SLACK = 1e-9  # m beyond the ends that rounding may ask for

NODES = ("s", "q", "dq_ds", "d2q_ds2", "jacobian")
LIMITS = ("lower", "upper", "velocity", "acceleration", "jerk", "effort")
TORQUES = ("inertial", "centrifugal", "damping", "gravity", "springs")
SHAPES = (
    {"tool_offset": "3", "s": "k", "jacobian": "k6n"}
    | dict.fromkeys(("q", "dq_ds", "d2q_ds2", *TORQUES), "kn")
    | dict.fromkeys(LIMITS, "n")
)
"""Arrays of a table's file, each with its axes: k nodes, n joints."""


class Posture(NamedTuple):
    """Joint positions at a path coordinate and their derivatives by it; (n,) for a scalar s, (k, n) for k of them."""

    q: Array  # rad or m
    dq_ds: Array  # rad/m
    d2q_ds2: Array  # rad/m^2


class JointMotion(NamedTuple):
    """Motion of the joints while the tool moves on the path; arrays are (n,) or (k, n)."""

    q: Array  # rad or m
    v: Array  # rad/s
    a: Array  # rad/s^2


@dataclass(frozen=True)
class PathTable:
    """One smooth branch of postures along a path; k evenly spaced nodes, n joints.

    Attributes:
        robot_name: name of the robot.
        joint_names: names of the joints from base to tool.
        tool_frame: frame that carries the tool.
        tool_offset: tool point in that frame, (3,) [m]; it is this point that moves on the path.
        path: path of the tool.
        s: nodes, (k,) [m].
        q: postures, (k, n) [rad or m].
        dq_ds: their first derivatives, (k, n) [rad/m].
        d2q_ds2: their second derivatives, (k, n) [rad/m^2].
        jacobian: Jacobian of the tool point in base axes, linear rows first, (k, 6, n).
        limits: limits of the joints.
        torque: terms of the joints' torques for a motion along the path, at the nodes.
        fingerprint: digest of the robot and its settings.
        joint_margin: smallest distance of any joint to its position limits over the path [rad or m].
        speed_limit: largest speed at each node, (k,) [m/s].
        acceleration_limit: largest acceleration at each node at that speed, (k,) [m/s^2].
    """

    robot_name: str
    joint_names: tuple[str, ...]
    tool_frame: str
    tool_offset: Array
    path: Path
    s: Array
    q: Array
    dq_ds: Array
    d2q_ds2: Array
    jacobian: Array
    limits: Limits
    torque: PathTorque
    fingerprint: str
    joint_margin: float = field(init=False)
    speed_limit: Array = field(init=False)
    acceleration_limit: Array = field(init=False)

    def __post_init__(self) -> None:
        freeze(self, "tool_offset", *NODES)
        object.__setattr__(self, "joint_margin", float(self.margin.min()))
        object.__setattr__(self, "speed_limit", self._speed(self.dq_ds))
        acceleration = self._acceleration(self.dq_ds, self.d2q_ds2, self.speed_limit)
        object.__setattr__(self, "acceleration_limit", acceleration)
        freeze(self, "speed_limit", "acceleration_limit")

    def posture(self, s: ArrayLike) -> Posture:
        """Postures at path coordinates [m], a scalar or (k,), between nodes by quintic Hermite interpolation.

        It meets q, q' and q'' at every node.

        Raises:
            InputError: a coordinate is not on the table.
        """
        at = self._on_table(s)
        first, last = self.s[0], self.s[-1]
        width = (last - first) / (len(self.s) - 1)
        node = np.clip(((at - first) / width).astype(int), 0, len(self.s) - 2)
        t = ((at - self.s[node]) / width)[..., None]
        start, end = self.q[node], self.q[node + 1]
        speed, end_speed = width * self.dq_ds[node], width * self.dq_ds[node + 1]
        bend, end_bend = 0.5 * width**2 * self.d2q_ds2[node], 0.5 * width**2 * self.d2q_ds2[node + 1]
        # Error at the right end of the parabola from the left end: in value, slope and half the second derivative.
        value_gap = end - start - speed - bend
        slope_gap = end_speed - speed - 2 * bend
        bend_gap = end_bend - bend
        c3 = 10 * value_gap - 4 * slope_gap + bend_gap
        c4 = -15 * value_gap + 7 * slope_gap - 2 * bend_gap
        c5 = 6 * value_gap - 3 * slope_gap + bend_gap
        return Posture(
            start + t * (speed + t * (bend + t * (c3 + t * (c4 + t * c5)))),
            (speed + t * (2 * bend + t * (3 * c3 + t * (4 * c4 + t * 5 * c5)))) / width,
            (2 * bend + t * (6 * c3 + t * (12 * c4 + t * 20 * c5))) / width**2,
        )

    def joint_motion(self, s: ArrayLike, v: ArrayLike, a: ArrayLike) -> JointMotion:
        """Joint positions, velocities q' v and accelerations q' a + q'' v^2 for a motion on the path.

        Coordinate s [m], velocity v [m/s] and acceleration a [m/s^2] are scalars or (k,).
        """
        posture = self.posture(s)
        speed, acceleration = np.asarray(v, dtype=np.float64)[..., None], np.asarray(a, dtype=np.float64)[..., None]
        return JointMotion(posture.q, posture.dq_ds * speed, posture.dq_ds * acceleration + posture.d2q_ds2 * speed**2)

    def speed_limit_at(self, s: ArrayLike) -> Array:
        """Largest speed on the path [m/s] that every joint can follow, of the shape of s."""
        return self._speed(self.posture(s).dq_ds)

    def acceleration_limit_at(self, s: ArrayLike, v: ArrayLike | None = None) -> Array:
        """Largest acceleration on the path [m/s^2] that every joint can follow, of the shape of s [m]; torques apart.

        Without a speed v [m/s], at the largest speed, which leaves the least for acceleration.
        """
        posture = self.posture(s)
        speed = self._speed(posture.dq_ds) if v is None else np.asarray(v, dtype=np.float64)
        return self._acceleration(posture.dq_ds, posture.d2q_ds2, speed)

    def torque_acceleration_range(self, s: ArrayLike, v: ArrayLike = 0.0, springs: bool = False) -> tuple[Array, Array]:
        """Lowest and highest acceleration on the path [m/s^2] within the torque limits, each of the shape of s [m].

        The speed v [m/s] is a scalar or of the same shape; with `springs`, those of the robot help.
        """
        return self.torque.at(self.s, self._on_table(s)).acceleration_range(self.limits.effort, v, springs)

    @cached_property
    def margin(self) -> Array:
        """Distance of each joint to its nearer position limit at the nodes, (k, n) [rad or m]."""
        return read_only(self.limits.margin(self.q))

    @cached_property
    def manipulability(self) -> Array:
        """Yoshikawa's sqrt(det(J J^T)) at the nodes for shifting [m^3] and turning [1] the tool, (k, 2); 0 if singular.

        Source: Yoshikawa 1985, The International Journal of Robotics Research 4(2).
        """
        parts = [self.jacobian[:, rows] for rows in (slice(0, 3), slice(3, 6))]
        measures = [np.linalg.det(part @ part.transpose(0, 2, 1)) for part in parts]
        return read_only(np.sqrt(np.maximum(0.0, np.stack(measures, axis=1))))

    @cached_property
    def torque_share(self) -> Array:
        """Largest share of a torque limit that holding still takes at the nodes, without and with springs, (k, 2)."""
        return read_only(np.stack(self.torque.shares_at_rest(self.limits.effort), axis=1))

    def _on_table(self, s: ArrayLike) -> Array:
        at = np.asarray(s, dtype=np.float64)
        first, last = self.s[0], self.s[-1]
        inside = (at >= first - LOOKUP_SLACK) & (at <= last + LOOKUP_SLACK)
        if not np.all(inside):
            wrong = at.ravel()[~inside.ravel()][0]
            raise InputError(f"line coordinate {wrong:g} m is not on the table, which covers {first:g} to {last:g} m")
        return at

    def _speed(self, dq_ds: Array) -> Array:
        return 1.0 / np.max(np.abs(dq_ds) / self.limits.velocity, axis=-1)

    def _acceleration(self, dq_ds: Array, d2q_ds2: Array, speed: Array) -> Array:
        left = np.maximum(0.0, self.limits.acceleration - np.abs(d2q_ds2) * np.square(speed)[..., None])
        return np.min(left / np.maximum(np.abs(dq_ds), 1e-12), axis=-1)

    def save(self, path: str | File) -> None:
        """Write the table as an npz file; an interrupted write leaves no broken file behind.

        Raises:
            InputError: the file cannot be written.
        """
        about = {
            "robot": self.robot_name,
            "joints": self.joint_names,
            "tool_frame": self.tool_frame,
            "path": self.path.describe(),
            "fingerprint": self.fingerprint,
        }
        arrays = {name: getattr(self, name) for name in ("tool_offset", *NODES)}
        write_arrays(File(path), about, arrays | asdict(self.limits) | asdict(self.torque))

    @classmethod
    def load(cls, path: str | File, robot: Robot | None = None) -> Self:
        """Read a table, which must belong to `robot` where one is given.

        Raises:
            InputError: there is no such file.
            StaleTableError: the file is damaged, belongs to another robot or other settings, or is of another kind.
        """
        source = File(path)
        with reading(source):
            about, arrays = read_arrays(source, SHAPES)
            if issubclass(cls, LineTable) and about["path"]["kind"] != "line":
                raise StaleTableError(f"{source}: the table of a {about['path']['kind']}, not of a line; {REBUILD}")
            if robot is not None:
                check_owner(source, about, robot, REBUILD)
            try:
                check_shapes(arrays, SHAPES, len(about["joints"]))
                own = path_of(about["path"])
                table = cls(
                    robot_name=about["robot"],
                    joint_names=tuple(about["joints"]),
                    tool_frame=about["tool_frame"],
                    tool_offset=arrays["tool_offset"],
                    path=own,
                    **{name: arrays[name] for name in NODES},
                    limits=Limits(**{name: arrays[name] for name in LIMITS}),
                    torque=PathTorque(**{name: arrays[name] for name in TORQUES}),
                    fingerprint=about["fingerprint"],
                )
                check_motion(arrays, own)
                if robot is not None:
                    check_robot(arrays, own, robot)
            except (InputError, UrdfError) as error:
                raise StaleTableError(f"{source}: {error}; {REBUILD}") from error
        return table


@dataclass(frozen=True)
class LineTable(PathTable):
    """The table of a straight line with one tool orientation."""

    path: Line

    @property
    def line(self) -> Line:
        """The line of the tool point."""
        return self.path
