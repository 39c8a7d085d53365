"""Add missing effects until the runs are explained, and keep the errors of every step."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from armdyn.displayable import Displayable
from armdyn.document import Document, ResultLevel, Section
from armdyn.effects.effect import Effect
from armdyn.errors import InputError, TaskFailedError
from armdyn.identify.compare import Comparison, comparison, fitted_parameters
from armdyn.identify.diagnose import decide_verdict
from armdyn.identify.explained_share import RepairStep, explained_share
from armdyn.identify.failed_fit import failed_fit_sentence
from armdyn.identify.fit import Fit
from armdyn.identify.holdout import HoldoutKind
from armdyn.identify.residual.character import ResidualCharacter, characterise, residual_sentence
from armdyn.identify.residual.force_law import force_law_sentence
from armdyn.identify.residual.missing_force import ForceCurve
from armdyn.identify.selection.path import ProgressCallback, SearchStep
from armdyn.identify.selection.search import Search, background_names, background_values, repair_step, search
from armdyn.identify.sentence import (
    NamedEffect,
    RepairResidual,
    Verdict,
    join_names,
    named_effects,
    repair_sentences,
)
from armdyn.identify.study import Study
from armdyn.identify.tables import (
    error_fall_sentence,
    link_section,
    missing_force_columns,
    prediction_curves,
    step_columns,
    step_table,
)
from armdyn.identify.uncertainty import uncertainty
from armdyn.model import Model
from armdyn.parameter import Parameter
from armdyn.recording.spikes import outlier_sentence
from armdyn.threads import one_thread

if TYPE_CHECKING:
    from armdyn.arm.links import LinkInertiaChange

MIN_IMPROVEMENT_EXPLAINED_SHARE = 0.5
"""Share of the squared error that a repair must explain to count as an improvement although its residual is more than
noise."""


def _finite(values: Mapping[str, float]) -> dict[str, float]:
    """The values that a file can hold: a diverged prediction of an exam has an infinite error."""
    return {name: float(value) for name, value in values.items() if np.isfinite(value)}


@dataclass(frozen=True, eq=False, repr=False)
class Repair(Displayable):
    """Result of a repair.

    Attributes:
        verdict: verdict on the model after the repair.
        sentence: the result in words, for a reader.
        model: the model with the added effects and fitted values, and with a background of small values where that
            improves predictions; the model as given where the fit has failed.
        model_without_background: the repaired model fitted without a background.
        path: errors after each step of the repair; the first step is the model as given.
        after: comparison of the repaired model with the runs.
        residual_character: description of the residual, where it is more than noise.
        study: what the fits of the steps were made by: of arms that are judged by motion not by the study of torques.
        links: links of an arm whose mass, centre or inertia the added effects change, in kg, m and kg m^2.
        explained: share of the squared error that the repair explains; `identify.explained` defines it.
        steps: fits and effects of each step of `path`.
        missing_force: curves of the force that the model as given and the repaired one lack.
        remarks: sentences on the law of the missing force, on the residual and on outliers of the recordings.
    """

    verdict: Verdict
    sentence: str
    model: Model
    model_without_background: Model
    path: tuple[RepairStep, ...]
    after: Comparison
    residual_character: ResidualCharacter | None
    study: Study
    links: tuple["LinkInertiaChange", ...] = ()
    explained: float = 0.0
    steps: tuple[SearchStep, ...] = ()
    missing_force: tuple[ForceCurve, ...] = ()
    remarks: str = ""

    def document(
        self, holdout_kinds: Sequence[HoldoutKind] = (), summaries: Mapping[str, str] | None = None
    ) -> Document:
        """Build the document: the fall of the error, the changed links of an arm, the quality of the repaired model.

        Args:
            holdout_kinds: kinds of runs whose errors are shown in addition to those of the fitted runs.
            summaries: one sentence on each effect, by its name; None leaves them out.
        """
        steps = step_table(self.path, self.after.scale, holdout_kinds, summaries or {})
        falling = Section(
            "The error falling",
            f"{error_fall_sentence(self.path, self.after.scale)} {self.remarks}".strip(),
            tables=[steps],
        )
        fits = {"as given": self.steps[0].fit} | ({"repaired": self.after.fit} if len(self.path) > 1 else {})
        added = {name for step in self.path for name in step.added}
        added_first = dict(sorted(self.after.parameters.items(), key=lambda item: item[1].effect not in added))
        compared = replace(self.after, parameters=added_first).document()
        links = [link_section(self.links)] if self.links else []
        values, *others = compared.sections
        values = replace(values, sentence=f"{_condition_of_values(self.path)}{values.sentence}")
        return replace(
            compared,
            title="Repair",
            verdict=self.sentence,
            sections=[falling, *links, values, *others],
            level=self.level,
            data={
                "steps": lambda: step_columns(self.path, self.after.scale.units),
                **compared.data,
                "missing_force": lambda: missing_force_columns(self.missing_force),
            },
            curves=partial(prediction_curves, self.after.study, fits),
        )

    @property
    def history(self) -> tuple[dict[str, Any], ...]:
        """Entries for the history of a model file, one for each step: what was added, the runs, the errors after it.

        The entry `contribution` has, for each channel, the root mean square of what the step's effects change in the
        prediction of the repaired model.
        """
        roles = {"runs": self.study.runs, "held_out": self.study.held_out, "exam": self.study.exam}
        names = {role: [run.name for run in runs] for role, runs in roles.items() if runs or role != "exam"}
        return tuple(
            {
                "added": " + ".join(step.added) or None,
                "joints": list(step.joints) or None,
                **names,
                "rmse": _finite(step.rmse),
                "held_out_rmse": _finite(step.held_out_rmse) or None,
                "exam_rmse": _finite(step.exam_rmse) or None,
                **_finite({"chi2_per_sample": step.chi2_per_sample, "bic": step.bic}),
                "contribution": _finite(self.steps[-1].fit.contribution(step.added)),
                "as_given_rmse": _finite(self.path[0].rmse) if k == 0 else None,
            }
            for k, step in enumerate(self.path[1:])
        )

    @property
    def named(self) -> list[NamedEffect]:
        """The added effects, that with the largest share of the misfit first."""
        return named_effects(self.path, self.after.scale)

    @property
    def level(self) -> ResultLevel:
        """Level of the result: good where the residual is noise, bad where the error grew, otherwise in between."""
        if self.verdict is Verdict.EXPLAINED and self.after.std_inflation == 1.0:
            return ResultLevel.GOOD
        if self.explained < 0.0 or self.verdict is Verdict.LOST:
            return ResultLevel.BAD
        return ResultLevel.IMPROVED if self.explained > MIN_IMPROVEMENT_EXPLAINED_SHARE else ResultLevel.CAUTION


@one_thread
def repair(study: Study, progress: ProgressCallback | None = None) -> Repair:
    """Find the effects that the model of a study lacks and add them, until the residual is noise or no effect helps.

    An arm's model also gets a background of small values, where that improves the prediction of other runs; see
    `armdyn.identify.selection.background`.
    """
    found = search(study, progress)
    exact = study.with_exact_steps(found.last.fit)
    return _concluded(study, found) if exact is None else repair(exact, progress)


@one_thread
def add(study: Study, wanted: Iterable[Effect]) -> Repair:
    """Add effects to the model of a study, one after the other, whether or not the runs need them, and refit it.

    Raises:
        InputError: the model has an effect already, or these runs cannot show it.
    """
    effects, now = study.present, study.first()
    steps = [SearchStep((), (), effects, now, study.tests(now, effects))]
    for effect in wanted:
        found = next((c for c in study.candidates if c.effect == effect.name), None)
        if found is None:
            if not effect.parameters():
                raise InputError(f"the effect '{effect.name}' has no parameter, so there is nothing to fit")
            if asked := effect.missing_channels(study.recorded):
                listed = " or ".join(asked)
                raise InputError(f"the effect '{effect.name}' does not show in these recordings: record {listed} too")
            raise InputError(f"the model already has the effect '{effect.name}'")
        candidate = found.on(effect.joints) if effect.joints else found
        effects = (*effects, candidate)
        now = study.fit_base_with_effects(effects, now)
        steps.append(SearchStep((candidate,), (), effects, now, study.tests(now, effects)))
    return _concluded(study, Search(tuple(steps)), searched=False)


def require_fit(found: Repair) -> Repair:
    """Return the repair unchanged, if its fit has not failed.

    Raises:
        TaskFailedError: the fit has failed.
    """
    if found.verdict is Verdict.LOST:
        raise TaskFailedError(found.sentence)
    return found


def _concluded(study: Study, found: Search, *, searched: bool = True) -> Repair:
    if study.fit_has_failed(found.last.fit):
        return _lost(study, found)
    last = found.last
    unknown = characterise(last.fit) if last.tests.fails else None
    verdict = _verdict(study, found, unknown)
    if verdict is Verdict.UNKNOWN_EFFECT and not searched:
        verdict = Verdict.EFFECT_MISSING  # the catalogue was not searched
    path = tuple(repair_step(study, step) for step in found.steps)
    after = comparison(study, last.fit, last.tests, process_error=False, unnamed=background_names(study, last))
    links = changed_links_of_fit(study, last.fit)
    left = RepairResidual(
        exceeds_noise=verdict is not Verdict.EXPLAINED,
        description=unknown.headline if unknown is not None else "",
        searched=searched,
        further_effect=found.further_effect.name_in_sentence if found.further_effect is not None else "",
        warnings=[link.warning for link in links if link.warning],
    )
    repaired = len(path) > 1
    forces = found.missing_force()
    law = force_law_sentence(forces, {c.effect for c in last.effects}) if repaired or left.exceeds_noise else ""
    beyond = residual_sentence(unknown) if left.exceeds_noise else ""
    return Repair(
        verdict=verdict,
        sentence=repair_sentences(path, study.holdout_kinds[0], after.scale, left),
        remarks=(law + beyond + outlier_sentence(study.runs)).strip(),
        model=fitted_model(study, found),
        model_without_background=model_of_step(study, found.named),
        path=path,
        after=after,
        residual_character=unknown,
        study=study,
        links=links,
        explained=explained_share(path[0], path[-1], after.scale),
        steps=found.steps,
        missing_force=forces,
    )


def _condition_of_values(path: Sequence[RepairStep]) -> str:
    """A sentence on what the values depend on, where effects are tied; empty where none are."""
    added = {name for step in path for name in step.added}
    tied = [step for step in path if not added.issuperset(step.tied_with)]
    if not tied:
        return ""
    names = join_names(list(dict.fromkeys(name for step in tied for name in step.added)))
    return f"The values hold if what acts is {names}; with an effect that cannot be distinguished from it they differ. "


def _lost(study: Study, found: Search) -> Repair:
    """The repair of a lost fit: the model as given, because effects added to a lost fit have no meaning."""
    first = found.steps[0]
    return Repair(
        verdict=Verdict.LOST,
        sentence=failed_fit_sentence(found.last.fit),
        model=study.model,
        model_without_background=study.model,
        path=(repair_step(study, first),),
        after=comparison(study, first.fit, first.tests, process_error=False),
        residual_character=None,
        study=study,
        steps=(first,),
    )


def fitted_model(study: Study, found: Search) -> Model:
    """The model with the effects, fitted values and background of the last step of a search.

    The background also keeps the values that the named effects have without it.
    """
    model, small = model_of_step(study, found.last), background_values(study, found.last)
    if not small:
        return model
    alone = model_of_step(study, found.named)
    named_only = {name: alone.value(name) for name, p in alone.parameters.items() if p.scope == "shared"}
    return model.with_background(found.last.background_width, small, study.effects.values(), named_only)


def model_of_step(study: Study, step: SearchStep) -> Model:
    """The model with the named effects of a step and their fitted values there.

    Parameters of single runs keep their start values.
    """
    model = study.model_with(step.effects)
    described, changed = fitted_parameters(study, step.fit), dict[str, Parameter]()
    for column in study.problem.columns:
        name = column.parameter.name
        # Where runs differ, the value of the first one is used.
        if column.name in described and name not in changed and name in model.parameters:
            kept, found = model.parameters[name], described[column.name]
            if kept.scope == "shared":
                changed[name] = replace(kept, value=found.value, std=found.std, fitted=kept.fitted or found.fitted)
    return model.with_parameters(changed)


def _verdict(study: Study, found: Search, unknown: ResidualCharacter | None) -> Verdict:
    """The verdict after a repair: explained, or the reason why not."""
    if not found.last.tests.fails:
        return Verdict.EXPLAINED
    noise = study.leaves_noise(found.steps[0].fit, found.last.fit)
    if noise is not None:
        return Verdict.EXPLAINED if noise else Verdict.UNKNOWN_EFFECT
    if decide_verdict(study, Search(found.steps[-1:]), unknown) is Verdict.EXPLAINED:
        return Verdict.EXPLAINED  # coloured noise
    shapeless = unknown is None or not unknown.significant
    near = found.last.fit.chi2_per_sample < study.settings.noise.stated_chi2
    little = (
        len(found.steps) > 1
        and study.explained_share(found.steps[0].fit, found.last.fit) > study.settings.verdict.explained_at_noise
    )
    return Verdict.EXPLAINED if shapeless and little and near else Verdict.UNKNOWN_EFFECT


def changed_links_of_fit(study: Study, fit: Fit) -> tuple["LinkInertiaChange", ...]:
    """Links whose mass, centre or inertia a fit has changed; empty for a model without links."""
    problem, certain = fit.problem, uncertainty(study, fit)
    own = problem.unknowns_of_run(0)  # links are the same in every run
    of_all, alone = (matrix[np.ix_(own, own)] for matrix in (certain.covariance, certain.covariance_without_priors))
    return problem.model.link_inertia_changes(problem.theta(0, fit.values), of_all, alone, fit.free[own])
