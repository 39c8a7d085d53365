"""How often does the test for a change raise an alarm where nothing changes, and how often does it find a step?

    python benchmarks/changes.py [--batches 40] [--first-seed 0] [--rate 0.01] [--recordings 20,40] [--only WORD]

A batch is 5 robots with 4 parameters and recordings on random days. One parameter of one robot has a step of five
standard deviations of its scatter in the middle, in half of the batches upwards; the other 19 do not change. Each fit
says that it is certain to a seventh of the scatter.
"""

import argparse
from collections.abc import Callable

import numpy as np

from pipeline.batch.change import find_changes
from pipeline.batch.series import ParameterSeries

DAY = 86400.0
ROBOTS, PARAMETERS, DAYS_PER_RECORDING = 5, 4, 3
STEP, STATED_STD, WITHIN_KIND = 5.0, 0.15, 0.2
"""Size of the step, the fits' own standard deviation, and scatter within a kind of motion, in deviations."""
Scatter = Callable[[np.random.Generator, np.ndarray], np.ndarray]


def white(rng, t):
    return rng.standard_normal(len(t))


def heavy_tails(rng, t):
    return rng.standard_t(3, len(t)) / np.sqrt(3.0)


def _of_kinds(rng, kind):
    return np.where(np.asarray(kind) % 2, 1.0, -1.0) + WITHIN_KIND * rng.standard_normal(len(kind))


def two_kinds_at_random(rng, t):
    return _of_kinds(rng, rng.integers(0, 2, len(t)))


def one_kind_in_four(rng, t):
    return _of_kinds(rng, rng.random(len(t)) < 0.25) / np.sqrt(0.75)


def alternating_kinds(rng, t):
    return _of_kinds(rng, np.arange(len(t)))


def blocks(length: int) -> Scatter:
    return lambda rng, t: _of_kinds(rng, (np.arange(len(t)) + rng.integers(2 * length)) // length)


def blocks_of_any_length(rng, t):
    return _of_kinds(rng, rng.integers(2) + np.repeat(np.arange(len(t)), rng.integers(2, 7, len(t)))[: len(t)])


def alike(phi: float) -> Scatter:
    def scatter(rng, t):
        e = rng.standard_normal(len(t))
        for i in range(1, len(e)):
            e[i] = phi * e[i - 1] + np.sqrt(1 - phi**2) * e[i]
        return e

    return scatter


def some_in_blocks(rng, t):
    return (blocks(5) if rng.random() < 0.2 else white)(rng, t)


def monthly_swing(rng, t):
    return (rng.standard_normal(len(t)) + 2.0 * np.sin(2 * np.pi * t / (30 * DAY) + rng.uniform(0, 6))) / np.sqrt(3.0)


def steady_wear(rng, t):
    return rng.standard_normal(len(t)) + 10.0 * t / t[-1]


def growing_wear(rng, t):
    return rng.standard_normal(len(t)) + 5.0 * (t / t[-1]) ** 2


KINDS: dict[str, Scatter] = {
    "white": white, "heavy tails (t, 3)": heavy_tails, "two kinds at random": two_kinds_at_random,
    "one recording in four of another kind": one_kind_in_four, "two kinds alternate": alternating_kinds,
    "kinds in blocks of 3": blocks(3), "kinds in blocks of 5": blocks(5),
    "kinds in blocks of 2 to 6": blocks_of_any_length, "one series in five in blocks of 5": some_in_blocks,
    "neighbours alike (0.3)": alike(0.3), "neighbours alike (0.6)": alike(0.6), "monthly swing": monthly_swing,
    "steady wear": steady_wear, "growing wear": growing_wear,
}  # fmt: skip


def batch(rng: np.random.Generator, scatter: Scatter, recordings: int, step: float) -> dict:
    """Series by robot and parameter, one of them with a step in the middle."""
    series = {}
    for robot in range(ROBOTS):
        days = rng.choice(DAYS_PER_RECORDING * recordings, recordings, replace=False)
        t = DAY * np.sort(days) + rng.uniform(0, DAY / 2, recordings)
        for parameter in range(PARAMETERS):
            value = scatter(rng, t)
            if robot == parameter == 0:
                value = value + step * (np.arange(recordings) >= recordings // 2)
            series[f"robot {robot}", f"p{parameter}"] = ParameterSeries(t, value, np.full(recordings, STATED_STD))
    return series


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--batches", type=int, default=40)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--rate", type=float, default=0.01, help="stated probability of an alarm per batch")
    parser.add_argument("--recordings", default="20,40")
    parser.add_argument("--only", default="", help="a word of the scatter's name")
    asked = parser.parse_args()
    print(f"of {asked.batches} batches: with a false step; with a false drift; whose step was found; on the exact day")
    for recordings in map(int, asked.recordings.split(",")):
        for name, scatter in KINDS.items():
            if asked.only not in name:
                continue
            false = drift = hit = exact = 0
            for seed in range(asked.first_seed, asked.first_seed + asked.batches):
                size = STEP if seed % 2 else -STEP
                series = batch(np.random.default_rng([recordings, seed]), scatter, recordings, size)
                found = find_changes(series, asked.rate, seed=seed)
                mine = [s for s in found.steps if (s.robot, s.parameter) == ("robot 0", "p0")]
                false += len(found.steps) > len(mine)
                drift += any((d.robot, d.parameter) != ("robot 0", "p0") for d in found.drifts)
                hit += bool(mine)
                exact += any(s.index == recordings // 2 for s in mine)
            print(f"  {recordings} {name:38} {false:3} {drift:4} {hit:4} {exact:4}", flush=True)


if __name__ == "__main__":
    main()
