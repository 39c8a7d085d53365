"""Laws that are in no list of shapes, hidden in five small bases of one's own, and the same bases without one.

A base is the text of a user's file; what really happens is written a second time, for scipy's integrator, which shares
nothing with it. A law is an addition to the rate of one state, drawn so large that it is a visible share of that rate.
"""

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from armdyn.physics.model import PhysicsModel
from armdyn.physics.user import load_base
from armdyn.run import Channel, Run

HEAD = "import casadi as ca\nfrom armdyn.physics import Equations, Moment, constant, physics, state\n"
LEAST_SHOWN = 4.0
"""Root mean square, in standard deviations of the noise, by which a law changes a recording at least."""
SHARE = 0.15, 0.4  # of a state's rate that a law is
OFF = 0.2  # by which the values of the base are off at most
Rates = Callable[[Mapping[str, float], np.ndarray, float], list[float]]
Addition = Callable[[np.ndarray, float], float]


@dataclass(frozen=True)
class Base:
    """A base with its true values, its rates, and how it is driven and measured."""

    name: str
    text: str
    values: Mapping[str, float]
    rates: Rates
    outputs: Mapping[str, tuple[int, float, str]]  # by channel: state, noise, unit
    driven: tuple[str, str]  # channel of the input, unit
    push: tuple[float, float]  # mean and size of the input
    pace: float  # rad/s
    start: tuple[float, ...]
    seconds: float
    rate: float


def _oven(p: Mapping[str, float], s: np.ndarray, u: float) -> list[float]:
    return [(u - (s[0] - 293.0) / p["resistance"]) / p["capacity"]]


def _tank(p: Mapping[str, float], s: np.ndarray, u: float) -> list[float]:
    return [(p["pump"] * u - p["seepage"] * s[0]) / p["area"]]


def _cart(p: Mapping[str, float], s: np.ndarray, u: float) -> list[float]:
    return [s[1], (u - p["viscous"] * s[1]) / p["mass"]]


def _bouncer(p: Mapping[str, float], s: np.ndarray, u: float) -> list[float]:
    return [s[1], (u - p["spring"] * s[0] - p["viscous"] * s[1]) / p["mass"]]


def _tanks(p: Mapping[str, float], s: np.ndarray, u: float) -> list[float]:
    return [p["pump"] * u - p["pipe"] * (s[0] - s[1]), p["pipe"] * (s[0] - s[1]) - p["drain"] * s[1]]


OVEN = Base("oven", '''
@physics("oven", summary="An oven.", source="Newton 1701",
    parameters=(constant("capacity", "J/K", 400.0, lower=1.0), constant("resistance", "K/W", 0.6, lower=0.01)),
    states=(state("temperature", "K", typical=50.0, start=320.0),),
    inputs={"extra.power": "W"}, outputs={"extra.temperature": "K"}, period=400.0)
def oven(at: Moment) -> Equations:
    T = at["temperature"]
    rate = (at.input("extra.power").value - (T - 293.0) / at["resistance"]) / at["capacity"]
    return Equations({"temperature": rate}, {"extra.temperature": T})
''', {"capacity": 400.0, "resistance": 0.6}, _oven, {"extra.temperature": (0, 0.2, "K")}, ("extra.power", "W"),
    (260.0, 180.0), 0.012, (330.0,), 2000.0, 0.3)  # fmt: skip
TANK = Base("tank", '''
@physics("tank", summary="A tank.", source="Torricelli 1643",
    parameters=(constant("area", "m^2", 0.05, lower=1e-3), constant("pump", "m^3/(s V)", 5e-5, lower=1e-6),
                constant("seepage", "m^2/s", 2e-4, lower=0.0, typical=1e-4)),
    states=(state("level", "m", typical=0.3, start=0.4, lower=0.0),),
    inputs={"extra.pump": "V"}, outputs={"extra.level": "m"}, period=200.0)
def tank(at: Moment) -> Equations:
    rate = (at["pump"] * at.input("extra.pump").value - at["seepage"] * at["level"]) / at["area"]
    return Equations({"level": rate}, {"extra.level": at["level"]})
''', {"area": 0.05, "pump": 5e-5, "seepage": 2e-4}, _tank, {"extra.level": (0, 1e-3, "m")}, ("extra.pump", "V"),
    (2.6, 2.0), 0.01, (0.4,), 1500.0, 0.4)  # fmt: skip
CART = Base("cart", '''
@physics("cart", summary="A cart.", source="Newton 1687",
    parameters=(constant("mass", "kg", 2.0, lower=0.01), constant("viscous", "N s/m", 0.8, lower=0.0, typical=0.3)),
    states=(state("place", "m", typical=1.0), state("speed", "m/s", typical=1.0)),
    inputs={"extra.force": "N"}, outputs={"extra.speed": "m/s"}, period=4.0)
def cart(at: Moment) -> Equations:
    rate = (at.input("extra.force").value - at["viscous"] * at["speed"]) / at["mass"]
    return Equations({"place": at["speed"], "speed": rate}, {"extra.speed": at["speed"]})
''', {"mass": 2.0, "viscous": 0.8}, _cart, {"extra.speed": (1, 5e-3, "m/s")}, ("extra.force", "N"),
    (0.2, 2.5), 1.1, (0.0, 0.5), 24.0, 25.0)  # fmt: skip
