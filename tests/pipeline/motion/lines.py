"""Lines to move on, and a check of motions that shares nothing with the package but its numbers."""

from collections.abc import Iterable

import numpy as np

import urdf
from pipeline.motion import LineLimits, LineState, LineTrajectory
from pipeline.motion.profile import JerkProfile

DT = 0.01

TWO_JOINTS = urdf.Limits(
    lower=np.array([-1.0, -2.0]),
    upper=np.array([1.0, 2.0]),
    velocity=np.array([1.5, 4.0]),
    acceleration=np.array([20.0, 40.0]),
    jerk=np.array([1000.0, 2000.0]),
    effort=np.array([50.0, 15.0]),
)

# The measured speed limit of Baxter's line; the acceleration limit has kinks on purpose.
BAXTER_S = [-0.3, -0.2, 0.0, 0.2, 0.3, 0.4, 0.45, 0.5, 0.55]
BAXTER_SPEED = [0.70, 1.02, 1.07, 1.04, 0.88, 0.70, 0.60, 0.51, 0.42]


def baxter_limits(jerk: float = 200.0) -> LineLimits:
    s = np.linspace(-0.3, 0.55, 171)
    return LineLimits(s, np.interp(s, BAXTER_S, BAXTER_SPEED), np.interp(s, [-0.3, 0.0, 0.55], [9.0, 14.0, 7.0]), jerk)


def sine(amplitude: float, frequency: float, count: int, centre: float = 0.0) -> LineTrajectory:
    w, t = 2 * np.pi * frequency, DT * np.arange(count)
    s, v = amplitude * np.sin(w * t), amplitude * w * np.cos(w * t)
    return LineTrajectory(t, centre + s, v, -(w**2) * s)


def worst_excess(limits: LineLimits, states: Iterable[LineState], dt: float = DT) -> float:
    """How far a sampled motion is beyond any limit, in SI units; negative where it is within all of them."""
    s, v, a = np.array(list(states)).T
    jerk = np.abs(np.diff(a)) / dt if a.size > 1 else np.zeros(1)
    return float(
        max(
            np.max(limits.s[0] - s),
            np.max(s - limits.s[-1]),
            np.max(np.abs(v) - np.interp(s, limits.s, limits.speed)),
            np.max(np.abs(a) - np.interp(s, limits.s, limits.acceleration)),
            # Rounding of an acceleration of 10 m/s^2, divided by dt, is 1e-13 of what a jerk is compared with.
            np.max(jerk - limits.jerk) * dt,
        )
    )


def worst_excess_between(limits: LineLimits, motion: JerkProfile, points: int = 40) -> float:
    """The same inside one cycle, which is a cubic in time."""
    if motion.duration == 0.0:
        return -1.0
    time = np.linspace(0.0, motion.duration, points)
    states = [motion.state_at(t) for t in time]
    return worst_excess(limits, states, float(time[1]))


def is_one_motion(states: list[LineState], jerk: float, dt: float = DT) -> bool:
    """Whether position, speed and acceleration of samples belong to one motion of bounded jerk."""
    s, v, a = np.array(states).T
    # Against the trapezium, a jerk within its bound moves the speed by at most J dt^2 / 4, the position by J dt^3 / 12.
    speed = np.abs(np.diff(v) - dt * (a[1:] + a[:-1]) / 2)
    position = np.abs(np.diff(s) - dt * (v[1:] + v[:-1]) / 2 + dt**2 * np.diff(a) / 12)
    return bool(np.all(speed <= jerk * dt**2 / 4 + 1e-9) and np.all(position <= jerk * dt**3 / 12 + 1e-9))
