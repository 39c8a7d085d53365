"""Score sets of effects of a model that simulates a motion, by their evidence with process noise."""

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from itertools import combinations
from math import log

import numpy as np

from armdyn.estimation.solve import inverse_positive
from armdyn.identify.fit import channel_rmse
from armdyn.identify.problem import transfer_values
from armdyn.identify.selection.candidate import Candidate
from armdyn.identify.selection.set_score import EffectSetScore, EffectSetScorer
from armdyn.identify.state_space.grey_box import CONVERGED_NATS, LinearisationPoint
from armdyn.identify.state_space.grey_run import LINEARISED_PRIOR_STD_TYPICAL_SIZES
from armdyn.identify.state_space.noise_evidence import RunNoiseTables, evaluate_all_noises
from armdyn.identify.state_space.study import StateSpaceStudy

FULLY_SCORED_EFFECT_SETS = 16
"""Number of changed sets, those with the best score at a few noise settings, that are scored in full."""
OPTIMISED_EFFECT_SETS = 4
"""Number of changed sets, those with the best score, that are optimised before one of them is chosen."""
EFFECTS_COMPARED_BY_RESIDUAL = 3
"""Number of effects, those with the best score, whose residuals are compared to choose the next step of a path."""
MAX_EFFECTS_TRIED_IN_PAIRS = 36
"""Number of effects, those with the best score alone, of which pairs are added."""
MAX_SET_FOR_PAIRS = 3
"""Largest number of effects in a set to which pairs of effects are added, because one effect may imitate two."""

POSSIBLE_TIE_NATS = 12.0
"""Difference of log evidence, nats, below which a set is optimised to test whether the runs can tell it apart."""
CACHED_SETS = 4
"""Number of optimised sets whose tables are cached, the most recent ones."""