BOUNCER = Base("bouncer", '''
@physics("bouncer", summary="A mass on a spring.", source="Hooke 1678",
    parameters=(constant("mass", "kg", 0.5, lower=0.01), constant("spring", "N/m", 20.0, lower=0.1),
                constant("viscous", "N s/m", 0.3, lower=0.0, typical=0.1)),
    states=(state("place", "m", typical=0.1), state("speed", "m/s", typical=0.5)),
    inputs={"extra.force": "N"}, outputs={"extra.place": "m"}, period=1.0)
def bouncer(at: Moment) -> Equations:
    x, v = at["place"], at["speed"]
    rate = (at.input("extra.force").value - at["spring"] * x - at["viscous"] * v) / at["mass"]
    return Equations({"place": v, "speed": rate}, {"extra.place": x})
''', {"mass": 0.5, "spring": 20.0, "viscous": 0.3}, _bouncer, {"extra.place": (0, 1e-3, "m")}, ("extra.force", "N"),
    (0.0, 2.5), 5.0, (0.1, 0.3), 12.0, 50.0)  # fmt: skip
TANKS = Base("tanks", '''
@physics("tanks", summary="Two tanks side by side.", source="Bernoulli 1738",
    parameters=(constant("pump", "m/(s V)", 1e-3, lower=1e-5), constant("pipe", "1/s", 0.01, lower=1e-4),
                constant("drain", "1/s", 5e-3, lower=1e-4)),
    states=(state("first", "m", typical=0.3, start=0.5, lower=0.0),
            state("second", "m", typical=0.3, start=0.3, lower=0.0)),
    inputs={"extra.pump": "V"}, outputs={"extra.first": "m", "extra.second": "m"}, period=200.0)
def tanks(at: Moment) -> Equations:
    one, two = at["first"], at["second"]
    over = at["pipe"] * (one - two)
    return Equations({"first": at["pump"] * at.input("extra.pump").value - over, "second": over - at["drain"] * two},
                     {"extra.first": one, "extra.second": two})
''', {"pump": 1e-3, "pipe": 0.01, "drain": 5e-3}, _tanks,
    {"extra.first": (0, 1e-3, "m"), "extra.second": (1, 1e-3, "m")}, ("extra.pump", "V"),
    (2.5, 2.0), 0.012, (0.5, 0.3), 1200.0, 0.4)  # fmt: skip
BASES = {base.name: base for base in (OVEN, TANK, CART, BOUNCER, TANKS)}


def _nothing(s: np.ndarray, u: float) -> float:
    del s, u
    return 0.0


def _signed(x: float, power: float) -> float:
    return float(np.sign(x) * abs(x) ** power)


LAWS: Mapping[str, tuple[str, int, Addition]] = {
    # Each: base, state whose rate it changes, and the law, with its sign; its size is drawn.
    "radiation": ("oven", 0, lambda s, _: -(s[0] ** 4 - 293.0**4)),
    "free convection": ("oven", 0, lambda s, _: -_signed(s[0] - 293.0, 1.25)),
    "evaporation": ("oven", 0, lambda s, _: -np.exp((s[0] - 293.0) / 25.0)),
    "a fan that switches on": ("oven", 0, lambda s, _: -0.5 * (1.0 + np.tanh((s[0] - 375.0) / 1.0))),
    "a heater that saturates": ("oven", 0, lambda _, u: -(u - 300.0 * np.tanh(u / 300.0))),
    "orifice": ("tank", 0, lambda s, _: -np.sqrt(max(s[0], 0.0))),
    "weir": ("tank", 0, lambda s, _: -max(0.0, s[0] - 0.45) ** 1.5),
    "hole in the side": ("tank", 0, lambda s, _: -np.sqrt(max(0.0, s[0] - 0.35))),
    "pump against a head": ("tank", 0, lambda s, u: -u * s[0] ** 2),
    "pump's curve": ("tank", 0, lambda _, u: _signed(u, 1.5)),
    "turbulent drag": ("cart", 1, lambda s, _: -_signed(s[1], 1.75)),
    "eddy brake": ("cart", 1, lambda s, _: -s[1] / (1.0 + (s[1] / 0.5) ** 2)),
    "dry friction": ("cart", 1, lambda s, _: -np.tanh(s[1] / 0.01)),
    "motor that saturates": ("cart", 1, lambda _, u: -_signed(u, 3.0)),
    "one-way clutch": ("cart", 1, lambda s, _: max(0.0, -s[1]) ** 2),
    "quintic spring": ("bouncer", 1, lambda s, _: -s[0] ** 5),
    "rubber ball": ("bouncer", 1, lambda s, _: -max(0.0, s[0] - 0.05) ** 1.5),
    "squared stop": ("bouncer", 1, lambda s, _: max(0.0, -0.05 - s[0]) ** 2),
    "magnet beside": ("bouncer", 1, lambda s, _: 1.0 / (0.6 - min(s[0], 0.5)) ** 2 - 1.0 / 0.6**2),
    "shock absorber": ("bouncer", 1, lambda s, _: -s[1] * s[0] ** 2),
    "turbulent pipe": ("tanks", 0, lambda s, _: -_signed(s[0] - s[1], 0.5)),
    "drain by its head": ("tanks", 1, lambda s, _: -np.sqrt(max(s[1], 0.0))),
    "overflow": ("tanks", 0, lambda s, _: -max(0.0, s[0] - 0.6) ** 1.5),
    "siphon": ("tanks", 1, lambda s, _: -0.5 * (1.0 + np.tanh((s[1] - 0.4) / 0.004))),
    "foam": ("tanks", 0, lambda s, _: -s[0] * s[1] ** 2),
}  # fmt: skip


