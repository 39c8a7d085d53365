"""Recordings of Baxter's right arm with physics that the model does not know.

A `World` whose dry friction has a sharp sign where armdyn has a smooth one, with laws of its own. Nothing of armdyn is
used but the container of a recording.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from armdyn.run import Channel, Run

from . import coloured
from .drive import SMALL, Hidden, Imperfections, Lump
from .motions import Derivatives, Fourier, Motion, random_fourier
from .plant import Plant, World

JOINTS = ("right_s0", "right_s1", "right_e0", "right_e1", "right_w0", "right_w1", "right_w2")
POSITION_NOISE = 4e-4  # rad, of the encoders
EFFORT_NOISE = np.array([0.08, 0.08, 0.08, 0.08, 0.04, 0.04, 0.04])  # N m
SHARE = np.array([1.0, 1.0, 1.0, 1.0, 0.3, 0.3, 0.3])  # the wrist's drives are smaller
CENTRE = np.array([0.1, -0.5, 0.2, 1.3, 0.0, 0.5, 0.0])  # rad
SWING = np.array([0.7, 0.5, 0.9, 0.7, 1.0, 0.8, 1.2])  # rad, within the position limits
FASTEST = np.array([1.1, 1.0, 1.1, 1.1, 2.0, 2.0, 2.5])  # rad/s, within the velocity limits
Beyond = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""(n, 7) torques, N m, from (n, 7) positions, velocities and accelerations, rad and s."""
PERIOD, HARMONICS = 10.0, 5  # s
STRIBECK_SPEED = 0.1  # rad/s
PAYLOAD_PLACE = (0.02, -0.01, 0.15)  # m, in the frame of the last joint
SPRING = (8.2, 35.3)  # N m, sine and cosine, on right_s1
REST = 0.7  # rad, of the spring in right_e1


def _per_joint(name: str, sizes: Sequence[float]) -> dict[str, float]:
    return {f"{name}[{joint}]": float(size) for joint, size in zip(JOINTS, sizes, strict=True)}


_SIGNS = np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0])
REALISTIC: Mapping[str, Mapping[str, float]] = {
    "joint_viscous_friction": _per_joint("coefficient", 2.0 * SHARE),
    "joint_coulomb_friction": _per_joint("torque", 1.0 * SHARE),
    "joint_asymmetric_friction": _per_joint("positive", 1.5 * SHARE) | _per_joint("negative", 0.7 * SHARE),
    "joint_stribeck_friction": _per_joint("torque", 1.0 * SHARE),
    "joint_load_friction": _per_joint("coefficient", np.full(7, 0.08)),
    "rotor_inertia": _per_joint("inertia", np.array([0.3, 0.3, 0.2, 0.2, 0.05, 0.05, 0.05])),
    "torque_offset": _per_joint("torque", 0.5 * SHARE * _SIGNS),
    "torque_gain": _per_joint("error", 0.08 * _SIGNS),
    "torque_delay": _per_joint("time", np.full(7, 0.02)),
    "gravity_spring": {"sine[right_s1]": SPRING[0], "cosine[right_s1]": SPRING[1]},
    "joint_spring": {"stiffness[right_e1]": 12.0},
    "joint_coupling": {"viscous[right_w2]": 0.3, "inertia[right_w2]": 0.05},
    "payload": {"mass[right_w2]": 0.8},
    "link_inertia": _per_joint("mass", np.array([0.1, 0.3, -0.2, 0.25, -0.2, 0.3, 0.2])),
    "base_tilt": {"roll": 0.05, "pitch": -0.08},
}
"""Parameters by effect at a realistic size, by ``"<quantity>[<joint>]"``, those of the base by ``"<quantity>"``; places
and speeds are the constants above."""
OUTSIDE = ("cogging", "backlash_spring", "warming_up")  # physics that armdyn's catalogue lacks


def motion(seed: int, recording: int = 0) -> Fourier:
    """The motion of a recording: random, as large as positions and velocities allow."""
    rng = np.random.default_rng([seed, recording, 1])
    return random_fourier(rng, CENTRE, SWING, FASTEST, PERIOD, HARMONICS)


