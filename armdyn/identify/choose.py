"""The set of effects that is worth most, by an appraiser: forward, backward, exchange, until nothing is better.

Adding one effect at a time fails where the first one imitates two others. So after every addition what has become
superfluous goes (backward elimination); whole effects, on all their joints at once, compete with single ones, and at
the end each effect is exchanged for others. A set costs one small linear solve for each run, so that thousands of them
take about a second (floating search: Pudil, Novovičová & Kittler, Pattern Recognition Letters 15, 1994).
"""

from collections.abc import Callable, Collection, Iterable, Sequence
from itertools import combinations

import numpy as np

from armdyn.identify.appraisal import SURE, Appraisal, Appraiser
from armdyn.identify.candidate import Candidate
from armdyn.identify.simplest import CORE, simplest_of_best
from armdyn.identify.summed import Change, Summed

PROMISING = 12
"""Effects with the largest foretold gain that are appraised in each round."""
LEADS = 0.5
"""Share of the misfit as given from which an effect is what a reader is told is missing: many small errors have no
name."""
MOST_ROUNDS = 60

Say = Callable[[str], None]
Refused = Collection[frozenset[Candidate]]
_Move = Callable[[Summed, Appraisal, Sequence[Candidate], Refused], Appraisal | None]


def chosen(appraiser: Summed, firm: Sequence[Candidate] = (), say: Say | None = None) -> Appraisal:
    """The best set that the search finds.

    Args:
        appraiser: of sets.
        firm: effects that stay: where the expansion's point holds them, sums foretell little without them.
        say: told how far the search is.
    """
    now = appraiser.of(firm)
    refused = {frozenset(now.effects)}
    for _ in range(MOST_ROUNDS):
        if say is not None:
            say(f"{len(now.effects)} effects chosen")
        steps: tuple[_Move, ...] = (_added, _exchanged, _exchanged_for_pair)
        found = (step(appraiser, now, firm, refused) for step in steps)
        better = next((one for one in found if one is not None), None)
        if better is None:
            break
        refused.add(frozenset(better.effects))
        fewer = backward_elimination(appraiser, better, firm)
        back = fewer is not better and frozenset(fewer.effects) in refused
        if not back and not _displaces(appraiser, fewer, now):
            refused.add(frozenset(fewer.effects))
            now = fewer
    simple = _simplified(appraiser, now, firm)
    while simple is not now:
        now = simple
        simple = _added(appraiser, now, firm, ()) or now
    return simple


def _displaces(appraiser: Summed, after: Appraisal, before: Appraisal) -> bool:
    """Whether something came that makes superfluous what explains most and would have been chosen before it."""
    common = [c for c in before.effects if c in after.effects]
    rest = appraiser.of(common)
    leads = rest.overall - before.overall > LEADS * appraiser.of(()).overall
    return leads and best_set(appraiser, rest, [before, after]) is before


def _added(appraiser: Summed, now: Appraisal, firm: Sequence[Candidate], refused: Refused) -> Appraisal | None:
    """With one effect more, on one joint or on all of its joints; None where that is worth nothing."""
    del firm
    left = [c for c in appraiser.candidates if c not in now.effects]
    if not left:
        return None
    options = appraiser.shortlist(now, [((), (c,)) for c in left], PROMISING)
    if not now.effects:
        options += _whole(appraiser, left)
    options = _better(appraiser, now, options, refused)
    if not options:
        # What is foretold is what training runs gain: the ten values of a link outbid a friction that carries over.
        options = _better(appraiser, now, [appraiser.of((*now.effects, c)) for c in left], refused)
    return best_set(appraiser, now, options) if options else None


def _better(appraiser: Summed, now: Appraisal, options: Iterable[Appraisal], refused: Refused) -> list[Appraisal]:
    """Those that are worth more, carry over, and whose further values explain enough."""
    worth = [o for o in options if o.worth > now.worth and frozenset(o.effects) not in refused]
    return [o for o in worth if _carries_over(appraiser, o, now) and appraiser.useful(o, now)]


def _carries_over(appraiser: Summed, after: Appraisal, before: Appraisal) -> bool:
    """Whether other runs are predicted better, and none of them worse, but where what came is sure without them."""
    return after.carries_over(before) or (after.transfer > before.transfer and appraiser.surely(after, before))


def best_set(appraiser: Summed, now: Appraisal, options: Sequence[Appraisal]) -> Appraisal:
    """What is worth most; where the model's own error is left, what leads."""
    if appraiser.complete:
        return max(options, key=lambda o: o.worth)
    return simplest_of_best(now, options)


