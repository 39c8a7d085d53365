"""Laws that no catalogue has, hidden in a pendulum below a moving gripper or in an arm of two links, and clean ones.

Physics of its own: Newton's equation along the swing, the textbook equations of two links in a vertical plane (Spong,
Hutchinson & Vidyasagar, Robot Modeling and Control, §7.4). Nothing is armdyn's but the container of a recording. A law
is drawn anew until what it does is visible: its rms force is a share of the typical one.
"""

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from armdyn.run import Channel, Run

G = 9.81
RATE = 100.0
ANGLE_NOISE = 1e-3  # rad, of a good encoder with its mounting
TORQUE_NOISE, POSITION_NOISE = 0.02, 2e-5  # N m and rad, of the arm
SMOOTH = 5e-3  # rad/s, over which dry friction turns round
TEMPERATURE = "temperature"  # in the name of a kind whose recordings hold a column of it, in K


class Moment(NamedTuple):
    """Of a swing: angle, rad, its rate, rad/s, the gripper's position, m, and how warm it is, K above the usual."""

    phi: float
    rate: float
    x: float
    warm: float


Force = Callable[[Moment], float]  # torque about the pivot, N m; a height of the rail apart


@dataclass(frozen=True)
class Law:
    """What is hidden."""

    kind: str  # what it is called here
    names: tuple[str, ...]  # kinds of `armdyn.discovery` that are a right answer; effects of the catalogue among them
    base: str  # ``"pendulum"`` or ``"arm"``


LAWS = {
    law.kind: law
    for law in (
        Law("magnet", ("magnet",), "pendulum"),
        Law("stop", ("stop",), "pendulum"),
        Law("one-sided rub", ("one-sided rub",), "pendulum"),
        Law("cubic drag", ("cubic drag",), "pendulum"),
        Law("flexure", ("flexure", "pivot_stiffness"), "pendulum"),
        Law("sticky seal", ("sticky seal",), "pendulum"),
        Law("rail", ("rail",), "pendulum"),
        Law("backlash", ("backlash",), "arm"),
        Law("cogging", ("cogging",), "arm"),
        Law("tightening cable", ("tightening cable", "stop"), "arm"),
        Law("warming friction", ("warming friction",), "arm"),
        Law("saturating motor", ("saturating motor",), "arm"),
        Law("friction by temperature", ("friction by temperature",), "pendulum"),
        Law("joint friction by temperature", ("friction by temperature",), "arm"),
    )
}
CLEAN = {
    "clean pendulum": "pendulum", "clean arm": "arm",
    "clean pendulum with temperature": "pendulum", "clean arm with temperature": "arm",
}  # fmt: skip


@dataclass(frozen=True)
class World:
    """Recordings with a law in them: two to fit, one held out, one that nothing sees until the end."""

    kind: str  # the law's, or of `CLEAN`
    base: str  # as of `Law`
    runs: tuple[Run, ...]  # to fit
    held_out: Run  # takes part in choosing
    exam: Run  # in nothing
    noise: Mapping[str, float]  # by channel, standard deviation
    length: float = 0.0  # of the pendulum, m
    mass: float = 0.0  # of its load, kg


def world(kind: str, seed: int) -> World:
    """Recordings of one law, of `LAWS`, or of none, of `CLEAN`."""
    rng = np.random.default_rng([seed, zlib.crc32(kind.encode())])
    base = LAWS[kind].base if kind in LAWS else CLEAN[kind]
    return _pendulum(kind, rng) if base == "pendulum" else _arm(kind, rng)


Warmth = Callable[[np.ndarray], np.ndarray]  # K above the usual temperature at (n,) times, s


def _wandering(rng: np.random.Generator) -> Warmth:
    """A temperature that goes up and down, otherwise in every recording."""
    middle, period, phase = rng.uniform(-4.0, 4.0), rng.uniform(6.0, 20.0, 2), rng.uniform(0, 2 * np.pi, 2)
    return lambda t: middle + np.sum(4.0 * np.sin(2 * np.pi * np.multiply.outer(t, 1 / period) + phase), axis=-1)


