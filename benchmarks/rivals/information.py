"""Information of a gripper motion about the length: sequential action control against chirps, multisines and sines.

    python benchmarks/rivals/information.py [--quick] [--seeds N] [--json FILE]

Every motion lasts 6 s, starts at rest, stays within 0.2 m of the middle and keeps the string taut. A load cell of 5 mN
at 100 Hz sees a load of 0.08 kg. The Cramer-Rao bound is of the length alone, and with mass, drag, bias and delay as
uncertain as a trial allows. Nothing is timed here.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))
import _timing as bench  # isort: skip

import argparse
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from _closed_loop import DT, held, learn, recording
from _pendulum import Pendulum
from scipy.interpolate import make_interp_spline

from armdyn.effects.catalogue import CATALOGUE
from armdyn.errors import InputError
from armdyn.identify.estimator import parameter_covariance
from armdyn.identify.problem import Problem
from armdyn.pendulum.model import PendulumModel, pendulum_model
from armdyn.pendulum.path import gripper_path
from armdyn.run import Run

LENGTH, MASS, NOISE, DURATION = 0.368, 0.08, 0.005, 6.0
TIME = DT * np.arange(round(DURATION / DT) + 1)
REACH = 0.2
"""Largest distance of the gripper from the middle [m]."""
LEAST_TENSION = 0.2
"""Least tension over the load's weight; below it, the string goes slack at the smallest disturbance."""
RAMP = 0.5
"""Time in which a periodic motion fades in [s]."""
RESONANCE = np.sqrt(9.81 / LENGTH) / (2 * np.pi)
CHIRPS = ((0.1, 1.0), (0.2, 2.0), (0.5, 3.0), (0.1, 5.0), (0.6, 1.1))
"""First and last frequency of the chirps [Hz]; the last chirp is about the resonance and needs a known length."""
MULTISINES = 20
GUESSES = (0.308, 0.328, 0.348, 0.368, 0.388, 0.408, 0.428, 0.448, 0.468)
"""Guesses of the length in the paper's Table I [m]."""
NUISANCES = {
    "linear_drag": ("linear_drag.coefficient", 0.0, 0.01),
    "sensor_bias": ("sensor_bias.force", 0.0, 0.02),
    "sensor_delay": ("sensor_delay.time", 0.01, 0.01),
}
MASS_STD = 0.0008
AGREEMENT = 0.01
"""Largest relative difference between armdyn's information and finite differences of other equations."""


@dataclass(frozen=True)
class Measures:
    """Sizes of a motion and its information about the length.

    Attributes:
        energy: integral of the squared acceleration [m^2/s^3].
        x: largest distance from the middle [m].
        v: largest speed [m/s].
        a: largest acceleration [m/s^2].
        swing: largest swing angle [rad].
        tension: smallest tension [N].
        information: Fisher information about the length where nothing else is unknown [1/m^2].
        bound: least standard deviation of the length where nothing else is unknown [m].
        full_bound: least standard deviation where mass, drag, bias and delay are uncertain [m].
    """

    energy: float
    x: float
    v: float
    a: float
    swing: float
    tension: float
    information: float
    bound: float
    full_bound: float


Condition = Callable[[Measures], bool]


def fisher_information(model: PendulumModel, run: Run, names: tuple[str, ...]) -> np.ndarray:
    """Fisher information of a run about some parameters, with the others known (Kay, Estimation Theory, 1993, §3.9)."""
    problem = Problem(model, [run], {(run.name, "load_force"): NOISE})
    return problem.expansion(problem.start_values(), problem.mask_of_unknowns(names)).hessian


def measure(gripper: np.ndarray) -> Measures:
    """Measures of a motion x, v, a (3, n) at `TIME`."""
    model = pendulum_model(LENGTH, MASS)
    run = recording(gripper, np.zeros(len(TIME)))
    outputs = model.rollout(gripper_path(run), model.theta(), channels=("load_force", "swing_angle")).outputs
    information = float(fisher_information(model, run, ("length",))[0, 0])
    names = ("length", "mass", *(parameter for parameter, _, _ in NUISANCES.values()))
    try:
        full_bound = float(
            np.sqrt(parameter_covariance(names, fisher_information(uncertain_model(), run, names))[0, 0])
        )
    except InputError:  # the motion has no information
        full_bound = np.inf
    x, v, a = np.max(np.abs(gripper), axis=1)
    return Measures(
        energy=float(np.sum(gripper[2] ** 2) * DT), x=float(x), v=float(v), a=float(a),
        swing=float(np.max(np.abs(outputs[:, 1]))), tension=float(np.min(outputs[:, 0])),
        information=information, bound=information**-0.5, full_bound=full_bound,
    )  # fmt: skip


