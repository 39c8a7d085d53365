"""The paper's Table I: nine guesses of the length, with and without estimation, over seeds."""

import math
import os
from collections.abc import Callable
from concurrent.futures import as_completed
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from armdyn.errors import InputError
from ik.children import worker_pool
from pipeline.trial.settings import TrialSettings
from pipeline.trial.simulated import run_trial

GUESSES = (0.308, 0.328, 0.348, 0.368, 0.388, 0.408, 0.428, 0.448, 0.468)
"""First guesses of the paper [m], whose string is 0.368 m long."""
PAPER_WITHOUT = (0.368, 0.388)
"""Guesses that succeed without estimation in the paper [m]; with estimation all nine do."""


@dataclass(frozen=True)
class TableRow:
    """Results of one guess over all seeds.

    Attributes:
        length_guess: guess of the length [m].
        succeeded_without: whether each seed succeeded without estimation.
        succeeded_with: whether each seed succeeded with estimation.
        length_estimates: estimated length of each seed [m].
        length_stds: reported standard deviation of each seed [m].
    """

    length_guess: float
    succeeded_without: tuple[bool, ...]
    succeeded_with: tuple[bool, ...]
    length_estimates: tuple[float, ...]
    length_stds: tuple[float, ...]

    @property
    def without(self) -> float:
        """Share of the seeds that succeed without estimation."""
        return float(np.mean(self.succeeded_without))

    @property
    def with_estimation(self) -> float:
        """Share of the seeds that succeed with estimation."""
        return float(np.mean(self.succeeded_with))

    @property
    def in_paper(self) -> bool:
        """Whether this guess succeeds without estimation in the paper."""
        return any(math.isclose(self.length_guess, guess, abs_tol=5e-4) for guess in PAPER_WITHOUT)


@dataclass(frozen=True)
class TableOne:
    """Results of all guesses, as in the paper's Table I.

    Attributes:
        seeds: number of trials per guess, with and without estimation each.
        length: true length [m].
        rows: results by guess.
    """

    seeds: int
    length: float
    rows: tuple[TableRow, ...]

    @property
    def estimates(self) -> np.ndarray:
        """(n,) length of every trial with estimation [m]."""
        return np.array([e for row in self.rows for e in row.length_estimates])

    @property
    def errors(self) -> np.ndarray:
        """(n,) estimate minus truth of every trial with estimation [m]."""
        return self.estimates - self.length

    @property
    def covered(self) -> float:
        """Share of the trials whose truth is within three reported standard deviations."""
        stds = np.array([s for row in self.rows for s in row.length_stds])
        return float(np.mean(np.abs(self.errors) <= 3 * stds))

    @property
    def pattern(self) -> float:
        """Share of the seeds that give the paper's whole column without estimation."""
        wanted = [row.in_paper for row in self.rows]
        columns = zip(*(row.succeeded_without for row in self.rows), strict=True)
        return float(np.mean([list(column) == wanted for column in columns]))

    def as_json(self) -> dict[str, Any]:
        """JSON ``armdyn.table/1`` of the table."""
        return {
            "schema": "armdyn.table/1",
            "seeds": self.seeds,
            "rows": [
                {
                    "length_guess": row.length_guess,
                    "without": row.without,
                    "with": row.with_estimation,
                    "length_estimates": list(row.length_estimates),
                }
                for row in self.rows
            ],
            "mean": float(np.mean(self.errors)) + self.length,
            "std": float(np.std(self.errors)),
            "covered_by_3_std": self.covered,
            "paper_pattern": self.pattern,
        }


def run_table(seeds: int, first_seed: int = 0, progress: Callable[[int, int], None] | None = None) -> TableOne:
    """Run every guess with and without estimation for `seeds` seeds, in parallel processes.

    Args:
        seeds: trials per guess and way.
        first_seed: the seeds are first_seed, first_seed + 1, ...
        progress: called with the number of trials done and their total.

    Raises:
        InputError: fewer than one seed.
    """
    if seeds < 1:
        raise InputError(f"{seeds} seeds: give at least 1")
    keys = list(product(GUESSES, (False, True), range(first_seed, first_seed + seeds)))
    with worker_pool(os.cpu_count() or 1) as pool:
        futures = [pool.submit(_outcome, TrialSettings(length_guess=g, estimate=e, seed=s)) for g, e, s in keys]
        for done, _ in enumerate(as_completed(futures), start=1):
            if progress is not None:
                progress(done, len(futures))
    outcomes = np.array([future.result() for future in futures]).reshape(len(GUESSES), 2, seeds, 3)
    rows = []
    for guess, (without, learnt) in zip(GUESSES, outcomes, strict=True):
        succeeded = [tuple(bool(success) for success in way[:, 0]) for way in (without, learnt)]
        rows.append(TableRow(guess, *succeeded, *(tuple(x.tolist()) for x in learnt[:, 1:].T)))
    return TableOne(seeds, TrialSettings().true_length, tuple(rows))


def _outcome(settings: TrialSettings) -> tuple[bool, float, float]:
    result = run_trial(settings)
    return result.success, result.length_estimate, result.length_std