def _with_temperature(kind: str, rng: np.random.Generator, warmth: Warmth, duration: float) -> dict[str, Channel]:
    """A sensor of its own clock, ten times a second, where the kind says so."""
    if TEMPERATURE not in kind:
        return {}
    time = np.arange(0.03, duration, 0.1)
    return {"extra.temperature": Channel(time, 295.0 + warmth(time) + 0.02 * rng.standard_normal(len(time)), "K")}


def _pendulum(kind: str, rng: np.random.Generator) -> World:
    length, mass = rng.uniform(0.3, 0.5), rng.uniform(0.06, 0.15)
    weight = mass * G * length  # N m
    moves = [_motion(rng, length) for _ in range(4)]
    starts = [(rng.uniform(0.25, 0.5) * rng.choice([-1.0, 1.0]), 0.0) for _ in range(4)]
    force, rail = _hidden(kind, rng, length, weight)
    names = ("a.csv", "b.csv", "c.csv", "d.csv")
    runs = [
        _swing(rng, kind, name, length, mass, move, start, force, rail)
        for name, move, start in zip(names, moves, starts, strict=True)
    ]
    return World(kind, "pendulum", (runs[0], runs[1]), runs[2], runs[3], {"swing_angle": ANGLE_NOISE}, length, mass)


def _hidden(kind: str, rng: np.random.Generator, length: float, weight: float) -> tuple[Force, np.ndarray]:
    """The torque of a law, and the (3,) polynomial, from the square on, of the rail's height over the position."""
    rail = np.zeros(3)
    damping = rng.uniform(0.001, 0.003) * weight if kind not in CLEAN else 0.0
    place, w = rng.uniform(-0.08, 0.08), np.sqrt(G / length)
    size = rng.uniform(0.7, 1.4)
    sharp = rng.uniform(0.03, 0.06)
    edge = rng.uniform(0.05, 0.2) * rng.choice([-1.0, 1.0])
    side = np.sign(edge)

    def sign(rate: float) -> float:
        return float(np.tanh(rate / SMOOTH))

    def magnet(at: Moment) -> float:
        away, below = at.x - length * np.sin(at.phi) - place, sharp
        pull = 0.15 * size * weight / length * below**5 / (away**2 + below**2) ** 2.5  # a dipole over a moment
        # Force towards the magnet below the lowest point; along the swing (-cos, sin).
        return length * pull * (away / below * np.cos(at.phi) - np.sin(at.phi))

    def stop(at: Moment) -> float:
        depth = max(0.0, side * (at.phi - edge))
        return -side * (0.8 * size * weight * depth * (1.0 + 0.3 * max(0.0, side * at.rate) / w))

    def rub(at: Moment) -> float:
        return -0.01 * size * weight * sign(at.rate) if side * (at.phi - edge) > 0 else 0.0

    def cubic(at: Moment) -> float:
        return -0.012 * size * weight * (at.rate / (0.3 * w)) ** 3

    def flexure(at: Moment) -> float:
        return -0.05 * size * weight * (at.phi + 4.0 * at.phi**3)

    def seal(at: Moment) -> float:
        return -0.015 * size * weight * sign(at.rate) * (0.1 + np.exp(-abs(at.rate) / (0.1 * w)))

    def thinning(at: Moment) -> float:
        return -0.008 * size * weight * at.rate / w * np.exp(-at.warm / (250.0 * sharp))

    if kind == "rail":
        rail = np.array([rng.uniform(0.6, 1.4) * rng.choice([-1.0, 1.0]), rng.uniform(-1.0, 1.0), 0.0])
    laws: Mapping[str, Force] = {
        "magnet": magnet, "stop": stop, "one-sided rub": rub, "cubic drag": cubic, "flexure": flexure,
        "sticky seal": seal, "friction by temperature": thinning,
    }  # fmt: skip
    law = laws.get(kind)

    def torque(at: Moment) -> float:
        return (0.0 if law is None else law(at)) - damping * at.rate / w

    return torque, rail


