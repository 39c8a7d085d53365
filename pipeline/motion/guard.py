"""A motion checked against limits, the motion to rest that must always exist, and the motion at the speed limit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from pipeline.motion.limits import LineLimits
from pipeline.motion.profile import JerkProfile, LinePlanner
from pipeline.motion.trajectory import LineState
from urdf.robot import Array

TOLERANCE = 1e-10
"""For rounding [SI units]."""


class Guard:
    """Holds motions against limits, quickly where the limits are far."""

    def __init__(self, limits: LineLimits, planner: LinePlanner) -> None:
        self.limits, self._planner = limits, planner

    def allows(self, motion: JerkProfile) -> bool:
        """Whether a motion respects the limits."""
        extremes = motion.extremes()
        # Most motions that break a limit do so at an extreme already.
        if not all(self._allows_state(state) for state in extremes):
            return False
        s, v, a = zip(*extremes, strict=True)
        fastest, strongest, lower, upper = max(map(abs, v)), max(map(abs, a)), min(s), max(s)
        limits = self.limits
        far = fastest <= limits.lowest_speed(lower, upper) and strongest <= limits.lowest_acceleration(lower, upper)
        return far or motion.respects(limits, TOLERANCE)

    def _allows_state(self, state: LineState) -> bool:
        s, v, a = state
        limits = self.limits
        return (
            limits.s_min - TOLERANCE <= s <= limits.s_max + TOLERANCE
            and abs(v) <= limits.lowest_speed(s, s) + TOLERANCE
            and abs(a) <= limits.lowest_acceleration(s, s) + TOLERANCE
        )

    def stop(self, state: LineState) -> JerkProfile | None:
        """The motion to rest, braking with what the whole stretch ahead allows; None where it breaks a limit.

        Args:
            state: to stop from; if it is beyond a limit itself the answer is None.
        """
        if not state.is_finite:
            return None
        limits = self.limits
        # Bounds of the speed (the acceleration is taken back first) and of the way to rest.
        fastest = abs(state.v) + state.a**2 / (2.0 * limits.jerk)
        weakest = limits.weakest
        reach = fastest * (fastest / (2.0 * weakest) + (abs(state.a) + weakest) / limits.jerk)
        if fastest > 10.0 * limits.fastest:
            return None
        motion = self._planner.to_rest(state, limits.lowest_acceleration(state.s - reach, state.s + reach))
        return motion if motion is not None and self.allows(motion) else None

    def drawn_back(self, target: LineState) -> LineState:
        """The nearest position on the line, with a share of the speed from which the tool can still stop.

        Args:
            target: anywhere, finite.
        """
        limits = self.limits
        s = min(max(target.s, limits.s_min), limits.s_max)
        speed, acceleration = limits.lowest_speed(s, s), limits.lowest_acceleration(s, s)
        v = min(max(target.v, -speed), speed)
        a = min(max(target.a, -acceleration), acceleration)
        for share in (1.0, 0.8, 0.5, 0.2):
            drawn = LineState(s, share * v, share * a)
            if self.stop(drawn) is not None:
                return drawn
        return LineState(s)


GRID = 1e-3
"""Spacing of the smoothed limit [m]."""

WINDOW = 10
"""Half width of the smoothing, in grid steps: a kink of the limit is rounded over 2 cm."""

STEP = 0.02
"""Longest time step of the integration of the ride; its error is 1e-7 m [s]."""


class RideCurve:
    """A smooth speed limit that lies under the true one everywhere.

    The limit is the lowest of the joints' limits and has a kink wherever another joint takes over; its acceleration
    ``a = W W'`` would jump there. Taking the minimum over a window and then a mean over the same window gives a limit
    that is smooth and still never above the true one.

    Attributes:
        limits: with the smooth speed limit, at `nodes`.
    """

    def __init__(self, limits: LineLimits) -> None:
        count = int(np.ceil((limits.s_max - limits.s_min) / GRID)) + 1
        self.nodes = np.linspace(limits.s_min, limits.s_max, max(count, 4))
        half = WINDOW * (self.nodes[1] - self.nodes[0])
        places = np.union1d(self.nodes, limits.s)
        speed = limits.speed_at(places)
        first, last = np.searchsorted(places, self.nodes - half), np.searchsorted(places, self.nodes + half, "right")
        lowest = np.array([speed[i:k].min() for i, k in zip(first, last, strict=True)])
        kernel = np.bartlett(2 * WINDOW + 1)[1:-1]
        smooth = np.convolve(np.pad(lowest, WINDOW - 1, mode="edge"), kernel / kernel.sum(), mode="valid")
        self._spline = CubicSpline(self.nodes, smooth)
        under = np.minimum(np.interp(places, self.nodes, smooth), speed)
        self.limits = LineLimits(places, under, limits.acceleration_at(places), limits.jerk)

    def at(self, s: float, direction: float) -> LineState:
        """State of a tool that rides the limit at `s`, towards larger s (+1) or smaller (-1)."""
        speed = float(self._spline(s))
        return LineState(s, direction * speed, speed * float(self._spline(s, 1)))

    def after(self, s: float, time: float, direction: float) -> LineState:
        """State of a ride `time` [s] after `s`, by midpoint steps; it ends at the end of the line."""
        for _ in range(steps := max(round(time / STEP), 1)):
            h = direction * time / steps
            s = self._clipped(s + h * float(self._spline(self._clipped(s + 0.5 * h * float(self._spline(s))))))
        return self.at(s, direction)

    def _clipped(self, s: float) -> float:
        return min(max(s, float(self.nodes[0])), float(self.nodes[-1]))

    def jerk(self, s: ArrayLike) -> Array:
        """Size of the jerk of riding, ``|W (W'^2 + W W'')|`` [m/s^3]."""
        w, slope, bend = (self._spline(s, order) for order in (0, 1, 2))
        return np.abs(np.asarray(w * (slope**2 + w * bend)))

    def between(self, s_from: float, s_to: float) -> Ride:
        """The ride from one position to another, in the direction of motion."""
        s = np.linspace(s_from, s_to, max(int(abs(s_to - s_from) / (0.1 * GRID)) + 1, 4))
        travelled = np.abs(s - s_from)
        time = CubicSpline(travelled, 1.0 / self._spline(s)).antiderivative()(travelled)
        return Ride(self, 1.0 if s_to > s_from else -1.0, float(time[-1]), CubicSpline(time, s))


@dataclass(frozen=True)
class Ride:
    """A stretch ridden at the speed limit.

    Attributes:
        curve: the limit.
        direction: +1 towards larger s, -1 towards smaller.
        duration: time that it takes [s].
        position: over time [m].
    """

    curve: RideCurve
    direction: float
    duration: float
    position: CubicSpline

    def at(self, time: float) -> LineState:
        """State at one time [s]."""
        return self.curve.at(float(self.position(time)), self.direction)