@dataclass(frozen=True)
class World:
    """Recordings of a base: two to fit, one to choose by, one that takes part in nothing."""

    base: Base
    runs: tuple[Run, ...]
    off: Mapping[str, float]  # values that the user states

    def model(self, folder: Path) -> PhysicsModel:
        """The base as a user has it, its values a little off."""
        path = folder / f"{self.base.name}.py"
        path.write_text(HEAD + self.base.text)
        return load_base(path).with_values(self.off)


def world(kind: str, seed: int) -> World:
    """Recordings of a base with one of `LAWS`, or, by a name of `BASES`, without one."""
    rng = np.random.default_rng([seed, zlib.crc32(kind.encode())])
    name, state, law = LAWS.get(kind, (kind, 0, _nothing))
    base = BASES[name]
    true = {n: v * rng.uniform(0.8, 1.25) for n, v in base.values.items()}
    off = {n: v * rng.uniform(1.0 - OFF, 1.0 + OFF) for n, v in true.items()}
    inputs = [_drawn_input(base, rng) for _ in range(4)]
    starts = [np.array(base.start) * rng.uniform(0.7, 1.3, len(base.start)) for _ in range(4)]
    bare = [_states(base, true, u, s, None) for u, s in zip(inputs, starts, strict=True)]
    size = 0.0
    if kind in LAWS:
        along = [
            (s, u(t))
            for (times, states), u in zip(bare, inputs, strict=True)
            for t, s in zip(times, states, strict=True)
        ]
        rates = np.array([base.rates(true, s, u)[state] for s, u in along])
        felt = np.array([law(s, u) for s, u in along])
        most = float(np.std(felt)) or 1.0
        size = rng.uniform(*SHARE) * float(np.std(rates)) / most
        noise = {k: n for _, (k, n, _) in base.outputs.items()}
        for _ in range(12):
            now = [_states(base, true, u, s, (state, law, size)) for u, s in zip(inputs, starts, strict=True)]
            moved = max(float(np.sqrt(np.mean((a[1][:, k] - b[1][:, k]) ** 2))) / n
                        for a, b in zip(now[:2], bare[:2], strict=True) for k, n in noise.items())  # fmt: skip
            if moved > LEAST_SHOWN:
                break
            size *= 1.6
    runs = []
    for k, (u, s) in enumerate(zip(inputs, starts, strict=True)):
        times, states = _states(base, true, u, s, (state, law, size) if size else None)
        channels = {base.driven[0]: Channel(times, np.array([u(t) for t in times]), base.driven[1])}
        for channel, (row, sd, unit) in base.outputs.items():
            channels[channel] = Channel(times, states[:, row] + sd * rng.standard_normal(len(times)), unit)
        runs.append(Run(f"{'abcd'[k]}.csv", channels))
    return World(base, tuple(runs), off)


def _drawn_input(base: Base, rng: np.random.Generator) -> Callable[[float], float]:
    sizes, paces, phases = rng.uniform(0.3, 1.0, 3), base.pace * rng.uniform(0.4, 1.8, 3), rng.uniform(0.0, 6.28, 3)
    mean, size = base.push
    return lambda t: float(mean + size * (sizes @ np.sin(paces * t + phases)) / 2.0)


def _states(
    base: Base, true: Mapping[str, float], u: Callable[[float], float], start: Sequence[float],
    law: tuple[int, Addition, float] | None,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """(N,) times and (N, n) states."""

    def rates(t: float, s: np.ndarray) -> list[float]:
        given = u(t)
        found = base.rates(true, s, given)
        if law is not None:
            found[law[0]] += law[2] * law[1](s, given)
        return found

    times = np.arange(0.0, base.seconds, 1.0 / base.rate)
    found = solve_ivp(rates, (0.0, times[-1]), start, t_eval=times, rtol=1e-7, atol=1e-9, max_step=4.0 / base.rate,
                      method="LSODA")  # fmt: skip
    return times, found.y.T