def _motion(rng: np.random.Generator, length: float) -> Callable[[float], tuple[float, float, float]]:
    """Position, velocity and acceleration of the gripper: a multisine that swings the load."""
    w = np.sqrt(G / length) * rng.uniform(0.15, 0.8, 3)
    size = rng.uniform(0.03, 0.08, 3) * np.array([1.0, 0.8, 0.5])
    phase = rng.uniform(0, 2 * np.pi, 3)

    def motion(t: float) -> tuple[float, float, float]:
        s, c = np.sin(w * t + phase), np.cos(w * t + phase)
        return float(size @ (s - np.sin(phase))), float((size * w) @ c), float(-(size * w**2) @ s)

    return motion


def _swing(
    rng: np.random.Generator,
    kind: str,
    name: str,
    length: float,
    mass: float,
    move: Callable[[float], tuple[float, float, float]],
    start: tuple[float, float],
    force: Force,
    rail: np.ndarray,
) -> Run:
    """m l (l phi'' - x'' cos + (g + z'') sin) = torque, with the rail's height z(x) = c2 x^2 + c3 x^3."""

    warmth = _wandering(np.random.default_rng(zlib.crc32(f"{kind} {name} {length}".encode())))

    def rate_of(t: float, y: np.ndarray) -> list[float]:
        x, v, a = move(t)
        lift = (2 * rail[0] + 6 * rail[1] * x) * v**2 + (2 * rail[0] * x + 3 * rail[1] * x**2) * a
        turning = (a * np.cos(y[0]) - (G + lift) * np.sin(y[0])) / length
        return [y[1], turning + force(Moment(y[0], y[1], x, float(warmth(np.array(t))))) / (mass * length**2)]

    time = np.arange(0.0, 12.0, 1.0 / RATE)
    found = solve_ivp(rate_of, (0.0, time[-1]), start, t_eval=time, rtol=1e-7, atol=1e-9, max_step=0.02, method="LSODA")
    x = np.array([move(t)[0] for t in time])
    angle = found.y[0] + ANGLE_NOISE * rng.standard_normal(len(time))
    channels = {"gripper_x": Channel(time, x, "m"), "swing_angle": Channel(time, angle, "rad")}
    channels |= _with_temperature(kind, rng, warmth, 12.0)
    return Run(name, channels, {}, {"swing_angle": ANGLE_NOISE})


URDF = """<robot name="two">
<link name="base"/>
<link name="upper"><inertial><origin xyz="0.2 0 0"/><mass value="2"/><inertia ixx="0.001" iyy="0.03" izz="0.03"
ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="lower"><inertial><origin xyz="0.15 0 0"/><mass value="1.2"/><inertia ixx="0.001" iyy="0.012" izz="0.012"
ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 -1 0"/>
<limit effort="60" velocity="6" lower="-3.1" upper="3.1"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0.4 0 0"/>
<axis xyz="0 -1 0"/><limit effort="30" velocity="6" lower="-3.1" upper="3.1"/></joint>
</robot>
"""
"""Two links in a vertical plane, q = 0 straight out along x, positive upwards."""


def _arm(kind: str, rng: np.random.Generator) -> World:
    law = _hidden_torque(kind, rng)
    viscous, dry = rng.uniform(0.1, 0.4, 2), rng.uniform(0.1, 0.4, 2)
    if kind in CLEAN:
        viscous, dry = np.zeros(2), np.zeros(2)
    runs = [_moved(rng, kind, name, law, viscous, dry) for name in ("a.csv", "b.csv", "c.csv", "d.csv")]
    noise = {f"tau.{joint}": TORQUE_NOISE for joint in ("shoulder", "elbow")}
    return World(kind, "arm", (runs[0], runs[1]), runs[2], runs[3], noise)


class Track(NamedTuple):
    """(n,) time, position, velocity and load of the elbow, and how warm it is, K above the usual."""

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    load: np.ndarray
    warm: np.ndarray


JointLaw = Callable[[Track], np.ndarray]  # what the elbow's drive gives besides, N m


