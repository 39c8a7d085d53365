"""Appraisal around the measured motion: for models that simulate, where the model's own error is part of the model."""

from collections.abc import Iterable, Sequence
from math import log

import numpy as np

from armdyn.identify.appraisal import Appraisal, Appraiser, Change, Described
from armdyn.identify.candidate import Candidate
from armdyn.identify.fit import channel_rmse
from armdyn.identify.grey_box import LOOSE, Tables, everywhere
from armdyn.identify.study import Study


class Filtered(Appraiser):
    """Appraises sets by their evidence at the noise that suits each best.

    Args:
        study: model, runs, catalogue.
    """

    few = True
    limited = 0.0

    def __init__(self, study: Study) -> None:
        self._study, self._motion = study, study.motion
        assert self._motion is not None
        problem = self._motion.problem
        super().__init__(problem, tuple(atom for c in study.candidates for atom in c.apart()))
        self._columns = {c: problem.of(c.names) for c in self.candidates}
        self._always = self._motion.base
        self._point, self._at = self._motion.point, frozenset[Candidate]()
        self._tabulate()

    def _tabulate(self) -> None:
        """Sums around the present point."""
        box = self._motion.box
        tables = [everywhere(a, n) for a, n in zip(box.around(self._point), self._point.noises, strict=True)]
        self._tables = Tables(tables, self._point.values, box.problem, self._motion.training)
        self._known.clear()

    def _free(self, effects: Iterable[Candidate]) -> np.ndarray:
        """(P,) bool: what is fitted with a set."""
        free = self._always.copy()
        for c in effects:
            free |= self._columns[c]
        return free

    def _appraised(self, effects: tuple[Candidate, ...]) -> Appraisal:
        free = self._free(effects)
        found = self._tables.evidence(free)
        columns = np.flatnonzero(free | (found.change != 0.0))
        price, nothing = self.price(effects), np.zeros(0)
        worth = found.value + found.predicted - price
        return Appraisal(
            effects=effects, worth=worth, fit=found.value, transfer=found.predicted, price=price, columns=columns,
            free=free[columns], change=found.change[columns], effective=found.change[columns], errors=nothing,
            likelihood=found.value + found.occam, values=float(free.sum() - self._always.sum()), predicted=nothing,
            misfit=-worth, overall=-worth, totals=nothing,
        )  # fmt: skip

    def advance(self, now: Appraisal) -> None:
        """See `Appraiser.advance`: settle the motion there, and take sums anew."""
        key = frozenset(now.effects)
        if key != self._at:
            self._point, self._at = self._motion.settled(self._free(now.effects), self._point), key
            self._tabulate()

    def promising(self, now: Appraisal, changes: Sequence[Change], most: int) -> list[Appraisal]:
        """See `Appraiser.promising`; asking costs little, so all are appraised."""
        sets = [[*(c for c in now.effects if c not in gone), *come] for gone, come in changes]
        return sorted((self.of(one) for one in sets), key=lambda one: -one.worth)[:most]

    def useful(self, more: Appraisal, fewer: Appraisal) -> bool:
        """See `Appraiser.useful`."""
        del more, fewer
        return True

    def contenders(self, rest: Appraisal) -> tuple[Candidate, ...]:
        """See `Appraiser.contenders`."""
        del rest
        return self.candidates

    def holds(self, richer: Candidate, simpler: Candidate) -> bool:
        """See `Appraiser.holds`: an effect of a pendulum is no other one with more values."""
        del richer, simpler
        return False

    def values(self, one: Appraisal) -> np.ndarray:
        """See `Appraiser.values`."""
        values = self._point.values.copy()
        values[one.columns] += one.change
        return values

    def standing(self, one: Appraisal) -> float:
        """See `Appraiser.standing`."""
        return one.likelihood + one.transfer - 0.5 * one.values * log(self._tables.rows)

    def described(self, one: Appraisal, own: np.ndarray) -> Described:
        """See `Appraiser.described`: in output error, what users compare."""
        study = self._study
        fit = study.fit_with((*study.present, *one.effects), study.first())
        held_out = study.held_out_blocks(fit) if study.held_out else None
        found = self._tables.evidence(self._free(one.effects))
        T = self.problem.typical
        spread = np.linalg.pinv(np.eye(len(T)) / LOOSE**2 + T[:, None] * found.information * T, hermitian=True)
        return Described(
            fit.rmse(), channel_rmse(held_out) if held_out else {}, self.values(one)[own],
            (T * np.sqrt(np.diag(spread)))[own],
        )  # fmt: skip
