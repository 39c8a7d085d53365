"""Table I of the paper: trials with nine guesses of the string's length, with and without estimation, by seed."""

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

STRING_LENGTH_GUESSES = (0.308, 0.328, 0.348, 0.368, 0.388, 0.408, 0.428, 0.448, 0.468)
"""First guesses of the string's length in the paper's Table I [m]; the true length is 0.368 m."""
SUCCESSFUL_GUESSES_WITHOUT_ESTIMATE = (0.368, 0.388)
"""Guesses of the length with which trials without estimation succeed in the paper [m]; with estimation all succeed."""


@dataclass(frozen=True, eq=False)
class TableOne:
    """Results for Table I of the paper: trials with the 9 `STRING_LENGTH_GUESSES` and n random seeds.

    Attributes:
        true_length: true length of the string [m].
        succeeded: whether each trial succeeded, without and with estimation (9, 2, n).
        estimates: estimated lengths of the trials with estimation (9, n) [m].
        stds: their reported standard deviations (9, n) [m].
    """

    true_length: float
    succeeded: np.ndarray
    estimates: np.ndarray
    stds: np.ndarray

    @property
    def seeds(self) -> int:
        """Number of random seeds: trials per guess without estimation, and likewise with estimation."""
        return self.succeeded.shape[2]

    @property
    def success_shares(self) -> np.ndarray:
        """Share of successful trials for each guess, without and with estimation (2, 9)."""
        return np.asarray(self.succeeded.mean(axis=2).T)

    @property
    def errors(self) -> np.ndarray:
        """Estimated minus true length for each guess and seed (9, n) [m]."""
        return self.estimates - self.true_length

    @property
    def succeeded_in_paper(self) -> np.ndarray:
        """Whether the paper's trials without estimation succeed, for each guess (9,)."""
        return np.isin(STRING_LENGTH_GUESSES, SUCCESSFUL_GUESSES_WITHOUT_ESTIMATE)

    @property
    def covered_share(self) -> float:
        """Share of trials in which the true length is within three reported standard deviations of the estimate."""
        return float(np.mean(np.abs(self.errors) <= 3 * self.stds))

    def as_json(self) -> dict[str, Any]:
        """The table as JSON ``armdyn.table/1``."""
        rows = zip(STRING_LENGTH_GUESSES, *self.success_shares.tolist(), self.estimates.tolist(), strict=True)
        names = "length_guess", "without", "with", "length_estimates"
        as_in_paper = (self.succeeded[:, 0] == self.succeeded_in_paper[:, None]).all(axis=0)
        return {
            "schema": "armdyn.table/1",
            "seeds": self.seeds,
            "rows": [dict(zip(names, row, strict=True)) for row in rows],
            "mean": float(np.mean(self.errors)) + self.true_length,
            "std": float(np.std(self.errors)),
            "covered_by_3_std": self.covered_share,
            "paper_pattern": float(np.mean(as_in_paper)),
        }


def run_table_one(seeds: int, first_seed: int = 0, progress: Callable[[int, int], None] | None = None) -> TableOne:
    """Run the trials of Table I of the paper in parallel processes: every guess, with and without estimation.

    Args:
        seeds: number of random seeds.
        first_seed: first seed; the others follow it, in steps of 1.
        progress: called with the number of trials done and their total.

    Raises:
        InputError: fewer than one seed.
    """
    if seeds < 1:
        raise InputError(f"{seeds} seeds: give at least 1")
    keys = list(product(STRING_LENGTH_GUESSES, (False, True), range(first_seed, first_seed + seeds)))
    with worker_pool(os.cpu_count() or 1) as pool:
        futures = [pool.submit(_outcome, TrialSettings(length_guess=g, estimate=e, seed=s)) for g, e, s in keys]
        for done, _ in enumerate(as_completed(futures), start=1):
            if progress is not None:
                progress(done, len(futures))
    outcomes = np.array([future.result() for future in futures]).reshape(len(STRING_LENGTH_GUESSES), 2, seeds, 3)
    return TableOne(TrialSettings().true_length, outcomes[..., 0] > 0.0, outcomes[:, 1, :, 1], outcomes[:, 1, :, 2])


def _outcome(settings: TrialSettings) -> tuple[bool, float, float]:
    result = run_trial(settings)
    return result.success, result.length_estimate, result.length_std
