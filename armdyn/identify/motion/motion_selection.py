"""Choose the effects of an arm whose servos do not measure their torque, by its simulated motion.

The simulated motion is far from linear: without friction a servo arm swings about its commands. So the search begins
where the frictions of all joints have usual sizes, adds or removes one effect at a time, as sums of derivatives at the
last fit foretell, and keeps a change only if the set predicts better at its own fit.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import norm

from armdyn.arm.slots import COSINE, REST_TORQUE, SINE, STIFFNESS, slots_of
from armdyn.effects.effect import Effect
from armdyn.identify.fit import Fit, continue_fit, fit
from armdyn.identify.motion.motion_study import USUAL_FRICTIONS, MotionStudy
from armdyn.identify.selection.arm_selection import LinearPath, best_path, empty_effects, without_empty_effects
from armdyn.identify.selection.candidate import Candidate, group_by_effect
from armdyn.identify.selection.path import ProgressCallback, SearchStep
from armdyn.identify.selection.select_effects import eliminate, group_joints_by_effect, larger_sets, smaller_sets

GEARED = ("joint_viscous_friction", "joint_load_friction", "rotor_inertia")
EVERY_USUAL = (*USUAL_FRICTIONS, "joint_load_friction", "rotor_inertia", "back_emf", "payload")
STARTS = ((USUAL_FRICTIONS, 1.0), (USUAL_FRICTIONS, 3.0), (GEARED, 3.0), (EVERY_USUAL, 1.0))
"""Effects with which a search may begin, and the size of their values in typical sizes. Hobby servos have dry friction,
geared ones much that grows with the load, and a rotor that is felt. Too much friction is a better start than little,
with which an arm swings: from 0.1 typical sizes, four of ten choices of recordings of an SO-101 end in a local minimum.
"""
LIKE_A_LOAD = frozenset({SINE, COSINE, STIFFNESS, REST_TORQUE})
"""Slots with which several joints together imitate a load; couplings of joints do so, too."""
MAX_START_FIT_STEPS = 5
"""Largest number of steps of the fit with which a search begins."""
MAX_REWEIGHTED_FITS = 2
"""Largest number of fits of a set, each with weights from the errors that the one before leaves."""
MAX_FIRST_LOSS_NATS = 50.0
"""Loss of likelihood after the first steps of a fit of another set, nats, beyond which it ends; not calibrated."""
FINAL_STEPS, FINAL_TOLERANCE_STDS = 8, 0.05
"""Largest number of steps of the fits that are reported, after those of the search, and their tolerance; see `fit`."""
SCORED_ADDITIONS = 8
"""Number of additions to a set, those with the largest predicted scores, whose score is computed in each round."""


def select_for_motion(
    study: MotionStudy, given: SearchStep, say: ProgressCallback
) -> tuple[LinearPath, list[SearchStep]]:
    """Choose the effects with which the simulated motion of an arm is that of the recordings.

    Args:
        study: runs and catalogue, with a model that predicts positions.
        given: the fit of the model as given.
        say: called with a text on the progress.

    Returns:
        The path to the chosen set, and the steps, each with effects in the order in which they were chosen.
    """
    found = _settled(_best_start(study, given, say))
    chosen, loads = [found], set[Candidate]()
    while better := _better(found, loads, say):
        found = better
        chosen.append(found)
    chosen.append(found := _settled(found))
    if (last := _without_chance_effects(found)) is not found:
        chosen.append(found := _settled(last))
    steps = [given, *_steps(chosen, given, say)]
    return found, [*steps, *_beside_description(found, steps[-1], say)]


def _without_chance_effects(found: LinearPath) -> LinearPath:
    """The path without effects that a catalogue shows by chance, or that are not worth their freedom in evidence."""
    least = float(norm.isf(found.study.settings.search.chance_level / 2.0 / max(len(found.scorer.searched_effects), 1)))
    found = without_empty_effects(found, least)
    while parts := [(c,) for c in found.scorer.removable(found.chosen_set)]:
        gone = found.scorer.promising_removals(found.chosen_set, parts)[0]
        other = found.with_effects([c for c in found.chosen_set.effects if c not in gone]).relinearised()
        scale = other.scorer
        before, after = (one.study.worth(one.scorer, one.fit, one.chosen_set, scale) for one in (found, other))
        if after < before:
            break
        found = other
    return found


def _better(found: LinearPath, loads: set[Candidate], say: ProgressCallback) -> LinearPath | None:
    """A path that is better than the one that was found: with another set, or with the same one elsewhere.

    Args:
        found: the path.
        loads: loads that were tried in place of springs; those that are tried now are added.
        say: called with a text on the progress.
    """
    other = next((path for path in _changed(found, loads, say) if best_path([found, path]) is path), None)
    is_first = isinstance(found.study, MotionStudy) and found.study.answer is None
    return _elsewhere(found, say) if other is None and is_first else other


def _elsewhere(found: LinearPath, say: ProgressCallback) -> LinearPath | None:
    """The path with a better fit of its set, from usual sizes of what is not negative, and from the drives as read.

    What a wrench shows stays: it is nearly linear, and has no other minimum.
    """
    study, fitted = found.study, found.fit
    problem = study.problem
    names = [name for c in found.chosen_set.effects if c not in found.scorer.given for name in c.names]
    sizes = problem.mask_of_unknowns(names) & (problem.lower >= problem.null)
    for block in fitted.blocks:
        if not block.channel.startswith("q."):
            sizes &= ~block.sensitivities.any(axis=0)
    drives = ~problem.is_effect & fitted.free
    for size in sorted({size for _, size in STARTS}):
        say(f"fitting the motion with {size:g} typical sizes")
        values = np.where(sizes, problem.null + size * problem.typical, fitted.values)
        values = np.where(drives, problem.start_values(), values)
        again = fit(
            problem, fitted.free, values, most_steps=MAX_START_FIT_STEPS, tolerance=study.tolerance,
            weighted=fitted.weighted,
        )  # fmt: skip
        if found.scorer.gain(fitted, again) > study.settings.search.tie_nats:
            return replace(found, known_fit=continue_fit(again, study.tolerance)).relinearised()
    return None


def _best_start(study: MotionStudy, given: SearchStep, say: ProgressCallback) -> LinearPath:
    """The path to the best of the sets with which a search begins."""
    problem, weighted = study.problem, study.coarsely_weighted(given.fit)

    def near(effects: Sequence[Candidate], values: np.ndarray) -> Fit:
        own = problem.mask_of_unknowns([name for c in effects for name in c.names])
        return fit(
            problem, given.fit.free | own, np.where(own | given.fit.free, values, problem.start_values()),
            most_steps=MAX_START_FIT_STEPS, tolerance=study.tolerance, weighted=weighted,
        )  # fmt: skip

    def begun(effects: Sequence[Candidate], near: Fit) -> LinearPath:
        scorer = study.scorer(near)
        chosen = scorer.evaluate(scorer.split_into_candidates([*study.present, *effects]))
        return LinearPath(study, scorer, chosen, given.effects, near, near)

    if study.answer is not None:
        say("fitting the motion with finer steps")
        effects, values = study.effects_of_answer(study.answer)
        return begun(effects, near(effects, values))
    found = list[tuple[Sequence[Candidate], Fit]]()
    sensed, there = ((), problem.start_values()) if study.sensed is None else study.effects_of_answer(study.sensed)
    for names, size in STARTS:
        say(f"fitting the motion with {', '.join(names)}")
        usual = [c for c in study.candidates if c.effect in names and c.effect not in {own.effect for own in sensed}]
        own = problem.mask_of_unknowns([name for c in usual for name in c.names])
        values_of_start = np.where(own, problem.null + size * problem.typical, there)
        found.append(((*sensed, *usual), near((*sensed, *usual), values_of_start)))
    return begun(*min(found, key=lambda one: one[1].chi2))


def _settled(found: LinearPath) -> LinearPath:
    """The path with a fit whose weights, from the errors that it leaves, are those with which it was made."""
    for _ in range(MAX_REWEIGHTED_FITS):
        found = found.relinearised()
        again = found.with_set(found.chosen_set)
        gain, found = found.scorer.gain(found.fit, again.fit), again
        if gain < found.study.settings.search.tie_nats:
            break
    return found.relinearised()


def _changed(found: LinearPath, tried: set[Candidate], say: ProgressCallback) -> Iterator[LinearPath]:
    """Fitted paths to sets with fewer effects or more, those that are foretold to be the best first."""
    scorer, now = found.scorer, found.chosen_set
    fewer, more = smaller_sets(scorer, now), larger_sets(scorer, now, SCORED_ADDITIONS)
    best = max([*fewer, *more], key=lambda one: one.score)
    promising = [eliminate(scorer, best), best, max(fewer, key=lambda one: one.score, default=now)]
    for one in dict.fromkeys(one for one in promising if one.score > now.score):
        change = ", ".join(sorted(c.label for c in set(one.effects) ^ set(now.effects)))
        say(f"fitting the motion {'with' if len(one.effects) > len(now.effects) else 'without'} {change}")
        path = found.with_set(one)
        if scorer.gain(found.fit, path.first_fit) < -MAX_FIRST_LOSS_NATS or _new_bounds(found.fit, path.fit):
            continue
        if scorer.gain(found.fit, path.fit) + scorer.complexity_penalty(now.effects) > scorer.complexity_penalty(
            one.effects
        ):
            yield path.relinearised()
    yield from _with_load_instead_of_springs(found, tried, say)
    yield from _completed(found, say)


def _new_bounds(before: Fit, after: Fit) -> set[str]:
    """Values of effects that are on a bound after a change of the set. A delay of nothing is as good as any other."""
    drives = {c.name for c in after.problem.columns if not c.parameter.effect}
    return set(after.at_bound) - set(before.at_bound) - drives


def _with_load_instead_of_springs(
    found: LinearPath, tried: set[Candidate], say: ProgressCallback
) -> Iterator[LinearPath]:
    """Fitted paths to sets with a load in place of springs, which imitate its weight on every joint.

    Where springs do so already, the sums, which are at their optimum, do not show the load.
    """
    model, now = found.study.problem.model, found.chosen_set
    alike = {effect.name for effect in model.effects if _is_like_a_load(effect)}
    springs = [c for c in now.effects if c.effect in alike and c not in found.scorer.given]
    loads = [c for c in found.scorer.addable(now) if model.changes_link(c.names)]
    for load in [c for c in loads if c not in tried] if springs else ():
        tried.add(load)
        say(f"fitting the motion with {load.label} in place of {', '.join(c.label for c in springs)}")
        without = found.with_effects([c for c in now.effects if c not in springs]).relinearised()
        yield without.with_effects(without.scorer.split_into_candidates([*without.effects, load])).relinearised()


def _is_like_a_load(effect: Effect) -> bool:
    return bool(slots_of(effect).names & LIKE_A_LOAD) or effect.reach == "coupled"


def _completed(found: LinearPath, say: ProgressCallback) -> Iterator[LinearPath]:
    """Fitted paths to sets in which an effect of most joints acts on all others too, at first with the usual size.

    Joints are alike, and what a motion says of a rotor in a light wrist is seen with the rotor alone.
    """
    now, problem = found.chosen_set, found.study.problem
    empty = empty_effects(found.study, found.fit, now.effects)
    sure = [c for c in now.effects if c not in empty]
    for effect in dict.fromkeys(c.effect for c in sure if c not in found.scorer.given):
        own = [c for c in sure if c.effect == effect]
        rest = [c for c in found.scorer.searched_effects if c.effect == effect and c not in own]
        if not len(own) > len(rest) > 0:
            continue
        say(f"fitting the motion with {effect} on all joints")
        values = found.fit.values.copy()
        for k in range(len(own[0].names)):
            there, here = (problem.mask_of_unknowns([c.names[k] for c in part]) for part in (own, rest))
            values[here] = np.median(values[there])
        more = found.with_set(found.scorer.evaluate(tuple(dict.fromkeys((*now.effects, *rest)))))
        near = found.study.fit_base_with_effects(more.effects, found.fit, values)
        if not _new_bounds(found.fit, near):
            yield replace(more, known_fit=continue_fit(near, found.study.tolerance)).relinearised()


def _steps(chosen: Sequence[LinearPath], given: SearchStep, say: ProgressCallback) -> Iterator[SearchStep]:
    """The steps to the last of the chosen sets, each with what stayed of the effects that were chosen next.

    Their links are as described.
    """
    last, effects = chosen[-1], given.effects
    study, there = last.study, [c for path in chosen for c in path.chosen_set.effects]
    stayed = [c for c in dict.fromkeys(there) if c in last.chosen_set.effects and c not in last.scorer.given]
    groups = group_joints_by_effect(stayed)
    for i, own in enumerate(groups):
        added = group_by_effect(own)[0]
        effects = (*study.present, *group_by_effect([*(c for c in effects if c not in study.present), added]))
        say(f"{i} of {len(groups)} steps fitted, now {added.name_in_sentence}")
        at = _fitted_as_described(last, effects)
        if i == len(groups) - 1:
            at = _finished(at)
        yield SearchStep((added,), (), effects, at, study.tests(at, effects))


def _fitted_as_described(found: LinearPath, effects: Sequence[Candidate]) -> Fit:
    """The fit of some effects of a path, from the values of its fit, with links as described."""
    study, scorer, problem = found.study, found.scorer, found.study.problem
    widths = scorer.prior_widths(scorer.split_into_candidates(effects), 0.0, described=True)
    stay = problem.mask_of_unknowns([name for c in effects for name in c.names]) | ~problem.is_effect
    return study.fit_with_prior_widths(scorer, widths, np.where(stay, found.fit.values, problem.null))


def _finished(at: Fit) -> Fit:
    """A fit with the further steps that the search had no time for."""
    return fit(
        at.problem, at.free, at.values, most_steps=FINAL_STEPS, tolerance=FINAL_TOLERANCE_STDS, weighted=at.weighted
    )


def _beside_description(found: LinearPath, named: SearchStep, say: ProgressCallback) -> Iterator[SearchStep]:
    """The step with links that differ from their description, or with a load in their place, if either is likelier.

    Links without a name imitate a load, at a price that only the evidence of the whole set knows.
    """
    search = found.study.settings.search
    study, scorer, effects = found.study, found.scorer, found.chosen_set.effects

    def errors(at: Fit) -> np.ndarray:
        return scorer.mean_squared_errors_of(at.blocks, study.held_out_blocks(at))

    def gain(at: Fit, chosen: Sequence[Candidate], *, described: bool) -> float:
        """Gain of evidence; none where held-out runs are predicted worse, because what is left is not noise."""
        better = scorer.predicted_gain(errors(named.fit), errors(at)) >= 0.0
        return scorer.evidence(at, errors(at), chosen, described=described) - least if better else -np.inf

    least = scorer.evidence(named.fit, errors(named.fit), effects, described=True)
    whole = _finished(found.fit)
    step = SearchStep((), (), named.effects, whole, study.tests(whole, named.effects), search.link_width)
    gains = {step: gain(whole, effects, described=False)}
    loads = [c for c in scorer.searched_effects if study.problem.model.changes_link(c.names) and c not in effects]
    for load in loads if gains[step] > search.tie_nats else ():
        say(f"fitting the motion with {load.label} in place of links")
        near = study.own(scorer.values(scorer.evaluate((*effects, load))), scorer.problem)
        own, chosen = study.problem.mask_of_unknowns(load.names), (*named.effects, load)
        begun = replace(named.fit, values=np.where(own, near, named.fit.values))
        at = _finished(_fitted_as_described(replace(found, known_fit=begun), chosen))
        loaded = SearchStep((load,), (), chosen, at, study.tests(at, chosen))
        gains[loaded] = gain(at, (*effects, load), described=True)
    best = max(gains, key=gains.__getitem__)
    if gains[best] > search.tie_nats:
        yield best
