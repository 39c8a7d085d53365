"""Add what is missing until nothing is left to explain or nothing in the catalogue helps.

An arm's effects are chosen together on sums, then refitted step by step. A pendulum's are added one at a time, which
fails where two mask each other: in the free swing of a real pendulum viscous friction is the best first choice, after
which neither dry friction nor drag helps, although those two together are right. So, when no single effect helps, pairs
of the best are tried in place of the last one, and what has become superfluous goes.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from armdyn.identify.appraisal import Appraisal, Appraiser
from armdyn.identify.choose import chosen, foremost
from armdyn.identify.compare import fitted_parameters
from armdyn.identify.exchange import Beam, exchanged
from armdyn.identify.fit import Fit, channel_rmse
from armdyn.identify.ladder import merged, rises
from armdyn.identify.ranking import Option, Ranking
from armdyn.identify.score import Candidate
from armdyn.identify.select import rank, rank_pairs, superfluous
from armdyn.identify.study import Study
from armdyn.identify.suspects import MOST_NAMED, Suspect, suspects
from armdyn.identify.whiteness import Remainder, remainder

MOST_STEPS = 8
HALF = 0.5
"""Share of the misfit; far above the noise, a single effect that explains less is weighed against pairs."""

FAR = 3.0
"""Typical sizes beyond which sums around null say little of a base that is turned: 0.3 rad."""

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
    """All steps, the model as given first, and what could have been the first effect, best first."""

    steps: tuple[Step, ...]
    suspects: tuple[Suspect, ...] = ()

    @property
    def last(self) -> Step:
        """Where it ended."""
        return self.steps[-1]

    @property
    def leading_ties(self) -> tuple[Candidate, ...]:
        """Effects that these runs cannot tell from the first one: what comes after it may have its own."""
        return self.steps[1].tied if len(self.steps) > 1 else ()

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


def search(study: Study, progress: Progress | None = None) -> Search:
    """Run it; `progress` is told every step in a few words."""
    say = progress or (lambda _: None)
    say("fitting the model as it is")
    return _by_sums(study, say) if study.model.linear else _stepwise(study, say)


def _by_sums(study: Study, say: Progress) -> Search:
    """Choose on sums around the fit of the model as given; refit every step of the way to what was chosen."""
    first = study.first()
    starts: list[tuple[Fit, tuple[Candidate, ...]]] = [(first, ())]
    for candidate in study.candidates:
        if not candidate.joints:  # it turns the whole arm, and a large angle is far from linear
            say(f"fitting with {candidate.spoken}")
            turned = study.fit_to_the_end((*study.present, candidate), first)
            own = study.problem.of(candidate.names)
            angles, typical = turned.values[own] - study.problem.null[own], study.problem.typical[own]
            if np.any(np.abs(angles) > FAR * typical):
                starts.append((turned, (candidate,)))
    appraisers = [study.appraiser(fit) for fit, _ in starts]
    found = {}
    for appraiser, (_, firm) in zip(appraisers, starts, strict=True):
        atoms = appraiser.within(firm)
        if not atoms or appraiser.of(atoms).worth > -np.inf:
            found[chosen(appraiser, atoms, say)] = appraiser
    nothing = appraisers[0].of(())
    better = [one for one in found if one.misfit < nothing.misfit]
    whole = foremost(appraisers[0], nothing, better) if better else nothing
    appraiser = found.get(whole, appraisers[0])
    ahead = starts[appraisers.index(appraiser)]
    steps = [Step((), (), (), study.present, first, remainder(first, study.scores(first, study.present)))]
    steps += _climbed(study, appraiser, whole, steps[0], ahead[0], say)
    if len(steps) > 1 and steps[-1].remainder.fails:
        # What multiplies others, such as a delay of a spring's torque, shows where they are.
        around = study.appraiser(steps[-1].fit)
        present = around.within(steps[-1].effects)
        if around.of(present).worth > -np.inf:
            more = chosen(around, present, say)
            steps += _climbed(study, around, more, steps[-1], steps[-1].fit, say, present)
    named = steps[min(1, len(steps) - 1)]
    return Search(tuple(steps), suspects(appraisers[0], appraisers[0].within(named.added), named.tied))


def _climbed(
    study: Study,
    appraiser: Appraiser,
    whole: Appraisal,
    last: Step,
    ahead: Fit,
    say: Progress,
    firm: Sequence[Candidate] = (),
) -> list[Step]:
    """Steps from the last one to the set `whole`, each refitted to all samples.

    Args:
        study: runs and catalogue.
        appraiser: that chose the set.
        whole: the set, on one joint each.
        last: where the way begins.
        ahead: the fit around which the sums are.
        say: told every step.
        firm: effects that are there already.
    """
    effects = last.effects
    steps: list[Step] = []
    given = study.present  # stays as it is, also where the same effect comes on further joints
    for rise in rises(appraiser, whole, firm):
        effects = (*given, *merged((*(e for e in effects if e not in given), rise.added)))
        say(f"fitting with {rise.added.spoken}")
        fit = study.fit_from(effects, study.foretold(appraiser, rise.appraisal), ahead)
        if rise.appraisal is whole:
            fit = study.fit_to_the_end(effects, fit)
        steps.append(Step((rise.added,), (), rise.tied, effects, fit, remainder(fit, study.scores(fit, effects))))
    return steps


def _stepwise(study: Study, say: Progress) -> Search:
    """One effect after the other, or two, by likelihood; for models whose minimum moves as effects come in."""
    effects, now = study.present, study.first()
    promised = study.scores(now, effects)
    steps = [Step((), (), (), effects, now, remainder(now, promised))]
    first: Ranking | None = None
    previous: Ranking | None = None
    beam: list[Beam] = []
    while steps[-1].remainder.fails and len(steps) <= MOST_STEPS:
        say(f"trying {min(len(promised), 9)} effects on {len(effects)} present")
        ranking = rank(study, now, effects, promised)
        first = first or ranking
        chosen, tied = ranking.best, _tied(ranking, ranking.best)
        small = chosen is not None and chosen.far and chosen.share < HALF
        if chosen is None or small:
            say("trying pairs")
            pair = _pair(study, now, effects, ranking, previous)
            if pair is not None and (chosen is None or pair.fit.cost < chosen.fit.cost):
                chosen, tied = pair, ()
        if chosen is None:
            break
        removed = tuple(e for e in effects if e not in chosen.effects)
        added = tuple(c for c in chosen.effects if c not in effects)
        effects, now = chosen.effects, chosen.fit
        while (less := superfluous(study, now, effects, (*study.present, *added))) is not None:
            removed, effects, now = (*removed, *less.added), less.effects, less.fit
        several = len(effects) > len(study.present) + 1
        if several:
            better = exchanged(study, now, effects, beam)
            effects, now, tied = better.effects, better.fit, better.tied
            added = tuple(e for e in effects if e not in steps[-1].effects)
            removed = tuple(e for e in steps[-1].effects if e not in effects)
        promised = study.scores(now, effects)
        steps.append(Step(added, removed, tied, effects, now, remainder(now, promised), several))
        previous = ranking
        beam = [(o.effects, o.fit) for o in ranking.options if len(o.effects) == len(effects)]
    return Search(tuple(steps), ranked_suspects(study, first, steps))


def ranked_suspects(study: Study, ranking: Ranking | None, steps: Sequence[Step]) -> tuple[Suspect, ...]:
    """Suspects of a ranking; what the search ended with leads, also where it was found later."""
    if ranking is None:
        return ()
    found = []
    for option in [o for o in ranking.options if o.delta_bic > 0][:MOST_NAMED]:
        candidate = option.added[0]
        values = fitted_parameters(study, option.fit)
        found.append(
            Suspect(
                effect=candidate.effect,
                joints=candidate.joints,
                delta_bic=ranking.evidence[ranking.options.index(option)],
                p_value=option.p_value,
                rmse=option.fit.rmse(),
                held_out_rmse=channel_rmse(option.held_out) if option.held_out is not None else {},
                parameters={n: v for n, v in values.items() if n.startswith(f"{candidate.effect}.")},
                tied_with=tuple(o.added[0].effect for o in ranking.tied_with(option)),
            )
        )
    added = {c.effect for c in steps[-1].effects if c not in steps[0].effects}
    return tuple(sorted(found, key=lambda s: s.effect not in added))


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
