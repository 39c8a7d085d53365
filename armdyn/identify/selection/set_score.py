"""Score sets of effects for given runs, in nats, less a penalty for complexity.

`LinearScorer` scores what a set predicts of motions to which it was not fitted; `StateSpaceScorer` the evidence of the
training runs, which is the likelihood at the best values less Occam's factor of the unknowns and a Cauchy prior on
their sizes (MacKay, Neural Computation 4, 1992), and the likelihood of the predicted held-out runs.
"""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from math import lgamma, log
from typing import ClassVar

import numpy as np

from armdyn.identify.problem import Problem
from armdyn.identify.selection.candidate import Candidate


@dataclass(frozen=True, eq=False)
class EffectSetScore:
    """Score of one set of effects.

    Attributes:
        effects: effects of the set, each on one joint.
        score: score in nats; it is comparable with that of other sets for the same runs.
        likelihood: log likelihood of the training runs.
        held_out_log_likelihood: log likelihood of the predicted held-out runs; 0 where there are none.
        occam_penalty_nats: penalty, nats, for the freedom of the effects' unknowns: Occam's factor and the prior on
            their sizes.
        effective_parameter_count: number of the effects' unknowns that the runs, not the priors, determine.
        columns: (c,) indices of the unknowns that change.
        change: (c,) change of these unknowns, from the point of linearisation to the fit to all training runs, in their
            units.
        misfit: mean squared error over the training runs plus that over the held-out runs, summed over channels, not
            below the noise; in the squared unit of the channels if they have one, else relative to the noise.
    """

    effects: tuple[Candidate, ...]
    score: float
    likelihood: float
    held_out_log_likelihood: float
    occam_penalty_nats: float
    effective_parameter_count: float
    columns: np.ndarray
    change: np.ndarray
    misfit: float


