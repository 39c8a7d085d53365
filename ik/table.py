"""The saved table of a line: postures, their derivatives, Jacobians and limits, with exact lookup between nodes."""

import hashlib
import json
import zipfile
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armdyn.errors import InputError
from ik.errors import StaleTableError
from urdf import Line, Robot, UrdfError
from urdf.robot import read_only

Array = NDArray[np.float64]

FORMAT = 2  # raise it when a change of the code makes other tables out of the same robot
LOOKUP_SLACK = 1e-9  # m beyond the ends that rounding may ask for


class Posture(NamedTuple):
    """Joint positions at a line coordinate and their derivatives by it; (n,) for a scalar s, (k, n) for k of them."""

    q: Array  # rad or m
    dq_ds: Array  # rad/m
    d2q_ds2: Array  # rad/m^2


class JointMotion(NamedTuple):
    """What the joints do while the tool moves on the line; (n,) or (k, n)."""

    q: Array  # rad or m
    v: Array  # rad/s
    a: Array  # rad/s^2


@dataclass(frozen=True)
class LineTable:
    """One smooth branch of postures along a line; k evenly spaced nodes, n joints.

    Attributes:
        robot_name: whose joints these are.
        joint_names: from base to tool.
        tool_frame: frame that carries the tool.
        tool_offset: tool point in that frame, (3,) [m]; it is this point that moves on the line.
        s: nodes, (k,) [m].
        q: postures, (k, n) [rad or m].
        dq_ds: their first derivatives, (k, n) [rad/m].
        d2q_ds2: their second derivatives, (k, n) [rad/m^2].
        jacobian: of the tool point in base axes, linear rows first, (k, 6, n).
        velocity_limits: of the joints, (n,) [rad/s].
        acceleration_limits: of the joints, (n,) [rad/s^2].
        joint_margin: smallest distance of any joint to its position limits over the line [rad or m].
        line: where the tool point moves.
        fingerprint: of the robot and its settings.
    """

    robot_name: str
    joint_names: tuple[str, ...]
    tool_frame: str
    tool_offset: Array
    s: Array
    q: Array
    dq_ds: Array
    d2q_ds2: Array
    jacobian: Array
    velocity_limits: Array
    acceleration_limits: Array
    joint_margin: float
    line: Line
    fingerprint: str
    speed_limit: Array = field(init=False)  # (k,) [m/s]
    acceleration_limit: Array = field(init=False)  # (k,) [m/s^2]

    def __post_init__(self) -> None:
        for name in ARRAYS:
            object.__setattr__(self, name, read_only(getattr(self, name)))
        object.__setattr__(self, "speed_limit", read_only(self._speed(self.dq_ds)))
        object.__setattr__(
            self, "acceleration_limit", read_only(self._acceleration(self.dq_ds, self.d2q_ds2, self.speed_limit))
        )

    def posture(self, s: ArrayLike) -> Posture:
        """Postures between nodes by quintic Hermite interpolation, which meets q, q' and q'' at every node.

        Args:
            s: line coordinates [m], a scalar or (k,).

        Raises:
            InputError: a coordinate is not on the table.
        """
        at = np.asarray(s, dtype=np.float64)
        first, last = self.s[0], self.s[-1]
        if not np.all((at >= first - LOOKUP_SLACK) & (at <= last + LOOKUP_SLACK)):
            flat = at.ravel()
            wrong = flat[~((flat >= first - LOOKUP_SLACK) & (flat <= last + LOOKUP_SLACK))][0]
            raise InputError(f"line coordinate {wrong:g} m is not on the table, which covers {first:g} to {last:g} m")
        width = (last - first) / (len(self.s) - 1)
        node = np.clip(((at - first) / width).astype(int), 0, len(self.s) - 2)
        t = ((at - self.s[node]) / width)[..., None]
        start, end = self.q[node], self.q[node + 1]
        speed, end_speed = width * self.dq_ds[node], width * self.dq_ds[node + 1]
        bend, end_bend = 0.5 * width**2 * self.d2q_ds2[node], 0.5 * width**2 * self.d2q_ds2[node + 1]
        # What the parabola from the left end misses at the right end, in value, slope and half the bend.
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
        """Joint positions, velocities q' v and accelerations q' a + q'' v^2 for a motion on the line.

        Args:
            s: line coordinate [m], a scalar or (k,).
            v: its velocity [m/s], of the same shape.
            a: its acceleration [m/s^2], of the same shape.
        """
        posture = self.posture(s)
        speed, acceleration = np.asarray(v, dtype=np.float64)[..., None], np.asarray(a, dtype=np.float64)[..., None]
        return JointMotion(posture.q, posture.dq_ds * speed, posture.dq_ds * acceleration + posture.d2q_ds2 * speed**2)

    def speed_limit_at(self, s: ArrayLike) -> Array:
        """Largest speed on the line [m/s] that every joint can follow, of the shape of s."""
        return self._speed(self.posture(s).dq_ds)

    def acceleration_limit_at(self, s: ArrayLike, v: ArrayLike | None = None) -> Array:
        """Largest acceleration on the line [m/s^2] that every joint can follow, of the shape of s.

        Args:
            s: line coordinates [m].
            v: speed there [m/s]; without it the largest speed, which leaves the least for acceleration.
        """
        posture = self.posture(s)
        speed = self._speed(posture.dq_ds) if v is None else np.asarray(v, dtype=np.float64)
        return self._acceleration(posture.dq_ds, posture.d2q_ds2, speed)

    def _speed(self, dq_ds: Array) -> Array:
        return 1.0 / np.max(np.abs(dq_ds) / self.velocity_limits, axis=-1)

    def _acceleration(self, dq_ds: Array, d2q_ds2: Array, speed: Array) -> Array:
        left = np.maximum(0.0, self.acceleration_limits - np.abs(d2q_ds2) * np.square(speed)[..., None])
        return np.min(left / np.maximum(np.abs(dq_ds), 1e-12), axis=-1)

    def save(self, path: str | Path) -> None:
        """Write the table as an npz file; an interrupted write leaves no broken file behind."""
        target = Path(path)
        arrays = {name: getattr(self, name) for name in ARRAYS}
        line = {item.name: np.asarray(getattr(self.line, item.name)).tolist() for item in fields(Line)}
        about = {
            "format": FORMAT,
            "robot": self.robot_name,
            "joints": self.joint_names,
            "tool_frame": self.tool_frame,
            "joint_margin": self.joint_margin,
            "line": line,
            "fingerprint": self.fingerprint,
            "digest": _digest(arrays),
        }
        unfinished = target.with_name(f".{target.name}.part")
        try:
            with unfinished.open("wb") as file:
                np.savez(file, about=np.array(json.dumps(about)), **arrays)
            unfinished.replace(target)
        except OSError as error:
            raise InputError(f"{target}: cannot be written ({error.strerror}); choose another file") from error

    @classmethod
    def load(cls, path: str | Path, robot: Robot | None = None) -> "LineTable":
        """Read a table.

        Args:
            path: the file.
            robot: whose table it must be; None accepts any.

        Raises:
            InputError: there is no such file.
            StaleTableError: it is damaged, of another robot, or of other settings of this robot.
        """
        source = Path(path)
        rebuild = "build it again with 'armdyn ik build'"
        try:
            with np.load(source, allow_pickle=False) as file:
                about = json.loads(str(file["about"]))
                arrays = {name: file[name] for name in ARRAYS}
            line = about["line"]
            if about["format"] == FORMAT and about["digest"] == _digest(arrays):
                table = cls(
                    robot_name=about["robot"],
                    joint_names=tuple(about["joints"]),
                    tool_frame=about["tool_frame"],
                    joint_margin=float(about["joint_margin"]),
                    line=Line(**{**line, "core": tuple(line["core"])}),
                    fingerprint=about["fingerprint"],
                    **arrays,
                )
            else:
                reason = (
                    "another version of armdyn wrote it" if about["format"] != FORMAT else "its numbers were changed"
                )
                raise StaleTableError(f"{source}: {reason}; {rebuild}")
        except FileNotFoundError as error:
            raise InputError(f"{source}: there is no such table; {rebuild}") from error
        except (OSError, EOFError, KeyError, ValueError, TypeError, zipfile.BadZipFile, UrdfError) as error:
            raise StaleTableError(f"{source}: not an IK table, or damaged; {rebuild}") from error
        if robot is not None and table.robot_name != robot.name:
            raise StaleTableError(
                f"{source}: the table is of robot '{table.robot_name}', not '{robot.name}'; {rebuild}"
            )
        if robot is not None and table.fingerprint != robot.fingerprint:
            raise StaleTableError(f"{source}: the URDF or the settings of '{robot.name}' have changed since; {rebuild}")
        return table


ARRAYS = (
    "tool_offset",
    "s",
    "q",
    "dq_ds",
    "d2q_ds2",
    "jacobian",
    "velocity_limits",
    "acceleration_limits",
)


def _digest(arrays: dict[str, Array]) -> str:
    digest = hashlib.sha256()
    for name in ARRAYS:
        digest.update(np.ascontiguousarray(arrays[name]).tobytes())
    return digest.hexdigest()
