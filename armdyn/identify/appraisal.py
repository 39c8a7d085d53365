r"""What a set of effects is worth to runs, in nats: one score from clean simulations to recordings of real arms.

    worth = fit + transfer - price

fit       log evidence of the training runs: likelihood, less Occam's factor log det(I + T G T) / 2 of the unknowns, T
          their typical sizes (MacKay, Neural Computation 4, 1992), and a Cauchy prior on their sizes.
transfer  log likelihood of the held-out runs as a fit to the training runs predicts them, or of every training run as
          a fit to the *others* does where none are held out: what decides where no model is complete, and there
          training alone names whatever bends most.
price     what a set must gain to be believed; see `Appraiser.price`.

The model's own error is an unknown variance d^2 >= 0 of each joint or channel beside the sensor's s^2. At its best
value the likelihood of n independent samples with mean squared error E is

    -n/2 (E/s^2 - 1)  where E < s^2 (noise-limited),      -n/2 log(E/s^2)  where E > s^2 (model-limited),

with the same slope where they meet. n counts independent samples: what the richest model leaves is correlated, and N
samples of a correlation time of k samples are worth N/k (Bayley & Hammersley, J. R. Stat. Soc. Suppl. 8, 1946).
"""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import log
from typing import ClassVar

import numpy as np

from armdyn.identify.candidate import Candidate
from armdyn.identify.problem import Problem

SURE = log(100.0)
"""Nats beyond chance at which an effect is believed: one false name in a hundred clean recordings."""
TIE = 3.0
"""Nats below which two sets count as tied: above it the first was right in 320 of 320."""
HARM = 0.02
"""Share by which an effect may make the total error of a predicted run larger."""


@dataclass(frozen=True, eq=False)
class Appraisal:
    """What one set of effects is worth.

    Attributes:
        effects: of the set, each on one joint.
        worth: nats; compare with that of other sets for the same runs.
        fit: log evidence of the training runs.
        transfer: log likelihood of runs as predicted from the others; 0 where there is nothing to predict.
        price: nats.
        columns: (c,) the unknowns that change.
        free: (c,) bool, those that are fitted; the others return to null.
        change: (c,) their change from the expansion's point in a fit to all training runs.
        effective: (c,) the change that predictions are linear in; see `Model.bend`.
        errors: (t,) mean squared error of the training units there.
        likelihood: log likelihood of the training runs.
        values: number of the effects' unknowns that the runs determine rather than the priors.
        predicted: (u,) mean squared error of the predicted units.
        misfit: squared error of held-out runs where such are given, else of runs predicted in turn, else of the
            training run, at least the noise's; summed over channels, in the unit's square where they share one, else
            over the noise.
        overall: likewise, of a training run, predicted from the others where there are others, plus that of a held-out
            run where such are given, means over runs. What explains one kind of motion alone is not what is missing.
        totals: (r, k) error of every predicted run over its channels of each unit, root of the sum of squares.
    """

    effects: tuple[Candidate, ...]
    worth: float
    fit: float
    transfer: float
    price: float
    columns: np.ndarray
    free: np.ndarray
    change: np.ndarray
    effective: np.ndarray
    errors: np.ndarray
    likelihood: float
    values: float
    predicted: np.ndarray
    misfit: float
    overall: float
    totals: np.ndarray

    def carries_over(self, before: "Appraisal") -> bool:
        """Whether other runs, where there are any, are predicted better than `before`, and none of them worse."""
        return len(self.predicted) == 0 or (self.transfer > before.transfer and not self.harms(before))

    def harms(self, before: "Appraisal") -> bool:
        """Whether a run is predicted worse than `before`."""
        return bool(np.any(self.totals > (1.0 + HARM) * before.totals))


class Appraiser(ABC):
    """Appraises sets of effects.

    Args:
        problem: whose unknowns effects have.
        candidates: all effects that a set may hold, each on one joint.
        given: those of them that the model has already: every set holds them.
    """

    tried = 0
    """Effects among which the candidates were chosen, where these were more."""
    most_named: ClassVar[int]
    """Effects of a table of suspects."""

    def __init__(self, problem: Problem, candidates: Sequence[Candidate], given: Sequence[Candidate] = ()) -> None:
        self.problem = problem
        self.candidates, self.given = tuple(candidates), tuple(given)
        self._reach = Counter(c.effect for c in candidates)
        self._known: dict[frozenset[Candidate], Appraisal] = {}

    @abstractmethod
    def _appraised(self, effects: tuple[Candidate, ...]) -> Appraisal:
        """The appraisal of a set, in the order of the candidates."""

    @abstractmethod
    def values(self, one: Appraisal) -> np.ndarray:
        """(P,) values of all unknowns at a set's minimum."""

    @abstractmethod
    def standing(self, one: Appraisal) -> float:
        """Nats by which two sets are held against each other, without the prior on sizes (Schwarz 1978).

        Runs alone decide whether they can tell two sets apart.
        """

    @abstractmethod
    def errors(self, one: Appraisal) -> tuple[dict[str, float], dict[str, float]]:
        """Rms error of a set by channel, of the training runs and of runs predicted from others; those may be none."""

    @abstractmethod
    def fitted(self, one: Appraisal) -> tuple[np.ndarray, np.ndarray]:
        """(P,) values of a set's unknowns as a person is told them, and (P,) their standard deviations."""

    @abstractmethod
    def best_with_one_more(self, now: Appraisal, left: Sequence[Candidate]) -> Appraisal:
        """Of the sets with one effect of `left` more, the one that a reader should be told first."""

    def settle(self, effects: Iterable[Candidate]) -> Appraisal:
        """The appraisal of a set where it is surest; others are appraised from there."""
        return self.of(effects)

    def ties(self, whole: Appraisal, other: Appraisal, without: Appraisal) -> bool:
        """Whether runs cannot tell a set from the `whole` one; `without` is what both have in common."""
        del without
        return self.standing(whole) - self.standing(other) < TIE

    def useful(self, more: Appraisal, fewer: Appraisal) -> bool:
        """Whether the further values of a set explain enough beside what `fewer` explain."""
        del more, fewer
        return True

    def within(self, effects: Iterable[Candidate]) -> tuple[Candidate, ...]:
        """The candidates, each on one joint, that make up `effects`."""
        names = {name for effect in effects for name in effect.names}
        return tuple(c for c in self.candidates if names.issuperset(c.names))

    def of(self, effects: Iterable[Candidate]) -> Appraisal:
        """The appraisal of one set."""
        key = frozenset(effects)
        if key not in self._known:
            self._known[key] = self._appraised(tuple(c for c in self.candidates if c in key))
        return self._known[key]

    def price(self, effects: Sequence[Candidate]) -> float:
        """What a set must gain over no effect at all, nats.

        Each effect could have been another one of the catalogue, each of its joints another joint, and is to be sure
        beyond that.
        """
        joints = Counter(c.effect for c in effects)
        return sum(
            log(max(len(self._reach), self.tried)) + n * (log(self._reach[name]) + SURE) for name, n in joints.items()
        )
