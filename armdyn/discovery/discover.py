"""Discover a formula for the missing force, with the same evidence as for effects of the catalogue.

Every candidate term is an effect. The catalogue's effects and the terms are searched together, as in a repair: terms
are fitted inside the model, held-out runs help to choose, and the penalty of a set grows with the number of effects
that were tried. The result is a formula, or the name of an effect of the catalogue.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import count

import numpy as np

from armdyn.discovery.arm import arm_curves, arm_terms
from armdyn.discovery.pendulum import pendulum_curves, pendulum_terms
from armdyn.discovery.physics import physics_curves, physics_terms
from armdyn.discovery.result import Discovery, Finding
from armdyn.discovery.source import effects_of_terms
from armdyn.discovery.term import Term, check_same_units, named_terms
from armdyn.effects.effect import Effect
from armdyn.errors import TaskFailedError
from armdyn.identify.compare import fitted_parameters
from armdyn.identify.diagnose import MIN_EXPLAINED_AT_NOISE
from armdyn.identify.explained import Scale
from armdyn.identify.fit import Fit, channel_rmse
from armdyn.identify.lost import lost_sentence
from armdyn.identify.residual.tests import residual_tests
from armdyn.identify.selection.candidate import Candidate
from armdyn.identify.selection.path import Progress, Step
from armdyn.identify.selection.search import Search, search
from armdyn.identify.study import Study
from armdyn.model import Model
from armdyn.parameter import Parameter
from armdyn.physics.model import PhysicsModel
from armdyn.run import Run
from armdyn.threads import one_thread

TERMS_BY_BASE: dict[str, tuple[Callable[[Fit], Iterator[Term]], Callable[[Fit], Iterator[Term]]]] = {
    "arm": (arm_terms, arm_curves),
    "pendulum": (pendulum_terms, pendulum_curves),
}
"""Candidate terms and candidate curves, by base."""


@one_thread
def discover(
    model: Model,
    runs: Sequence[Run],
    held_out: Sequence[Run],
    catalogue: Sequence[Effect],
    progress: Progress | None = None,
) -> Discovery:
    """Find a formula for the force that a model lacks.

    Args:
        model: the model as given.
        runs: runs to fit.
        held_out: runs that help to choose, but are not fitted.
        catalogue: known effects; a formula that one of them explains as well gets its name.
        progress: called with a text at every step.

    Raises:
        InputError: a further quantity has two units, or the states of a user's base are not in SI units.
    """
    check_same_units([*runs, *held_out])
    say = progress or (lambda _: None)
    say("fitting the model as it is")
    bare = Study.of(model, runs, held_out, ())
    first = bare.first()
    given = Search((Step((), (), bare.present, first, residual_tests(first, [])),))
    if not given.last.tests.fails:
        return concluded(bare, given, {}, {})
    formulas, curves = (physics_terms, physics_curves) if isinstance(model, PhysicsModel) else TERMS_BY_BASE[model.base]
    taken = {effect.name for effect in (*model.effects, *catalogue)}
    terms = named_terms(formulas(first), taken)
    study, found = _searched(model, runs, held_out, catalogue, terms, say)
    if study.is_lost(found.last.fit):
        raise TaskFailedError(lost_sentence(found.last.fit))
    if not _is_whole(study, found):
        smooth = named_terms(curves(first), taken)
        other, drawn = _searched(model, runs, held_out, catalogue, smooth, say)
        if other.squared_error(drawn.last.fit) < MAX_CURVE_RESIDUAL_SHARE * study.squared_error(found.last.fit):
            study, found, terms = other, drawn, smooth
    return concluded(study, found, terms, {e.name: e for e in catalogue})


MAX_TERMS_PER_JOINT, MAX_TERMS_PER_KIND = 12, 3
"""Number of terms of a joint, and of each kind, that are fully evaluated: those with the largest predicted
contribution."""
MAX_CURVE_RESIDUAL_SHARE = 0.7
"""Largest share of a formula's squared error above the noise that a curve may leave to be reported instead."""


def _searched(
    model: Model,
    runs: Sequence[Run],
    held_out: Sequence[Run],
    catalogue: Sequence[Effect],
    terms: dict[str, Term],
    say: Progress,
) -> tuple[Study, Search]:
    effects = effects_of_terms(list(terms.values()))
    size = len(catalogue) + len(effects) // max(len({t.site.joint for t in terms.values()}), 1)
    study = Study.of(model, runs, held_out, [*catalogue, *effects], catalogue_size=size)
    if model.linear:
        promising = [effect for effect in effects if effect.name in _promising(study, terms)]
        study = Study.of(model, runs, held_out, [*catalogue, *promising], catalogue_size=size)
    found = search(study, say)
    return study, found if predicts_better(study, found) else Search(found.steps[:1])


def predicts_better(study: Study, found: Search) -> bool:
    """Whether held-out runs are predicted better than by the model as given; True where there are none."""
    unfitted = [study.held_out_blocks(step.fit) for step in (found.steps[0], found.last)]
    given, then = (sum(float(block.residual @ block.residual) for block in blocks) for blocks in unfitted)
    return not unfitted[1] or then < given