def _simplified(appraiser: Summed, now: Appraisal, firm: Sequence[Candidate]) -> Appraisal:
    """With simpler effects in place of richer ones that hold them.

    At the noise a richer effect must be surely better than the simpler one; where the model's own error is left, small
    errors make it better in any case, and the simpler one must be the core of it.
    """
    for effect in now.effects:
        if effect in firm:
            continue
        rest = [c for c in now.effects if c != effect]
        without = appraiser.of(rest)
        enough = CORE * np.log(without.overall / now.overall)
        # Likelihood counts twice at the noise.
        surely = now.worth - (2.0 - appraiser.limited) * SURE
        simpler = [
            appraiser.of((*rest, c))
            for c in appraiser.candidates
            if c not in now.effects and appraiser.holds(effect, c)
        ]
        near = [
            o
            for o in simpler
            if np.isfinite(o.worth)
            and (o.worth > surely or (not appraiser.complete and np.log(without.overall / o.overall) >= enough))
        ]
        if near:
            now = min(near, key=lambda o: o.overall)
    return now


def _whole(appraiser: Summed, left: Sequence[Candidate]) -> list[Appraisal]:
    """Every effect on all the joints that need it."""
    found = []
    for name in dict.fromkeys(c.effect for c in left):
        joints = [c for c in left if c.effect == name]
        if len(joints) > 1:
            found.append(backward_elimination(appraiser, appraiser.of(joints)))
    return found


def without_worthless(appraiser: Summed, now: Appraisal, firm: Sequence[Candidate]) -> Appraisal:
    """A set without what it is worth more without, one after the other."""
    while len(now.effects) > len(firm):
        fewer = (appraiser.of([c for c in now.effects if c != gone]) for gone in now.effects if gone not in firm)
        best = max(fewer, key=lambda o: o.worth)
        if best.worth < now.worth:
            break
        now = best
    return now


def backward_elimination(appraiser: Appraiser, now: Appraisal, firm: Sequence[Candidate] = ()) -> Appraisal:
    """Backward elimination: without what the others make superfluous, one after the other; `firm` effects stay."""
    while len(now.effects) > len(firm):
        fewer = [appraiser.of([c for c in now.effects if c != gone]) for gone in now.effects if gone not in firm]
        best = max(fewer, key=lambda o: o.worth)
        if best.worth < now.worth and all(appraiser.useful(now, o) for o in fewer):
            break
        now = best if best.worth >= now.worth else min(fewer, key=lambda o: o.misfit)
    return now


def _exchanged(appraiser: Summed, now: Appraisal, firm: Sequence[Candidate], refused: Refused) -> Appraisal | None:
    """With one effect, or all joints of one, exchanged for another; None where none is better."""
    free = [c for c in now.effects if c not in firm]
    parts: list[tuple[Candidate, ...]] = [(c,) for c in free]
    for name in dict.fromkeys(c.effect for c in free):
        joints = tuple(c for c in free if c.effect == name)
        if len(joints) > 1:
            parts.append(joints)
    left = [c for c in appraiser.candidates if c not in now.effects]
    changes = [(part, (c,)) for part in parts for c in left]
    return _best_exchange(appraiser, now, changes, PROMISING // 2 * len(parts), refused)


def _exchanged_for_pair(
    appraiser: Summed, now: Appraisal, firm: Sequence[Candidate], refused: Refused
) -> Appraisal | None:
    """With two effects more on one joint, in place of at most two others; None where none is better.

    A gain and a friction that grows with the load hide each other: neither is worth anything without the other one,
    where a spring and a rotor do some of what both do.
    """
    changes: list[Change] = []
    joints = list(dict.fromkeys(c.joints for c in appraiser.candidates if c.joints))
    for joint in joints:
        own = [c for c in appraiser.candidates if c.joints == joint]
        there = [c for c in own if c in now.effects and c not in firm]
        gone = [(), *((c,) for c in there), *combinations(there, 2)]
        come = list(combinations([c for c in own if c not in now.effects], 2))
        changes += [(part, pair) for part in gone for pair in come]
    return _best_exchange(appraiser, now, changes, PROMISING // 2 * len(joints), refused)


def _best_exchange(
    appraiser: Summed, now: Appraisal, changes: Sequence[Change], most: int, refused: Refused
) -> Appraisal | None:
    """The best set after one of the changes, of the `most` that promise most; None where none is better."""
    best: Appraisal | None = None
    for option in appraiser.shortlist(now, changes, most):
        if option.worth <= max(now.worth, best.worth if best else -np.inf) or frozenset(option.effects) in refused:
            continue
        rest = appraiser.of([c for c in now.effects if c in option.effects])
        first = best_set(appraiser, rest, [now, option]) is option
        if first and not option.harms(now) and appraiser.useful(option, rest):
            best = option
    return best
