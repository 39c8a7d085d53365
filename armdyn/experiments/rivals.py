"""Find the rival hypotheses that a diagnosis does not distinguish, and fit each to the runs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from armdyn.errors import InputError, TaskFailedError, UnknownNameError
from armdyn.estimation.correlation import correlation_time
from armdyn.estimation.solve import marginal_information, pseudo_inverse
from armdyn.experiments.hypothesis import EXPERIMENT_CHANNELS, Hypothesis
from armdyn.experiments.separation import TIE_CHI2
from armdyn.identify.diagnose import Diagnosis, diagnose
from armdyn.identify.fit import Fit, continue_fit
from armdyn.identify.problem import Problem
from armdyn.identify.residual.block import blocks_by_channel
from armdyn.identify.selection.candidate import Candidate, group_by_effect
from armdyn.identify.sentence import Verdict
from armdyn.identify.study import Study
from armdyn.pendulum.path import GripperPath, gripper_path
from armdyn.physics.simulated import SimulatedModel, as_model_with_motion, as_simulated_model
from armdyn.run import Run
from armdyn.threads import one_thread

UNSEEN_EFFECT_SIZE_IN_STDS = 2.0
"""Size of an effect that the runs may not reveal, in standard deviations of its parameter."""
MAX_RIVALS = 5
"""Largest number of rival hypotheses in a plan; the most plausible ones are used."""
WELL_KNOWN_STD_TYPICAL_SIZES = 0.05
"""Ratio of standard deviation to typical size up to which a parameter counts as well known."""
NO_EFFECT_NAME = "nothing"
"""Name of the hypothesis without an added effect."""


@dataclass(frozen=True, eq=False)
class Rivals:
    """Rival hypotheses on the true model, and the noise of the channels.

    Attributes:
        hypotheses: the hypotheses, the best one so far first.
        noise: by channel, standard deviation of one sample, increased for the samples' correlation.
        last: the last run, whose motion could be repeated in another experiment.
    """

    hypotheses: tuple[Hypothesis, ...]
    noise: dict[str, float]
    last: Run

    @property
    def pivot_stands(self) -> bool:
        """Whether no gripper moves, so that an experiment is a swing that a hand releases."""
        return "gripper_x" not in self.last.channels

    @property
    def of_process(self) -> bool:
        """Whether the model is that of a process of one's own, not of a pendulum."""
        return not self.hypotheses[0].model.hangs_from_gripper


def require_plannable(study: Study) -> None:
    """Refuse a study for which no experiment can be planned.

    Raises:
        InputError: the model simulates no motion, or an unstable one; or it is a pendulum, and a gripper moves in some
            runs only, or a run has no channel by which an experiment is judged.
    """
    model = study.model
    if not model.hangs_from_gripper:
        simulated = as_model_with_motion(model)
        if simulated is None:
            raise InputError(
                "experiments are designed for pendulums and bases of your own, and this model is of base "
                f"'{model.base}': for an arm, 'armdyn excite' designs the motion"
                + "".join(f". {text}" for text in model.open_questions)
            )
        if simulated.following.restart is not None:
            raise InputError(
                f"a process of base '{model.base}' is unstable, so no signal can be applied to it as it was planned: "
                "plan experiments with the controller that holds it, as a part of the base"
            )
        return
    moved = [run for run in study.runs if "gripper_x" in run.channels]
    for run in study.runs:
        if moved and run not in moved:
            raise InputError(
                f"{run.name}: has no 'gripper_x', which {moved[0].name} has: plan for runs of one kind at a time"
            )
        if not any(channel in run.channels for channel in EXPERIMENT_CHANNELS):
            raise InputError(
                f"{run.name}: has none of {', '.join(EXPERIMENT_CHANNELS)}, by which an experiment would be judged"
            )


@one_thread
def rivals_of_study(
    study: Study, names: Sequence[str] | None = None, say: Callable[[str], None] | None = None
) -> tuple[str, str, Rivals | None]:
    """Diagnose a study; return the verdict, a sentence, and the rivals to distinguish, None without rivals.

    If `names` of effects are given, these are the rivals, and the study is not diagnosed.

    Raises:
        InputError: see `require_plannable` and `rivals_by_name`.
        TaskFailedError: the fit has failed.
    """
    require_plannable(study)
    if names is not None:
        return "", "", rivals_by_name(study, names)
    found = diagnose(study, say)
    if found.verdict is Verdict.LOST:
        raise TaskFailedError(found.sentence)
    rivals = rivals_of_diagnosis(study, found) or rival_values_of_worst_parameter(study, found)
    said = found.comparison.sentence if rivals is None else ""
    if rivals is None:
        said = f"{found.sentence} No effects remain to be distinguished, and all values are known well."
        if found.verdict.key == "unknown_effect":
            said = f"{found.sentence} No experiment can be designed for an effect that no model describes."
    return found.verdict.key, said, rivals