def _hidden_torque(kind: str, rng: np.random.Generator) -> JointLaw:
    size, phase = rng.uniform(0.25, 0.6), rng.uniform(0, 2 * np.pi)
    period, play, edge = rng.uniform(0.1, 0.5), rng.uniform(0.02, 0.08), rng.uniform(0.2, 0.6)
    fade, strength, width = rng.uniform(4.0, 12.0), rng.uniform(1.8, 3.0), rng.uniform(0.3, 0.6)

    def backlash(at: Track) -> np.ndarray:
        turned, last, found = 0.0, at.q[0], []
        for now in at.q:  # a spring that slips at its limit
            turned, last = float(np.clip(turned + (now - last) / (play / 2), -1.0, 1.0)), now
            found.append(turned)
        return size * np.array(found)

    laws: Mapping[str, JointLaw] = {
        "backlash": backlash,
        "cogging": lambda at: size * np.sin(2 * np.pi * at.q / period + phase),
        "tightening cable": lambda at: size * np.expm1(np.clip(at.q - edge, 0.0, 0.6) / width),
        "warming friction": lambda at: 2.0 * size * at.v * np.exp(-at.t / fade),
        "joint friction by temperature": lambda at: 1.5 * size * at.v * np.exp(-at.warm / (2.0 * fade)),
        "saturating motor": lambda at: strength * np.tanh(at.load / strength) - at.load,
    }
    return laws.get(kind, lambda at: np.zeros(len(at.t)))


def _moved(rng: np.random.Generator, kind: str, name: str, law: JointLaw, viscous: np.ndarray, dry: np.ndarray) -> Run:
    """Torques of two links along a multisine, friction and the law on the elbow."""
    t = np.arange(0.0, 15.0, 1.0 / RATE)
    w = 2 * np.pi * rng.uniform(0.08, 0.6, (2, 3))
    size, phase = rng.uniform(0.2, 0.5, (2, 3)) / (1.0 + w / 3.0), rng.uniform(0, 2 * np.pi, (2, 3))
    middle = rng.uniform(-0.4, 0.4, 2)
    angle = np.multiply.outer(t, w) + phase
    q = middle + np.sum(size * np.sin(angle), axis=2)
    v, a = np.sum(size * w * np.cos(angle), axis=2), np.sum(-size * w**2 * np.sin(angle), axis=2)
    m1, m2, l1, c1, c2, i1, i2 = 2.0, 1.2, 0.4, 0.2, 0.15, 0.03, 0.012
    couple, both = m2 * l1 * c2, q[:, 0] + q[:, 1]
    d11 = m1 * c1**2 + m2 * (l1**2 + c2**2) + 2 * couple * np.cos(q[:, 1]) + i1 + i2
    d12, d22 = m2 * c2**2 + couple * np.cos(q[:, 1]) + i2, m2 * c2**2 + i2
    h = -couple * np.sin(q[:, 1])
    g1 = (m1 * c1 + m2 * l1) * G * np.cos(q[:, 0]) + m2 * c2 * G * np.cos(both)
    g2 = m2 * c2 * G * np.cos(both)
    tau = np.column_stack([
        d11 * a[:, 0] + d12 * a[:, 1] + h * (2 * v[:, 0] * v[:, 1] + v[:, 1] ** 2) + g1,
        d12 * a[:, 0] + d22 * a[:, 1] - h * v[:, 0] ** 2 + g2,
    ])  # fmt: skip
    load = tau[:, 1].copy()
    tau += viscous * v + dry * np.tanh(v / SMOOTH)
    warmth = _wandering(np.random.default_rng(zlib.crc32(f"{kind} {name} {viscous}".encode())))
    tau[:, 1] += law(Track(t, q[:, 1], v[:, 1], load, warmth(t)))
    tau += TORQUE_NOISE * rng.standard_normal(tau.shape)
    q = q + POSITION_NOISE * rng.standard_normal(q.shape)
    channels = _with_temperature(kind, rng, warmth, 15.0)
    for i, joint in enumerate(("shoulder", "elbow")):
        channels[f"q.{joint}"] = Channel(t, q[:, i], "rad")
        channels[f"tau.{joint}"] = Channel(t, tau[:, i], "N m")
    return Run(name, channels, {}, {f"tau.{j}": TORQUE_NOISE for j in ("shoulder", "elbow")})