class EffectSetScorer(ABC):
    """Base class of objects that score sets of effects.

    Args:
        problem: the problem of the unknowns.
        candidates: all effects that a set may contain, each on one joint.
        given: candidates that the model already has; every set contains them.
        catalogue_size: number of effects from which the candidates were chosen, if it is larger than theirs.
    """

    max_ranked_effects: ClassVar[int]
    """Largest number of effects in a ranking of those that may be missing."""

    def __init__(
        self,
        problem: Problem,
        candidates: Sequence[Candidate],
        given: Sequence[Candidate] = (),
        catalogue_size: int = 0,
    ) -> None:
        self.problem, self.settings, self._catalogue_size = problem, problem.settings, catalogue_size
        self.candidates, self.given = tuple(candidates), tuple(given)
        self._reach = Counter(c.effect for c in candidates)
        self._known: dict[frozenset[Candidate], EffectSetScore] = {}

    @abstractmethod
    def _score_of(self, effects: tuple[Candidate, ...]) -> EffectSetScore:
        """The score of a set, in the order of the candidates."""

    @abstractmethod
    def values(self, one: EffectSetScore) -> np.ndarray:
        """(P,) values of all unknowns at a set's minimum."""

    @abstractmethod
    def schwarz_criterion_nats(self, one: EffectSetScore) -> float:
        """Score of a set in nats without the prior on sizes (Schwarz 1978), to test if runs can tell two sets apart."""

    @abstractmethod
    def rmse_by_channel(self, one: EffectSetScore) -> tuple[dict[str, float], dict[str, float]]:
        """Root mean square errors of a set, by channel, on the training runs, and on runs predicted from others.

        The second ones are empty where there are no such runs.
        """

    @abstractmethod
    def fitted_values(self, one: EffectSetScore) -> tuple[np.ndarray, np.ndarray]:
        """(P,) values of a set's unknowns as reported, and (P,) their standard deviations."""

    @abstractmethod
    def set_with_next_reported_effect(
        self, now: EffectSetScore, options: Sequence[Sequence[Candidate]]
    ) -> EffectSetScore:
        """Of the sets with one of the options added to `now`, the one that a report should name first."""

    def leading_effects(self, now: EffectSetScore, effects: Sequence[Candidate]) -> list[Candidate]:
        """Effects, out of `effects`, that a report lists before all others, in this order; by default none."""
        del now, effects
        return []

    def promising_removals(
        self, now: EffectSetScore, parts: Sequence[tuple[Candidate, ...]]
    ) -> list[tuple[Candidate, ...]]:
        """Parts of a set whose removal may improve its score."""
        del now
        return list(parts)

    def effects_on_other_states(
        self, whole: EffectSetScore, rest: Sequence[Candidate], part: Sequence[Candidate]
    ) -> Iterable[tuple[Candidate, ...]]:
        """Effects on other states that may be tied with a `part` of a set; an arm measures every joint and has none."""
        del whole, rest, part
        return ()

    def optimise(self, effects: Iterable[Candidate]) -> EffectSetScore:
        """Optimise a set and score it; other sets are then scored by linearisation at this optimum."""
        return self.evaluate(effects)

    def ties(self, whole: EffectSetScore, other: EffectSetScore, without: EffectSetScore) -> bool:
        """Whether the runs cannot tell two sets apart.

        Args:
            whole: the better set.
            other: the set that is compared with it.
            without: the set of the effects that both share.
        """
        del without
        return self.schwarz_criterion_nats(whole) - self.schwarz_criterion_nats(other) < self.settings.search.tie_nats

    def split_into_candidates(self, effects: Iterable[Candidate]) -> tuple[Candidate, ...]:
        """Split effects on several joints into the scorer's candidates, each on one joint."""
        names = {name for effect in effects for name in effect.names}
        return tuple(c for c in self.candidates if names.issuperset(c.names))

    def evaluate(self, effects: Iterable[Candidate]) -> EffectSetScore:
        """The score of a set of effects; it is computed once."""
        key = frozenset(effects)
        if key not in self._known:
            self._known[key] = self._score_of(tuple(c for c in self.candidates if c in key))
        return self._known[key]

    def complexity_penalty(self, effects: Sequence[Candidate]) -> float:
        """Evidence, nats, that a set needs to be accepted.

        The penalty is larger for a larger catalogue and for an effect that could act on more joints, as both make a
        good fit by chance more probable; it is smaller for a further joint of an effect.
        """
        return sum(self._price(name, on) for name, on in Counter(c.effect for c in effects).items())

    def complexity_penalties(self, effects: Sequence[Candidate], options: Sequence[Sequence[Candidate]]) -> np.ndarray:
        """(k,) `complexity_penalty` of some effects with each of k additions."""
        counts, whole = Counter(c.effect for c in effects), self.complexity_penalty(effects)
        rises = (Counter(c.effect for c in come).items() for come in options)
        prices = [[self._price(n, counts[n] + on) - self._price(n, counts[n]) for n, on in rise] for rise in rises]
        return whole + np.array([sum(price) for price in prices])

    def _price(self, effect: str, on: int) -> float:
        """Evidence, nats, that one effect on so many joints needs."""
        reach, search = self._reach[effect], self.settings.search
        joints = lgamma(reach + 1) - lgamma(on + 1) - lgamma(reach - on + 1)
        catalogue = log(max(len(self._reach), self._catalogue_size, 1))
        return (
            catalogue + log(reach) + joints + search.acceptance_nats + (on - 1) * search.further_joint_nats
            if on
            else 0.0
        )

    @property
    def searched_effects(self) -> tuple[Candidate, ...]:
        """Candidates from which a search chooses."""
        return self.candidates

    def removable(self, now: EffectSetScore) -> list[Candidate]:
        """Effects that a search may remove from a set."""
        return [c for c in now.effects if c not in self.given]

    def addable(self, now: EffectSetScore) -> list[Candidate]:
        """Effects that a search may add to a set."""
        return [c for c in self.searched_effects if c not in now.effects]

    def without(self, now: EffectSetScore, part: Collection[Candidate]) -> EffectSetScore:
        """A set without a part of it."""
        return self.evaluate([c for c in now.effects if c not in part])
