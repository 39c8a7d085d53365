"""Find the mistake that explains a recording: each is compared with "as it stands" and with the next best."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from armdyn.inspection.arm import AS_DESCRIBED, ArmRun
from armdyn.inspection.check import MODEL_PLACEHOLDER, Check, Severity, amount
from armdyn.inspection.correction import Correction
from armdyn.inspection.hypotheses import MISTAKES, Hypothesis
from armdyn.inspection.swing import SwingRun, mistakes

MISTAKE_PRICE_NATS = 8.0
"""Log prior odds against a mistake, nats: one recording in some ten has one of some hundred mistakes."""
CERTAIN_MISTAKE_NATS = 12.0
"""Nats by which a mistake must then exceed "as it stands" to be certain: sound recordings reach 6, see
docs/inspect.md."""
POSSIBLE_MISTAKE_NATS = 8.0
"""Nats from which a mistake is reported as possible."""
MISTAKE_TIE_NATS = 6.0
"""Nats below which two mistakes explain a recording equally well: both are reported, and neither is corrected."""
MAX_RESIDUAL_SHARE = 0.35
"""Largest residual share of the concerned channels' mean square after correcting the mistake; where it is larger, the
description is of another arm, and no mistake is reported."""
FULLY_EVALUATED, FULLY_EVALUATED_PER_KIND = 8, 3
"""Number of hypotheses that are evaluated fully, the most probable at first, and how many of one kind."""
MIN_UNEXPLAINED_SHARE = 0.2
"""Residual share of a typical channel's mean square from which two mistakes at once are tried, where one explains
nothing; the median of sound recordings, real ones too, is below 0.14."""
MAX_MISTAKES = 3
"""Largest number of mistakes in one recording."""
MAX_FIRST_DEFICIT_NATS = 10.0
"""Nats by which a hypothesis may be worse than "as it stands" at first and still be evaluated fully."""
FIRST_SHIFT_STEP, FIRST_RATE_STEP = 0.03, 5e-3
"""First steps of the search for a clock's error: shift, s, and relative rate error."""
CLOCK_SEARCH_RANGE = 4.0
"""Range of that search, in first steps, to either side of the best value tried."""
MAX_CLOCKS_TRIED = 80
"""Number of clock errors that such a search tries."""
Modelled = ArmRun | SwingRun
REGISTRY: dict[type, Sequence[Callable[[Any], Iterator[Hypothesis]]]] = {ArmRun: MISTAKES, SwingRun: (mistakes,)}
"""Functions that yield the hypotheses, by type of recording."""


@dataclass(frozen=True, eq=False)
class Verdict:
    """A hypothesis, or two together, with the evidence.

    Attributes:
        hypothesis: the best hypothesis.
        gain: log evidence over "as it stands", nats.
        lead: log evidence over the next best, nats.
        rival: another mistake that explains as much; None where there is none.
    """

    hypothesis: Hypothesis
    gain: float
    lead: float
    rival: Hypothesis | None = None

    @property
    def sure(self) -> bool:
        """Whether the recording is certainly wrong, rather than possibly."""
        return self.gain >= CERTAIN_MISTAKE_NATS


def find_mistakes(run: Modelled) -> Iterator[Verdict]:
    """Find the mistakes of a recording; each is corrected before the next one is searched."""
    told: set[tuple[str, tuple[str, ...]]] = set()
    for _ in range(MAX_MISTAKES):
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
    """The mistake, or the two mistakes, that explain a recording; empty where it is best explained as it stands."""
    hypotheses = [h for mistake in REGISTRY[type(run)] for h in mistake(run)]
    looked = run.rough([(Correction(), AS_DESCRIBED), *((h.correction, h.description) for h in hypotheses)])
    stands, first = float(looked[0]), looked[1:] - np.array([h.price + MISTAKE_PRICE_NATS for h in hypotheses])
    near = _foremost(hypotheses, first, stands - MAX_FIRST_DEFICIT_NATS, FULLY_EVALUATED)
    if not near:
        return ()
    as_is = run.sure(Correction(), AS_DESCRIBED)
    found = _best(run, [(hypotheses[i],) for i in near], as_is.value)
    if found or float(np.median(as_is.share)) < MIN_UNEXPLAINED_SHARE:
        return found
    pairs = [
        (hypotheses[i], second)
        for i in _foremost(hypotheses, first, -np.inf, FULLY_EVALUATED)
        for k, second in enumerate(hypotheses)
        if k != i
        and hypotheses[i].kind != second.kind
        and hypotheses[i].description == AS_DESCRIBED == second.description
    ]
    if not pairs:
        return ()
    rough = run.rough([(one.correction.then(second.correction), AS_DESCRIBED) for one, second in pairs])
    rough = rough - np.array([one.price + second.price + 2.0 * MISTAKE_PRICE_NATS for one, second in pairs])
    order = [
        i for i in np.argsort(rough)[::-1][:FULLY_EVALUATED].tolist() if rough[i] > stands - MAX_FIRST_DEFICIT_NATS
    ]
    return _best(run, [pairs[i] for i in order], as_is.value)


