"""The IK table of a path: postures, derivatives, Jacobians and limits at nodes, and interpolation between them."""

from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path as File
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from armdyn.errors import InputError
from ik.errors import StaleTableError, check_table_belongs_to_robot
from ik.path import Path
from ik.pathfile import path_from_description
from ik.table_archive import (
    REBUILD_REMEDY,
    check_consistency,
    check_robot,
    check_shapes,
    read_arrays,
    table_errors_as_input_errors,
    write_arrays,
)
from ik.torque import PathTorque
from urdf import Limits, Line, Robot, UrdfError
from urdf.robot import Array, freeze_arrays, read_only_copy

LOOKUP_END_TOLERANCE = 1e-9
"""Distance beyond the ends of the path at which a lookup is still accepted, because of rounding [m]."""

NODE_ARRAYS = ("s", "q", "dq_ds", "d2q_ds2", "jacobian")
LIMIT_ARRAYS = ("lower", "upper", "velocity", "acceleration", "jerk", "effort")
TORQUE_ARRAYS = ("inertial", "centrifugal", "damping", "gravity", "springs", "forward", "backward")
ARRAY_AXES = (
    {"tool_offset": "3", "s": "k", "jacobian": "k6n"}
    | dict.fromkeys(("q", "dq_ds", "d2q_ds2", *TORQUE_ARRAYS), "kn")
    | dict.fromkeys(LIMIT_ARRAYS, "n")
)
"""Axes of each array in the file of an IK table: k nodes, n joints, or a number."""


class Posture(NamedTuple):
    """Joint positions at a path coordinate s, and their derivatives; (n,) for a scalar s, (k, n) for s of shape (k,).

    Attributes:
        q: joint positions [rad or m].
        dq_ds: first derivatives with respect to s [rad/m or 1].
        d2q_ds2: second derivatives with respect to s [rad/m^2 or 1/m].
    """

    q: Array
    dq_ds: Array
    d2q_ds2: Array


class JointMotion(NamedTuple):
    """Motion of the joints while the tool moves on a path; arrays are (n,), or (k, n) for k instants.

    Attributes:
        q: joint positions [rad or m].
        v: joint velocities [rad/s or m/s].
        a: joint accelerations [rad/s^2 or m/s^2].
    """

    q: Array
    v: Array
    a: Array


