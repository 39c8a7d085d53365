"""Effects with a place, as a user declares them, hidden in recordings of pendulums and arms.

A place is where something begins: a stop, an edge that rubs, the end of some play, the load from which on a cell reads
too little. `PENDULUM` and `ARM` are files of effects as the documentation asks for them, whose nulls and typical sizes
know nothing of the truth; what really happens is written a second time, in numbers.
"""

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import numpy as np

from armdyn.effects.effect import Effect
from armdyn.effects.user import load_effects
from armdyn.recording.units import KnownQuantity
from armdyn.run import Run
from worlds import baxter as arm
from worlds import pendulum

SHOWN = 1.0
"""Root mean square change of a pendulum's first recording by its hidden effect, over the noise, below which a case is
drawn anew: a stop that no swing reaches shows nothing."""
EDGE = 0.01  # width over which a rub sets in, rad: the files say so as well
HEAD = "import casadi as ca\nfrom armdyn import effect, quantity\n"
PENDULUM = (
    HEAD
    + """
@effect(summary="a soft stop at an angle", source="of its own")
def pad(string, stiffness=quantity("N m/rad", typical=0.1, lower=0.0),
        place=quantity("rad", typical=0.1, null=0.0, lower=-1.0, upper=1.0)):
    return string.with_torque(-stiffness * ca.fmax(0, string.angle - place))

@effect(summary="the string rubs on an edge beyond an angle", source="of its own")
def edge_rub(string, friction=quantity("N m", typical=1e-3, lower=0.0),
             place=quantity("rad", typical=0.1, null=0.0, lower=-1.0, upper=1.0)):
    return string.with_dry_torque(friction * (1 + ca.tanh((string.angle - place) / 0.01)) / 2)

@effect(summary="a spring with play", source="of its own")
def loose_spring(string, stiffness=quantity("N m/rad", typical=0.1, lower=0.0),
                 gap=quantity("rad", typical=0.1, null=0.0, lower=0.0, upper=1.0)):
    return string.with_torque(-stiffness * (string.angle - ca.fmax(-gap, ca.fmin(gap, string.angle))))

@effect(summary="the load cell gives in beyond a force", source="of its own")
def tired_cell(sensor, lost=quantity("1", typical=0.1, lower=0.0, upper=1.0),
               knee=quantity("N", typical=0.2, null=2.0, lower=0.0)):
    return sensor.with_force(sensor.force - lost * ca.fmax(0, sensor.force - knee))
"""
)
ARM = (
    HEAD
    + """
@effect(summary="a soft stop at a position", source="of its own")
def stop(joint, stiffness=quantity("N m/rad", typical=10.0, lower=0.0), place=quantity("rad", typical=0.3)):
    return joint.with_torque(stiffness * ca.fmax(0, joint.position - place))

@effect(summary="a cover rubs beyond a position", source="of its own")
def cover_rub(joint, friction=quantity("N m", typical=1.0, lower=0.0), place=quantity("rad", typical=0.3)):
    return joint.with_torque(friction * joint.direction * (1 + ca.tanh((joint.position - place) / 0.01)) / 2)

@effect(summary="a spring with play", source="of its own")
def loose_spring(joint, stiffness=quantity("N m/rad", typical=10.0, lower=0.0),
                 gap=quantity("rad", typical=0.3, lower=0.0)):
    return joint.with_torque(stiffness * (joint.position - ca.fmax(-gap, ca.fmin(gap, joint.position))))

@effect(summary="beyond a load the torque reads too little", source="of its own")
def tired_gauge(joint, lost=quantity("1", typical=0.1, lower=0.0, upper=1.0),
                knee=quantity("N m", typical=10.0, null=100.0, lower=0.0)):
    return joint.with_offset(-lost * (joint.load - ca.fmax(-knee, ca.fmin(knee, joint.load))))
"""
)
OF_PENDULUM: Mapping[str, Mapping[str, float]] = {
    "pad": {"stiffness": 0.05, "place": 0.15},
    "edge_rub": {"friction": 3e-3, "place": 0.06},
    "loose_spring": {"stiffness": 0.05, "gap": 0.12},
    "tired_cell": {"lost": 0.25, "knee": 0.8},
}
OF_ARM: Mapping[str, tuple[str, Mapping[str, float]]] = {
    "stop": ("right_e1", {"stiffness": 8.0, "place": 1.45}),
    "cover_rub": ("right_s0", {"friction": 1.5, "place": 0.2}),
    "loose_spring": ("right_w0", {"stiffness": 3.0, "gap": 0.3}),
    "tired_gauge": ("right_s1", {"lost": 0.15, "knee": 44.0}),
}
"""True sizes about which a case draws its own, and the joint of an arm."""