def _promising(study: Study, terms: Mapping[str, Term]) -> set[str]:
    """Names of the terms of each joint with the largest predicted contribution, few of a kind."""
    looked_at = Counter[tuple[str, ...]]()
    found = set[str]()
    for score in study.scores(study.first(), study.present):
        term = terms.get(score.candidate.effect)
        if term is None:
            continue
        joint, kind = term.site.joint, term.kind
        if looked_at[joint,] < MAX_TERMS_PER_JOINT and looked_at[joint, kind] < MAX_TERMS_PER_KIND:
            looked_at.update([(joint,), (joint, kind)])
            found.add(term.name)
    return found


def _is_whole(study: Study, found: Search) -> bool:
    """Whether the residual is only noise, or nearly."""
    start, last = found.steps[0], found.last
    return not last.tests.fails or (
        len(found.steps) > 1 and study.explained_share(start.fit, last.fit) > MIN_EXPLAINED_AT_NOISE
    )


def concluded(study: Study, found: Search, terms: dict[str, Term], known: dict[str, Effect]) -> Discovery:
    """The result of a search, as formulas."""
    start, last = found.steps[0], found.last
    values = fitted_parameters(study, last.fit)
    shares = [study.explained_share(start.fit, step.fit) for step in found.steps[1:]]
    gains = dict(zip(found.steps[1:], np.diff([0.0, *shares]).tolist(), strict=True))
    findings = [
        _finding(study, candidate, {step: gain for step, gain in gains.items() if _brings(step, candidate)},
                 terms, known, values)
        for candidate in last.effects
        if candidate not in start.effects
    ]  # fmt: skip
    unfitted = [study.held_out_blocks(step.fit) for step in (start, last)]
    scale = Scale.of(last.fit.blocks)
    return Discovery(
        findings=tuple(_distinct(findings, {*known, *(effect.name for effect in study.model.effects)})),
        before=start.fit.rmse(),
        after=last.fit.rmse(),
        held_out_before=channel_rmse(unfitted[0]),
        held_out_rmse=channel_rmse(unfitted[1]),
        noise=scale.noise,
        units=scale.units,
        explains=study.explained_share(start.fit, last.fit) if len(found.steps) > 1 else 0.0,
        leaves_something=last.tests.fails,
        judged=bool(unfitted[1]),
        runs=tuple(run.name for run in study.runs),
        held_out=tuple(run.name for run in study.held_out),
        still=all(block.predicted.std() < block.noise for block in start.fit.blocks),
        missing_force=found.missing_force(law=True),
    )


def _brings(step: Step, candidate: Candidate) -> bool:
    """Whether a step added an effect, or one of the joints of its final form."""
    return any(not set(candidate.names).isdisjoint(added.names) for added in step.added)


def _finding(
    study: Study,
    candidate: Candidate,
    gains: Mapping[Step, float],
    terms: dict[str, Term],
    known: dict[str, Effect],
    values: Mapping[str, Parameter],
) -> Finding:
    """One effect of the result, with the share that the steps which added it explain."""
    own = {n.split(".", 1)[1]: values[n] for n in candidate.names if n in values}
    if len(candidate.joints) == 1:
        own = {name.partition("[")[0]: value for name, value in own.items()}
    term = terms.get(candidate.effect)
    tied = [c.effect for step in gains for c in step.tied]
    same = [name for name in tied if name in known]
    rivals = dict.fromkeys(
        _formula(name, terms, known)
        for name in tied
        if term is None or name not in terms or terms[name].kind != term.kind
    )
    effect = study.effects[candidate.effect]
    if term is not None:
        term = term.at({name: own[name].value for name in term.constants if name in own})
    return Finding(
        effect=candidate.effect,
        joints=candidate.joints,
        acts_on=effect.acts_on,
        kind=candidate.effect if term is None else term.kind,
        says=effect.summary.rstrip("."),
        formula=_formula(candidate.effect, terms, known),
        values=own,
        explains=sum(gains.values()),
        known_as=candidate.effect if term is None else next(iter(same), None),
        rivals=tuple(rivals),
        term=term,
    )


def _formula(name: str, terms: dict[str, Term], known: dict[str, Effect]) -> str:
    if name in terms:
        return terms[name].formula
    text = (known[name].function.__doc__ or known[name].summary).strip().split("\n")[0]
    return f"{name}: {text}".rstrip(".")


def _distinct(findings: Sequence[Finding], taken: set[str]) -> Iterator[Finding]:
    """Give findings unique names that describe them: ``discovered_stop``, ``discovered_stop_2``."""
    for one in findings:
        if one.term is None:
            yield one
            continue
        stem = one.term.stem
        name = next(n for k in count(1) if (n := stem if k == 1 else f"{stem}_{k}") not in taken)
        taken = taken | {name}
        yield replace(one, effect=name, term=one.term.named(name))