def undistinguished_effect_sets(found: Diagnosis) -> list[tuple[Candidate, ...]]:
    """Sets of added effects that the runs cannot distinguish by a diagnosis, the best set first."""
    last, given = found.search.last, found.search.steps[0].effects
    added = group_by_effect([c for c in last.effects if c not in given])
    sets = [tuple(added)]
    for step in found.search.steps[1:]:
        mine = {name for c in step.added for name in c.names}
        rest = [left for c in added if (left := c.without_parameters(mine)).parameter_names_by_joint]
        sets += [group_by_effect([*rest, tied]) for tied in found.search.ties(step)]
    return sets


def rivals_of_diagnosis(study: Study, found: Diagnosis) -> Rivals | None:
    """The hypotheses that a diagnosis does not distinguish; None if it distinguishes all."""
    sets = undistinguished_effect_sets(found)
    if len(sets) < 2:
        return None
    return fit_rivals(study, sets, found.search.steps[0].fit)


def rivals_of_first_effect(study: Study, found: Diagnosis, *, designed: bool) -> Rivals | None:
    """Rivals of the effect that a diagnosis names first: effects that are not certainly worse; None without rivals.

    A diagnosis names an effect that is certainly better than no effect. Here the same certainty is required against
    similar effects, because model errors can decide between them wrongly.

    Args:
        study: study of all runs.
        found: the diagnosis of the study.
        designed: whether a run was designed to distinguish them; then the margin of that design is used.
    """
    steps = found.search.steps
    if len(steps) < 2:
        return None
    added = group_by_effect([c for c in found.search.last.effects if c not in steps[0].effects])
    leading = {c.effect for c in steps[1].added}
    rest = tuple(c for c in added if c.effect not in leading)
    by_name = _by_name(study)
    # A ranking is linearised at the leading effect, where its nearest rival may look worse than none.
    scores = study.scores(steps[0].fit, steps[0].effects)
    least = study.settings.search.missing_evidence_share * scores[0].chi2_decrease
    promised = [s.candidate.effect for s in scores if s.chi2_decrease >= least]
    likely = dict.fromkeys([*(s.effect for s in found.ranked_effects), *promised])
    others = [name for name in likely if name in by_name and name not in {c.effect for c in added}]
    sets = [tuple(added), *((*rest, by_name[name]) for name in others[: MAX_RIVALS - 1])]
    all_of_them = fit_rivals(study, sets, steps[0].fit)
    # Otherwise the fall of chi2 that a diagnosis requires of one effect among the catalogue is required.
    margin = (
        TIE_CHI2 if designed else 2.0 * (study.settings.search.acceptance_nats + float(np.log(len(study.candidates))))
    )
    close = tuple(h for h in all_of_them.hypotheses if h.misfit <= margin)
    return replace(all_of_them, hypotheses=close) if len(close) > 1 else None


def rivals_by_name(study: Study, names: Sequence[str]) -> Rivals:
    """Rivals by names of effects: the model with each effect added; a single effect is compared with none.

    Raises:
        UnknownNameError: the catalogue has no such effect, or the model has it already.
    """
    by_name, present = _by_name(study), {c.effect for c in study.present}
    for name in names:
        if name in present:
            raise InputError(f"--rivals {name}: the model has this effect already: name one that it lacks")
        if name not in by_name:
            raise UnknownNameError("effect", name, by_name)
    sets: list[tuple[Candidate, ...]] = [(by_name[name],) for name in dict.fromkeys(names)]
    return fit_rivals(study, sets if len(sets) > 1 else [*sets, ()], study.first())


def rivals_refitted_to(study: Study, sets: Sequence[Sequence[str]]) -> Rivals:
    """Rivals with the effects of each of `sets` added, fitted to the runs of a study."""
    by_name = _by_name(study)
    return fit_rivals(study, [tuple(by_name[name] for name in names) for names in sets], study.first(), most=len(sets))


def rival_values_of_worst_parameter(study: Study, found: Diagnosis) -> Rivals | None:
    """Two possible values of the parameter that the runs determine worst; None if all are well known.

    Two values of one parameter are rivals like others: their separation is the information on the parameter, with all
    other unknowns as nuisance, times the squared difference of the values.
    """
    if found.residual_character is not None and found.search.last.tests.fails:
        return None
    noise = effective_noise(found.search.last.fit)
    best = _hypothesis(study, found.search.last.fit, (), noise)
    covariance = pseudo_inverse(best.information)
    parameters = [best.model.parameters[name] for name in best.free]
    stds = np.sqrt(np.diag(covariance))
    shares = stds / [p.typical for p in parameters]
    worst = int(np.argmax(shares))
    if shares[worst] < WELL_KNOWN_STD_TYPICAL_SIZES:
        return None
    p, std = parameters[worst], float(stds[worst])
    away = (
        UNSEEN_EFFECT_SIZE_IN_STDS * std
        if p.value + UNSEEN_EFFECT_SIZE_IN_STDS * std <= p.upper
        else -UNSEEN_EFFECT_SIZE_IN_STDS * std
    )
    rest = [i for i in range(len(best.free)) if i != worst]
    # With the parameter at the other value, the others change with it, as the runs correlate them.
    moved = [(parameters[i], parameters[i].value + covariance[i, worst] / std**2 * away) for i in rest]
    values = {q.name: float(np.clip(value, q.lower, q.upper)) for q, value in moved} | {p.name: p.value + away}
    first = replace(
        best, name=f"{p.name} = {p.value:.4g} {p.unit}", free=tuple(best.free[i] for i in rest),
        information=best.information[np.ix_(rest, rest)],
    )  # fmt: skip
    name = f"{p.name} = {p.value + away:.4g} {p.unit}"
    second = replace(first, name=name, model=best.model.with_values(values), misfit=UNSEEN_EFFECT_SIZE_IN_STDS**2)
    return Rivals((first, second), noise, study.runs[-1])


