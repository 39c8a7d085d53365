"""Which mistake explains a recording: each hypothesis against "as it stands" and against the next best."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from armdyn.inspection.arm import AS_DESCRIBED, ArmRun
from armdyn.inspection.check import MODEL, Check, Severity, amount
from armdyn.inspection.correction import Correction
from armdyn.inspection.hypotheses import MISTAKES, Hypothesis
from armdyn.inspection.swing import SwingRun, mistakes

SURPRISE = 8.0
"""Nats that a mistake costs before anything is measured: one recording in some ten has one of some hundred."""
SURE = 12.0
"""Nats by which a mistake must then beat "as it stands": sound recordings reach 6, see docs/inspect.md."""
PERHAPS = 8.0
"""Nats from which a mistake is told as one to look at."""
TIE = 6.0
"""Nats below which two mistakes explain a recording equally well: both are told, and neither is mended."""
EXPLAINED = 0.35
"""Of the concerned channels' mean square that the model may leave once the mistake is undone; where it leaves more, the
description is of another arm, and no mistake is told."""
CHOSEN, OF_A_KIND = 8, 3
"""Hypotheses that are looked at closely, the most probable at a first look, and how many of one kind."""
UNEXPLAINED = 0.2
"""Share of a typical channel's mean square from which two mistakes at once are looked for, where one explains nothing;
of sound recordings, real ones too, the median is below 0.14."""
AT_ONCE = 3
"""Mistakes in one recording."""
HOPELESS = 10.0
"""Nats by which a hypothesis may look worse than "as it stands" at first and still be looked at closely."""
SHIFT, DRIFT = 0.03, 5e-3
"""s, and share of the time that passes: first steps of the search for how a clock runs."""
AROUND = 4.0
"""First steps to either side of a clock's shift and drift, as far as the next that were tried."""
MOST_TRIED = 80
"""Clocks that such a search tries."""
Modelled = ArmRun | SwingRun
REGISTRY: dict[type, Sequence[Callable[[Any], Iterator[Hypothesis]]]] = {ArmRun: MISTAKES, SwingRun: (mistakes,)}
"""Kinds of mistake by what was recorded."""


@dataclass(frozen=True, eq=False)
class Verdict:
    """A hypothesis with what speaks for it, or for it and another one together.

    Attributes:
        hypothesis: the best.
        gain: nats against "as it stands".
        lead: nats against the next best.
        rival: another mistake that explains as much; None where there is none.
    """

    hypothesis: Hypothesis
    gain: float
    lead: float
    rival: Hypothesis | None = None

    @property
    def sure(self) -> bool:
        """Whether the recording is wrong, rather than to be looked at."""
        return self.gain >= SURE


def find_mistakes(run: Modelled) -> Iterator[Verdict]:
    """Mistakes of a recording, one after the other, each undone before the next is looked for."""
    told: set[tuple[str, tuple[str, ...]]] = set()
    for _ in range(AT_ONCE):
        found = most_probable(run)
        for verdict in found:
            h = verdict.hypothesis
            if (h.kind, h.channels) in told:
                return
            yield verdict
            told.add((h.kind, h.channels))
            if h.description != AS_DESCRIBED or not verdict.sure or verdict.rival is not None:
                return
            run = run.with_run(h.correction.of(run.run))
        if not found:
            return


def most_probable(run: Modelled) -> tuple[Verdict, ...]:
    """The mistake that explains a recording, or the two; none where it is best explained as it stands."""
    hypotheses = [h for mistake in REGISTRY[type(run)] for h in mistake(run)]
    looked = run.rough([(Correction(), AS_DESCRIBED), *((h.correction, h.description) for h in hypotheses)])
    stands, first = float(looked[0]), looked[1:] - np.array([h.price + SURPRISE for h in hypotheses])
    near = _foremost(hypotheses, first, stands - HOPELESS, CHOSEN)
    if not near:
        return ()
    as_is = run.sure(Correction(), AS_DESCRIBED)
    found = _best(run, [(hypotheses[i],) for i in near], as_is.value)
    if found or float(np.median(as_is.share)) < UNEXPLAINED:
        return found
    pairs = [
        (hypotheses[i], second)
        for i in _foremost(hypotheses, first, -np.inf, CHOSEN)
        for k, second in enumerate(hypotheses)
        if k != i
        and hypotheses[i].kind != second.kind
        and hypotheses[i].description == AS_DESCRIBED == second.description
    ]
    if not pairs:
        return ()
    rough = run.rough([(one.correction.then(second.correction), AS_DESCRIBED) for one, second in pairs])
    rough = rough - np.array([one.price + second.price + 2.0 * SURPRISE for one, second in pairs])
    order = [i for i in np.argsort(rough)[::-1][:CHOSEN].tolist() if rough[i] > stands - HOPELESS]
    return _best(run, [pairs[i] for i in order], as_is.value)


