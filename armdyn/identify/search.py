"""Add what is missing, step by step, until nothing is left to explain or nothing in the catalogue helps.

One at a time fails where two effects mask each other: in the free swing of a real pendulum viscous friction is the best
first choice, after which neither dry friction nor drag helps, although those two together are right. So, when no single
effect helps, pairs of the best are tried in place of the last one, an effect that has become superfluous is removed,
and at the end each is exchanged for its rivals once.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from armdyn.identify.exchange import Beam, exchanged
from armdyn.identify.fit import Fit
from armdyn.identify.ranking import Option, Ranking
from armdyn.identify.score import Candidate
from armdyn.identify.select import compare, rank, rank_pairs, superfluous
from armdyn.identify.study import Study
from armdyn.identify.whiteness import Remainder, remainder

MOST_STEPS = 8
HALF = 0.5
"""Share of the misfit; far above the noise, a single effect that explains less is weighed against pairs."""
RIVALS = 3
"""Of each step, how many runners-up are tried in exchange at the end."""

Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Step:
    """One change of the model.

    Attributes:
        added: effects that came in; empty for the model as given.
        removed: effects that went out.
        tied: effects that these runs cannot tell from the one added.
        effects: all effects after it.
        fit: the minimum after it.
        remainder: what is left.
        whole: whether `tied` counts for all effects together, not only for the one added.
    """

    added: tuple[Candidate, ...]
    removed: tuple[Candidate, ...]
    tied: tuple[Candidate, ...]
    effects: tuple[Candidate, ...]
    fit: Fit
    remainder: Remainder
    whole: bool = False


@dataclass(frozen=True, eq=False)
class Search:
    """All steps, the model as given first, and the ranking that the first decision was made on."""

    steps: tuple[Step, ...]
    first_ranking: Ranking | None

    @property
    def last(self) -> Step:
        """Where it ended."""
        return self.steps[-1]

    @property
    def tied(self) -> tuple[Candidate, ...]:
        """Effects that these runs cannot tell from those that it ended with."""
        found: dict[Candidate, None] = {}
        for step in reversed(self.steps):
            if any(effect in self.last.effects for effect in step.added):
                found.update(dict.fromkeys(step.tied))
            if step.whole:
                break
        return tuple(effect for effect in found if effect not in self.last.effects)


def search(study: Study, progress: Progress | None = None, *, most_steps: int = MOST_STEPS) -> Search:
    """Run it; `progress` is told every step in a few words."""
    say = progress or (lambda _: None)
    say("fitting the model as it is")
    effects, now = study.present, study.first()
    on_joints = any(c.joints for c in study.candidates)  # many unknowns each: their sets are too many to compare
    promised = study.scores(now, effects)
    steps = [Step((), (), (), effects, now, remainder(now, promised))]
    first: Ranking | None = None
    previous: Ranking | None = None
    rivals: list[Candidate] = []
    beam: list[Beam] = []
    while steps[-1].remainder.fails and len(steps) <= most_steps:
        say(f"trying {min(len(promised), 9)} effects on {len(effects)} present")
        ranking = rank(study, now, effects, promised)
        first = first or ranking
        chosen, tied = ranking.best, _tied(ranking, ranking.best)
        small = chosen is not None and chosen.far and chosen.share < HALF
        if chosen is None or (small and (previous is not None or not on_joints)):
            say("trying pairs")
            pair = _pair(study, now, effects, ranking, previous)
            if pair is not None and (chosen is None or pair.fit.cost < chosen.fit.cost):
                chosen, tied = pair, ()
        if chosen is None:
            break
        rivals += [o.added[0] for o in ranking.options[: RIVALS + 1]]
        removed = tuple(e for e in effects if e not in chosen.effects)
        added = tuple(c for c in chosen.effects if c not in effects)
        effects, now = chosen.effects, chosen.fit
        while (less := superfluous(study, now, effects, (*study.present, *added))) is not None:
            removed, effects, now = (*removed, *less.added), less.effects, less.fit
        several = len(effects) > len(study.present) + 1 and not on_joints
        if several:
            better = exchanged(study, now, effects, beam)
            effects, now, tied = better.effects, better.fit, better.tied
            added = tuple(e for e in effects if e not in steps[-1].effects)
            removed = tuple(e for e in steps[-1].effects if e not in effects)
        promised = study.scores(now, effects)
        steps.append(Step(added, removed, tied, effects, now, remainder(now, promised), several))
        previous = ranking
        beam = [(o.effects, o.fit) for o in ranking.options if len(o.effects) == len(effects)]
    last = _exchanged(study, steps[-1], rivals) if on_joints else None
    if last is not None:
        steps.append(last)
    return Search(tuple(steps), first)


def _tied(ranking: Ranking, option: Option | None) -> tuple[Candidate, ...]:
    return () if option is None else tuple(o.added[0] for o in ranking.tied_with(option))


def _pair(
    study: Study, now: Fit, effects: Sequence[Candidate], ranking: Ranking, previous: Ranking | None
) -> Option | None:
    """Two effects, in place of the last one where there was one."""
    best = rank_pairs(study, now, effects, ranking).best
    if best is None and previous is not None:
        given = study.present
        last = [e for e in effects if e not in given][-1:]
        best = rank_pairs(study, now, [e for e in effects if e not in last], previous).best
    return best


def _exchanged(study: Study, last: Step, rivals: Sequence[Candidate]) -> Step | None:
    """The last step with one effect exchanged for a rival where that is clearly better; only with two or more."""
    effects, now = last.effects, last.fit
    added = [e for e in effects if e not in study.present]
    removed: list[Candidate] = []
    if len(added) < 2:
        return None
    for effect in added:
        others = [e for e in effects if e is not effect]
        fresh = [r for r in dict.fromkeys(rivals) if r not in effects]
        if not fresh:
            break
        best = compare(study, now, others, [(r,) for r in fresh], tried=len(fresh), exchange=True).best
        if best is not None:
            removed.append(effect)
            effects, now = best.effects, best.fit
    if not removed:
        return None
    while (less := superfluous(study, now, effects, study.present)) is not None:
        removed, effects, now = [*removed, *less.added], less.effects, less.fit
    came = tuple(e for e in effects if e not in last.effects)
    return Step(came, tuple(removed), (), effects, now, remainder(now, study.scores(now, effects)))
