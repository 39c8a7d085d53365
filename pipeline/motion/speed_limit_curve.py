"""Motions along the line at its speed limit."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from pipeline.motion.limits import LineLimits
from pipeline.motion.trajectory import LineState
from urdf.robot import Array

SPEED_LIMIT_NODE_SPACING = 1e-3
"""Distance between the nodes of the smoothed speed limit [m]."""
SMOOTHING_HALF_WIDTH_NODES = 10
"""Half width of the smoothing window in nodes; a kink of the speed limit is rounded over 2 cm."""
MAX_INTEGRATION_STEP_SECONDS = 0.02
"""Largest time step of the integration in `RideCurve.after` [s]; its error is about 1e-5 m."""


class SpeedLimitCurve:
    """A smooth speed limit that is nowhere above the true one, and motions at this speed.

    The speed limit W(s) of the line has a kink wherever another joint limits the speed; the acceleration ``a = W W'``
    of a motion at the limit would jump there. The minimum over a window, averaged over a window of the same width, is
    smooth and never above the true limit.

    Args:
        limits: limits along the line.

    Attributes:
        limits: limits along the line, with the smooth speed limit.
        nodes: evenly spaced positions, about `SPEED_LIMIT_NODE_SPACING` apart, (n,) [m].
    """

    def __init__(self, limits: LineLimits) -> None:
        count = int(np.ceil((limits.s_max - limits.s_min) / SPEED_LIMIT_NODE_SPACING)) + 1
        self.nodes = np.linspace(limits.s_min, limits.s_max, max(count, 4))
        half = SMOOTHING_HALF_WIDTH_NODES * (self.nodes[1] - self.nodes[0])
        places = np.union1d(self.nodes, limits.s)
        speed = limits.speed_at(places)
        first, last = np.searchsorted(places, self.nodes - half), np.searchsorted(places, self.nodes + half, "right")
        lowest = np.array([speed[i:k].min() for i, k in zip(first, last, strict=True)])
        kernel = np.bartlett(2 * SMOOTHING_HALF_WIDTH_NODES + 1)[1:-1]
        smooth = np.convolve(
            np.pad(lowest, SMOOTHING_HALF_WIDTH_NODES - 1, mode="edge"), kernel / kernel.sum(), mode="valid"
        )
        self._spline = CubicSpline(self.nodes, smooth)
        under = np.minimum(np.interp(places, self.nodes, smooth), speed)
        self.limits = LineLimits(places, under, limits.acceleration_at(places), limits.jerk)

    def state_at(self, s: float, direction: float) -> LineState:
        """State of a tool that moves at the speed limit at position s [m]; `direction` is the sign of its speed."""
        speed = float(self._spline(s))
        return LineState(s, direction * speed, speed * float(self._spline(s, 1)))

    def state_after(self, s: float, time: float, direction: float) -> LineState:
        """State of a tool that moves at the speed limit, a time [s] after it has passed position s [m].

        `direction` is the sign of its speed. The position is at most the end of the line.
        """
        for _ in range(steps := max(round(time / MAX_INTEGRATION_STEP_SECONDS), 1)):
            h = direction * time / steps
            s = self._clipped(s + h * float(self._spline(self._clipped(s + 0.5 * h * float(self._spline(s))))))
        return self.state_at(s, direction)

    def _clipped(self, s: float) -> float:
        return min(max(s, float(self.nodes[0])), float(self.nodes[-1]))

    def motion_between(self, s_from: float, s_to: float) -> tuple[float, Callable[[float], LineState]]:
        """Motion at the speed limit between two positions [m]: its duration [s], and a function from time to state."""
        s = np.linspace(s_from, s_to, max(int(abs(s_to - s_from) / (0.1 * SPEED_LIMIT_NODE_SPACING)) + 1, 4))
        travelled = np.abs(s - s_from)
        time = CubicSpline(travelled, 1.0 / self._spline(s)).antiderivative()(travelled)
        position, direction = CubicSpline(time, s), 1.0 if s_to > s_from else -1.0
        return float(time[-1]), lambda t: self.state_at(float(position(t)), direction)

    def jerk(self, s: ArrayLike) -> Array:
        """Absolute jerk of a motion at the speed limit at positions s [m], ``|W (W'^2 + W W'')|`` [m/s^3]."""
        w, slope, bend = (self._spline(s, order) for order in (0, 1, 2))
        return np.abs(np.asarray(w * (slope**2 + w * bend)))