def _by_name(study: Study) -> dict[str, Candidate]:
    return {c.effect: c for c in study.candidates}


def fit_rivals(study: Study, sets: Sequence[tuple[Candidate, ...]], first: Fit, most: int = MAX_RIVALS) -> Rivals:
    """Fit the model with each of `sets` of effects added, and keep the `most` that fit best, the best first.

    Args:
        study: the study.
        sets: sets of effects.
        first: fit of the model as given, from which the fits start.
        most: number of hypotheses that are kept.
    """
    fits = [continue_fit(study.fit_base_with_effects((*study.present, *s), first)) for s in sets]
    noise = effective_noise(min(fits, key=lambda one: one.cost))
    common = set.intersection(*(set(s) for s in sets))
    own = [tuple(c for c in s if c not in common) for s in sets]
    hypotheses = [_hypothesis(study, fit, effects, noise) for fit, effects in zip(fits, own, strict=True)]
    least = min(h.misfit for h in hypotheses)
    hypotheses = sorted((replace(h, misfit=h.misfit - least) for h in hypotheses), key=lambda h: h.misfit)
    return Rivals(tuple(hypotheses[:most]), noise, study.runs[-1])


def effective_noise(best: Fit) -> dict[str, float]:
    """By channel, the residual of the best model, at least the noise, increased for the samples' correlation."""
    left = best.rmse()
    return {
        channel: max(left[channel], *(block.noise for block in blocks))
        * float(np.sqrt(correlation_time([block.misfit for block in blocks])))
        for channel, blocks in blocks_by_channel(best.blocks).items()
    }


def _hypothesis(study: Study, found: Fit, own: Sequence[Candidate], noise: dict[str, float]) -> Hypothesis:
    """A fit as a hypothesis: values, and information of all runs with the unknowns of single runs as nuisance."""
    lean = study.without_unused_effects(found)
    model, last = as_simulated_model(lean.problem.model), len(lean.problem.runs) - 1  # see `require_plannable`
    problem = Problem(
        model, lean.problem.runs, {key: noise[key[1]] for key in lean.problem.noise}, lean.problem.settings
    )
    at = problem.expansion(lean.values, lean.free, guesses=False)
    unknowns = {i: k for k, i in enumerate(np.flatnonzero(lean.free).tolist())}
    places = zip(model.names, problem.unknowns_of_run(last).tolist(), strict=True)
    shared = {name: unknowns[i] for name, i in places if i in unknowns and name not in model.start_names}
    others = np.setdiff1d(np.arange(len(unknowns)), list(shared.values()))
    kept, _ = marginal_information(at.hessian, np.array(list(shared.values()), dtype=int), others)
    theta = dict(zip(model.names, problem.theta(last, lean.values).tolist(), strict=True))
    begun = {name: theta.pop(name) for name in model.start_names}
    values, names = theta, tuple(shared)
    for i, name in enumerate(names):
        if any(name in c.names for c in own):
            values[name] = _sizeable(model, name, values[name], float(kept[i, i]))
    spoken = " + ".join(c.name_in_sentence for c in own) or NO_EFFECT_NAME
    return Hypothesis(spoken, model.with_values(values), names, kept, 2.0 * at.cost, begun)


def _sizeable(model: SimulatedModel, name: str, value: float, information: float) -> float:
    """A value of an effect that is worth testing: the fitted one, or where it is zero as much as the runs allow."""
    p = model.parameters[name]
    std = information**-0.5 if information > 0.0 else np.inf
    if abs(value - p.null) >= std:
        return value
    side = -1.0 if value < p.null or p.upper <= p.null else 1.0
    return float(np.clip(p.null + side * min(p.typical, UNSEEN_EFFECT_SIZE_IN_STDS * std), p.lower, p.upper))


def last_motion(run: Run, seconds: float) -> GripperPath:
    """The gripper's motion in a run, cut to its first `seconds`."""
    path = gripper_path(run)
    count = min(len(path.x), round(seconds / path.dt) + 1)
    return GripperPath(0.0, path.dt, *path.motion_along_line[:, :count])
