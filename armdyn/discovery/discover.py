"""Discover a formula for the missing force, with the same statistical evidence as for effects of the catalogue.

Every candidate term is an effect. The catalogue's effects and the terms are searched together, as in a repair: terms
are fitted inside the model, held-out runs help to choose, and the penalty of a set of effects grows with the number of
effects that were tried. The result is a formula, or the name of an effect of the catalogue.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain, count

import numpy as np

from armdyn.discovery.arm import arm_curve_candidates, arm_formula_candidates
from armdyn.discovery.pendulum import pendulum_curve_candidates, pendulum_formula_candidates
from armdyn.discovery.physics import (
    physics_curve_candidates,
    physics_family_candidates,
    physics_formula_candidates,
)
from armdyn.discovery.result import DiscoveredLaw, Discovery
from armdyn.discovery.source import effects_of_terms
from armdyn.discovery.term import CandidateTerm, check_same_units, named_terms
from armdyn.effects.effect import Effect
from armdyn.errors import TaskFailedError
from armdyn.identify.compare import fitted_parameters
from armdyn.identify.explained_share import ChannelScale
from armdyn.identify.failed_fit import failed_fit_sentence
from armdyn.identify.fit import Fit, channel_rmse
from armdyn.identify.problem import transfer_mask, transfer_values
from armdyn.identify.residual.noise_tests import residual_tests
from armdyn.identify.selection.candidate import Candidate
from armdyn.identify.selection.path import ProgressCallback, SearchStep
from armdyn.identify.selection.search import Search, search
from armdyn.identify.state_space.study import StateSpaceStudy
from armdyn.identify.study import Study
from armdyn.parameter import Parameter
from armdyn.threads import one_thread

Terms = Callable[[Fit], Iterator[CandidateTerm]]
TERM_FUNCTIONS_BY_BASE: dict[str, tuple[Terms, Terms]] = {
    "arm": (arm_formula_candidates, arm_curve_candidates),
    "pendulum": (pendulum_formula_candidates, pendulum_curve_candidates),
}
"""Functions that give candidate formulas and candidate curves, by base model; a user's own base has those of
`discovery.physics`."""
MAX_EVALUATED_TERMS_PER_JOINT, MAX_EVALUATED_TERMS_PER_KIND = 12, 3
"""Largest number of terms for one joint, and of one kind for one joint, that are fully evaluated: those with the
largest predicted contribution."""
MIN_SHARE_WITHOUT_TERM = 0.02
"""Least share of the samples in which a term that acts beyond a place does not act. A term that acts in all of them is
a simpler one, such as a constant, whose place nothing determines."""
NOTHING_EXPLAINED_SHARE, LEAST_SHARE_OF_REST = 0.005, 0.5
"""Share of the squared error below which a step is told as 0 %, and least share of what was left before that it must
remove to be told nevertheless: a second law may be small beside the first and bring the error down to the noise."""
MAX_CURVE_ERROR_SHARE_OF_FORMULA = 0.7
"""A curve is reported in place of a formula if it leaves less than this share of the squared error (above the noise)
that the formula leaves."""


@one_thread
def discover(study: Study, progress: ProgressCallback | None = None) -> Discovery:
    """Find a formula for the force that the model of a study lacks.

    Args:
        study: model, runs and catalogue; where an effect of the catalogue explains the error as well as a formula, its
            name is reported too.
        progress: called with a short text at every step.

    Raises:
        InputError: a recorded quantity has different units in two runs.
        TaskFailedError: the fit has failed.
    """
    model, catalogue = study.model, study.catalogue
    check_same_units([*study.runs, *study.held_out])
    say = progress or (lambda _: None)
    say("fitting the model as it is")
    bare = study.with_other_catalogue(())
    first = bare.first()
    given = Search((SearchStep((), (), bare.present, first, residual_tests(first, [])),))
    if not given.last.tests.fails:
        return describe_discovery(bare, given, {}, {})
    formulas, curves = TERM_FUNCTIONS_BY_BASE.get(model.base, (physics_formula_candidates, physics_curve_candidates))
    taken = {effect.name for effect in (*model.effects, *catalogue)}
    known = search(study, say).last if study.sums_predict else None
    searched = partial(_searched, study, known, say)
    terms = named_terms(formulas(first), taken)
    study, found = searched(terms)
    if study.fit_has_failed(found.last.fit):
        raise TaskFailedError(failed_fit_sentence(found.last.fit))
    if (
        isinstance(study, StateSpaceStudy)
        and model.base not in TERM_FUNCTIONS_BY_BASE
        and len(found.steps) > 1
        and not study.residual_may_be_noise(found.last.fit)
    ):
        simple = [terms[c.effect] for c in found.last.effects if c.effect in terms]
        states = {term.location.joint for term in simple}
        say(f"searching families of laws in the rate of {' and '.join(sorted(states))}")
        families = named_terms([*simple, *physics_family_candidates(first, states)], taken)
        other, drawn = searched(families)
        if _explains_more(other, drawn, study, found):
            study, found, terms = other, drawn, families
    if not _is_whole(study, found):
        say("searching smooth curves")
        smooth = named_terms(curves(first), taken)
        other, drawn = searched(smooth)
        if other.squared_error(drawn.last.fit) < MAX_CURVE_ERROR_SHARE_OF_FORMULA * study.squared_error(found.last.fit):
            study, found, terms = other, drawn, smooth
    return describe_discovery(study, found, terms, {e.name: e for e in catalogue})


def _searched(
    given: Study, known: SearchStep | None, say: ProgressCallback, terms: dict[str, CandidateTerm]
) -> tuple[Study, Search]:
    effects = effects_of_terms(list(terms.values()))
    size = len(given.catalogue) + len(effects) // max(len({t.location.joint for t in terms.values()}), 1)
    study = given.with_other_catalogue([*given.catalogue, *effects], catalogue_size=size)
    if known is not None:
        names = _promising(study, terms, known)
        promising = [effect for effect in effects if effect.name in names]
        study = given.with_other_catalogue([*given.catalogue, *promising], catalogue_size=size)
    found = search(study, say)
    found = Search(steps_that_explain(study, found.steps), found.ranked_effects, found.further_effect)
    if everywhere := _acting_everywhere(found.last, terms):
        say("searching without a place that the runs do not show")
        return _searched(given, known, say, {name: t for name, t in terms.items() if name not in everywhere})
    return study, found if predicts_better(study, found) else Search(found.steps[:1])


def steps_that_explain(study: Study, steps: Sequence[SearchStep]) -> tuple[SearchStep, ...]:
    """Steps of a search without the last ones, where these explain 0 % together, and little of what was left before."""
    given, last = steps[0].fit, steps[-1].fit
    for k, step in enumerate(steps[:-1]):
        more = study.explained_share(given, last) - study.explained_share(given, step.fit)
        left = study.squared_error(last) / study.squared_error(step.fit)
        if more < NOTHING_EXPLAINED_SHARE and left > 1.0 - LEAST_SHARE_OF_REST:
            return tuple(steps[: k + 1])
    return tuple(steps)


def _acting_everywhere(step: SearchStep, terms: Mapping[str, CandidateTerm]) -> set[str]:
    """Names of the terms of a step that act beyond a place, where nearly all samples are beyond it."""
    values = {c.parameter.name: v for c, v in zip(step.fit.problem.columns, step.fit.values, strict=True)}
    placed = {c.effect: c for c in step.effects if c.effect in terms and terms[c.effect].acts_beyond}
    places = {name: values[n] for name, c in placed.items() for n in c.names if n.startswith(f"{name}.place")}
    return {name for name, place in places.items() if terms[name].share_without(place) < MIN_SHARE_WITHOUT_TERM}


def predicts_better(study: Study, found: Search) -> bool:
    """Whether the last step of a search predicts held-out runs better than the model as given.

    True where no run is predicted without having been fitted.
    """
    unfitted = [study.held_out_blocks(step.fit) for step in (found.steps[0], found.last)]
    given, then = (sum(float(block.residual @ block.residual) for block in blocks) for blocks in unfitted)
    return not unfitted[1] or then < given


def _promising(study: Study, terms: Mapping[str, CandidateTerm], known: SearchStep) -> set[str]:
    """Names of the terms of each joint with the largest predicted contribution beside known effects, few of a kind."""
    before = known.fit.problem
    values = transfer_values(known.fit.values, before, study.problem)
    free = transfer_mask(known.fit.free, before, study.problem)
    near = replace(known.fit, problem=study.problem, free=free, values=values, weighted=None)
    at = study.fit_base_with_effects(known.effects, near, values)
    looked_at = Counter[tuple[str, ...]]()
    found = set[str]()
    for score in study.scores(study.with_thresholds(at), known.effects):
        term = terms.get(score.candidate.effect)
        if term is None:
            continue
        joint, kind = term.location.joint, term.kind
        if looked_at[joint,] < MAX_EVALUATED_TERMS_PER_JOINT and looked_at[joint, kind] < MAX_EVALUATED_TERMS_PER_KIND:
            looked_at.update([(joint,), (joint, kind)])
            found.add(term.name)
    return found


def _is_whole(study: Study, found: Search) -> bool:
    """Whether the residual is only noise, or nearly."""
    start, last = found.steps[0], found.last
    return not last.tests.fails or (
        len(found.steps) > 1 and study.explained_share(start.fit, last.fit) > study.settings.verdict.explained_at_noise
    )


def _explains_more(study: Study, found: Search, other_study: Study, other: Search) -> bool:
    """Whether one search explains more than another, by what each value must explain of what is left without it."""
    more = int(found.last.fit.free.sum()) - int(other.last.fit.free.sum())
    left, before = study.squared_error(found.last.fit), other_study.squared_error(other.last.fit)
    needed = study.settings.search.needed_share
    return left < needed(max(more, 1)) * before if more >= 0 else needed(-more) * left < before


def describe_discovery(
    study: Study, found: Search, terms: dict[str, CandidateTerm], known: dict[str, Effect]
) -> Discovery:
    """Describe the result of a search as formulas with values, errors and shares of the error.

    Args:
        study: the runs and the model.
        found: the finished search.
        terms: candidate terms by the names of their effects.
        known: effects of the catalogue by name.
    """
    start, last = found.steps[0], found.last
    shares = [0.0, *(study.explained_share(start.fit, step.fit) for step in found.steps[1:])]
    gains = dict(zip(found.steps[1:], np.diff(shares).tolist(), strict=True))
    fitted = fitted_parameters(study, last.fit)
    findings = [_finding(study, c, gains, fitted, terms, known) for c in last.effects if c not in start.effects]
    unfitted = [study.held_out_blocks(step.fit) for step in (start, last)]
    scale = ChannelScale.of(last.fit.blocks)
    return Discovery(
        laws=tuple(_distinct(findings, {*known, *(effect.name for effect in study.model.effects)})),
        rmse_before=start.fit.rmse(),
        rmse_after=last.fit.rmse(),
        held_out_rmse_before=channel_rmse(unfitted[0]),
        held_out_rmse=channel_rmse(unfitted[1]),
        noise=scale.noise,
        units=scale.units,
        explained_share=shares[-1],
        residual_exceeds_noise=last.tests.fails,
        has_unfitted_run=bool(unfitted[1]),
        runs=tuple(run.name for run in study.runs),
        held_out=tuple(run.name for run in study.held_out),
        nothing_moves=all(block.predicted.std() < block.noise for block in start.fit.blocks),
        missing_force=found.missing_force(law=True),
    )


def _finding(
    study: Study,
    candidate: Candidate,
    gains: Mapping[SearchStep, float],
    fitted: Mapping[str, Parameter],
    terms: dict[str, CandidateTerm],
    known: dict[str, Effect],
) -> DiscoveredLaw:
    """One effect of the result, with the share that the steps which added it, or one of its joints, explain."""
    own = set(candidate.names)
    steps = [step for step in gains if any(not own.isdisjoint(added.names) for added in step.added)]
    values = {n.split(".", 1)[1]: fitted[n] for n in candidate.names if n in fitted}
    if len(candidate.joints) == 1:
        values = {name.partition("[")[0]: value for name, value in values.items()}
    effect, term = study.effects[candidate.effect], terms.get(candidate.effect)
    tied_effects = [c.effect for step in steps for c in step.tied_effects if set(c.joints) <= set(candidate.joints)]
    other_kind = [name for name in tied_effects if term is None or name not in terms or terms[name].kind != term.kind]
    if term is not None:
        term = term.with_start_values({name: values[name].value for name in term.parameters if name in values})
    return DiscoveredLaw(
        effect=candidate.effect,
        joints=candidate.joints,
        acts_on=effect.acts_on,
        kind=candidate.effect if term is None else term.kind,
        description=effect.summary.rstrip("."),
        formula=_formula(candidate.effect, terms, known),
        values=values,
        explained_share=sum(gains[step] for step in steps),
        known_as=candidate.effect if term is None else next((name for name in tied_effects if name in known), None),
        rivals=tuple(dict.fromkeys(_formula(name, terms, known) for name in other_kind)),
        term=term,
    )


def _formula(name: str, terms: dict[str, CandidateTerm], known: dict[str, Effect]) -> str:
    return terms[name].formula if name in terms else f"{name}: {known[name].equation}"


def _distinct(findings: Sequence[DiscoveredLaw], taken: set[str]) -> Iterator[DiscoveredLaw]:
    """Give findings unique names that describe them: ``discovered_stop``, ``discovered_stop_2``."""
    for one in findings:
        if one.term is None:
            yield one
            continue
        names = chain([one.term.stem], (f"{one.term.stem}_{k}" for k in count(2)))
        name = next(name for name in names if name not in taken)
        taken = taken | {name}
        yield replace(one, effect=name, term=replace(one.term, name=name))
