"""How wrong may the start values of a user's base be?

    python benchmarks/own_bases.py [--starts N]

Recordings come from scipy's integrator, with a friction or leak hidden in each. Every value begins at random between
half and one and a half times the truth, and `repair` is asked. Right: the hidden effect is named and every value within
four standard deviations or 2 % of the truth. Lost: the verdict says so. All else is wrong.
"""

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import _timing as bench
import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

from armdyn.effects.effect import Effect, effect
from armdyn.identify.repair import repair
from armdyn.identify.sentence import Verdict
from armdyn.identify.studies import make_study
from armdyn.parameter import quantity
from armdyn.physics import Equations, Expression, Moment, Stage, constant, physics, state
from armdyn.physics.definition import Physics
from armdyn.physics.model import physics_model
from armdyn.run import Channel, Run

SECONDS, RATE = 12.0, 100.0
SURELY, CLOSE = 4.0, 0.02
Motion = Callable[[np.ndarray, float], Sequence[float]]


@dataclass(frozen=True)
class Place(Stage):
    """Place of a loss: a speed or a level, and the other forces or flows there."""

    level: Expression
    force: Expression = 0


@effect("in_proportion", acts_on="place", summary="A loss in proportion.", source="of its own")
def in_proportion(place: Place, size: Expression = quantity("1", typical=0.1, lower=0.0)) -> Place:
    """Loss in proportion to the speed or level: viscous friction, seepage."""
    return replace(place, force=place.force - size * place.level)


@effect("with_the_square", acts_on="place", summary="A loss with the square.", source="of its own")
def with_the_square(place: Place, size: Expression = quantity("1", typical=0.1, lower=0.0)) -> Place:
    """Loss with the square of the speed or level: drag, radiation."""
    return replace(place, force=place.force - size * place.level * ca.fabs(place.level))


EFFECTS: list[Effect] = [in_proportion, with_the_square]


@dataclass(frozen=True)
class World:
    """A base, its true values, the simulated system, the measured channels with their noise, and the hidden effect."""

    base: Physics
    truth: dict[str, float]
    motion: Motion
    start: tuple[float, ...]
    measured: dict[str, tuple[int, float]]
    push: float
    pace: float
    hidden: str

    def record(self, seed: int) -> Run:
        """Simulated run, with an input that depends on the seed."""
        rng = np.random.default_rng(seed)
        sizes, paces, phases = rng.uniform(0.4, 1.0, 3), self.pace * rng.uniform(0.5, 2.0, 3), rng.uniform(0.0, 6.0, 3)

        def given(t: np.ndarray | float) -> np.ndarray:
            return self.push * (1.0 + np.sin(np.multiply.outer(t, paces) + phases) @ sizes / 3.0)

        time = np.arange(0.0, SECONDS, 1.0 / RATE)
        ends = 0.0, SECONDS
        found = solve_ivp(
            lambda t, s: self.motion(s, float(given(t))), ends, self.start, t_eval=time, rtol=1e-9, max_step=0.01
        ).y
        (driven, unit), *_ = self.base.inputs.items()
        channels = {driven: Channel(time, given(time), unit)}
        for name, (k, noise) in self.measured.items():
            value = found[k] + noise * rng.normal(size=len(time))
            channels[name] = Channel(time, value, self.base.outputs[name])
        return Run(f"{self.base.name}_{seed}.csv", channels)


@physics(
    "circuit", summary="A capacitor behind a resistor.", source="Kirchhoff 1845",
    parameters=(constant("lag", "s", 0.8, lower=0.01, upper=100.0), constant("gain", "1", 1.2, lower=0.01)),
    states=(state("charge", "m", typical=1.0),), inputs={"gripper_x": "m"}, outputs={"q.charge": "m"}, period=2.0,
)  # fmt: skip
def circuit(at: Moment) -> Equations:
    """Electric circuit with one state of first order."""
    leak = at.stage("place", Place(at["charge"]))
    rate = (at["gain"] * at.input("gripper_x").value - at["charge"]) / at["lag"] + leak.force
    return Equations({"charge": rate}, {"q.charge": at["charge"]})


@physics(
    "shaft", summary="A motor that turns a load through a shaft.", source="Spong, ASME J. Dyn. Syst. 109, 1987",
    parameters=(
        constant("motor", "kg m^2", 0.02, lower=1e-4, upper=1.0),
        constant("load", "kg m^2", 0.05, lower=1e-4, upper=1.0),
        constant("stiffness", "N m/rad", 5.0, lower=0.01, upper=1e3),
    ),
    states=(
        state("motor_angle", "rad", typical=1.0), state("motor_rate", "rad/s", typical=3.0),
        state("load_angle", "rad", typical=1.0), state("load_rate", "rad/s", typical=3.0),
    ),
    inputs={"tau.motor": "N m"}, outputs={"q.motor": "rad"}, period=1.0, step=0.005,
)  # fmt: skip
def shaft(at: Moment) -> Equations:
    """Shaft between a motor and a load that is not measured."""
    v, w = at["motor_rate"], at["load_rate"]
    twist, bearing = at["stiffness"] * (at["motor_angle"] - at["load_angle"]), at.stage("place", Place(v))
    motor = (at.input("tau.motor").value - twist + bearing.force) / at["motor"]
    rates = {"motor_angle": v, "motor_rate": motor, "load_angle": w, "load_rate": twist / at["load"]}
    return Equations(rates, {"q.motor": at["motor_angle"]})


