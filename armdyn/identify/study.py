"""A model, runs and a catalogue: every fit that a diagnosis or a repair asks for, each done once."""

from collections.abc import Iterable, Sequence
from functools import lru_cache

import numpy as np

from armdyn.effects.effect import Effect
from armdyn.identify.evidence import Weighed, Whitening, weighed, whitening_of
from armdyn.identify.fit import GROSS, Fit, determined, fit
from armdyn.identify.held_out import held_out_blocks
from armdyn.identify.prepare import noise_of_runs, prepared, stated_noise
from armdyn.identify.problem import Block, Problem
from armdyn.identify.score import Candidate, Score, scores
from armdyn.model import Model
from armdyn.run import Run


class Study:
    """Fits of one model with any of the catalogue's effects.

    One formulation holds every effect at its null value; a fit frees the columns it needs.

    Args:
        model: with the effects that it has.
        runs: for training.
        held_out: whole runs that take no part in any fit.
        catalogue: effects that may be missing.

    Raises:
        InputError: see `prepare.prepared`.
    """

    def __init__(
        self, model: Model, runs: Sequence[Run], held_out: Sequence[Run], catalogue: Iterable[Effect]
    ) -> None:
        self.model = model
        self.runs, self.held_out = prepared(model, runs, held_out)
        everything = [*self.runs, *self.held_out]
        self.noise = noise_of_runs(model, everything)
        self.noise_is_stated = stated_noise(model, everything)
        extended = model.with_candidates(catalogue)
        self.problem = Problem(extended, self.runs, self.noise)
        self.candidates = tuple(
            Candidate(effect.name, tuple(j for j in extended.parts(effect.name) if j),
                      tuple(n for names in extended.parts(effect.name).values() for n in names))
            for effect in extended.effects
        )  # fmt: skip
        self._of_effect = {c.effect: self.problem.of(c.names) for c in self.candidates}
        self._fits: dict[tuple[Candidate, ...], Fit] = {}
        self._held_out: dict[int, list[Block] | None] = {}
        self._first: Fit | None = None

    @property
    def present(self) -> tuple[Candidate, ...]:
        """The effects that the given model has."""
        names = {effect.name for effect in self.model.effects}
        return tuple(c for c in self.candidates if c.effect in names)

    def first(self) -> Fit:
        """The fit of the model as given."""
        if self._first is None:
            alone = Problem(self.model, self.runs, self.noise)
            start = alone.start()
            free = alone.fitted & determined(alone, alone.fitted, start)
            found = fit(alone, free, start, windows=True)
            again = alone.fitted & determined(alone, alone.fitted, found.values)
            if np.any(again != free):
                found = fit(alone, again, found.values)
            values, mask = self.problem.start(), np.zeros(len(self.problem.columns), dtype=bool)
            place = {column.name: i for i, column in enumerate(self.problem.columns)}
            for column, value, is_free in zip(alone.columns, found.values, found.free, strict=True):
                values[place[column.name]], mask[place[column.name]] = value, is_free
            self._first = Fit(self.problem, mask, values, tuple(self.problem.blocks(values)), found.outcome)
            self._fits[self._key(self.present)] = self._first
        return self._first

    def fit_with(self, effects: Sequence[Candidate], near: Fit) -> Fit:
        """The model's base with exactly these effects, started from the fit `near` and, where that is bad, afresh."""
        key = self._key(effects)
        if key not in self._fits:
            free, start = self._released(effects, near)
            starts = [start]
            if near.chi2_per_sample > GROSS:
                starts.append(self._pushed(effects, start, near))
            best = min((fit(self.problem, free, s) for s in starts), key=lambda f: f.cost)
            if best.chi2_per_sample > GROSS:
                afresh = fit(self.problem, free, self._pushed(effects, self._cold(), near), windows=True)
                best = min(best, afresh, key=lambda f: f.cost)
            self._fits[key] = best
        return self._fits[key]

    def scores(self, at: Fit, effects: Sequence[Candidate]) -> list[Score]:
        """Promises of the effects that are not among `effects`."""
        return scores(at, [c for c in self.candidates if c not in effects])

    def held_out_blocks(self, found: Fit) -> list[Block] | None:
        """Residuals of runs that took no part; see `held_out.held_out_blocks`."""
        key = id(found)
        if key not in self._held_out:
            self._held_out[key] = held_out_blocks(found, self.held_out)
            self._keep_alive = (*getattr(self, "_keep_alive", ()), found)
        return self._held_out[key]

    def weighed(self, fits: Sequence[Fit]) -> tuple[list[Weighed], Whitening]:
        """Fits under the whitening that the best of them asks for."""
        best = min(range(len(fits)), key=lambda i: fits[i].cost)
        for _ in range(3):
            whitening = whitening_of(fits[best])
            compared = [weighed(found, whitening) for found in fits]
            now = min(range(len(fits)), key=lambda i: compared[i].cost)
            if now == best:
                break
            best = now
        return compared, whitening

    def _released(self, effects: Sequence[Candidate], near: Fit) -> tuple[np.ndarray, np.ndarray]:
        """What is free with these effects, and values near a fit; other effects are at their null values."""
        values = near.values.copy()
        free = self.problem.fitted.copy()
        for candidate in self.candidates:
            mask = self._of_effect[candidate.effect]
            if candidate in effects:
                wanted = mask & ~self._held_fixed
                free |= wanted
            else:
                free &= ~mask
                values[mask] = self.problem.null[mask]
        known_slopes = near.values if near.problem is self.problem else values
        return free & determined(self.problem, free, known_slopes), values

    @property
    def _held_fixed(self) -> np.ndarray:
        """Parameters of present effects that the user fixed."""
        mask = np.zeros(len(self.problem.columns), dtype=bool)
        for candidate in self.present:
            mask |= self._of_effect[candidate.effect] & ~self.problem.fitted
        return mask

    def _pushed(self, effects: Sequence[Candidate], start: np.ndarray, near: Fit) -> np.ndarray:
        """Effects that are at null start at a typical size, those that were fitted without the others at half."""
        values = start.copy()
        for candidate in effects:
            mask = self._of_effect[candidate.effect]
            at_null = mask & (values == self.problem.null)
            fitted_before = mask & near.free & ~at_null
            values[at_null] = np.clip(self.problem.null + self.problem.typical, self.problem.lower, self.problem.upper)[at_null]
            values[fitted_before] *= 0.5
        return values

    def _cold(self) -> np.ndarray:
        return self.problem.start()

    @staticmethod
    def _key(effects: Sequence[Candidate]) -> tuple[Candidate, ...]:
        return tuple(sorted(effects, key=lambda c: c.effect))
