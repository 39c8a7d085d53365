"""Which mistake explains a recording of an arm: each hypothesis against "as it stands" and against the next best."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from armdyn.inspection.arm import AS_DESCRIBED, NOTHING, ArmRun
from armdyn.inspection.check import Check, Severity, amount
from armdyn.inspection.correction import Correction
from armdyn.inspection.evidence import Evidence
from armdyn.inspection.hypotheses import MISTAKES, Hypothesis

SURPRISE = 8.0
"""Nats that a mistake costs before anything is measured: one recording in some hundreds has one of some hundred."""
SURE = 12.0
"""Nats by which a mistake must beat "as it stands" to be called one: see docs/inspect.md for the rates."""
EXPLAINED = 0.35
"""Of the concerned channels' mean square that the model may leave once the mistake is undone; where it leaves more, the
description is of another arm, and no mistake is told."""
CHOSEN = 6
"""Hypotheses that are looked at closely, the most probable at a first look."""
AT_ONCE = 3
"""Mistakes in one recording."""
HOPELESS = 5.0
"""Nats by which a hypothesis may look worse than "as it stands" at first and still be looked at closely."""


@dataclass(frozen=True, eq=False)
class Verdict:
    """A hypothesis with what speaks for it.

    Attributes:
        hypothesis: the best.
        gain: nats against "as it stands".
        lead: nats against the next best.
        found: with every effect.
    """

    hypothesis: Hypothesis
    gain: float
    lead: float
    found: Evidence


def tested(run: ArmRun) -> Iterator[Verdict]:
    """Mistakes of a recording, one after the other, each undone before the next is looked for."""
    for _ in range(AT_ONCE):
        best = most_probable(run)
        if best is None:
            return
        yield best
        h = best.hypothesis
        if h.description != AS_DESCRIBED:
            return
        run = replace(run, run=h.correction.of(run.run))


def most_probable(run: ArmRun) -> Verdict | None:
    """The mistake that explains a recording, None where it is best explained as it stands."""
    nothing = Correction()
    stands = run.rough(nothing, AS_DESCRIBED)
    hypotheses = [h for mistake in MISTAKES for h in mistake(run)]
    first = [run.rough(h.correction, h.description) - h.price - SURPRISE for h in hypotheses]
    near = [i for i in np.argsort(first)[::-1][:CHOSEN] if first[i] > stands - HOPELESS]
    if not near:
        return None
    as_is = run.sure(nothing, AS_DESCRIBED).value
    found = [run.sure(hypotheses[i].correction, hypotheses[i].description) for i in near]
    values = np.array([f.value - hypotheses[i].price - SURPRISE for f, i in zip(found, near, strict=True)])
    best = int(np.argmax(values))
    chosen = hypotheses[near[best]]
    gain = float(values[best] - max(as_is, run.sure(nothing, NOTHING).value))
    concerned = [k for k, c in enumerate(run.channels) if c in chosen.channels] or slice(None)
    left = float(np.mean(found[best].share[concerned]))
    if gain < SURE or left > EXPLAINED:
        return None
    others = np.append(np.delete(values, best), as_is)
    return Verdict(chosen, gain, float(values[best] - others.max()), found[best])


def checks(run: ArmRun) -> list[Check]:
    """What is wrong with a recording of an arm, as the model sees it."""
    return [_check(run, verdict) for verdict in tested(run)]


def _check(run: ArmRun, v: Verdict) -> Check:
    h = v.hypothesis
    fixes = bool(h.correction.readings)
    return Check(
        kind=h.kind,
        severity=Severity.WRONG,
        run=run.run.name,
        channels=h.channels,
        sentence=f"{h.said}: so the model explains it better by {amount(v.gain)} nats",
        remedy=h.remedy,
        evidence=v.lead,
        correction=h.correction if fixes else None,
    )


def names(found: Sequence[Check]) -> list[str]:
    """Kinds, for a line."""
    return [check.kind for check in found]
