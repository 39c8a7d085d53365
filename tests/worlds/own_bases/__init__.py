"""Bases of one's own with a hidden effect: what a user writes, and what really happens, written a second time.

A base is the text of a file, as the documentation asks for it. The truth is a plain function of numbers for scipy's
integrator, which shares nothing with it.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from armdyn.physics.model import PhysicsModel
from armdyn.physics.user import load_base
from armdyn.run import Channel, Run

Rates = Callable[["Case", np.ndarray, float], Sequence[float]]

HEAD = """
from dataclasses import dataclass, replace
import casadi as ca
from armdyn.effects.effect import effect
from armdyn.parameter import quantity
from armdyn.physics import Equations, Expression, Moment, Rate, Stage, constant, physics, state
"""
RUNS = 4  # of a case: two to fit, one to choose by, one that takes part in nothing
SHOWN = 1.0
"""Change of a recording by its hidden effect, over the noise, below which a case is drawn anew: an edge that it never
reaches shows nothing."""
OFF = 0.3  # share by which start values are off at most


@dataclass(frozen=True)
class Family:
    """A kind of base."""

    name: str  # of the base
    kind: str  # of physics
    text: str  # of the user's file, without its head
    values: Mapping[str, float]  # of the base, by parameter, and within which factor they are drawn
    effects: Mapping[str, Mapping[str, float]]  # hidden ones, with their true sizes by quantity
    rates: Rates  # of the states
    # by channel, which state is measured, or from the case, the states and the input to what is measured
    outputs: Mapping[str, int | Callable[["Case", np.ndarray, np.ndarray], np.ndarray]]
    noise: Mapping[str, float]  # by channel
    push: tuple[float, float]  # mean and size of the input
    pace: float  # angular frequency of the input, 1/s
    start: tuple[float, ...]  # typical states at the start
    seconds: float  # of a run
    rate: float  # Hz
    driven: str  # channel of the input; empty for none
    unit: str  # of the input
    held: bool = False  # whether the input is a command that steps
    # the input from the states and an aim, where the process is held by feedback; `push` and `pace` are the aim's
    control: Callable[["Case", np.ndarray, float], float] | None = None


@dataclass(frozen=True)
class Case:
    """One base with its true values and one hidden effect; ``""`` is none."""

    family: Family
    seed: int
    hidden: str
    true: Mapping[str, float]

    def __getitem__(self, name: str) -> float:
        """A value; 0 of an effect that is not hidden."""
        return self.true[name] if name.rpartition(".")[0] in ("", self.hidden) else 0.0

    @property
    def shows(self) -> float:
        """Root mean square of what the hidden effect changes in the first recording, over its noise."""
        one, other = (case._run(0) for case in (self, replace(self, hidden="")))
        off = [(c.value - other.all_channels[n].value) / self.family.noise[n] for n, c in one.all_channels.items()
               if n in self.family.noise]  # fmt: skip
        return float(np.sqrt(np.mean(np.square(off))))

    def model(self, folder: Path, off: float = OFF) -> PhysicsModel:
        """What the user begins with: values off at random, by at most a share `off`, or by a factor of 1 or more."""
        path = folder / f"{self.family.name}.py"
        path.write_text(HEAD + self.family.text, encoding="utf-8")
        rng = np.random.default_rng([self.seed, 1])
        model = load_base(path)
        low, high = (1.0 - off, 1.0 + off) if off < 1.0 else (1.0 / off, off)
        share = rng.uniform if off < 1.0 else lambda *ends: np.exp(rng.uniform(*np.log(ends)))
        begun = {n: self.true[n] * float(share(low, high)) for n in self.family.values}
        bounds = {n: (model.parameters[n].lower, model.parameters[n].upper) for n in begun}
        return model.with_values({n: float(np.clip(value, *bounds[n])) for n, value in begun.items()})

    def runs(self) -> list[Run]:
        """Recordings."""
        return [self._run(k) for k in range(RUNS)]

    def _run(self, k: int) -> Run:
        f, rng = self.family, np.random.default_rng([self.seed, 2, k])
        time = np.arange(0.0, f.seconds, 1.0 / f.rate)
        given = self._given(rng, time)
        start = np.array(f.start) * rng.uniform(0.5, 1.5, len(f.start))

        def moves(t: float, s: np.ndarray) -> Sequence[float]:
            return f.rates(self, s, float(given(t)))

        if f.control is None:
            y, u = _solved(moves, (0.0, time[-1]), start, time, f), given(time)
        else:
            y, u = self._controlled(start, time, given)
        channels = {f.driven: Channel(time, u, f.unit)} if f.driven else {}
        units = dict(re.findall(r'"([\w.]+)": "([^"]+)"', f.text.split("outputs=")[1].split("}")[0]))
        for name, look in f.outputs.items():
            read = y[look] if isinstance(look, int) else look(self, y, u)
            value = read + f.noise[name] * rng.normal(size=len(time))
            channels[name] = Channel(time, value, units[name])
        return Run(f"{f.name}_{self.seed}_{k}.csv", channels)

    def _controlled(
        self, start: np.ndarray, time: np.ndarray, aim: Callable[[np.ndarray | float], np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        """(n, N) states and (N,) commands, each of which holds from one sample to the next."""
        f, states, commands = self.family, [start], list[float]()
        assert f.control is not None
        for t, after in pairwise(time):
            u = f.control(self, states[-1], float(aim(t)))
            commands.append(u)
            moved = _solved(lambda _, s, u=u: f.rates(self, s, u), (t, after), states[-1], np.array([after]), f)
            states.append(moved[:, 0])
        return np.array(states).T, np.array([*commands, commands[-1]])

    def _given(self, rng: np.random.Generator, time: np.ndarray) -> Callable[[np.ndarray | float], np.ndarray]:
        f = self.family
        if f.held and f.control is None:
            every = max(1, round(2.0 / f.pace * f.rate))
            levels = f.push[0] + f.push[1] * rng.uniform(-1.0, 1.0, len(time) // every + 2)
            edges = time[::every]
            return lambda t: levels[np.clip(np.searchsorted(edges, np.asarray(t) + 1e-9, side="right") - 1, 0, None)]
        sizes, paces = rng.uniform(0.3, 1.0, 3), f.pace * np.array([0.45, 1.0, 2.2]) * rng.uniform(0.8, 1.25, 3)
        phases = rng.uniform(0.0, 2 * np.pi, 3)

        def smooth(t: np.ndarray | float) -> np.ndarray:
            shape = np.sin(np.multiply.outer(np.asarray(t), paces) + phases) @ sizes / sizes.sum()
            return f.push[0] + f.push[1] * shape

        return smooth


def _solved(
    rates: Callable[[float, np.ndarray], Sequence[float]],
    span: tuple[float, float],
    start: np.ndarray,
    time: np.ndarray,
    f: Family,
) -> np.ndarray:
    """(n, N) states at `time` by scipy's LSODA."""
    atol = 1e-9 * max(map(abs, f.start), default=1.0) + 1e-14
    found = solve_ivp(rates, span, start, "LSODA", time, max_step=0.25 / f.rate, rtol=1e-8, atol=atol)
    assert found.success, (f.name, found.message)
    return found.y


def beyond(value: float, gap: float) -> float:
    """How far a value is outside of a gap on either side of 0."""
    return float(value - np.clip(value, -gap, gap))


def case(family: Family, seed: int, hidden: str | None = None) -> Case:
    """A case drawn from a family; the hidden effect is drawn as well where it is not given."""
    rng = np.random.default_rng([seed, 0])
    names = list(family.effects)
    effect = names[seed % len(names)] if hidden is None else hidden
    while True:
        true = {name: value * float(rng.uniform(0.75, 1.3)) for name, value in family.values.items()}
        for name, size in (family.effects[effect] if effect else {}).items():
            true[f"{effect}.{name}"] = size * float(rng.uniform(0.8, 1.3))
        found = Case(family, seed, effect, true)
        if not effect or found.shows > SHOWN:
            return found