@dataclass(frozen=True)
class Case:
    """A pendulum or an arm with a hidden threshold; ``""`` hides none."""

    robot: str  # ``"pendulum"`` or ``"arm"``
    hidden: str  # name of the effect
    seed: int  # of everything that is drawn
    true: Mapping[str, float]  # the effect's values by parameter
    runs: tuple[Run, ...]  # two recordings to fit, and one that takes part in choosing

    @property
    def labels(self) -> list[str]:
        """What is to be named."""
        joint = f":{OF_ARM[self.hidden][0]}" if self.robot == "arm" and self.hidden else ""
        return [self.hidden + joint] if self.hidden else []


def effects(robot: str) -> tuple[Effect, ...]:
    """The user's effects of a robot."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "effects.py"
        path.write_text(PENDULUM if robot == "pendulum" else ARM, encoding="utf-8")
        return load_effects(path)


def _beyond(position: np.ndarray | float, place: float) -> np.ndarray:
    """Share of a rub, which sets in over some width of the edge."""
    return np.asarray(0.5 * (1.0 + np.tanh((position - place) / EDGE)))


def of_pendulum(hidden: str, seed: int, seconds: float = 15.0) -> Case:
    """A load on a string, whose mass and length were measured by hand; see `SHOWN`."""
    for again in count():
        found, without = (_of_pendulum(hidden, seed, again, seconds, acts=acts) for acts in (True, False))
        one, other = (case.runs[0] for case in (found, without))
        change = one.channels["load_force"].value - other.channels["load_force"].value
        if not hidden or np.sqrt(np.mean(change**2)) >= SHOWN * one.noise["load_force"]:
            break
    return found


def _of_pendulum(hidden: str, seed: int, again: int, seconds: float, *, acts: bool) -> Case:
    rng = np.random.default_rng([seed, 7, again])
    size = {name: value * rng.uniform(0.8, 1.3) for name, value in OF_PENDULUM.get(hidden, {}).items()}
    mass, length = rng.uniform(0.06, 0.12), rng.uniform(0.30, 0.45)
    if hidden == "tired_cell":
        size["knee"] *= mass * pendulum.G

    def torque(angle: float, rate: float) -> float:
        if hidden == "pad":
            return -size["stiffness"] * max(angle - size["place"], 0.0)
        if hidden == "loose_spring":
            return -size["stiffness"] * (angle - float(np.clip(angle, -size["gap"], size["gap"])))
        return -size["friction"] * float(np.tanh(rate / 0.01) * _beyond(angle, size["place"]))

    def reading(force: np.ndarray) -> np.ndarray:
        return np.asarray(force - size["lost"] * np.maximum(force - size["knee"], 0.0))

    weighed = KnownQuantity(mass * (1 + 0.005 * rng.normal()), 0.005 * mass, "kg")
    measured = KnownQuantity(length + 1e-3 * rng.normal(), 1e-3, "m")
    runs = []
    for k in range(3):
        setup = pendulum.Setup(
            length=length, mass=mass, duration=seconds, start=(0.02 * rng.normal(), 0.04 * rng.normal()),
            torque=torque if acts and hidden not in ("", "tired_cell") else None,
            reading=reading if acts and hidden == "tired_cell" else None,
        )  # fmt: skip
        runs.append(pendulum.weighed(pendulum.record(f"r{k}.csv", setup, rng), weighed, measured))
    return Case("pendulum", hidden, seed, {f"{hidden}.{name}": value for name, value in size.items()}, tuple(runs))


def of_arm(hidden: str, seed: int, seconds: float = 15.0) -> Case:
    """Baxter's right arm."""
    rng = np.random.default_rng([seed, 7])
    joint, usual = OF_ARM.get(hidden, (arm.JOINTS[0], {}))
    size = {name: value * rng.uniform(0.85, 1.15) for name, value in usual.items()}
    i = arm.JOINTS.index(joint)

    def beyond(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        found, x = np.zeros(q.shape), q[:, i]
        if hidden == "stop":
            found[:, i] = size["stiffness"] * np.maximum(x - size["place"], 0.0)
        elif hidden == "cover_rub":
            found[:, i] = size["friction"] * np.sign(v[:, i]) * _beyond(x, size["place"])
        elif hidden == "loose_spring":
            found[:, i] = size["stiffness"] * (x - np.clip(x, -size["gap"], size["gap"]))
        elif hidden == "tired_gauge":
            load = arm.rigid_torque(q, v, a)[:, i]
            found[:, i] = -size["lost"] * (load - np.clip(load, -size["knee"], size["knee"]))
        return found

    runs = [arm.generate(None, 1.0, seed, recording=k, duration=seconds, beyond=beyond) for k in range(3)]
    true = {f"{hidden}.{name}[{joint}]": value for name, value in size.items()}
    return Case("arm", hidden, seed, true, tuple(runs))
