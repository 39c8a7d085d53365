"""The paper's Table I: nine guesses of the length, with and without estimation, over seeds."""

import os
from collections.abc import Callable
from concurrent.futures import as_completed
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from armdyn.errors import InputError
from ik.child_processes import worker_pool
from pipeline.trial.settings import TrialSettings
from pipeline.trial.simulated import run_trial

GUESSES = (0.308, 0.328, 0.348, 0.368, 0.388, 0.408, 0.428, 0.448, 0.468)
"""First guesses of the paper [m], whose string is 0.368 m long."""
PAPER_WITHOUT = (0.368, 0.388)
"""Guesses that succeed without estimation in the paper [m]; with estimation all nine do."""


@dataclass(frozen=True, eq=False)
class TableOne:
    """The paper's Table I for the 9 `GUESSES` and n seeds.

    Attributes:
        true_length: true length [m].
        succeeded: (9, 2, n) whether each trial without and with estimation succeeded.
        estimates: (9, n) length of every trial with estimation [m].
        stds: (9, n) reported standard deviations [m].
    """

    true_length: float
    succeeded: np.ndarray
    estimates: np.ndarray
    stds: np.ndarray

    @property
    def seeds(self) -> int:
        """Number of trials per guess, with and without estimation each."""
        return self.succeeded.shape[2]

    @property
    def shares(self) -> np.ndarray:
        """(2, 9) share of the seeds that succeed, without and with estimation."""
        return np.asarray(self.succeeded.mean(axis=2).T)

    @property
    def errors(self) -> np.ndarray:
        """(9, n) estimate minus truth [m]."""
        return self.estimates - self.true_length

    @property
    def in_paper(self) -> np.ndarray:
        """(9,) whether a guess succeeds without estimation in the paper."""
        return np.isin(GUESSES, PAPER_WITHOUT)

    @property
    def covered(self) -> float:
        """Share of the trials whose truth is within three reported standard deviations."""
        return float(np.mean(np.abs(self.errors) <= 3 * self.stds))

    def as_json(self) -> dict[str, Any]:
        """JSON ``armdyn.table/1`` of the table."""
        rows = zip(GUESSES, *self.shares.tolist(), self.estimates.tolist(), strict=True)
        names = "length_guess", "without", "with", "length_estimates"
        as_in_paper = (self.succeeded[:, 0] == self.in_paper[:, None]).all(axis=0)
        return {
            "schema": "armdyn.table/1",
            "seeds": self.seeds,
            "rows": [dict(zip(names, row, strict=True)) for row in rows],
            "mean": float(np.mean(self.errors)) + self.true_length,
            "std": float(np.std(self.errors)),
            "covered_by_3_std": self.covered,
            "paper_pattern": float(np.mean(as_in_paper)),
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
    return TableOne(TrialSettings().true_length, outcomes[..., 0] > 0.0, outcomes[:, 1, :, 1], outcomes[:, 1, :, 2])


def _outcome(settings: TrialSettings) -> tuple[bool, float, float]:
    result = run_trial(settings)
    return result.success, result.length_estimate, result.length_std
