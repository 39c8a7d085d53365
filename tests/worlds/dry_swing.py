"""A rigid pendulum on a moving pivot with true dry friction, from the moments about the pivot.

With the load at (x - l sin phi, -l cos phi) and the pivot's speed V and acceleration u,

    phi'' = (u cos phi - g sin phi)/l - 2 l' phi'/l - (b phi' + k phi)/(m l^2) + F_across/(m l) + e
            - sign(phi') (c + r |T|)/(m l^2),

    T = m (g cos phi + l phi'^2 + u sin phi) + F_along,   F = -(d + q |v|) v of the load's speed v, and the wind,

where b, c, r belong to the pivot's viscous, Coulomb and load-dependent friction, k to its stiffness, and e is what a
hand does. Dry friction is exact: the step in which phi' changes its sign is cut at that instant, and from there the
load stands as long as the torque that would move it is no larger than c + r |T|. Nothing here comes from armdyn's
models.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import cos, pi, sin, sqrt

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.signal import lfilter

G = 9.81
STEPS, STEEP_STEPS, STEEP = 200, 400, 1.3
"""Of the Runge-Kutta method per period of small swings; more from a start beyond so many rad, where the top is nearer
and an error of the energy is one of the period. In a minute from 2.95 rad the angle errs by less than 3 microradians;
150 steps throughout err by up to 0.4 of the noise of a fine sensor."""
FORCES = (
    "pivot_viscous_friction", "pivot_coulomb_friction", "pivot_load_friction", "pivot_stiffness", "linear_drag",
    "quadratic_drag", "string_creep", "wind",
)  # fmt: skip
DRY = ("pivot_coulomb_friction", "pivot_load_friction")
AT_THE_GRIPPER = ("gripper_scale", "gripper_lag")  # effects by where they act; what acts on readings is in `reading`
Motion = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Pendulum:
    """What swings."""

    length: float  # pivot to centre of the load, m
    mass: float  # kg
    effects: Mapping[str, float]  # size by name, SI units

    @property
    def period(self) -> float:
        """Of small swings, s."""
        return 2 * pi * sqrt(self.length / G)


@dataclass(frozen=True)
class Push:
    """What acts on a pendulum from outside."""

    # measured x, v, a of the pivot (3, n) at times (n,), before `AT_THE_GRIPPER`; None where it stands
    gripper: Motion | None = None
    shake: Motion | None = None  # x, v, a of a motion of the pivot that nobody measures; None where it is firm
    # acceleration, rad/s^2, and seconds, of the hand that lets go: half a sine from the first instant on
    hand: tuple[float, float] = (0.0, 0.1)


@dataclass(frozen=True, eq=False)
class Swing:
    """True motion at asked times (n,): rad, rad/s, N."""

    angle: np.ndarray
    rate: np.ndarray
    tension: np.ndarray


def swing(pendulum: Pendulum, start: tuple[float, float], push: Push, time: np.ndarray) -> Swing:
    """Motion from `start` (rad, rad/s) at `time[0]`."""
    step = pendulum.period / (STEPS if abs(start[0]) < STEEP else STEEP_STEPS)
    count = max(2, int(np.ceil((time[-1] - time[0]) / step)) + 1)
    half = time[0] + 0.5 * step * np.arange(2 * count + 1)
    speed, pull = _pivot(pendulum, push, half)
    size, seconds = push.hand
    since = half - half[0]
    hand = np.where(since < seconds, size * np.sin(pi * since / seconds), 0.0)
    states = _integrated(pendulum, start, half.tolist(), speed.tolist(), pull.tolist(), hand.tolist(), step)
    grid = half[::2][: len(states)]
    angle = CubicHermiteSpline(grid, states[:, 0], states[:, 1])(time)
    rate = CubicHermiteSpline(grid, states[:, 1], states[:, 2])(time)
    v, u = _pivot(pendulum, push, time, grid)
    along = _drag(pendulum.effects, pendulum.length, angle, rate, v)[1]
    tension = pendulum.mass * (G * np.cos(angle) + pendulum.length * rate**2 + u * np.sin(angle)) + along
    return Swing(angle, rate, tension)


def reading(effects: Mapping[str, float], channel: str, motion: Swing) -> np.ndarray:
    """What a sensor makes of the true motion, without noise."""
    if channel == "swing_rate":
        return motion.rate + effects.get("sensor_bias", 0.0)
    if channel == "load_force":
        return motion.tension + effects.get("sensor_bias", 0.0)
    skew, cubic = effects.get("angle_skew", 0.0), effects.get("angle_distortion", 0.0)
    true = motion.angle
    bent = (1 + effects.get("angle_gain", 0.0)) * true + skew * true**2 + cubic * true**3
    return bent + effects.get("angle_offset", 0.0)


def _pivot(
    pendulum: Pendulum, push: Push, time: np.ndarray, grid: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """True speed and acceleration of the pivot at times; `grid` is uniform, for what has a memory."""
    v, u = np.zeros(len(time)), np.zeros(len(time))
    if push.gripper is not None:
        scale, lag = (pendulum.effects.get(name, 0.0) for name in AT_THE_GRIPPER)
        if lag:
            at = time if grid is None else grid
            v, u = (_lagged(row, at[1] - at[0], lag) for row in push.gripper(at)[1:])
            if grid is not None:
                v, u = np.interp(time, grid, v), np.interp(time, grid, u)
        else:
            _, v, u = push.gripper(time)
        v, u = (1 + scale) * v, (1 + scale) * u
    if push.shake is not None:
        _, dv, du = push.shake(time)
        v, u = v + dv, u + du
    return v, u


def _lagged(values: np.ndarray, step: float, lag: float) -> np.ndarray:
    """First-order lag, from 0, of what is straight between its samples."""
    decay = np.exp(-step / lag)
    late = lag / step * (1 - decay)
    found, _ = lfilter([1 - late, late - decay], [1.0, -decay], values, zi=[-(1 - late) * values[0]])
    return found


def _drag(
    effects: Mapping[str, float], length: float, angle: np.ndarray, rate: np.ndarray, speed: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Force of the air across the string, towards growing angle, and along it, away from the pivot, N."""
    vx, vz = speed - length * rate * np.cos(angle), length * rate * np.sin(angle)
    size = effects.get("linear_drag", 0.0) + effects.get("quadratic_drag", 0.0) * np.hypot(vx, vz)
    x, z = size * vx - effects.get("wind", 0.0), size * vz
    return x * np.cos(angle) - z * np.sin(angle), x * np.sin(angle) + z * np.cos(angle)


