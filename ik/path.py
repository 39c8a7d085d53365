"""Paths of the tool's position and orientation as functions of the arc length s; `urdf.Line` is the straight path."""

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.spatial.transform import Rotation, RotationSpline

from armdyn.errors import InputError
from urdf.robot import Array, freeze_arrays

MAX_PATH_LENGTH = 20.0
"""Length of the longest accepted path [m]; no arm on a fixed base follows a longer one."""
CORE_SPEED_WITHOUT_REQUIREMENT = (
    1e-3  # m/s; a required speed that every arm reaches, for paths without a required speed
)
"""Required speed of a path for which none is given [m/s]; every arm reaches it."""


class Path(Protocol):
    """A smooth path of the tool, in the robot's base frame, with the path coordinate s [m].

    The last axis of every array belongs to the k path coordinates.
    """

    @property
    def s_min(self) -> float:
        """First path coordinate [m]."""

    @property
    def s_max(self) -> float:
        """Last path coordinate [m]."""

    @property
    def core(self) -> tuple[float, float]:
        """First and last coordinate of the core, the part of the path on which a speed is required [m]."""

    @property
    def core_speed(self) -> float:
        """Speed of the tool point that is required on the core [m/s]."""

    def pose(self, s: Array) -> tuple[Array, Array]:
        """Orientations (3, 3, k) and positions (3, k) [m] of the tool at path coordinates s (k,) [m]."""

    def twist(self, s: Array) -> Array:
        """Velocity of the tool per unit of s, (6, k): three linear rows [1], then three angular rows [rad/m]."""

    def twist_rate(self, s: Array) -> Array:
        """Derivative of the twist with respect to s, (6, k) [1/m, rad/m^2]."""

    def describe(self) -> dict[str, Any]:
        """The path as a dictionary; `ik.pathfile.path_from_description` restores it."""


class _WithoutCore:
    """A path without a required speed: its core is the whole path."""

    s_min: float
    s_max: float
    core_speed = CORE_SPEED_WITHOUT_REQUIREMENT

    @property
    def core(self) -> tuple[float, float]:
        """First and last coordinate of the whole path [m]."""
        return self.s_min, self.s_max


@dataclass(frozen=True)
class CirclePath(_WithoutCore):
    """A circle or a part of one, with the arc length as path coordinate.

    Attributes:
        centre: centre of the circle, (3,) [m].
        normal: unit vector of the circle's axis, (3,); the path turns about it by the right-hand rule.
        start: unit vector from the centre to the point with s = 0, perpendicular to the normal, (3,).
        radius: radius of the circle [m].
        rotation: orientation of the tool at s = 0, (3, 3).
        s_min: first path coordinate [m].
        s_max: last path coordinate [m].
        follow: whether the tool turns with the circle; otherwise it keeps its orientation.
    """

    centre: Array
    normal: Array
    start: Array
    radius: float
    rotation: Array
    s_min: float
    s_max: float
    follow: bool = False

    def __post_init__(self) -> None:
        freeze_arrays(self, "centre", "normal", "start", "rotation")
        if not self.radius > 0 or not self.s_min < self.s_max:
            raise InputError(f"circle: radius {self.radius:g} m and range {self.s_min:g} to {self.s_max:g} m are empty")
        unit = [np.linalg.norm(self.normal), np.linalg.norm(self.start), 1.0 + abs(self.normal @ self.start)]
        if np.abs(np.array(unit) - 1.0).max() > 1e-9:
            raise InputError("circle: normal and start must be unit vectors at a right angle to each other")

    def pose(self, s: Array) -> tuple[Array, Array]:
        """Orientations (3, 3, k) and positions (3, k) [m] of the tool at path coordinates s (k,) [m]."""
        out, _ = self._directions(s)
        position = self.centre[:, None] + self.radius * out
        if not self.follow:
            return np.broadcast_to(self.rotation[:, :, None], (3, 3, len(s))), position
        turn = Rotation.from_rotvec(np.multiply.outer(s / self.radius, self.normal)).as_matrix()
        return (turn @ self.rotation).transpose(1, 2, 0), position

    def twist(self, s: Array) -> Array:
        """Velocity of the tool per unit of s, (6, k): three linear rows [1], then three angular rows [rad/m]."""
        _, along = self._directions(s)
        turning = self.normal / self.radius if self.follow else np.zeros(3)
        return np.concatenate((along, np.repeat(turning[:, None], len(s), axis=1)))

    def twist_rate(self, s: Array) -> Array:
        """Derivative of the twist with respect to s, (6, k) [1/m, rad/m^2]; it points towards the centre."""
        out, _ = self._directions(s)
        return np.concatenate((-out / self.radius, np.zeros((3, len(s)))))

    def describe(self) -> dict[str, Any]:
        """The circle as a dictionary; `ik.pathfile.path_from_description` restores it."""
        return {
            "kind": "circle",
            "centre": self.centre.tolist(),
            "normal": self.normal.tolist(),
            "start": self.start.tolist(),
            "radius": self.radius,
            "rotation": self.rotation.tolist(),
            "range": [self.s_min, self.s_max],
            "follow": self.follow,
        }

    def _directions(self, s: Array) -> tuple[Array, Array]:
        """Radial unit vectors outwards, and tangential unit vectors, (3, k) each."""
        angle = s / self.radius
        across = np.cross(self.normal, self.start)
        cosine, sine = np.cos(angle), np.sin(angle)
        return (
            np.outer(self.start, cosine) + np.outer(across, sine),
            np.outer(across, cosine) - np.outer(self.start, sine),
        )


