"""Paths of the tool point in SE(3), as functions of one coordinate s."""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from armdyn.errors import InputError
from urdf import Line
from urdf.robot import read_only

Array = NDArray[np.float64]


class Path(Protocol):
    """A smooth path; base axes, linear rows first, the batch of k coordinates s as the last axis."""

    @property
    def s_min(self) -> float:
        """First coordinate [m]."""

    @property
    def s_max(self) -> float:
        """Last coordinate [m]."""

    def pose(self, s: Array) -> tuple[Array, Array]:
        """Orientations (3, 3, k) and positions (3, k) [m] of the tool."""

    def twist(self, s: Array) -> Array:
        """Velocity of the tool per unit of s, (6, k) [1, rad/m]."""

    def twist_rate(self, s: Array) -> Array:
        """Derivative of the twist by s, (6, k) [1/m, rad/m^2]."""

    def describe(self) -> dict[str, Any]:
        """What `ik.pathfile.path_of` makes the same path from: numbers, lists and texts only."""


@dataclass(frozen=True)
class LinePath:
    """A straight path of one orientation."""

    line: Line

    @property
    def s_min(self) -> float:
        """First coordinate [m]."""
        return self.line.s_min

    @property
    def s_max(self) -> float:
        """Last coordinate [m]."""
        return self.line.s_max

    def pose(self, s: Array) -> tuple[Array, Array]:
        """Orientations (3, 3, k) and positions (3, k) [m] of the tool."""
        return np.broadcast_to(self.line.rotation[:, :, None], (3, 3, len(s))), self.line.position(s).T

    def twist(self, s: Array) -> Array:
        """Velocity of the tool per unit of s, (6, k) [1, rad/m]."""
        return np.concatenate((np.outer(self.line.direction, np.ones_like(s)), np.zeros((3, len(s)))))

    def twist_rate(self, s: Array) -> Array:
        """Derivative of the twist by s, (6, k) [1/m, rad/m^2]: none."""
        return np.zeros((6, len(s)))

    def describe(self) -> dict[str, Any]:
        """The line's numbers."""
        line = self.line
        return {
            "kind": "line",
            "origin": line.origin.tolist(),
            "direction": line.direction.tolist(),
            "rotation": line.rotation.tolist(),
            "range": [line.s_min, line.s_max],
            "core": list(line.core),
            "core_speed": line.core_speed,
        }


@dataclass(frozen=True)
class CirclePath:
    """A circle or a part of one, by its arc length; s = 0 where it starts.

    Attributes:
        centre: (3,) [m].
        normal: unit vector about which it turns, (3,).
        start: unit vector from the centre to s = 0, across the normal, (3,).
        radius: [m].
        rotation: orientation of the tool at s = 0, (3, 3).
        s_min: first coordinate [m].
        s_max: last coordinate [m].
        follow: whether the tool turns with the circle or keeps its orientation.
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
        for name in ("centre", "normal", "start", "rotation"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        if not self.radius > 0 or not self.s_min < self.s_max:
            raise InputError(f"circle: radius {self.radius:g} m and range {self.s_min:g} to {self.s_max:g} m are empty")
        unit = [np.linalg.norm(self.normal), np.linalg.norm(self.start), 1.0 + abs(self.normal @ self.start)]
        if np.abs(np.array(unit) - 1.0).max() > 1e-9:
            raise InputError("circle: normal and start must be unit vectors at a right angle to each other")

    def pose(self, s: Array) -> tuple[Array, Array]:
        """Orientations (3, 3, k) and positions (3, k) [m] of the tool."""
        out, _ = self._directions(s)
        position = self.centre[:, None] + self.radius * out
        if not self.follow:
            return np.broadcast_to(self.rotation[:, :, None], (3, 3, len(s))), position
        # Rodrigues' formula for the turn about the normal.
        hat, angle = pin.skew(self.normal), s / self.radius
        turn = np.eye(3)[:, :, None] + np.sin(angle) * hat[:, :, None] + (1 - np.cos(angle)) * (hat @ hat)[:, :, None]
        return np.einsum("ijk,jl->ilk", turn, self.rotation), position

    def twist(self, s: Array) -> Array:
        """Velocity of the tool per unit of s, (6, k) [1, rad/m]."""
        _, along = self._directions(s)
        turning = self.normal / self.radius if self.follow else np.zeros(3)
        return np.concatenate((along, np.repeat(turning[:, None], len(s), axis=1)))

    def twist_rate(self, s: Array) -> Array:
        """Derivative of the twist by s, (6, k) [1/m, rad/m^2]: towards the centre."""
        out, _ = self._directions(s)
        return np.concatenate((-out / self.radius, np.zeros((3, len(s)))))

    def describe(self) -> dict[str, Any]:
        """The circle's numbers."""
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

    def _directions(self, s: ArrayLike) -> tuple[Array, Array]:
        """Unit vectors outwards and along the circle, (3, k) each."""
        angle = np.asarray(s) / self.radius
        across = np.cross(self.normal, self.start)
        cosine, sine = np.cos(angle), np.sin(angle)
        return (
            np.outer(self.start, cosine) + np.outer(across, sine),
            np.outer(across, cosine) - np.outer(self.start, sine),
        )