class StateSpaceScorer(EffectSetScorer):
    """Scores sets of effects by their evidence, each at its most likely process and sensor noise.

    Args:
        study: model, runs and catalogue.
    """

    max_ranked_effects = 5

    def __init__(self, study: StateSpaceStudy) -> None:
        self._study, self._motion = study, study.motion
        problem = self._motion.problem
        seen = [c for c in study.candidates if np.any(problem.mask_of_unknowns(c.names) & self._motion.influential)]
        atoms = tuple(atom for c in seen for atom in c.split_by_joint())
        super().__init__(problem, atoms, catalogue_size=study.catalogue_size)
        self._columns = {c: problem.mask_of_unknowns(c.names) & self._motion.influential for c in self.candidates}
        self._always = self._motion.base
        self._tables: dict[frozenset[Candidate], tuple[LinearisationPoint, RunNoiseTables]] = {}
        self._settled = set[frozenset[Candidate]]()
        self._verified: dict[frozenset[Candidate], tuple[LinearisationPoint, EffectSetScore]] = {}
        self.optimise(())

    def optimise(self, effects: Iterable[Candidate]) -> EffectSetScore:
        """Optimise a set and score it; other sets are then scored by linearisation at this optimum."""
        self._at = frozenset(effects)
        point = self._motion.optimise(self._free(self._at))
        kept = self._tables.pop(self._at, None)
        if kept is None or kept[0] is not point:
            box = self._motion.box
            kept = point, box.evaluate_noises(box.linearise(point), point, evaluate_all_noises)
        self._tables[self._at] = kept
        if len(self._tables) > CACHED_SETS:
            del self._tables[next(iter(self._tables))]
        # Scores from another point are computed again; those of optimised sets stay.
        self._settled.add(self._at)
        self._known = {key: one for key, one in self._known.items() if key in self._settled and key != self._at}
        return self.evaluate(self._at)

    def _verify(self, effects: tuple[Candidate, ...]) -> EffectSetScore:
        """Score of a set at its own motion and noise; linearising by its own unknowns alone is faster."""
        key, free, box = frozenset(effects), self._free(effects), self._motion.box
        point = self._motion.optimise(free)
        if key not in self._verified or self._verified[key][0] is not point:
            own = box.evaluate_noises(box.linearise(point, free), point, evaluate_all_noises)
            self._verified[key] = point, self._score_by(own, effects)
        return self._verified[key][1]

    def _free(self, effects: Iterable[Candidate]) -> np.ndarray:
        """(P,) bool: unknowns that are fitted with a set."""
        free = self._always.copy()
        for c in effects:
            free |= self._columns[c]
        return free

    @property
    def _here(self) -> RunNoiseTables:
        return self._tables[self._at][1]

    def _score_of(self, effects: tuple[Candidate, ...]) -> EffectSetScore:
        return self._score_by(self._here, effects)

    def _score_by(self, tables: RunNoiseTables, effects: tuple[Candidate, ...]) -> EffectSetScore:
        free = self._free(effects)
        found = tables.evidence(free)
        columns = np.flatnonzero(free | (found.change != 0.0))
        price = self.complexity_penalty(effects)
        worth = found.log_evidence + found.prediction_log_likelihood - price if found.within_bounds else -np.inf
        return EffectSetScore(
            effects=effects,
            score=worth,
            likelihood=found.log_evidence + found.occam_penalty_nats,
            held_out_log_likelihood=found.prediction_log_likelihood,
            occam_penalty_nats=found.occam_penalty_nats,
            effective_parameter_count=float(free.sum() - self._always.sum()),
            columns=columns,
            change=found.change[columns],
            misfit=-worth,
        )

    def search_best_effect_set(self, say: Callable[[str], None]) -> EffectSetScore:
        """Search for the set with the best score, starting without effects.

        In each round one or two effects are added, one is exchanged for one or two, or one is removed. A change is
        first scored by linearisation at the present set; it is accepted if the changed set is better at its own optimum
        too.

        Args:
            say: called with a text on the progress.
        """
        now, refused, looked = self.optimise(()), {frozenset[Candidate]()}, False
        while True:
            say(f"{len(now.effects)} effects chosen")
            changed = [one for one in self._changed(now.effects) if frozenset(one) not in refused]
            promised = [self.evaluate(one) for one in self._looked_at(changed)]
            promised = sorted((o for o in promised if o.score > now.score + CONVERGED_NATS), key=lambda o: -o.score)
            options = _unlike([one.effects for one in promised], now.effects)[:OPTIMISED_EFFECT_SETS]
            gains = {one.effects: one.score - now.score for one in promised}
            found, share = list[EffectSetScore](), self.settings.search.missing_evidence_share
            for i, option in enumerate(options):
                if gains[option] < share * max((one.score - now.score for one in found), default=0.0):
                    break  # the options that follow promise less still
                say(f"{i} of {len(options)} candidates tried, now {', '.join(c.name_in_sentence for c in option)}")
                refused.add(frozenset(option))
                found.append(self._verify(option))
            better = [one for one in sorted(found, key=lambda o: -o.score) if one.score > now.score + CONVERGED_NATS]
            following = next((one for one in better if one.score > self._again(now, one).score + CONVERGED_NATS), None)
            if following is not None:
                now = self.optimise(following.effects)
                continue
            now = self.optimise(now.effects)
            moved = set() if looked or not self._lacks_more(now) else self._moved_thresholds(now)
            if not moved:
                return now
            looked = True
            say("searching thresholds beside the effects that were found")
            refused = {one for one in refused if moved.isdisjoint(one)}
            now = self.optimise(now.effects)

    def _lacks_more(self, now: EffectSetScore) -> bool:
        """Whether a set has effects, and whole runs show that more than noise is left."""
        study = self._study
        return bool(now.effects) and not study.residual_may_be_noise(study.quick_fit((*study.present, *now.effects)))

    def _moved_thresholds(self, now: EffectSetScore) -> set[Candidate]:
        """Effects whose threshold was found elsewhere beside a set; all that was computed with them is forgotten."""
        names = set(self._study.move_thresholds(self._free(now.effects)))
        moved = {c for c in self.candidates if not names.isdisjoint(c.names)}
        if moved:
            self._settled = {key for key in self._settled if moved.isdisjoint(key)}
            self._verified = {key: one for key, one in self._verified.items() if moved.isdisjoint(key)}
            self._tables, self._known = {}, {}
        return moved

    def ties(self, whole: EffectSetScore, other: EffectSetScore, without: EffectSetScore) -> bool:
        """Whether the runs cannot tell two sets apart, by their evidence or by their residuals.

        Where the residual is above the noise, another effect is missing too, so sets whose residuals differ by little
        count as equal.

        Args:
            whole: the better set.
            other: the set that is compared with it.
            without: the set of the effects that both share.
        """
        search = self.settings.search
        standing = self.schwarz_criterion_nats(whole)
        gap = standing - self.schwarz_criterion_nats(other)
        near = gap <= search.missing_evidence_share * (standing - self.schwarz_criterion_nats(without))
        if (near or gap < POSSIBLE_TIE_NATS) and standing - self.schwarz_criterion_nats(
            self._again(other, whole)
        ) < search.tie_nats:
            return True
        study = self._study
        if not near or study.asked:
            return False  # the evidence decides in an experiment that was made to distinguish them
        found = study.fit_base_with_effects((*study.present, *whole.effects))
        if study.residual_may_be_noise(found):
            return False
        least = study.squared_error(found)
        left, most = (study.left((*study.present, *one.effects)) for one in (other, without))
        return left * search.needed_share(1) < least and left - least < search.explained_share_per_parameter * (
            most - least
        )

    def effects_on_other_states(
        self, whole: EffectSetScore, rest: Sequence[Candidate], part: Sequence[Candidate]
    ) -> Iterator[tuple[Candidate, ...]]:
        """Effects on other states of a process that may be tied with a `part` of a set, the same effect as well."""
        joints, least = {j for c in part for j in c.joints}, self.schwarz_criterion_nats(whole) - POSSIBLE_TIE_NATS
        for c in self.candidates:
            there = c not in whole.effects and not set(c.joints) <= joints
            if there and self.schwarz_criterion_nats(self.evaluate((*rest, c))) > least:
                yield (c,)

    def _again(self, now: EffectSetScore, better: EffectSetScore) -> EffectSetScore:
        """The score of a set, optimised from the point of a better one as well: its noise may be better there."""
        self._motion.optimise(self._free(now.effects), self._free(better.effects))
        return self._verify(now.effects)

    def _looked_at(self, sets: Sequence[tuple[Candidate, ...]]) -> Sequence[tuple[Candidate, ...]]:
        """The sets of many that are worth a full score."""
        coarse = self._coarse()
        ranked = sorted(sets, key=lambda one: self._promised(coarse, one), reverse=True)
        return list(
            dict.fromkeys([*ranked[:FULLY_SCORED_EFFECT_SETS], *_unlike(ranked, self._at)[:FULLY_SCORED_EFFECT_SETS]])
        )

    def _coarse(self) -> RunNoiseTables:
        """Sums at few noises, those near the one that suits the present set."""
        here = self._here
        return here.coarsened(here.evidence(self._free(self._at)))

    def _promised(self, coarse: RunNoiseTables, one: tuple[Candidate, ...]) -> float:
        found = coarse.evidence(self._free(one))
        return (
            found.log_evidence + found.prediction_log_likelihood - self.complexity_penalty(one)
            if found.within_bounds
            else -np.inf
        )

    def _changed(self, effects: tuple[Candidate, ...]) -> Iterator[tuple[Candidate, ...]]:
        """Sets that differ from a set by a small change."""
        left = [c for c in self.candidates if c not in effects]
        paired = left
        if len(left) > MAX_EFFECTS_TRIED_IN_PAIRS:
            coarse = self._coarse()
            paired = sorted(left, key=lambda c: -self._promised(coarse, (*effects, c)))[:MAX_EFFECTS_TRIED_IN_PAIRS]
        coming = [(), *((c,) for c in left), *(combinations(paired, 2) if len(effects) <= MAX_SET_FOR_PAIRS else ())]
        for gone in (None, *effects):
            rest = tuple(c for c in effects if c != gone)
            yield from (tuple(c for c in self.candidates if c in {*rest, *come}) for come in coming if come or gone)

    def set_with_next_reported_effect(
        self, now: EffectSetScore, options: Sequence[Sequence[Candidate]]
    ) -> EffectSetScore:
        """Of the sets with one of the options added, the one that a report should name first.

        It has the smallest error of whole runs among those with the best scores.
        """
        self.optimise(now.effects)
        promised = sorted((self.evaluate((*now.effects, *one)) for one in options), key=lambda one: -one.score)
        compared = promised if not now.effects else promised[:EFFECTS_COMPARED_BY_RESIDUAL]
        best = min(compared, key=lambda one: self._study.left((*self._study.present, *one.effects)))
        return self.optimise(best.effects)

    def values(self, one: EffectSetScore) -> np.ndarray:
        """(P,) values of all unknowns at a set's optimum."""
        values = self._here.values.copy()
        values[one.columns] += one.change
        return values

    def schwarz_criterion_nats(self, one: EffectSetScore) -> float:
        """Score of a set in nats without the prior on sizes (Schwarz 1978), for comparing two sets."""
        return one.likelihood + one.held_out_log_likelihood - 0.5 * one.effective_parameter_count * log(self._here.rows)

    def rmse_by_channel(self, one: EffectSetScore) -> tuple[dict[str, float], dict[str, float]]:
        """Root mean square output error by channel, of training runs and of held-out runs."""
        fit = self._study.quick_fit((*self._study.present, *one.effects))
        held_out = self._study.held_out_blocks(fit) if self._study.held_out else []
        return fit.rmse(), channel_rmse(held_out)

    def fitted_values(self, one: EffectSetScore) -> tuple[np.ndarray, np.ndarray]:
        """(P,) values of a set's output-error fit, and (P,) their standard deviations."""
        fit = self._study.quick_fit((*self._study.present, *one.effects))
        found = self._here.evidence(self._free(one.effects))
        T = self.problem.typical
        told = np.isfinite(found.information).all()  # where a simulation diverges, nothing is determined
        information = T[:, None] * found.information * T if told else np.zeros((len(T), len(T)))
        spread = inverse_positive(np.eye(len(T)) / LINEARISED_PRIOR_STD_TYPICAL_SIZES**2 + information)
        deviations = T * np.sqrt(np.maximum(np.diag(spread), 0.0))
        return transfer_values(fit.values, fit.problem, self.problem), deviations


def _unlike(sets: Iterable[tuple[Candidate, ...]], now: Collection[Candidate]) -> list[tuple[Candidate, ...]]:
    """Sets, in their order, each of which adds (or else removes) an effect that no earlier one does."""
    found, changed = list[tuple[Candidate, ...]](), set[Candidate]()
    for effects in sets:
        change = set(effects).difference(now) or set(now).difference(effects)
        if not change & changed:
            found.append(effects)
            changed |= change
    return found
