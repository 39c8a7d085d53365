"""How often the test for a change raises an alarm where nothing changes, and how often it finds a step, over seeds.

    python benchmarks/changes.py [--batches 60] [--rate 0.05]

A batch is 10 robots with 4 parameters and 40 recordings on random days. None of its noise is of the kind that the test
simulates but the first.
"""

import argparse
from collections.abc import Callable

import numpy as np

from pipeline.batch.change import find_changes
from pipeline.batch.series import ParameterSeries

DAY = 86400.0
ROBOTS, PARAMETERS, RECORDINGS, DAYS = 10, 4, 40, 120
SIMULATED = 400
"""Number of simulated batches for the bound; fewer than in use, with little effect at 5 %."""
Noise = Callable[[np.random.Generator, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray | None]]


def white(rng, t, _common):
    return rng.standard_normal(len(t)), None


def together(rng, t, common):
    return 0.8 * common + 0.6 * rng.standard_normal(len(t)), None


def heavy_tails(rng, t, _common):
    return rng.standard_t(2, len(t)), None


def some_poor(rng, t, _common):
    std = np.exp(rng.standard_normal(len(t)))
    return std * rng.standard_normal(len(t)), std


def poor_later(rng, t, _common):
    std = np.where(np.arange(len(t)) < len(t) // 2, 1.0, 5.0)
    return std * rng.standard_normal(len(t)), std


def steady_wear(rng, t, _common):
    return rng.standard_normal(len(t)) + 10.0 * t / t[-1], None


def growing_wear(rng, t, _common):
    return rng.standard_normal(len(t)) + 5.0 * (t / t[-1]) ** 2, None


def monthly_swing(rng, t, _common):
    return rng.standard_normal(len(t)) + 2.0 * np.sin(2 * np.pi * t / (30 * DAY) + rng.uniform(0, 6)), None


def weather(phi: float) -> Noise:
    def noise(rng, t, _common):
        e = rng.standard_normal(len(t))
        for i in range(1, len(e)):
            e[i] = phi * e[i - 1] + np.sqrt(1 - phi**2) * e[i]
        return e, None

    return noise


KINDS: dict[str, Noise] = {
    "white noise": white, "parameters of a robot together (0.64)": together, "heavy tails (t, 2)": heavy_tails,
    "uncertainties from 0.1 to 10": some_poor, "five times less certain later": poor_later,
    "neighbours alike (0.3)": weather(0.3), "neighbours alike (0.6)": weather(0.6), "monthly swing": monthly_swing,
    "steady wear": steady_wear, "growing wear": growing_wear,
}  # fmt: skip


def batch(rng: np.random.Generator, noise: Noise, recordings: int = RECORDINGS, step: float = 0.0) -> dict:
    """Series by robot and parameter, one of them with a step in the middle."""
    series = {}
    for robot in range(ROBOTS):
        t = DAY * np.sort(rng.choice(DAYS, recordings, replace=False)) + rng.uniform(0, DAY / 2, recordings)
        common = rng.standard_normal(recordings)
        for parameter in range(PARAMETERS):
            value, std = noise(rng, t, common)
            if step and robot == parameter == 0:
                value = value + step * (np.arange(recordings) >= recordings // 2)
            series[f"robot {robot}", f"p{parameter}"] = ParameterSeries(t, value, std)
    return series


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--batches", type=int, default=60)
    parser.add_argument("--rate", type=float, default=0.05, help="stated probability of an alarm per batch")
    asked = parser.parse_args()
    print(f"batches of {asked.batches} with a step and with a drift marked; stated: {asked.rate:.0%}")
    for name, noise in KINDS.items():
        found = [
            find_changes(batch(np.random.default_rng([1, i]), noise), asked.rate, batches=SIMULATED, seed=i)
            for i in range(asked.batches)
        ]
        print(f"  {name:38} {sum(bool(f.steps) for f in found):3} {sum(bool(f.drifts) for f in found):3}", flush=True)
    print("steps found at a stated 1 %, by size in standard deviations of one recording, and on the exact day")
    for recordings, size in ((40, 2), (40, 3), (40, 4), (40, 6), (16, 10), (24, 10)):
        hits = exact = others = 0
        for i in range(asked.batches):
            rng = np.random.default_rng([2, i])
            steps = find_changes(batch(rng, white, recordings, size), batches=1000, seed=i).steps
            mine = [s for s in steps if (s.robot, s.parameter) == ("robot 0", "p0")]
            hits, exact = hits + bool(mine), exact + any(s.index == recordings // 2 for s in mine)
            others += len(steps) - len(mine)
        found, right = hits / asked.batches, exact / asked.batches
        print(f"  {recordings} recordings, {size:2}: {found:4.0%} {right:4.0%}; others {others}", flush=True)


if __name__ == "__main__":
    main()