@dataclass(frozen=True)
class PathTable:
    """Postures (joint positions) of an arm along a path of its tool, at k evenly spaced nodes, for n joints.

    Attributes:
        robot_name: name of the robot.
        joint_names: names of the joints from base to tool.
        tool_frame: frame that carries the tool.
        tool_offset: the tool point, which moves on the path, in the tool frame, (3,) [m].
        path: path of the tool.
        s: path coordinates of the nodes, (k,) [m].
        q: postures, (k, n) [rad or m].
        dq_ds: first derivatives of q with respect to s, (k, n) [rad/m or 1].
        d2q_ds2: second derivatives of q with respect to s, (k, n) [rad/m^2 or 1/m].
        jacobian: Jacobian of the tool point in base axes, three linear rows, then three angular rows, (k, 6, n).
        limits: limits of the joints.
        torque: terms of the joint torques for a motion along the path, at the nodes.
        fingerprint: SHA-256 digest of the robot and its settings.
        joint_margin: smallest distance of a joint from its position limit on the path [rad or m].
        speed_limit: largest speed of the tool at each node within the joints' speed limits, (k,) [m/s].
        acceleration_limit: largest acceleration of the tool along the path at `speed_limit`, (k,) [m/s^2].
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
        freeze_arrays(self, "tool_offset", *NODE_ARRAYS)
        object.__setattr__(self, "joint_margin", float(self.margin.min()))
        object.__setattr__(self, "speed_limit", self._speed(self.dq_ds))
        acceleration = self._acceleration(self.dq_ds, self.d2q_ds2, self.speed_limit)
        object.__setattr__(self, "acceleration_limit", acceleration)
        freeze_arrays(self, "speed_limit", "acceleration_limit")

    def posture(self, s: ArrayLike) -> Posture:
        """Postures at path coordinates s [m], a scalar or (k,), by quintic Hermite interpolation.

        The interpolation has the table's q, dq/ds and d^2q/ds^2 at every node.

        Raises:
            InputError: a coordinate lies outside the table.
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
        """Joint motion for a motion of the tool on the path: velocities q' v and accelerations q' a + q'' v^2.

        The tool's path coordinate s [m], speed v [m/s] and acceleration a [m/s^2] are scalars or (k,).
        """
        posture = self.posture(s)
        speed, acceleration = np.asarray(v, dtype=np.float64)[..., None], np.asarray(a, dtype=np.float64)[..., None]
        return JointMotion(posture.q, posture.dq_ds * speed, posture.dq_ds * acceleration + posture.d2q_ds2 * speed**2)

    def jacobian_at(self, s: ArrayLike) -> Array:
        """Jacobians (6, n), or (k, 6, n), of the tool point in base axes at path coordinates s [m], (k,).

        Between two nodes they are interpolated linearly.
        """
        place = np.interp(self._on_table(s), self.s, np.arange(len(self.s)))
        node = np.clip(place.astype(int), 0, len(self.s) - 2)
        return self.jacobian[node] + (place - node)[..., None, None] * (self.jacobian[node + 1] - self.jacobian[node])

    def speed_limit_at(self, s: ArrayLike) -> Array:
        """Largest tool speed [m/s] within the joints' speed limits at path coordinates s [m], with the shape of s."""
        return self._speed(self.posture(s).dq_ds)

    def acceleration_limit_at(self, s: ArrayLike, v: ArrayLike | None = None) -> Array:
        """Largest acceleration of the tool along the path within the joints' acceleration limits, [m/s^2].

        Torque limits are not considered. The result has the shape of the path coordinates s [m]. The default of the
        tool's speed v [m/s] is `speed_limit_at(s)`, at which the possible acceleration is smallest.
        """
        posture = self.posture(s)
        speed = self._speed(posture.dq_ds) if v is None else np.asarray(v, dtype=np.float64)
        return self._acceleration(posture.dq_ds, posture.d2q_ds2, speed)

    def torque_acceleration_range(self, s: ArrayLike, v: ArrayLike = 0.0, springs: bool = False) -> tuple[Array, Array]:
        """Lowest and highest acceleration of the tool along the path within the joints' torque limits, [m/s^2].

        Both results have the shape of the path coordinates s [m]. The tool's speed v [m/s] is a scalar or has this
        shape. With `springs`, the torque of the robot's springs is included.
        """
        return self.torque.interpolate(self.s, self._on_table(s)).acceleration_range(self.limits.effort, v, springs)

    @cached_property
    def margin(self) -> Array:
        """Distance of each joint from its nearer position limit at the nodes, (k, n) [rad or m]."""
        return read_only_copy(self.limits.margin(self.q))

    @cached_property
    def manipulability(self) -> Array:
        """Yoshikawa's manipulability sqrt(det(J J^T)) at the nodes, (k, 2); 0 in a singular posture.

        The first column uses the Jacobian's linear rows [m^3], the second its angular rows [1]. Source: Yoshikawa 1985,
        The International Journal of Robotics Research 4(2).
        """
        parts = [self.jacobian[:, rows] for rows in (slice(0, 3), slice(3, 6))]
        measures = [np.linalg.det(part @ part.transpose(0, 2, 1)) for part in parts]
        return read_only_copy(np.sqrt(np.maximum(0.0, np.stack(measures, axis=1))))

    @cached_property
    def torque_share(self) -> Array:
        """Largest share of a joint's torque limit that creeping either way takes at the nodes, (k, 2).

        The first column is without the robot's springs, the second with them.
        """
        return read_only_copy(np.stack(self.torque.holding_torque_shares(self.limits.effort), axis=1))

    def _on_table(self, s: ArrayLike) -> Array:
        at = np.asarray(s, dtype=np.float64)
        first, last = self.s[0], self.s[-1]
        inside = (at >= first - LOOKUP_END_TOLERANCE) & (at <= last + LOOKUP_END_TOLERANCE)
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
        """Write the table to an npz file; an interrupted write leaves the old file unchanged.

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
        arrays = {name: getattr(self, name) for name in ("tool_offset", *NODE_ARRAYS)}
        write_arrays(File(path), about, arrays | asdict(self.limits) | asdict(self.torque))

    @classmethod
    def load(cls, path: str | File, robot: Robot | None = None) -> Self:
        """Read a table from an npz file; if `robot` is given, the table must have been built for this robot.

        Raises:
            InputError: the file does not exist.
            StaleTableError: the file is damaged, was built for another robot or other settings, or contains the table
                of a curved path where a line's is needed.
        """
        source = File(path)
        with table_errors_as_input_errors(source):
            about, arrays = read_arrays(source, ARRAY_AXES)
            if issubclass(cls, LineTable) and about["path"]["kind"] != "line":
                raise StaleTableError(
                    f"{source}: the table of a {about['path']['kind']}, not of a line; {REBUILD_REMEDY}"
                )
            if robot is not None:
                check_table_belongs_to_robot(source, about, robot, REBUILD_REMEDY)
            try:
                check_shapes(arrays, ARRAY_AXES, len(about["joints"]))
                own = path_from_description(about["path"])
                table = cls(
                    robot_name=about["robot"],
                    joint_names=tuple(about["joints"]),
                    tool_frame=about["tool_frame"],
                    tool_offset=arrays["tool_offset"],
                    path=own,
                    **{name: arrays[name] for name in NODE_ARRAYS},
                    limits=Limits(**{name: arrays[name] for name in LIMIT_ARRAYS}),
                    torque=PathTorque(**{name: arrays[name] for name in TORQUE_ARRAYS}),
                    fingerprint=about["fingerprint"],
                )
                check_consistency(arrays, own)
                if robot is not None:
                    check_robot(arrays, own, robot)
            except (InputError, UrdfError) as error:
                raise StaleTableError(f"{source}: {error}; {REBUILD_REMEDY}") from error
        return table


@dataclass(frozen=True)
class LineTable(PathTable):
    """An IK table of a straight line with a constant orientation of the tool."""

    path: Line

    @property
    def line(self) -> Line:
        """The straight line on which the tool point moves."""
        return self.path


def load(path: str | File, robot: Robot | None = None) -> PathTable:
    """Read a table from an npz file: a `LineTable` for a line, else a `PathTable`.

    Args:
        path: file that `PathTable.save` or ``armdyn ik build`` wrote.
        robot: robot for which the table must have been built; None for any.

    Raises:
        InputError: the file does not exist.
        StaleTableError: the file is damaged, or was built for another robot or other settings.
    """
    table = PathTable.load(path, robot)
    return LineTable.load(path, robot) if isinstance(table.path, Line) else table
