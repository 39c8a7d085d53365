"""Zeros of joints that are off by any angle, as rivals of mistakes that explain the torques by quarter turns.

Angles that nobody rounds are none of the candidates, and a quarter turn of another joint may come near them. A zero is
therefore only corrected where no search among the zeros of all joints comes near its evidence.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import log, pi
from typing import Any

import numpy as np

from armdyn.inspection.check import names_in_words
from armdyn.inspection.correction import CorrectedReading, Correction
from armdyn.inspection.description import AS_DESCRIBED
from armdyn.inspection.hypothesis import MISTAKE_PRICE_NATS, Hypothesis
from armdyn.inspection.mistake import Mistake
from armdyn.inspection.together import SampledRuns

ZERO_STEPS_RAD = (0.1, 0.2, 0.4, 0.8, 1.6)
"""Steps by which the search changes a zero, to either side, rad."""
MAX_ZERO_STEPS = 12
"""Largest number of steps of the search."""
FULLY_EVALUATED_ZEROS = 4
"""Number of joints whose best step is evaluated fully, in each step of the search."""
USUAL_RESIDUAL_SHARE, MAX_RESIDUAL_TO_USUAL = 0.01, 4.0
"""Residual that every model may have, as a share of a channel's mean square, and largest residual of a channel, in
those of the others, with which the zeros of several joints count as corrected."""
ANY_ANGLE_PRICE_NATS = log(2.0 * pi / ZERO_STEPS_RAD[0])
"""Log prior odds, nats, against a zero that is off by one of all angles rather than by a quarter turn."""


@dataclass(frozen=True, eq=False)
class OtherZeros:
    """An explanation of recordings by zeros that are off by any angle, as the rival of a hypothesis.

    Attributes:
        channels: positions whose zeros are off.
        lead: log odds of the hypothesis over this explanation, nats, of one recording on average.
    """

    channels: tuple[str, ...]
    lead: float

    @property
    def as_mistake(self) -> Mistake:
        """The explanation as a mistake that is not corrected."""
        names = names_in_words(self.channels)
        many = len(self.channels) > 1
        said = f"the zeros of {names} are off by other angles" if many else f"the zero of {names} by another angle"
        return Mistake("position_offset", self.channels, said, correctable=False)


def rival_zeros(runs: SampledRuns[Any], chosen: Hypothesis, tie: float) -> OtherZeros | None:
    """Other zeros that make those of a hypothesis unsure; None if the hypothesis is sure, or has no zeros.

    Args:
        runs: the recordings.
        chosen: the hypothesis.
        tie: log odds, nats, up to which two explanations are equally good.
    """
    zeros = {name for m in chosen.mistakes if m.kind == "position_offset" for name in m.channels}
    if not zeros.intersection(runs.positions_with_zeros):
        return None
    found = runs.evidence(chosen.meaning, chosen.runs)
    beside = tuple(m for m in chosen.mistakes if m.kind != "position_offset")
    starts = [chosen.mistakes, (), *([beside] if beside else ())]
    tried = sorted(each for start in starts for each in _Search(runs, replace(chosen, mistakes=start)).tried())[::-1]
    for value, channels in tried:
        lead = found.value / len(chosen.runs) - chosen.price - value
        # An angle beside the quarter turn of a single joint is only a rival if it is the more probable one.
        if lead < (tie if len(channels) > 1 else 0.0):
            return OtherZeros(channels, lead)
    share = np.array([s for s, (k, _) in zip(found.share, runs.units, strict=True) if k in chosen.runs])
    usual = max(float(np.median(share)), USUAL_RESIDUAL_SHARE)
    if len(zeros) > 1 and float(share.max()) > MAX_RESIDUAL_TO_USUAL * usual:
        return OtherZeros(tuple(sorted(zeros)), found.value / len(chosen.runs) - chosen.price - tried[0][0])
    return None


@dataclass(frozen=True, eq=False)
class _Search:
    """Search among the zeros of all joints, beside the mistakes of a hypothesis.

    Attributes:
        runs: the recordings.
        base: the hypothesis; it may be without a mistake.
    """

    runs: SampledRuns[Any]
    base: Hypothesis

    def tried(self) -> list[tuple[float, tuple[str, ...]]]:
        """Log evidence less price of zeros, of one recording on average, each with the positions that are off."""
        at: dict[str, float] = {}
        value, tried = -np.inf, list[tuple[float, tuple[str, ...]]]()
        for _ in range(MAX_ZERO_STEPS):
            steps = self._foremost_steps(at)
            now = [self._value(step) for step in steps]
            tried += [(v, tuple(sorted(self._zeros | set(step)))) for v, step in zip(now, steps, strict=True)]
            if max(now) <= value:
                break
            value, at = max(now), steps[int(np.argmax(now))]
        return tried

    @property
    def _zeros(self) -> set[str]:
        """Positions whose zeros the hypothesis corrects."""
        return {name for m in self.base.mistakes if m.kind == "position_offset" for name in m.channels}

    def _foremost_steps(self, at: Mapping[str, float]) -> list[dict[str, float]]:
        """Offsets, rad, one step away from `at`, that are the best by their coarse evidence; one step of each joint."""
        steps = [
            (name, offsets)
            for name in self.runs.positions_with_zeros
            for size in ZERO_STEPS_RAD
            for offsets in ({**at, name: at.get(name, 0.0) + size}, {**at, name: at.get(name, 0.0) - size})
            if abs(offsets[name]) > 0.5 * ZERO_STEPS_RAD[0]
        ]
        meanings = [(self._correction(offsets), AS_DESCRIBED) for _, offsets in steps]
        coarse = sum(self.runs.runs[k].coarse_log_evidence(meanings) for k in self.base.runs)
        found: dict[str, dict[str, float]] = {}
        for i in np.argsort(-np.asarray(coarse)).tolist():
            name, offsets = steps[i]
            if name not in found and len(found) < FULLY_EVALUATED_ZEROS:
                found[name] = offsets
        return list(found.values())

    def _correction(self, offsets: Mapping[str, float]) -> Correction:
        moved = Correction({name: CorrectedReading(name, offset=size) for name, size in offsets.items()})
        return (self.base.meaning[0] if self.base.mistakes else Correction()).followed_by(moved)

    def _value(self, offsets: Mapping[str, float]) -> float:
        """Log evidence less price of offsets, rad, of one recording on average."""
        further = len(set(offsets) - self._zeros)
        price = self.base.price + ANY_ANGLE_PRICE_NATS * len(offsets) + MISTAKE_PRICE_NATS * further
        found = self.runs.evidence((self._correction(offsets), AS_DESCRIBED), self.base.runs)
        return found.value / len(self.base.runs) - price