def _integrated(
    pendulum: Pendulum,
    start: tuple[float, float],
    times: Sequence[float],
    speed: Sequence[float],
    pull: Sequence[float],
    hand: Sequence[float],
    step: float,
) -> np.ndarray:
    """(count, 3) angle, rate and acceleration at every second of `times`."""
    viscous, coulomb, grip, stiff, linear, quadratic, creep, wind = (pendulum.effects.get(n, 0.0) for n in FORCES)
    m, rest = pendulum.mass, pendulum.length
    air, dry, moving = linear + quadratic > 0.0, coulomb + grip > 0.0, any(speed)
    begin = times[0]

    def smooth(t: float, v: float, u: float, e: float, angle: float, rate: float) -> float:
        """Acceleration without dry friction."""
        length = rest + creep * (t - begin)
        c, s = cos(angle), sin(angle)
        found = (u * c - G * s) / length - 2 * creep * rate / length + e - wind * c / (m * length)
        found -= (viscous * rate + stiff * angle) / (m * length * length)
        if air:
            if moving:
                vx, vz = v - length * rate * c, length * rate * s
                found += (linear + quadratic * sqrt(vx * vx + vz * vz)) * (vx * c - vz * s) / (m * length)
            else:
                found -= (linear + quadratic * length * abs(rate)) * rate / m
        return found

    def braking(t: float, v: float, u: float, angle: float, rate: float) -> float:
        """Largest acceleration of dry friction."""
        length = rest + creep * (t - begin)
        size = coulomb
        if grip:
            c, s = cos(angle), sin(angle)
            tension = m * (G * c + length * rate * rate + u * s) - wind * s
            if air and moving:
                vx, vz = v - length * rate * c, length * rate * s
                tension += (linear + quadratic * sqrt(vx * vx + vz * vz)) * (vx * s + vz * c)
            size += grip * abs(tension)
        return size / (m * length * length)

    def acceleration(t: float, v: float, u: float, e: float, angle: float, rate: float, sign: float) -> float:
        found = smooth(t, v, u, e, angle, rate)
        return found - sign * braking(t, v, u, angle, rate) if sign else found

    def stepped(
        t: float, h: float, ins: Sequence[Sequence[float]], angle: float, rate: float, sign: float
    ) -> tuple[float, float, float]:
        """Angle and rate after `h`, and the acceleration before it."""
        (v0, u0, e0), (v1, u1, e1), (v2, u2, e2) = ins
        k1 = acceleration(t, v0, u0, e0, angle, rate, sign)
        r2 = rate + 0.5 * h * k1
        k2 = acceleration(t + 0.5 * h, v1, u1, e1, angle + 0.5 * h * rate, r2, sign)
        r3 = rate + 0.5 * h * k2
        k3 = acceleration(t + 0.5 * h, v1, u1, e1, angle + 0.5 * h * r2, r3, sign)
        r4 = rate + h * k3
        k4 = acceleration(t + h, v2, u2, e2, angle + h * r3, r4, sign)
        return angle + h / 6 * (rate + 2 * r2 + 2 * r3 + r4), rate + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), k1

    def between(ins: Sequence[Sequence[float]], f: float) -> list[float]:
        """What acts from outside at a share of a step."""
        a, b, c = (2 * f - 1) * (f - 1), 4 * f * (1 - f), f * (2 * f - 1)
        return [a * x + b * y + c * z for x, y, z in zip(*ins, strict=True)]

    def direction(t: float, outside: Sequence[float], angle: float) -> float:
        """Where a load that stands starts to go; 0 where friction holds it."""
        v, u, e = outside
        wanted = smooth(t, v, u, e, angle, 0.0)
        return 0.0 if abs(wanted) <= braking(t, v, u, angle, 0.0) else (1.0 if wanted > 0.0 else -1.0)

    count = len(times) // 2
    outside = list(zip(speed, pull, hand, strict=True))
    states, (angle, rate) = [], start
    for k in range(count):
        t, ins = times[2 * k], outside[2 * k : 2 * k + 3]
        if not dry:
            after, faster, k1 = stepped(t, step, ins, angle, rate, 0.0)
            states.append((angle, rate, k1))
            angle, rate = after, faster
            continue
        sign = (1.0 if rate > 0.0 else -1.0) if rate else direction(t, ins[0], angle)
        if not sign:
            states.append((angle, 0.0, 0.0))
            continue
        after, faster, k1 = stepped(t, step, ins, angle, rate, sign)
        states.append((angle, rate, k1))
        if faster * sign < 0.0:
            share = rate / (rate - faster)
            for _ in range(2):
                until = [ins[0], between(ins, 0.5 * share), between(ins, share)]
                stopped, left, _ = stepped(t, share * step, until, angle, rate, sign)
                slope = acceleration(t + share * step, *until[2], stopped, left, sign)
                share = min(max(share - left / (step * slope), 0.0), 1.0) if slope else share
            after, faster = stopped, 0.0
            back = direction(t + share * step, between(ins, share), stopped)
            if back:
                rest_of = [between(ins, share), between(ins, 0.5 * (1 + share)), ins[2]]
                after, faster, _ = stepped(t + share * step, (1 - share) * step, rest_of, stopped, 0.0, back)
                faster = faster if faster * back > 0.0 else 0.0
        angle, rate = after, faster
    return np.array(states)