ARC_LENGTH_INTERVALS_PER_SEGMENT = 64
"""Number of intervals between two points of a spline in which its arc length is integrated."""
GAUSS_POINTS, GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(6)
"""Points and weights of Gauss-Legendre quadrature on the interval from -1 to 1."""
ARC_LENGTH_NEWTON_STEPS = 4  # Newton steps from a linear guess to double precision


@dataclass(frozen=True)
class SplinePath(_WithoutCore):
    """A path through given points: quintic spline of the position, cubic rotation spline of the orientation.

    Through fewer than six points the spline of the position is cubic or lower. The path coordinate s is the arc length.

    Attributes:
        points: positions that the tool passes through, (m, 3) [m].
        rotations: orientations of the tool at the points, (m, 3, 3).
        s_min: first path coordinate, 0 [m].
        s_max: length of the path [m].
    """

    points: Array
    rotations: Array
    s_min: float = field(init=False, default=0.0)
    s_max: float = field(init=False)
    _position: BSpline = field(init=False, repr=False, compare=False)
    _turning: RotationSpline | None = field(init=False, repr=False, compare=False)
    _u: Array = field(init=False, repr=False, compare=False)
    _s: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        freeze_arrays(self, "points", "rotations")
        count = len(self.points)
        if count < 2 or self.points.shape != (count, 3) or self.rotations.shape != (count, 3, 3):
            raise InputError(f"spline: {self.points.shape} points, {self.rotations.shape} rotations; give two or more")
        chords = np.linalg.norm(np.diff(self.points, axis=0), axis=1)
        if not chords.min() > 1e-6:
            raise InputError(f"spline: points {int(chords.argmin())} and {int(chords.argmin()) + 1} coincide; drop one")
        knots = np.concatenate(([0.0], np.cumsum(chords)))
        degree = 5 if count >= 6 else min(3, count - 1)
        turning = Rotation.from_matrix(self.rotations)
        moved = (turning[:-1].inv() * turning[1:]).magnitude().max() > 1e-12
        object.__setattr__(self, "_position", make_interp_spline(knots, self.points, k=degree))
        object.__setattr__(self, "_turning", RotationSpline(knots, turning) if moved else None)
        u = np.linspace(0.0, knots[-1], ARC_LENGTH_INTERVALS_PER_SEGMENT * (count - 1) + 1)
        object.__setattr__(self, "_u", u)
        object.__setattr__(self, "_s", np.concatenate(([0.0], np.cumsum(self._length(u[:-1], u[1:])))))
        object.__setattr__(self, "s_max", float(self._s[-1]))

    def pose(self, s: Array) -> tuple[Array, Array]:
        """Orientations (3, 3, k) and positions (3, k) [m] of the tool at path coordinates s (k,) [m]."""
        u = self._parameter(s)
        return self._rotation(u), self._position(u).T

    def twist(self, s: Array) -> Array:
        """Velocity of the tool per unit of s, (6, k): three linear rows [1], then three angular rows [rad/m]."""
        u = self._parameter(s)
        first = self._position(u, 1).T
        speed = np.linalg.norm(first, axis=0)
        return np.concatenate((first / speed, self._angular(u, 1) / speed))

    def twist_rate(self, s: Array) -> Array:
        """Derivative of the twist with respect to s, (6, k) [1/m, rad/m^2]."""
        u = self._parameter(s)
        first, second = self._position(u, 1).T, self._position(u, 2).T
        speed = np.linalg.norm(first, axis=0)
        along = first / speed
        gain = (along * second).sum(axis=0)  # d speed / du
        bending = (second - along * gain) / speed**2
        turning = self._angular(u, 2) / speed**2 - self._angular(u, 1) * gain / speed**3
        return np.concatenate((bending, turning))

    def describe(self) -> dict[str, Any]:
        """The spline's points and orientations as a dictionary; `ik.pathfile.path_from_description` restores it."""
        return {"kind": "spline", "points": self.points.tolist(), "rotations": self.rotations.tolist()}

    def _rotation(self, u: Array) -> Array:
        if self._turning is None:
            return np.broadcast_to(self.rotations[0][:, :, None], (3, 3, len(u)))
        return np.asarray(self._turning(u).as_matrix().transpose(1, 2, 0))

    def _angular(self, u: Array, order: int) -> Array:
        """Angular velocity (order 1) or acceleration (order 2) per spline parameter u, in base axes, (3, k)."""
        if self._turning is None:
            return np.zeros((3, len(u)))
        return np.einsum("ijk,kj->ik", self._rotation(u), self._turning(u, order))

    def _length(self, start: Array, end: Array) -> Array:
        """Arc length between parameters within one cell, (k,) [m]: Gauss-Legendre quadrature."""
        half = (end - start) / 2
        u = (start + end)[:, None] / 2 + half[:, None] * GAUSS_POINTS
        return half * (np.linalg.norm(self._position(u, 1), axis=2) @ GAUSS_WEIGHTS)

    def _parameter(self, s: Array) -> Array:
        """Spline parameters u at arc lengths s, (k,), by Newton's method."""
        u = np.interp(s, self._s, self._u)
        for _ in range(ARC_LENGTH_NEWTON_STEPS):
            cell = np.clip(np.searchsorted(self._u, u, side="right") - 1, 0, len(self._u) - 2)
            missing = s - self._s[cell] - self._length(self._u[cell], u)
            u = u + missing / np.linalg.norm(self._position(u, 1), axis=1)
        return np.asarray(np.clip(u, 0.0, self._u[-1]))