def generate(
    effect: str | Sequence[str] | None,
    size: float,
    seed: int,
    *,
    recording: int = 0,
    duration: float = 15.0,
    rate: float = 100.0,
    colour: float = 0.0,
    noise: float = 1.0,
    jitter: float = 0.0,
    rates: bool = False,
    stated: bool = True,
    path: Motion | None = None,
    beyond: Beyond | None = None,
) -> Run:
    """One recording of the right arm, of `duration` s with `rate` samples per second.

    The hidden `effect`, or several, is of the catalogue or of `OUTSIDE`, and realistic at `size` 1. Of one seed every
    `recording` has another motion and the same physics. The efforts' noise is `colour` correlated from one sample to
    the next, velocities have 0.015 rad/s of it; stamps have `jitter`, a share of the interval. Efforts hold what is
    `beyond` as well.
    """
    names = (effect,) if isinstance(effect, str) else tuple(effect or ())
    rng = np.random.default_rng([seed, recording])
    time = np.arange(round(duration * rate)) / rate
    time = time + jitter / rate * rng.uniform(-0.5, 0.5, len(time))
    path = motion(seed, recording) if path is None else path
    q, v, _ = path.at(time)
    effort = _torque(names, size, path, time)
    if beyond is not None:
        effort = effort + beyond(*path.at(time))
    effort = effort + noise * EFFORT_NOISE * coloured(rng.standard_normal(effort.shape), colour)
    q = q + noise * POSITION_NOISE * rng.standard_normal(q.shape)
    channels = {f"q.{joint}": Channel(time, q[:, i], "rad") for i, joint in enumerate(JOINTS)}
    if rates:
        v = v + noise * 0.015 * rng.standard_normal(v.shape)
        channels |= {f"v.{joint}": Channel(time, v[:, i], "rad/s") for i, joint in enumerate(JOINTS)}
    channels |= {f"tau.{joint}": Channel(time, effort[:, i], "N m") for i, joint in enumerate(JOINTS)}
    known = {f"tau.{joint}": float(s) for joint, s in zip(JOINTS, noise * EFFORT_NOISE, strict=True)} if stated else {}
    return Run(f"seed {seed}, recording {recording}", channels, noise=known)


def true_parameters(effect: str, size: float) -> dict[str, float]:
    """The hidden effect's parameters under the names of armdyn's models."""
    exact = {f"{effect}.{name}": size * value for name, value in REALISTIC[effect].items()}
    if effect == "joint_stribeck_friction":
        exact |= {f"{effect}.speed[{joint}]": STRIBECK_SPEED for joint in JOINTS}
    if effect == "joint_spring":
        exact |= {f"{effect}.rest[right_e1]": REST}
    if effect == "payload":
        exact |= {f"{effect}.{axis}[right_w2]": p for axis, p in zip("xyz", PAYLOAD_PLACE, strict=True)}
    return exact


def _torque(names: Sequence[str], size: float, path: Motion, time: np.ndarray) -> np.ndarray:
    """(n, 7) what the efforts read without noise."""
    known = (true_parameters(name, size) for name in names if name in REALISTIC)
    truth, values = [], {key: value for parameters in known for key, value in parameters.items()}
    for name in [n for n in names if n in SMALL or n == "payload"]:
        for joint in JOINTS:
            mine = {key: value for key, value in values.items() if key.startswith(f"{name}.") and joint in key}
            own = {key[len(name) + 1 : key.index("[")]: value for key, value in mine.items()}
            truth += [Hidden(name, joint, own)] if own else []
    cogging = size * 0.8 * SHARE * ("cogging" in names)
    drive = replace(Imperfections.none(7), presliding=0.0, cogging=cogging, cogs=np.full(7, 14.0), phase=np.arange(7.0))
    coupling = [values.get(f"joint_coupling.{short}[right_w2]", 0.0) for short in ("viscous", "inertia")]

    def further(motion: Derivatives) -> np.ndarray:
        q, v, a = motion
        found = np.zeros_like(q)
        found[:, [5, 6]] = coupling[0] * v[:, [6, 5]] + coupling[1] * a[:, [6, 5]]
        if "backlash_spring" in names:
            found += size * 3.0 * SHARE * np.maximum(q - CENTRE - 0.2, 0.0) ** 2
        return found

    plant = Plant("baxter")
    ratios = [values.get(f"link_inertia.mass[{joint}]", 0.0) for joint in JOINTS]
    world = World(plant, plant.heavier(np.exp(ratios)), drive, path, time, further)
    with plant.in_gravity(_gravity([values.get(f"base_tilt.{angle}", 0.0) for angle in ("roll", "pitch")])):
        reading = world.measured(truth)[1]
    if "warming_up" in names:
        reading = reading + size * 0.8 * SHARE * np.exp(-time / 5.0)[:, None]
    return reading


def _gravity(tilt: Sequence[float]) -> np.ndarray:
    """(3,) m/s^2 in the frame of a base that is turned about its x axis and then about the level y axis, rad."""
    return -9.81 * Rotation.from_euler("xy", tilt).inv().apply([0.0, 0.0, 1.0])


def rigid_torque(
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    payload: float = 0.0,
    heavier: Sequence[float] | None = None,
    tilt: Sequence[float] = (0.0, 0.0),
) -> np.ndarray:
    """(n, 7) torques of rigid bodies by MuJoCo's inverse dynamics, with kg at `PAYLOAD_PLACE`.

    `heavier` are (7,) logarithms of the links' mass ratios; `tilt` turns the base about x, then about the level y, rad.
    """
    plant = Plant("baxter")
    with plant.in_gravity(_gravity(tilt)):
        return plant.torques((q, v, a), plant.heavier(np.exp(np.zeros(7) if heavier is None else heavier)),
                             {6: Lump(payload, PAYLOAD_PLACE)})  # fmt: skip
