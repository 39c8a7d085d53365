"""Which mistake explains a recording: each hypothesis against "as it stands" and against the next best."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from armdyn.inspection.arm import AS_DESCRIBED, ArmRun
from armdyn.inspection.check import MODEL, Check, Severity, amount
from armdyn.inspection.correction import Correction
from armdyn.inspection.evidence import Evidence
from armdyn.inspection.hypotheses import MISTAKES, Hypothesis
from armdyn.inspection.swing import SwingRun, mistakes

SURPRISE = 8.0
"""Nats that a mistake costs before anything is measured: one recording in some ten has one of some hundred."""
SURE = 12.0
"""Nats by which a mistake must then beat "as it stands": sound recordings reach 6, see docs/inspect.md."""
EXPLAINED = 0.35
"""Of the concerned channels' mean square that the model may leave once the mistake is undone; where it leaves more, the
description is of another arm, and no mistake is told."""
CHOSEN, OF_A_KIND = 8, 3
"""Hypotheses that are looked at closely, the most probable at a first look, and how many of one kind."""
AT_ONCE = 3
"""Mistakes in one recording."""
HOPELESS = 5.0
"""Nats by which a hypothesis may look worse than "as it stands" at first and still be looked at closely."""
Modelled = ArmRun | SwingRun
REGISTRY: dict[type, Sequence[Callable[[Any], Iterator[Hypothesis]]]] = {ArmRun: MISTAKES, SwingRun: (mistakes,)}
"""Kinds of mistake by what was recorded."""


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


def tested(run: Modelled) -> Iterator[Verdict]:
    """Mistakes of a recording, one after the other, each undone before the next is looked for."""
    told: set[tuple[str, tuple[str, ...]]] = set()
    for _ in range(AT_ONCE):
        best = most_probable(run)
        if best is None or (best.hypothesis.kind, best.hypothesis.channels) in told:
            return
        yield best
        h = best.hypothesis
        told.add((h.kind, h.channels))
        if h.description != AS_DESCRIBED:
            return
        run = run.with_run(h.correction.of(run.run))


def most_probable(run: Modelled) -> Verdict | None:
    """The mistake that explains a recording, None where it is best explained as it stands."""
    nothing = Correction()
    stands = run.rough(nothing, AS_DESCRIBED)
    hypotheses = [h for mistake in REGISTRY[type(run)] for h in mistake(run)]
    first = [run.rough(h.correction, h.description) - h.price - SURPRISE for h in hypotheses]
    near: list[int] = []
    for i in np.argsort(first)[::-1].tolist():
        alike = sum(hypotheses[k].kind == hypotheses[i].kind for k in near)
        if len(near) < CHOSEN and alike < OF_A_KIND and first[i] > stands - HOPELESS:
            near.append(i)
    if not near:
        return None
    as_is = run.sure(nothing, AS_DESCRIBED).value
    found = [run.sure(hypotheses[i].correction, hypotheses[i].description) for i in near]
    values = np.array([f.value - hypotheses[i].price - SURPRISE for f, i in zip(found, near, strict=True)])
    best = int(np.argmax(values))
    chosen = hypotheses[near[best]]
    gain = float(values[best] - max(as_is, run.nothing()))
    concerned = [k for k, c in enumerate(run.channels) if c in chosen.channels] or slice(None)
    left = float(np.mean(found[best].share[concerned]))
    if gain < SURE or left > EXPLAINED:
        return None
    others = np.append(np.delete(values, best), as_is)
    return Verdict(chosen, gain, float(values[best] - others.max()), found[best])


def checks(run: Modelled) -> list[Check]:
    """What is wrong with a recording, as the model sees it."""
    return [_check(run, verdict) for verdict in tested(run)]


def _check(run: Modelled, v: Verdict) -> Check:
    h = v.hypothesis
    fixes = bool(h.correction.readings) and h.sure
    sure = f"{amount(v.gain)} nats more probable than as it stands, {amount(v.lead)} more than anything else"
    return Check(
        kind=h.kind,
        severity=Severity.WRONG,
        run=run.run.name,
        channels=h.channels,
        sentence=f"{h.said} ({sure})",
        remedy=h.remedy or f"armdyn inspect {MODEL} {run.run.source or run.run.name} --fix fixed",
        evidence=v.lead,
        correction=h.correction if fixes else None,
    )
