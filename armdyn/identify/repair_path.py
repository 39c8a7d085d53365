"""A chosen set of effects as a reader takes it in: the biggest first, joints together that need the same effect."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import log

import numpy as np

from armdyn.identify.appraisal import Appraisal, Appraiser
from armdyn.identify.candidate import Candidate
from armdyn.identify.choose import foremost

ALIKE = 0.1
"""Share of what an effect on one joint explains that the same effect on another joint must bring to be told with it."""
TIE = 3.0
"""Nats below which two sets count as tied: above it the first was right in 320 of 320."""


@dataclass(frozen=True)
class Rise:
    """One step from a smaller set to a larger one.

    Attributes:
        added: the effect, with all joints that it comes on.
        appraisal: of the set with it.
        gain: what it is worth there, nats.
        tied: other effects that do as well in its place in the whole set.
    """

    added: Candidate
    appraisal: Appraisal
    gain: float
    tied: tuple[Candidate, ...]


def merged(candidates: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """Candidates on one joint each as one candidate for each effect, in the order in which they come."""
    found: dict[str, Candidate] = {}
    for c in candidates:
        known = found.get(c.effect)
        found[c.effect] = c if known is None else Candidate(c.effect, (*known.parts, *c.parts))
    return tuple(found.values())


def rises(appraiser: Appraiser, whole: Appraisal, firm: Sequence[Candidate] = ()) -> list[Rise]:
    """The way from the effects `firm` to the set `whole`, what explains most first."""
    now, left = appraiser.of(firm), [c for c in whole.effects if c not in firm]
    found = []
    while left:
        options = {appraiser.of((*now.effects, c)): c for c in left}
        beside = foremost(appraiser, now, list(options))
        first, gain = options[beside], now.misfit - beside.misfit
        joined = [first] + [
            c
            for c in left
            if c is not first
            and c.effect == first.effect
            and beside.misfit - appraiser.of((*beside.effects, c)).misfit >= ALIKE * gain
        ]
        after = appraiser.of((*now.effects, *joined))
        found.append(Rise(merged(joined)[0], after, after.worth - now.worth, tied(appraiser, whole, joined)))
        now, left = after, [c for c in left if c not in joined]
    return found


def tied(appraiser: Appraiser, whole: Appraisal, part: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """Effects on the same joints that fit and predict as well in the place of `part`, each as free as it really is.

    A richer effect that does the same with its further unknowns is no rival; on a slide, where a link has but one
    unknown that matters, it is.
    """
    close = TIE * (2.0 - appraiser.limited)  # where only noise is left, likelihood counts twice in the evidence
    rest = [c for c in whole.effects if c not in part]
    joints = {j for c in part for j in c.joints}
    found = []
    contenders = appraiser.contenders(appraiser.of(rest))
    for name in dict.fromkeys(c.effect for c in contenders if c.effect != part[0].effect):
        others = [c for c in contenders if c.effect == name and set(c.joints) <= joints]
        if any(c in rest for c in others) or len(others) < len(part):
            continue
        other = appraiser.of((*rest, *others))
        if np.isfinite(other.worth) and _evidence(appraiser, whole) - _evidence(appraiser, other) < close:
            found.append(merged(others)[0])
    return tuple(found)


def _evidence(appraiser: Appraiser, one: Appraisal) -> float:
    """Without the prior on sizes: runs alone decide whether they can tell two sets apart (Schwarz 1978)."""
    samples = float(np.sum(appraiser.independent[appraiser.sums.training]))
    occam = one.likelihood - one.fit
    return one.likelihood + one.transfer + (1.0 - appraiser.limited) * occam - 0.5 * one.values * log(max(samples, 2.0))
