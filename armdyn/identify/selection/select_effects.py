"""Search for the set of effects with the largest score, by adding, removing and exchanging effects.

Adding one effect at a time fails where the first one imitates two others. So after every addition superfluous effects
are removed (backward elimination), an effect may be added on one joint or on all its joints, each effect is exchanged
for others, and two at once for two (floating search: Pudil, Novovičová & Kittler, Pattern Recognition Letters 15,
1994). The score rises with every step, so the search ends.
"""

from collections.abc import Callable, Iterator, Sequence
from itertools import combinations

from armdyn.identify.selection.candidate import Candidate
from armdyn.identify.selection.linear_scorer import LinearScorer
from armdyn.identify.selection.set_score import EffectSetScore, EffectSetScorer

SCORED_CHANGES_PER_KIND = 12
"""Number of changes of each kind, those with the largest predicted score, whose score is computed in each round."""
ELIMINATED_CHANGES = 3
"""Number of these changes, the best ones, after which superfluous effects are removed in each round: so one effect can
take the place of several on other joints."""

Change = tuple[tuple[Candidate, ...], tuple[Candidate, ...]]
"""Effects removed from a set, and effects added to it."""


def search_set(scorer: LinearScorer, start: EffectSetScore, say: Callable[[str], None]) -> EffectSetScore:
    """Search for the set of effects with the largest score.

    Args:
        scorer: scorer of sets.
        start: the set from which the search starts.
        say: called with a text on the progress of the search.
    """
    now = eliminate(scorer, start)
    while True:
        say(f"{len(now.effects)} effects chosen")
        for changes in (_additions, _exchanges, _pairs):
            options = _promising(scorer, now, list(changes(scorer, now)))
            best = max((eliminate(scorer, one) for one in options[:ELIMINATED_CHANGES]), key=_score, default=now)
            if best.score > now.score:
                now = best
                break
        else:
            return now


def eliminate(scorer: EffectSetScorer, now: EffectSetScore) -> EffectSetScore:
    """Remove effects from a set, on one joint or on all, as long as the score does not fall (backward elimination).

    Args:
        scorer: scorer of sets.
        now: the set.
    """
    while True:
        fewer = smaller_sets(scorer, now)
        best = max(fewer, key=_score, default=now)
        if best is now or best.score < now.score:
            return now
        now = best


def smaller_sets(scorer: EffectSetScorer, now: EffectSetScore) -> list[EffectSetScore]:
    """Sets without one effect, on one joint or on all, that may be better than a set."""
    parts = scorer.promising_removals(now, singles_and_groups(scorer.removable(now)))
    return [scorer.without(now, part) for part in parts]


def larger_sets(scorer: LinearScorer, now: EffectSetScore, count: int) -> list[EffectSetScore]:
    """The `count` sets with one more effect, on one joint or on all, that promise most."""
    return _promising(scorer, now, list(_additions(scorer, now)), count)


def group_joints_by_effect(atoms: Sequence[Candidate]) -> list[tuple[Candidate, ...]]:
    """Group candidates on one joint each by the name of their effect."""
    return [tuple(c for c in atoms if c.effect == name) for name in dict.fromkeys(c.effect for c in atoms)]


def singles_and_groups(atoms: Sequence[Candidate]) -> list[tuple[Candidate, ...]]:
    """Effects on one joint each, and then the same ones on all of their joints together."""
    return [*((c,) for c in atoms), *(own for own in group_joints_by_effect(atoms) if len(own) > 1)]


def _score(one: EffectSetScore) -> float:
    return one.score


def _additions(scorer: LinearScorer, now: EffectSetScore) -> Iterator[Change]:
    yield from (((), come) for come in singles_and_groups(scorer.addable(now)))


def _exchanges(scorer: LinearScorer, now: EffectSetScore) -> Iterator[Change]:
    coming = singles_and_groups(scorer.addable(now))
    yield from ((gone, come) for gone in singles_and_groups(scorer.removable(now)) for come in coming)


def _pairs(scorer: LinearScorer, now: EffectSetScore) -> Iterator[Change]:
    """Changes that add two effects on one joint, in place of at most two others.

    A gain and a friction that grows with the load hide each other: neither improves the score without the other one
    where a spring and a rotor imitate part of both.
    """
    removable, addable = scorer.removable(now), scorer.addable(now)
    for joint in dict.fromkeys(c.joints for c in scorer.searched_effects if c.joints):
        there = [c for c in scorer.searched_effects if c.joints == joint and c in removable]
        coming = [c for c in addable if c.joints == joint]
        for gone in [(), *((c,) for c in there), *combinations(there, 2)]:
            yield from ((gone, pair) for pair in combinations(coming, 2))


def _promising(
    scorer: LinearScorer, now: EffectSetScore, changes: Sequence[Change], count: int = SCORED_CHANGES_PER_KIND
) -> list[EffectSetScore]:
    """Sets after the `count` changes with the largest predicted scores, the best first."""
    by_gone: dict[tuple[Candidate, ...], list[tuple[Candidate, ...]]] = {}
    for gone, come in changes:
        by_gone.setdefault(gone, []).append(come)
    found: list[tuple[float, tuple[Candidate, ...]]] = []
    for gone, options in by_gone.items():
        rest = scorer.without(now, gone)
        scores = scorer.approximate_addition_scores(rest, options).tolist()
        found += [(score, (*rest.effects, *come)) for score, come in zip(scores, options, strict=True)]
    likely = sorted(found, key=lambda one: -one[0])[:count]
    return sorted((scorer.evaluate(effects) for _, effects in likely), key=_score, reverse=True)
