"""Appraisal by refits: for models whose minimum moves as effects come in, as a pendulum's does.

What a set is worth is computed from its own minimum; predictions of left-out runs are linear around it. Which sets are
refitted is foretold from one expansion with every effect, at the best set so far. Far above the noise an expansion says
little: there every effect is sketched in a few steps, and the best get other starts as well.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import cache
from itertools import combinations

import numpy as np

from armdyn.identify.appraisal import NOISY, Appraisal, Change, SampleAppraiser
from armdyn.identify.candidate import Candidate
from armdyn.identify.fit import GROSS, Fit
from armdyn.identify.problem import Block
from armdyn.identify.study import LONG, Study
from armdyn.identify.subset import Solver, Subset
from armdyn.identify.summed import Summed, deviations
from armdyn.identify.sums import sums_at

SKETCHED = 5
"""Sets, of those that are foretold to be best, that are sketched in a round."""
REFITTED = 9
"""Effects that are carried on where all had to be sketched."""
THOROUGH = 5
"""Sets that are fitted from other starts, where none is close."""
LEADING = 2
"""Of the refitted sets, how many are carried on after a sketch, beside those that are nearly as good."""
HOPELESS = 0.5
"""Share of its further price below which what a set is foretold to gain is not worth a refit."""
BEHIND = 30.0
"""Chi2 by which a set that lacks an effect of the best one may be foretold to stay behind it: foretelling is off by
less."""
LOOSE = 10.0
"""Times the prior widths that an effect may have where its gain is foretold: a refit has no such width, and a load cell
for 5 kg has an offset of a hundred typical ones."""
PAIRED = 5
"""Effects whose pairs are sketched where an expansion says little."""
SAME = 1e-4
"""Relative difference of the costs of two effects that do the same."""
LEAST_SHARE = 0.25
"""Of what is left above the noise, what each effect must explain: errors of the measured motion and effects that are
missing leave a residual that small gains only happen to look like."""


class Refitted(SampleAppraiser):
    """Appraises sets of effects by fitting them.

    Args:
        study: model, runs, catalogue.
        say: told how many of how many sets are tried.
    """

    few = True

    def __init__(self, study: Study, say: Callable[[str], None] | None = None) -> None:
        self._study = study
        self._say = say or (lambda _: None)
        first = study.first()
        self._fits: dict[frozenset[Candidate], Fit] = {frozenset(): first}
        self._rough: set[frozenset[Candidate]] = set()  # sketched, not fitted
        self._tried: set[tuple[frozenset[Candidate], frozenset[Candidate]]] = set()  # from which best set
        self._contenders: dict[frozenset[Candidate], tuple[Candidate, ...]] = {}
        p = study.problem
        self._base = p.fitted & ~p.of([n for c in study.candidates for n in c.names])
        candidates = tuple(atom for c in study.candidates for atom in c.apart())
        super().__init__(sums_at(first, first.blocks, self._held_out(first)), self._base, candidates)
        self._expand(first, frozenset())

    def fit(self, one: Appraisal) -> Fit:
        """The minimum of a set."""
        return self._fits[frozenset(one.effects)]

    def useful(self, more: Appraisal, fewer: Appraisal) -> bool:
        """Whether each further effect explains `LEAST_SHARE` of what is left above the noise.

        As in the score, likelihood says how much that is where only noise is left, and predicted runs where more is.
        Effects that were asked about are spared: an experiment that was made to see them, on a robot whose own errors
        stay, shows them by what they are worth.
        """
        further = sum(c not in fewer.effects and c.effect not in self._study.asked for c in more.effects)
        before, after = self.fit(fewer), self.fit(more)
        by_cost = _share(before.cost, after.cost, before.samples + np.sqrt(2.0 * before.samples))
        by_runs = _share(fewer.misfit, more.misfit, self.floor)
        share = self.limited * by_runs + (1.0 - self.limited) * by_cost
        return bool(share >= LEAST_SHARE * further)

    def without(self, now: Appraisal, gone: Candidate) -> Appraisal:
        """See `Appraiser.without`: also fitted from where the set stands, which may have led out of a wrong minimum."""
        effects = [c for c in now.effects if c != gone]
        key, here = frozenset(effects), frozenset(now.effects)
        if key in self._fits and (key, here) not in self._tried and self._fits[key].cost > self._fits[here].cost:
            other = self._study.sketch((*self._study.present, *effects), self._fits[here])
            if other.cost < self._fits[key].cost:
                self._keep(key, self._study.fit_with((*self._study.present, *effects), other))
        self._tried.add((key, here))
        return self.of(effects)

    def advance(self, now: Appraisal) -> None:
        """See `Appraiser.advance`: expand there, and measure by what the richest model leaves there."""
        key = frozenset(now.effects)
        if key != self._at:
            if key in self._rough:
                self._carry_on(key)
            self._keep(key, self._study.to_the_end(self._fits[key]))
            self._expand(self._fits[key], key)

    def _expand(self, fit: Fit, key: frozenset[Candidate]) -> None:
        self._at = key
        around = sums_at(fit, fit.problem.blocks(fit.values))
        self._around = Summed(around, self._base, self.candidates, loose=LOOSE)
        self.measure(self._around.left)

    def _learn(self, fit: Fit) -> None:
        """A fit that leaves less than the richest model of the expansion shows better what noise there is."""
        units, importance = self._training, self._importance[self._training]
        left = {unit: block.misfit for unit, block in zip(units.tolist(), fit.blocks, strict=True)}
        if importance @ self._levels(left)[units] < importance @ self.level[units]:
            self.measure(left)

    def _solved(self, effects: tuple[Candidate, ...]) -> tuple[Solver, Subset]:
        fit = self._fitted(effects)
        solver = Solver(sums_at(fit, fit.blocks, self._held_out(fit)), fit.free, ())
        solver.weigh(self.independent / (self.sums.count * self.level))
        return solver, solver.subset(())

    def _held_out(self, fit: Fit) -> list[Block]:
        channels = {block.channel for block in fit.blocks}
        blocks = self._study.held_out_blocks(fit) if self._study.held_out else None
        return [block for block in blocks or () if block.channel in channels]

    def _fitted(self, effects: Sequence[Candidate]) -> Fit:
        key = frozenset(effects)
        if key not in self._fits:
            self._fits[key] = self._study.fit_with((*self._study.present, *effects), self._nearest(key))
        return self._fits[key]

    def _nearest(self, key: frozenset[Candidate]) -> Fit:
        """The best of the fits whose effects differ least."""
        near = min(self._fits, key=lambda other: (len(other ^ key), self._fits[other].cost))
        return self._fits[near]

    def values(self, one: Appraisal) -> np.ndarray:
        """See `Appraiser.values`."""
        return self.fit(one).values

    def deviations(self, one: Appraisal) -> np.ndarray:
        """See `Appraiser.deviations`."""
        return deviations(self._solved(one.effects)[0], one, self._training)

    def holds(self, richer: Candidate, simpler: Candidate) -> bool:
        """See `Appraiser.holds`."""
        return self._around.holds(richer, simpler)

    def promising(self, now: Appraisal, changes: Sequence[Change], most: int) -> list[Appraisal]:
        """See `Appraiser.promising`."""
        alone = changes and all(not gone and len(come) == 1 for gone, come in changes)
        if alone and not now.effects and self.fit(now).chi2_per_sample > GROSS:
            return self._raced(now, [come for _, come in changes])
        if changes and len(changes[0][1]) == 2 and self.fit(now).chi2_per_sample > GROSS:
            return self._followed(self._pairs_of_best(now, changes))
        here, around = self._around.of(now.effects), self._around
        standing = around.remaining(here) + 2.0 * self.price(now.effects)
        sets = []
        for effects, foretold in around.foretold(here, changes):
            further = self.price(effects) - self.price(now.effects)
            grown = len(effects) > len(now.effects)
            if foretold - standing < (min(BEHIND, (2.0 - HOPELESS) * further) if grown else BEHIND):
                sets.append(effects)
        return self._followed(sets[: min(most, SKETCHED)])

    def _pairs_of_best(self, now: Appraisal, changes: Sequence[Change]) -> list[tuple[Candidate, ...]]:
        """Where an expansion says little: pairs, in place of an effect, of those that alone did best there."""
        sets = []
        for gone in dict.fromkeys(tuple(gone) for gone, _ in changes if gone):
            rest = [c for c in now.effects if c not in gone]
            keys = {c: frozenset((*rest, c)) for c in self.candidates if c not in rest}
            alone = sorted((c for c in keys if keys[c] in self._fits), key=lambda c: self._fits[keys[c]].cost)
            costs = [self._fits[keys[c]].cost for c in alone]
            # Of those that do exactly the same one will do.
            distinct = [c for i, c in enumerate(alone) if i == 0 or costs[i] - costs[i - 1] > SAME * costs[i]]
            sets += [(*rest, *pair) for pair in combinations(distinct[:PAIRED], 2) if gone[0] not in pair]
        return sets

    def contenders(self, rest: Appraisal) -> tuple[Candidate, ...]:
        """See `Appraiser.contenders`."""
        key = frozenset(rest.effects)
        if key not in self._contenders:
            left = [((), (c,)) for c in self.candidates if c not in rest.effects]
            found = self.promising(rest, left, REFITTED)
            self._contenders[key] = tuple(c for one in found for c in one.effects if c not in rest.effects)
        return self._contenders[key]

    def _raced(self, now: Appraisal, options: Sequence[Sequence[Candidate]]) -> list[Appraisal]:
        """Every option is sketched; the best are carried on, and get other starts where none comes close.

        Of a long recording only those are sketched whole that suit its beginning best.
        """
        study, near = self._study, self.fit(now)
        sets = [(*now.effects, *option) for option in options]

        @cache
        def begins(effects: tuple[Candidate, ...]) -> float:
            cost = study.begun_with((*study.present, *effects), near).cost
            return cost if np.isfinite(cost) else np.inf

        if near.samples > LONG:
            sets = sorted(sets, key=begins)[:REFITTED]
        for effects in self._counted(sets, "sketched"):
            if frozenset(effects) not in self._fits:
                self._sketched(effects)
        ranked = sorted(sets, key=lambda effects: self._fits[frozenset(effects)].cost)[:REFITTED]
        found = [one.effects for one in self._followed(ranked)]
        if min(self._fits[frozenset(effects)].chi2_per_sample for effects in ranked) > NOISY:
            whole = sorted(found, key=lambda effects: self._fits[frozenset(effects)].cost)
            early = sorted(sets, key=begins)
            tried = list(dict.fromkeys(e for pair in zip(early, whole, strict=False) for e in pair))[:THOROUGH]
            found += [effects for effects in tried if effects not in found]
            for effects in self._counted(tried, "tried from other starts"):
                key = frozenset(effects)
                self._keep(key, study.fit_thoroughly((*study.present, *effects), self._fits[key]))
                if self._fits[key].chi2_per_sample < NOISY:
                    break
        self._contenders[frozenset(now.effects)] = tuple(
            c for effects in found for c in effects if c not in now.effects
        )
        return [self.of(effects) for effects in found]

    def _sketched(self, effects: Sequence[Candidate]) -> None:
        """Sketch a set that is new, and one that stands worse than the best set could be exchanged for it."""
        key, wanted = frozenset(effects), (*self._study.present, *effects)
        best = self._fits[self._at]
        if key not in self._fits:
            self._fits[key] = self._study.sketch(wanted, self._nearest(key))
            self._rough.add(key)
        elif (key, self._at) not in self._tried and self._fits[key].cost > best.cost:
            other = self._study.sketch(wanted, best, self._around.values(self._around.of(effects)))
            if other.cost < self._fits[key].cost:
                self._fits[key] = other
                self._rough.add(key)
                self._known.pop(key, None)
        self._tried.add((key, self._at))

    def _keep(self, key: frozenset[Candidate], fit: Fit) -> None:
        """Take a better fit of a set, and what it shows of the noise."""
        self._rough.discard(key)
        if fit is not self._fits.get(key):
            self._fits[key] = fit
            self._known.pop(key, None)
            self._learn(fit)

    def _followed(self, sets: Sequence[tuple[Candidate, ...]]) -> list[Appraisal]:
        """Appraisals of sets: all are sketched, those that lead are carried on."""
        for effects in self._counted(sets, "tried"):
            self._sketched(effects)
        standing = {k: self._fits[k].cost + 2.0 * self.price(e) for e in sets for k in [frozenset(e)]}
        order = sorted(standing, key=lambda key: standing[key])
        for place, key in enumerate(order):
            if key in self._rough and (place < LEADING or standing[key] < standing[order[0]] + BEHIND):
                self._carry_on(key)
        return [self.of(effects) for effects in sets]

    def _counted(self, sets: Sequence[tuple[Candidate, ...]], done: str) -> Iterator[tuple[Candidate, ...]]:
        for i, effects in enumerate(sets):
            self._say(f"{i} of {len(sets)} candidates {done}")
            yield effects

    def _carry_on(self, key: frozenset[Candidate]) -> None:
        self._keep(key, self._study.fit_with((*self._study.present, *key), self._fits[key]))


def _share(before: float, after: float, noise: float) -> float:
    """Of what is left above the noise, the share that is gone; 1 where nothing is left."""
    return 1.0 if before <= noise else (before - after) / (before - noise)
