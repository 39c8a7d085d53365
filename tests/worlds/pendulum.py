"""Recordings of a load on a string with a hidden effect, from equations of its own.

Nothing here comes from armdyn's models. The load is a particle in Cartesian coordinates, q'' = F/m - T n/m with
n = (q - g)/|q - g|; the tension T follows from twice differentiating |q - g| = l(t) (Baumgarte's constraint, kept by
the tight tolerance), or from the stretch of a real spring where the string is elastic. A load with inertia, or a string
with mass, adds its generalised inertia to the constrained direction. Where only friction, drag or wind act on the load,
its equations are those of `dry_swing`, forty times as fast; a test holds one against the other.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import accumulate
from math import atan2, cos, sin, sqrt, tanh
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from armdyn.recording.units import KnownQuantity
from armdyn.run import Channel, Run

from . import coloured, dry_swing
from .dry_swing import G

REALISTIC: Mapping[str, float] = {
    "gripper_lag": 0.02, "gripper_compliance": 5e-3, "gripper_scale": 0.03, "gripper_bob": 0.5, "path_tilt": 0.02,
    "pivot_viscous_friction": 1e-3, "pivot_coulomb_friction": 1e-3, "string_elasticity": 2e-3, "string_mass": 5e-3,
    "string_creep": 2e-4, "linear_drag": 5e-3, "quadratic_drag": 1e-2, "wind": 0.01, "load_inertia": 4e-4,
    "out_of_plane_swing": 0.15, "sensor_bias": 0.02, "sensor_gain": 0.03, "sensor_drift": 1e-3, "sensor_lag": 0.02,
    "sensor_delay": 0.01, "vertical_sensing_axis": 1.0, "cross_axis_sensitivity": 0.02, "sensor_nonlinearity": 0.05,
}  # fmt: skip
"""Sizes in SI units; `angle_offset` needs an angle sensor and is tested apart."""

OUTSIDE = ("one_sided_rub", "hum", "magnet", "sensor_play", "sensor_clipping")
"""In N m, N, N, N, and in weights of the load."""

IN_THE_ANGLE = {
    "pivot_viscous_friction", "pivot_coulomb_friction", "linear_drag", "quadratic_drag", "wind",
    "sensor_bias", "sensor_gain", "sensor_drift", "sensor_lag", "sensor_delay", "vertical_sensing_axis",
    "cross_axis_sensitivity", "sensor_nonlinearity", "angle_offset", "hum", "sensor_play", "sensor_clipping",
}  # fmt: skip
"""Effects that `dry_swing` and `sensor` have between them."""


@dataclass(frozen=True)
class Setup:
    """One experiment."""

    length: float = 0.368  # pivot to centre of the load, m
    mass: float = 0.08  # kg
    hidden: Mapping[str, float] = field(default_factory=dict)  # effect to size
    duration: float = 15.0  # s
    force_noise: float = 3e-3  # N
    encoder_noise: float = 0.0  # m
    correlation: float = 0.0  # of the force noise from sample to sample
    start: tuple[float, float] = (0.01, 0.02)  # angle and rate at the start, rad and rad/s
    angle_noise: float | None = None  # rad; None where there is no angle sensor
    # further torque about the pivot, N m, from the angle, rad, and its rate, rad/s
    torque: Callable[[float, float], float] | None = None
    reading: Callable[[np.ndarray], np.ndarray] | None = None  # what the load cell makes of the tension, N


def gripper_motion(rng: np.random.Generator) -> Callable[[np.ndarray], np.ndarray]:
    """A multisine from rest, within about 0.2 m, that swings the load by 0.2 to 0.6 rad; x, v, a (3, n) at times."""
    frequencies = rng.uniform(0.25, 1.3, 4)
    amplitudes = rng.uniform(0.3, 1.0, 4) * np.array([0.06, 0.04, 0.03, 0.02]) * rng.choice([-1, 1], 4)
    amplitudes *= np.where(np.abs(frequencies - 0.82) < 0.15, 0.3, 1.0)  # not at the resonance
    w = 2 * np.pi * frequencies

    speeds, accelerations, whole = amplitudes * w, amplitudes * w**2, amplitudes.sum()

    def motion(t: np.ndarray | float) -> np.ndarray:
        phase = w * t if isinstance(t, float) else np.multiply.outer(w, t)
        cosine = np.cos(phase)
        return np.array([whole - amplitudes @ cosine, speeds @ np.sin(phase), accelerations @ cosine])

    return motion


def record(name: str, setup: Setup, rng: np.random.Generator, motion: Callable | None = None) -> Run:
    """One run as a user would have it, on a motion of the gripper, a random one where not given."""
    motion = gripper_motion(rng) if motion is None else motion
    time = np.arange(0.0, setup.duration, 0.01)
    truth = simulate(setup, motion, time)
    force = sensor(setup, time, truth)
    noise = coloured(rng.normal(size=len(time)), setup.correlation)
    x = motion(time)[0] + setup.encoder_noise * rng.normal(size=len(time))
    channels = {
        "gripper_x": Channel(time, x, "m"),
        "load_force": Channel(time, force + setup.force_noise * noise, "N"),
    }
    stated = {"load_force": setup.force_noise}
    if setup.encoder_noise == 0.0:
        stated["gripper_x"] = 0.0
    if setup.angle_noise is not None:
        angle = truth["angle"] + setup.hidden.get("angle_offset", 0.0) + setup.angle_noise * rng.normal(size=len(time))
        channels["swing_angle"] = Channel(time, angle, "rad")
        stated["swing_angle"] = setup.angle_noise
    return Run(name, channels, {}, stated)


def weighed(run: Run, mass: KnownQuantity, length: KnownQuantity) -> Run:
    """The run with what was measured by hand."""
    return Run(run.name, run.channels, {"mass": mass, "length": length}, run.noise)


def recordings(seed: int = 7, **settings: Any) -> list[Run]:
    """Two runs of the usual load, which was weighed and measured; `settings` are those of `Setup`."""
    rng, known = np.random.default_rng(seed), (KnownQuantity(0.0802, 4e-4, "kg"), KnownQuantity(0.3685, 1e-3, "m"))
    return [weighed(record(f"r{k}.csv", Setup(**settings), rng), *known) for k in range(2)]


def simulate(setup: Setup, motion: Callable, time: np.ndarray) -> dict[str, np.ndarray]:
    """True tension, angle and its sine at `time`."""
    if setup.torque is not None or not setup.hidden.keys() <= IN_THE_ANGLE:
        return in_space(setup, motion, time)
    load = dry_swing.Pendulum(setup.length, setup.mass, setup.hidden)
    moved = dry_swing.swing(load, setup.start, dry_swing.Push(motion), time)
    return {"tension": moved.tension, "angle": moved.angle, "side": np.sin(moved.angle)}


def in_space(setup: Setup, motion: Callable, time: np.ndarray) -> dict[str, np.ndarray]:
    """See `simulate`; by the Cartesian equations."""
    h, m, l0 = setup.hidden, setup.mass, setup.length
    elastic = h.get("string_elasticity", 0.0)
    gripper = _gripper(h, motion, setup.duration)

    creep, tilt = h.get("string_creep", 0.0), h.get("path_tilt", 0.0)
    steady = m * G * np.array([sin(tilt), 0.0, -cos(tilt)]) + np.array([h.get("wind", 0.0), 0.0, 0.0])
    linear, quadratic = h.get("linear_drag", 0.0), h.get("quadratic_drag", 0.0)
    viscous, coulomb = h.get("pivot_viscous_friction", 0.0), h.get("pivot_coulomb_friction", 0.0)
    rub, magnet = h.get("one_sided_rub", 0.0), h.get("magnet", 0.0)

    def length(t: float) -> tuple[float, float]:
        return l0 + creep * t, creep

    def forces(t: float, q: np.ndarray, v: np.ndarray, n: np.ndarray, rate: float) -> np.ndarray:
        f = steady - (linear + quadratic * sqrt(v @ v)) * v
        torque = -viscous * rate - coulomb * tanh(rate / 0.01)
        if q[0] > 0.03:
            torque -= rub * tanh(rate / 0.02)
        if setup.torque is not None:
            torque += setup.torque(atan2(-n[0], -n[2]), rate)
        if torque:
            across = np.array([n[2], 0.0, -n[0]])  # towards growing angle, for n = (-sin, 0, -cos)
            f = f + torque / length(t)[0] * across
        if magnet:
            d = (q[0] - 0.02) / 0.03
            f[0] -= magnet * d / (1 + d**2) ** 2
        return f

    heavy, inertia = h.get("string_mass", 0.0), h.get("load_inertia", 0.0)

    def rate_of(q: np.ndarray, v: np.ndarray, g: np.ndarray, gv: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        d = q - g
        r = sqrt(d @ d)
        n = d / r
        across = np.array([n[2], 0.0, -n[0]])
        return n, across, float((v - gv) @ across) / r

    def right(t: float, s: np.ndarray) -> np.ndarray:
        return np.concatenate([s[3:6], accelerations(t, s)[0]])

    def accelerations(t: float, s: np.ndarray) -> tuple[np.ndarray, float]:
        q, v = s[:3], s[3:6]
        g, gv, ga = gripper(t)
        n, across, rate = rate_of(q, v, g, gv)
        r, r_rate = length(t)
        f = forces(t, q, v, n, rate)
        if elastic:  # a spring with a quarter of its critical damping
            damping = 0.25 * 2 * np.sqrt(m / elastic)
            tension = ((q - g) @ n - r) / elastic + damping * ((v - gv) @ n)
            return (f - tension * n) / m, float(tension)
        # |q - g|' = l', twice: n.(q'' - g'') + |(v - gv) across the string|^2 / r = 0 for a constant creep rate
        w = v - gv
        bend = (w @ w - (w @ n) ** 2) / r
        stabilise = 40.0 * ((w @ n) - r_rate) + 400.0 * ((q - g) @ n - r)
        if heavy or inertia:
            # In the plane: (m + ms/3 + I/l^2) acts across the string, m along it; the string's own terms by Lagrange.
            angular = (m + heavy / 3) * r**2 + inertia
            gravity = (m + heavy / 2) * r * G * n[0]  # n[0] = -sin(angle)
            drive = (m + heavy / 2) * r * (-n[2]) * ga[0]
            other = (f - m * G * np.array([0, 0, -1.0])) @ across * r
            acceleration = (gravity + drive + other) / angular
            a = ga + r * acceleration * across - r * rate**2 * n - stabilise * n
            pull = (m + heavy / 2) * r * rate**2 + (m + heavy) * (-n[2] * G - n[0] * ga[0])  # at the upper end
            return a, float(pull + (f - m * G * np.array([0, 0, -1.0])) @ n)
        tension = f @ n + m * (bend - ga @ n + stabilise)
        return (f - tension * n) / m, float(f @ n + m * (bend - ga @ n))

    if "gripper_compliance" in h:
        return _compliant(setup, gripper, forces, time)
    g, gv, _ = gripper(0.0)
    angle, rate = setup.start
    out = h.get("out_of_plane_swing", 0.0)
    n = np.array([-np.sin(angle) * np.cos(out), np.sin(out), -np.cos(angle) * np.cos(out)])
    across = np.array([n[2], 0.0, -n[0]])
    begin = setup.length
    if elastic:
        begin += elastic * m * G * np.cos(angle)
    q0 = g + begin * n
    s0 = np.concatenate([q0, gv * 0 + begin * rate * across + gv * [1, 0, 1]])
    found = solve_ivp(right, (0.0, time[-1]), s0, "DOP853", t_eval=time, rtol=1e-9, atol=1e-10, max_step=0.02)
    states = found.y
    tension = np.array([accelerations(t, s)[1] for t, s in zip(time, states.T, strict=True)])
    pivots = np.array([gripper(t)[0] for t in time]).T
    d = states[:3] - pivots
    return {"tension": tension, "angle": np.arctan2(-d[0], -d[2]), "side": -d[0] / np.linalg.norm(d, axis=0)}


def _compliant(setup: Setup, gripper: Callable, forces: Callable, time: np.ndarray) -> dict[str, np.ndarray]:
    """A pendulum below a light carriage (2 g) on a spring: three Lagrangian coordinates less one.

    A damper quiets the carriage's own vibration; in proportion to the load it would also brake the swing, which would
    be another effect.
    """
    give, m, r, carriage = setup.hidden["gripper_compliance"], setup.mass, setup.length, 2e-3
    damping = 2 * 0.3 * np.sqrt(carriage / give)

    def parts(t: float, s: np.ndarray) -> tuple[np.ndarray, float]:
        p, angle, pv, rate = s
        (gx, _, _), (gvx, _, _), _ = gripper(t)
        sin, cos = np.sin(angle), np.cos(angle)
        spring = -(p - gx) / give - damping * (pv - gvx)
        n = np.array([-sin, 0.0, -cos])
        q = np.array([p, 0.0, 0.0]) + r * n
        v = np.array([pv - r * cos * rate, 0.0, r * sin * rate])
        f = forces(t, q, v, n, rate)
        along = f @ np.array([-cos, 0.0, sin])
        # m (p'' (1,0) + r phi'' (-cos, sin) + r phi'^2 (sin, cos)) = f - T n; carriage p'' = spring + T n_x
        matrix = np.array([[m + carriage, -m * r * cos], [-m * cos, m * r]])
        rhs = np.array([f[0] + spring - m * r * sin * rate**2, along])
        acceleration = np.linalg.solve(matrix, rhs)
        tension = f @ n - m * (acceleration[0] * n[0] - r * rate**2)
        return acceleration, float(tension)

    angle, rate = setup.start
    s0 = np.array([gripper(0.0)[0][0] - give * m * G * np.sin(angle), angle, 0.0, rate])
    found = solve_ivp(
        lambda t, s: np.concatenate([s[2:], parts(t, s)[0]]), (0.0, time[-1]), s0, "LSODA", t_eval=time,
        rtol=1e-9, atol=1e-10, max_step=0.01,
    )  # fmt: skip
    tension = np.array([parts(t, s)[1] for t, s in zip(time, found.y.T, strict=True)])
    return {"tension": tension, "angle": found.y[1], "side": np.sin(found.y[1])}


def _gripper(h: Mapping[str, float], motion: Callable, duration: float) -> Callable[[float], tuple[np.ndarray, ...]]:
    """Real position, velocity, acceleration of the string's end, from the measured motion."""
    scale, bob, lag = 1 + h.get("gripper_scale", 0.0), h.get("gripper_bob", 0.0), h.get("gripper_lag", 0.0)
    along = motion
    if lag:
        grid = np.arange(0.0, duration + 0.1, 0.001)
        x0 = motion(np.array([0.0]))[0]
        trailed = solve_ivp(
            lambda t, z: (motion(t)[0] - z) / lag, (0.0, grid[-1]), x0, "DOP853", t_eval=grid,
            rtol=1e-10, atol=1e-12,
        ).y[0]  # fmt: skip
        spline = CubicSpline(grid, trailed)

        def along(t: float) -> np.ndarray:
            x, v, _ = motion(t)
            z = spline(t)
            dz = (x - z) / lag
            return np.array([z, dz, (v - dz) / lag])

    def at(t: float) -> tuple[np.ndarray, ...]:
        x, v, a = (scale * along(float(t))).tolist()
        return (
            np.array([x, 0.0, bob * x**2]),
            np.array([v, 0.0, 2 * bob * x * v]),
            np.array([a, 0.0, 2 * bob * (v**2 + x * a)]),
        )

    return at


