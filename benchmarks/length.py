"""How well a trial learns the length, over seeds of the whole simulated robot and guesses from 0.15 to 0.9 m.

    python benchmarks/length.py [--quick] [--seeds N] [--first-seed N] [--workers N] [--json FILE]

Every seed draws the load's mass (1 %), the cell's bias (10 mN) and latency (0 to 20 ms), the arm's inertias and every
noise. Each trial runs to its end, swing included. Nothing is timed here.
"""

import _timing as bench  # isort: skip

import argparse
import multiprocessing
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.trial import TrialSettings, run_trial

GUESSES = np.linspace(0.15, 0.9, 16)
"""Guesses of the length [m]; the seeds take them in turn."""
LARGEST_MEAN, LARGEST_STD = 5e-4, 1.5e-3
"""Largest mean and standard deviation of the length's error [m]."""
COVERAGE, LEAST_COVERED = 3.0, 0.97
"""Distance of the truth in reported standard deviations, and the least share of trials within it."""
FEW, ENOUGH = 10, 100
"""Least number of trials for any claim, and for the claim about the covered share."""


@dataclass(frozen=True)
class Learnt:
    """Length after one trial: guess, error and reported standard deviation [m]."""

    seed: int
    guess: float
    error: float
    std: float
    updates: int
    success: bool
    message: str

    @property
    def deviations(self) -> float:
        """Error in reported standard deviations; infinite without an estimate."""
        return abs(self.error) / self.std if self.std > 0 else np.inf


def learn(seed: int) -> Learnt:
    """Learnt length of one trial."""
    guess = float(GUESSES[seed % len(GUESSES)])
    result = run_trial(TrialSettings(seed=seed, length_guess=guess))
    return Learnt(
        seed, guess, result.length_estimate - result.true_length, result.length_std, len(result.estimates),
        result.success, result.message,
    )  # fmt: skip


def run(seeds: range, workers: int) -> list[Learnt]:
    """Learnt lengths of all trials; a terminal shows a line of progress for each."""
    found = []
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        for learnt in pool.map(learn, seeds):
            found.append(learnt)
            if sys.stderr.isatty():
                print(f"\r{len(found)} of {len(seeds)} trials", end="", file=sys.stderr, flush=True)
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="one trial only, nothing is judged")
    parser.add_argument("--seeds", type=int, default=ENOUGH, help="trials")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="processes")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write what is printed as JSON too")
    options = parser.parse_args()
    count = 1 if options.quick else options.seeds
    found = run(range(options.first_seed, options.first_seed + count), options.workers)
    errors, deviations = np.array([f.error for f in found]), np.array([f.deviations for f in found])
    bench.print_table(
        f"Length learnt in 6 s, {count} trials",
        ["guess m", "trials", "mean error mm", "largest mm", "reported std mm", "largest error/std", "in the box"],
        [
            [
                f"{guess:.3f}",
                str(len(group)),
                f"{1e3 * np.mean([f.error for f in group]):+.2f}",
                f"{1e3 * max(abs(f.error) for f in group):.2f}",
                f"{1e3 * np.mean([f.std for f in group]):.2f}",
                f"{max(f.deviations for f in group):.2f}",
                f"{np.mean([f.success for f in group]):.0%}",
            ]
            for guess in sorted({f.guess for f in found})
            for group in [[f for f in found if f.guess == guess]]
        ],
    )
    for failed in (f for f in found if not f.success):
        print(f"seed {failed.seed}, guess {failed.guess:.3f} m: {failed.message}")
    mean, std, covered = float(np.mean(errors)), float(np.std(errors)), float(np.mean(deviations <= COVERAGE))
    chance = std / np.sqrt(count)

    def judged(holds: bool, needs: int = FEW) -> bool | None:
        return holds if count >= needs else None

    claims = [
        bench.Claim(
            f"mean error within {1e3 * LARGEST_MEAN:g} mm",
            f"{1e3 * mean:+.3f} +/- {1e3 * chance:.3f} mm",
            judged(abs(mean) <= LARGEST_MEAN),
        ),
        bench.Claim(
            f"standard deviation at most {1e3 * LARGEST_STD:g} mm (the paper's: 4.2 mm)",
            f"{1e3 * std:.3f} +/- {1e3 * chance / np.sqrt(2):.3f} mm",
            judged(std <= LARGEST_STD),
        ),
        bench.Claim(
            f"truth within {COVERAGE:g} reported standard deviations in {LEAST_COVERED:.0%} of {ENOUGH} trials or more",
            f"{covered:.1%} of {count}",
            judged(covered >= LEAST_COVERED, ENOUGH),
        ),
    ]
    results = {"mean_error": mean, "std": std, "covered": covered, "trials": [vars(f) for f in found]}
    return bench.conclude(claims, results, options.json)


if __name__ == "__main__":
    raise SystemExit(main())