@physics(
    "cart_and_pole", summary="A pole swings on a cart that is pushed.", source="Cannon, Dynamics of Physical Systems",
    parameters=(
        constant("cart", "kg", 1.0, lower=0.01, upper=100.0), constant("pole", "kg", 0.3, lower=0.01, upper=100.0),
        constant("length", "m", 0.5, lower=0.01, upper=10.0),
    ),
    states=(
        state("place", "m", typical=0.3), state("speed", "m/s", typical=1.0),
        state("angle", "rad", typical=0.5), state("rate", "rad/s", typical=2.0),
    ),
    inputs={"tau.push": "N"}, outputs={"q.cart": "m", "q.pole": "rad"}, period=1.5,
)  # fmt: skip
def cart_and_pole(at: Moment) -> Equations:
    """Cart with a pole, two bodies."""
    v, a, w, length, pole = at["speed"], at["angle"], at["rate"], at["length"], at["pole"]
    force = at.input("tau.push").value + at.stage("place", Place(v)).force
    pushed = force + pole * ca.sin(a) * (length * w**2 + 9.81 * ca.cos(a))
    faster = pushed / (at["cart"] + pole * ca.sin(a) ** 2)
    turning = -(faster * ca.cos(a) + 9.81 * ca.sin(a)) / length
    return Equations(
        {"place": v, "speed": faster, "angle": w, "rate": turning}, {"q.cart": at["place"], "q.pole": a}
    )  # fmt: skip


def _cart_moves(s: np.ndarray, force: float) -> Sequence[float]:
    pushed = force - 0.4 * s[1] + 0.3 * np.sin(s[2]) * (0.5 * s[3] ** 2 + 9.81 * np.cos(s[2]))
    faster = pushed / (1.0 + 0.3 * np.sin(s[2]) ** 2)
    return [s[1], faster, s[3], -(faster * np.cos(s[2]) + 9.81 * np.sin(s[2])) / 0.5]


def _shaft_moves(s: np.ndarray, torque: float) -> Sequence[float]:
    twist = 5.0 * (s[0] - s[2])
    return [s[1], (torque - twist - 0.03 * s[1]) / 0.02, s[3], twist / 0.05]


WORLDS = (
    World(
        circuit, {"lag": 0.8, "gain": 1.2}, lambda s, u: [(1.2 * u - s[0]) / 0.8 - 0.15 * s[0] * abs(s[0])], (0.5,),
        {"q.charge": (0, 2e-3)}, 1.5, 2.0, "with_the_square",
    ),
    World(
        shaft, {"motor": 0.02, "load": 0.05, "stiffness": 5.0}, _shaft_moves, (0.0, 0.0, 0.0, 0.0),
        {"q.motor": (0, 1e-3)}, 0.2, 6.0, "in_proportion",
    ),
    World(
        cart_and_pole, {"cart": 1.0, "pole": 0.3, "length": 0.5}, _cart_moves, (0.0, 0.0, 0.8, 0.0),
        {"q.cart": (0, 5e-4), "q.pole": (2, 1e-3)}, 0.5, 4.0, "in_proportion",
    ),
)  # fmt: skip


def outcome(world: World, seed: int, runs: Sequence[Run]) -> str:
    """Result of a repair from one start: right, lost or wrong."""
    factors = np.random.default_rng(seed).uniform(0.5, 1.5, len(world.truth))
    values = {name: f * value for f, (name, value) in zip(factors, world.truth.items(), strict=True)}
    model = physics_model(world.base, own_effects=EFFECTS).with_values(values)
    found = repair(make_study(model, runs[:2], runs[2:], EFFECTS))
    if found.verdict is Verdict.LOST:
        return "lost"
    told = ((found.model.parameters[name], value) for name, value in world.truth.items())
    near = all(abs(p.value - value) <= max(SURELY * (p.std or 0.0), CLOSE * value) for p, value in told)
    return "right" if near and [e.name for e in found.model.effects] == [world.hidden] else "wrong"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, default=20, help="of every base")
    starts, rows = parser.parse_args().starts, []
    for world in WORLDS:
        runs, begun = [world.record(seed) for seed in range(3)], time.process_time()
        ends = [outcome(world, seed, runs) for seed in range(starts)]
        counts = [str(ends.count(end)) for end in ("right", "lost", "wrong")]
        rows.append([world.base.name, world.hidden, *counts, f"{(time.process_time() - begun) / starts:.1f}"])
    headings = ["base", "hidden", "right", "lost", "wrong", "processor s"]
    bench.print_table("start values up to half off", headings, rows, texts=2)
    if any(row[4] != "0" for row in rows):
        raise SystemExit("a start ended wrong")


if __name__ == "__main__":
    main()
