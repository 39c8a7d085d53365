"""Paths of the tool point in SE(3), as functions of one coordinate s."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from urdf import Line

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