def _foremost(hypotheses: Sequence[Hypothesis], values: np.ndarray, least: float, most: int) -> list[int]:
    """Places of the best, few of each kind."""
    near: list[int] = []
    for i in np.argsort(values)[::-1].tolist():
        alike = sum(hypotheses[k].kind == hypotheses[i].kind for k in near)
        if len(near) < most and alike < OF_A_KIND and values[i] > least:
            near.append(i)
    return near


def _best(run: Modelled, sets: Sequence[tuple[Hypothesis, ...]], as_is: float) -> tuple[Verdict, ...]:
    """Verdicts on the best of several sets of mistakes, none where it does not explain the recording."""
    values, found = [], []
    for mistakes_ in sets:
        correction = Correction()
        for h in mistakes_:
            correction = correction.then(h.correction)
        found.append(run.sure(correction, mistakes_[-1].description))
        values.append(found[-1].value - sum(h.price + SURPRISE for h in mistakes_))
    if not values:
        return ()
    best = int(np.argmax(values))
    chosen = sets[best]
    concerned = [k for k, c in enumerate(run.channels) if any(c in h.channels for h in chosen)] or slice(None)
    explained = float(np.mean(found[best].share[concerned])) <= EXPLAINED
    least = max(as_is, run.nothing())
    of_description = any(h.description.mass != 1.0 or h.description.length != 1.0 for h in chosen)
    enough = SURE if of_description else PERHAPS  # a description is that of all its recordings
    if values[best] - least < enough or not explained or any(h.effect for h in chosen):
        return ()
    same = {h.family for h in chosen}
    others = [k for k, those in enumerate(sets) if {h.family for h in those} != same]
    next_best = max(others, key=lambda k: values[k], default=best)
    lead = values[best] - max([*(values[k] for k in others), as_is])
    rival = sets[next_best][0] if lead < TIE and len(chosen) == 1 and values[next_best] > as_is else None
    chosen = tuple(_fitted(run, chosen, k) for k in range(len(chosen)))
    return tuple(Verdict(h, values[best] - least, lead, rival) for h in chosen)


def _fitted(run: Modelled, chosen: tuple[Hypothesis, ...], which: int) -> Hypothesis:
    """A mistake of a clock with the shift and the drift that explain best, in place of the nearest that was tried."""
    h = chosen[which]
    if not h.clock:
        return h
    reading = h.readings[0]

    def worth(clock: np.ndarray) -> float:
        correction = Correction()
        for k, other in enumerate(chosen):
            meant = h.with_clock(SHIFT * clock[0], DRIFT * clock[1]) if k == which else other
            correction = correction.then(meant.correction)
        return -run.sure(correction, AS_DESCRIBED).value

    start = np.array([reading.late / SHIFT, reading.pace / DRIFT])
    bounds = [(x - AROUND, x + AROUND) for x in start]
    simplex = start + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    both = minimize(
        worth, start, method="Nelder-Mead", bounds=bounds,
        options={"initial_simplex": simplex, "xatol": 0.02, "fatol": 0.05, "maxfev": MOST_TRIED},
    )  # fmt: skip
    alone = minimize_scalar(
        lambda late: worth(np.array([late, 0.0])), bounds=bounds[0], method="bounded",
        options={"xatol": 1e-3, "maxiter": MOST_TRIED // 2},
    )  # fmt: skip
    if alone.fun <= both.fun + SURPRISE:
        return h.with_clock(SHIFT * float(alone.x), 0.0)
    return h.with_clock(SHIFT * float(both.x[0]), DRIFT * float(both.x[1]))


def checks(run: Modelled) -> list[Check]:
    """What is wrong with a recording, as the model sees it."""
    return [_check(run, verdict) for verdict in find_mistakes(run)]


def _check(run: Modelled, v: Verdict) -> Check:
    h = v.hypothesis
    fixes = bool(h.correction.readings) and h.sure and v.sure and v.rival is None
    sure = f"{amount(v.gain)} nats more probable than as it stands, {amount(v.lead)} more than anything else"
    rival = "" if v.rival is None else f", or {v.rival.said}: this recording does not tell which"
    remedy = h.remedy or f"armdyn inspect {MODEL} {run.run.source or run.run.name} --fix fixed"
    return Check(
        kind=h.kind,
        severity=Severity.WRONG if v.sure else Severity.SUSPECT,
        run=run.run.name,
        channels=h.channels,
        sentence=f"{'' if v.sure else 'perhaps '}{h.said}{rival} ({sure})",
        remedy=remedy if fixes or h.remedy else "record a motion that tells, or ask who made the recording",
        evidence=v.lead,
        correction=h.correction if fixes else None,
    )