def uncertain_model() -> PendulumModel:
    """Pendulum model with the effects and priors of a trial."""
    model = pendulum_model(LENGTH, MASS)
    for name, prior in NUISANCES.items():
        model = model.with_effect(CATALOGUE[name]).with_prior(*prior)
    return model.with_prior("mass", MASS, MASS_STD)


def faded_in(wave: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Motion x, v, a (3, n) at `TIME` of a wave that fades in from rest."""
    knots = np.linspace(0.0, DURATION, round(DURATION / 0.002) + 1)
    s = np.clip(knots / RAMP, 0.0, 1.0)
    position = make_interp_spline(knots, s**3 * (10 - 15 * s + 6 * s**2) * wave(knots), k=5)
    return np.stack([position(TIME), position.derivative(1)(TIME), position.derivative(2)(TIME)])


def chirp(start: float, end: float) -> np.ndarray:
    """Motion along a sine whose frequency rises linearly from `start` to `end` [Hz]."""
    return faded_in(lambda t: np.sin(2 * np.pi * (start * t + (end - start) * t**2 / (2 * DURATION))))


def multisine(seed: int) -> np.ndarray:
    """Motion along ten sines from 0.2 to 2 Hz with equal acceleration and random phases."""
    tones = 0.2 * np.arange(1, 11)
    phases = np.random.default_rng(seed).uniform(0, 2 * np.pi, len(tones))
    return faded_in(lambda t: sum(np.sin(2 * np.pi * f * t + p) / f**2 for f, p in zip(tones, phases, strict=True)))


def rivals() -> dict[str, np.ndarray]:
    """Motions x, v, a (3, n) at `TIME` by name, each up to a scale."""
    found = {f"chirp {low:g}-{high:g} Hz": chirp(low, high) for low, high in CHIRPS}
    sines = [multisine(seed) for seed in range(MULTISINES)]
    found[f"multisine 0.2-2 Hz, best of {MULTISINES}"] = max(sines, key=efficiency)
    for length, name in ((1.0, "resonant sine"), (0.85, "... length 15 % short"), (1.25, "... length 25 % long")):
        factor = length**-0.5
        found[name] = faded_in(lambda t, w=2 * np.pi * RESONANCE * factor: np.sin(w * t))
    return found


def efficiency(gripper: np.ndarray) -> float:
    """Information per energy of a motion scaled to a peak of 0.1 m [s^3/m^4]."""
    found = measure(gripper * (0.1 / np.max(np.abs(gripper[0]))))
    return found.information / found.energy


def crossing(gripper: np.ndarray, largest: float, condition: Condition) -> tuple[float, float] | None:
    """Neighbouring scales of a motion between which a condition becomes true; None if it is false up to `largest`."""
    scales = np.geomspace(largest / 100, largest, 60)
    holds = [condition(measure(scale * gripper)) for scale in scales]
    if not any(holds):
        return None
    first = int(np.argmax(holds))
    low, high = float(scales[max(first - 1, 0)]), float(scales[first])
    for _ in range(12):
        middle = (low + high) / 2
        low, high = (low, middle) if condition(measure(middle * gripper)) else (middle, high)
    return low, high


def largest_allowed(gripper: np.ndarray, acceleration: float = np.inf) -> float:
    """Largest scale of a motion within the reach and a peak acceleration [m/s^2] that keeps the string taut."""
    x, _, a = np.max(np.abs(gripper), axis=1)
    most = float(min(REACH / x, acceleration / a))
    slack = crossing(gripper, most, lambda found: found.tension < LEAST_TENSION * MASS * 9.81)
    return most if slack is None else slack[0]


def least_that(gripper: np.ndarray, condition: Condition) -> Measures | None:
    """Measures at the smallest allowed scale at which a condition is true; None where it is never true."""
    found = crossing(gripper, largest_allowed(gripper), condition)
    return None if found is None else measure(found[1] * gripper)


def learnt(guess: float, seed: int) -> np.ndarray:
    """Motion x, v, a (3, n) of the gripper while SAC learns the length in closed loop."""
    model = pendulum_model(guess, MASS).with_fixed("mass", "initial_angle", "initial_rate")
    trial = learn(Pendulum(LENGTH, MASS), model, DURATION, NOISE, np.random.default_rng(seed))
    return np.stack([trial.run.channels[name].value for name in ("gripper_x", "gripper_v", "gripper_a")])


def average(found: list[Measures]) -> Measures:
    """Mean of every measure, information and bounds included."""
    return Measures(**{name: float(np.mean([getattr(m, name) for m in found])) for name in vars(found[0])})


def disagreement(gripper: np.ndarray) -> float:
    """Relative difference of armdyn's information from finite differences of the benchmarks' own equations."""
    slope = Pendulum(LENGTH, MASS).length_sensitivity(held(gripper), TIME)
    return abs(measure(gripper).information * NOISE**2 / float(slope @ slope) - 1)


def row(name: str, found: Measures, sac: Measures) -> list[str]:
    share = found.information / sac.information
    return [
        name, f"{found.energy:.2f}", f"{found.x:.3f}", f"{found.v:.2f}", f"{found.a:.2f}", f"{found.swing:.2f}",
        f"{found.tension:.2f}", f"{1e3 * found.bound:.3f}", f"{1e3 * found.full_bound:.2f}", f"{share:.2f}",
        f"{share * sac.energy / found.energy:.2f}",
    ]  # fmt: skip


HEADINGS = (
    "motion", "energy", "x m", "v m/s", "a m/s2", "swing", "tension N", "bound mm", "full bound mm", "info/SAC",
    "per energy/SAC",
)  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a few seconds only: fewer runs of SAC, two rivals")
    parser.add_argument("--seeds", type=int, default=2, help="closed-loop runs per guess")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write what is printed as JSON too")
    options = parser.parse_args()
    guesses, seeds = (GUESSES[:1], 1) if options.quick else (GUESSES, options.seeds)
    runs = [learnt(guess, seed) for guess in guesses for seed in range(seeds)]
    sac = average([measure(run) for run in runs])
    others = rivals()
    if options.quick:
        others = {name: others[name] for name in ("chirp 0.2-2 Hz", "resonant sine")}
    same_peak = {name: measure(largest_allowed(motion, sac.a) * motion) for name, motion in others.items()}
    bench.print_table(
        f"As large as {REACH:g} m, SAC's peak acceleration and a taut string allow; everything lasts {DURATION:g} s",
        HEADINGS,
        [row(f"SAC, mean of {len(runs)} runs", sac, sac), *(row(name, m, sac) for name, m in same_peak.items())],
    )
    conditions: dict[str, Condition] = {
        "SAC's information on the length alone": lambda found: found.information >= sac.information,
        "SAC's full bound": lambda found: found.full_bound <= sac.full_bound,
    }
    same = {
        wish: {name: least_that(motion, holds) for name, motion in others.items()} for wish, holds in conditions.items()
    }
    for wish, found in same.items():
        bench.print_table(
            f"Energy for {wish}, within {REACH:g} m and with a taut string",
            ["motion", "energy/SAC", *HEADINGS[2:9]],
            [
                [
                    name,
                    *(["cannot"] + [""] * 7 if m is None else [f"{m.energy / sac.energy:.2f}", *row("", m, sac)[2:9]]),
                ]
                for name, m in found.items()
            ],
        )
    spread = [measure(run).bound for run in runs]
    print(f"\nSAC's bound over its runs: {1e3 * min(spread):.3f} to {1e3 * max(spread):.3f} mm")
    off = max(disagreement(motion) for motion in (runs[0], *(0.02 * other for other in others.values())))
    claims = [
        bench.Claim(
            f"information agrees to {AGREEMENT:g} with finite differences of other equations",
            f"{off:.1e}",
            off <= AGREEMENT,
        )
    ]
    results = {
        "sac": vars(sac),
        "same_peak": {name: vars(m) for name, m in same_peak.items()},
        "same": {w: {name: m and vars(m) for name, m in found.items()} for w, found in same.items()},
    }
    return bench.conclude(claims, results, options.json)


if __name__ == "__main__":
    raise SystemExit(main())