def _foremost(hypotheses: Sequence[Hypothesis], values: np.ndarray, least: float, most: int) -> list[int]:
    """Indices of the best hypotheses, with a limit for each kind."""
    near: list[int] = []
    for i in np.argsort(values)[::-1].tolist():
        alike = sum(hypotheses[k].kind == hypotheses[i].kind for k in near)
        if len(near) < most and alike < FULLY_EVALUATED_PER_KIND and values[i] > least:
            near.append(i)
    return near


def _best(run: Modelled, sets: Sequence[tuple[Hypothesis, ...]], as_is: float) -> tuple[Verdict, ...]:
    """Verdicts on the best of several sets of mistakes; empty where it does not explain the recording."""
    values, found = [], []
    for mistakes_ in sets:
        correction = Correction()
        for h in mistakes_:
            correction = correction.then(h.correction)
        found.append(run.sure(correction, mistakes_[-1].description))
        values.append(found[-1].value - sum(h.price + MISTAKE_PRICE_NATS for h in mistakes_))
    if not values:
        return ()
    best = int(np.argmax(values))
    chosen = sets[best]
    concerned = [k for k, c in enumerate(run.channels) if any(c in h.channels for h in chosen)] or slice(None)
    explained = float(np.mean(found[best].share[concerned])) <= MAX_RESIDUAL_SHARE
    least = max(as_is, run.nothing())
    of_description = any(h.description.mass != 1.0 or h.description.length != 1.0 for h in chosen)
    # A description belongs to all its recordings, so a mistake in it must be certain.
    enough = CERTAIN_MISTAKE_NATS if of_description else POSSIBLE_MISTAKE_NATS
    if values[best] - least < enough or not explained or any(h.effect for h in chosen):
        return ()
    same = {h.family for h in chosen}
    others = [k for k, those in enumerate(sets) if {h.family for h in those} != same]
    next_best = max(others, key=lambda k: values[k], default=best)
    lead = values[best] - max([*(values[k] for k in others), as_is])
    rival = sets[next_best][0] if lead < MISTAKE_TIE_NATS and len(chosen) == 1 and values[next_best] > as_is else None
    chosen = tuple(_fitted(run, chosen, k) for k in range(len(chosen)))
    return tuple(Verdict(h, values[best] - least, lead, rival) for h in chosen)


def _fitted(run: Modelled, chosen: tuple[Hypothesis, ...], which: int) -> Hypothesis:
    """A clock mistake with the shift and rate error that explain best, in place of the nearest ones tried."""
    h = chosen[which]
    if not h.clock:
        return h
    reading = h.readings[0]

    def worth(clock: np.ndarray) -> float:
        correction = Correction()
        for k, other in enumerate(chosen):
            meant = h.with_clock(FIRST_SHIFT_STEP * clock[0], FIRST_RATE_STEP * clock[1]) if k == which else other
            correction = correction.then(meant.correction)
        return -run.sure(correction, AS_DESCRIBED).value

    start = np.array([reading.late / FIRST_SHIFT_STEP, reading.pace / FIRST_RATE_STEP])
    bounds = [(x - CLOCK_SEARCH_RANGE, x + CLOCK_SEARCH_RANGE) for x in start]
    simplex = start + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    both = minimize(
        worth, start, method="Nelder-Mead", bounds=bounds,
        options={"initial_simplex": simplex, "xatol": 0.02, "fatol": 0.05, "maxfev": MAX_CLOCKS_TRIED},
    )  # fmt: skip
    alone = minimize_scalar(
        lambda late: worth(np.array([late, 0.0])), bounds=bounds[0], method="bounded",
        options={"xatol": 1e-3, "maxiter": MAX_CLOCKS_TRIED // 2},
    )  # fmt: skip
    if alone.fun <= both.fun + MISTAKE_PRICE_NATS:
        return h.with_clock(FIRST_SHIFT_STEP * float(alone.x), 0.0)
    return h.with_clock(FIRST_SHIFT_STEP * float(both.x[0]), FIRST_RATE_STEP * float(both.x[1]))


def checks(run: Modelled) -> list[Check]:
    """Findings on a recording from its comparison with the model."""
    return [_check(run, verdict) for verdict in find_mistakes(run)]


def _check(run: Modelled, v: Verdict) -> Check:
    h = v.hypothesis
    fixes = bool(h.correction.readings) and h.sure and v.sure and v.rival is None
    sure = f"{amount(v.gain)} nats more probable than as it stands, {amount(v.lead)} more than anything else"
    rival = "" if v.rival is None else f", or {v.rival.said}: this recording does not tell which"
    remedy = h.remedy or f"armdyn inspect {MODEL_PLACEHOLDER} {run.run.source or run.run.name} --fix fixed"
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