def sensor(setup: Setup, time: np.ndarray, truth: Mapping[str, np.ndarray]) -> np.ndarray:
    """What the load cell says, without noise."""
    h, tension = setup.hidden, truth["tension"] if setup.reading is None else setup.reading(truth["tension"])
    force = tension * (1 - h.get("vertical_sensing_axis", 0.0) * (1 - np.cos(truth["angle"])))
    force = force + h.get("cross_axis_sensitivity", 0.0) * tension * truth["side"]
    force = force + h.get("sensor_nonlinearity", 0.0) * force**2
    force = (1 + h.get("sensor_gain", 0.0)) * force
    force = force + h.get("sensor_bias", 0.0) + h.get("sensor_drift", 0.0) * time
    force = force + h.get("hum", 0.0) * np.sin(2 * np.pi * 6.3 * time)
    if play := h.get("sensor_play", 0.0):  # the reading follows only when pushed by more than this
        force = np.array(list(accumulate(force, lambda y, f: min(max(y, f - play), f + play))))
    if clipping := h.get("sensor_clipping", 0.0):
        force = np.minimum(force, clipping * setup.mass * G)
    lag, delay = h.get("sensor_lag", 0.0), h.get("sensor_delay", 0.0)
    if lag:
        spline = CubicSpline(time, force)
        force = solve_ivp(
            lambda t, z: (spline(t) - z) / lag, (time[0], time[-1]), force[:1], "DOP853", t_eval=time, rtol=1e-9,
            atol=1e-11,
        ).y[0]  # fmt: skip
    if delay:
        force = CubicSpline(time, force)(np.clip(time - delay, time[0], None))
    return force
